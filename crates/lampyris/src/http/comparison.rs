//! Fits beside the measurements, for charts and spreadsheets.

use super::access::Caller;
use super::extract::Asked as Query;
use super::negotiate::{Wanted, rendered};
use super::problem::{ApiError, PROBLEM_JSON, Problem, Problems};
use super::shared::{Shared, shared_body};
use crate::service::catalogue::windows::Format;
use crate::service::query::chart::{ComparedDocument, ComparisonDocument};
use crate::service::query::comparison::{self, MOST_FITS};
use crate::service::query::subject::ComparisonAsked;
use axum::extract::{Path, State};
use axum::response::Response;
use lampyris_core::data::{Duration, Length, read_time};
use lampyris_core::fault::{Fault, nearest};
use serde::Deserialize;
use std::collections::HashSet;
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// Points of a line where nothing else is asked.
const DEFAULT_POINTS: usize = 2_000;
/// Most points of a line.
const MOST_POINTS: usize = 20_000;
/// The longest forecast.
const LONGEST_HORIZON: Duration = Duration::from_days(7);
const MODES: [&str; 2] = ["free_run", "ahead"];

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_comparison)).routes(routes!(get_compare))
}

/// What is to be shown of a fit.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct ComparisonQuery {
    /// First instant, RFC 3339; the start of the fit's window by default. A fit says nothing about earlier
    /// times.
    #[param(format = DateTime)]
    from: Option<String>,
    /// Last instant; the end of the fit's window by default. The run goes on over newer measurements.
    #[param(format = DateTime)]
    to: Option<String>,
    /// `free_run` (the default): one simulation from the start of the fit's window. `ahead`: at each sample
    /// the forecast made `horizon` before, from re-estimated states and with measured inputs.
    #[param(value_type = Option<ComparisonMode>, inline)]
    mode: Option<String>,
    /// How far ahead, PT24H by default, at most P7D; a multiple of the step between samples.
    #[param(value_type = Option<Length>, example = "PT6H")]
    horizon: Option<String>,
    /// Most points of a line, 2000 by default, at most 20000. Longer lines are thinned to their extremes.
    #[param(value_type = Option<u32>, minimum = 1, maximum = 20_000)]
    max_points: Option<String>,
}

/// What is to be shown of several fits.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct CompareQuery {
    /// Fits of one system, separated by commas, at most 8.
    #[param(
        value_type = String,
        pattern = "^[A-Za-z0-9_]{1,64}(,[A-Za-z0-9_]{1,64}){0,7}$",
        example = "fit_a,fit_b"
    )]
    fits: Option<String>,
    /// First instant, RFC 3339; the latest start of a fit's window by default, and never earlier.
    #[param(format = DateTime)]
    from: Option<String>,
    /// Last instant; the latest end of a fit's window by default.
    #[param(format = DateTime)]
    to: Option<String>,
    /// `free_run` (the default) or `ahead`: which series are shown. The table of errors has both.
    #[param(value_type = Option<ComparisonMode>, inline)]
    mode: Option<String>,
    /// How far ahead, PT24H by default, at most P7D; a multiple of every fit's step.
    #[param(value_type = Option<Length>, example = "PT6H")]
    horizon: Option<String>,
    /// Most points of a line, 2000 by default, at most 20000.
    #[param(value_type = Option<u32>, minimum = 1, maximum = 20_000)]
    max_points: Option<String>,
}

/// Which simulation is shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ToSchema)]
#[serde(rename_all = "snake_case")]
enum ComparisonMode {
    FreeRun,
    Ahead,
}

impl ComparisonQuery {
    /// The question, or every fault in it.
    fn read(&self, format: Format, faults: &mut Vec<Fault>) -> ComparisonAsked {
        let mode = match self.mode.as_deref() {
            None | Some("free_run") => ComparisonMode::FreeRun,
            Some("ahead") => ComparisonMode::Ahead,
            Some(other) => {
                let detail = format!("`{}` is none of {}", shown(other), MODES.join(", "));
                let fault = Fault::new("query mode", "unknown-value", detail);
                faults.push(match nearest(other, MODES) {
                    Some(near) => fault.suggest(format!("did you mean `{near}`?")),
                    None => fault,
                });
                // Whatever was meant, a horizon is judged for itself.
                ComparisonMode::Ahead
            }
        };
        let ahead = mode == ComparisonMode::Ahead;
        let horizon = match self.horizon.as_deref().map(str::parse::<Duration>) {
            None => Duration::from_hours(24),
            Some(Ok(horizon)) => horizon,
            Some(Err(error)) => {
                faults.push(Fault::new("query horizon", "invalid-duration", error.to_string()));
                Duration::from_hours(24)
            }
        };
        if horizon.is_zero() || horizon > LONGEST_HORIZON {
            faults.push(Fault::new(
                "query horizon",
                "invalid-range",
                format!("a forecast looks ahead by up to {LONGEST_HORIZON}, and by more than nothing"),
            ));
        }
        if self.horizon.is_some() && !ahead {
            faults.push(
                Fault::new("query horizon", "contradiction", "a free run has no horizon")
                    .suggest("mode=ahead"),
            );
        }
        let mut instant = |field: &str, text: &Option<String>| {
            text.as_ref().and_then(|text| {
                read_time(&format!("query {field}"), text).map_err(|fault| faults.push(fault)).ok()
            })
        };
        let (from, to) = (instant("from", &self.from), instant("to", &self.to));
        if let (Some(from), Some(to)) = (from, to)
            && from > to
        {
            faults.push(Fault::new("query to", "out-of-order", "the range ends before it starts"));
        }
        let max_points = match self.max_points.as_deref().map(str::parse::<usize>) {
            None => DEFAULT_POINTS,
            Some(Ok(points)) if (1..=MOST_POINTS).contains(&points) => points,
            Some(_) => {
                faults.push(Fault::new(
                    "query max_points",
                    "out-of-range",
                    format!("a line has between 1 and {MOST_POINTS} points"),
                ));
                DEFAULT_POINTS
            }
        };
        ComparisonAsked { horizon: ahead.then_some(horizon), from, to, max_points, format }
    }
}

/// The ids of a list that names each once.
fn read_fits(text: Option<&str>, faults: &mut Vec<Fault>) -> Vec<String> {
    let ids: Vec<String> = text
        .unwrap_or_default()
        .split(',')
        .map(str::trim)
        .filter(|id| !id.is_empty())
        .map(str::to_owned)
        .collect();
    if ids.is_empty() {
        faults.push(Fault::new("query fits", "missing-field", "no fit is named").suggest("fits=fit_a,fit_b"));
    }
    if ids.len() > MOST_FITS {
        faults.push(Fault::new(
            "query fits",
            "out-of-range",
            format!("{} fits are named, {MOST_FITS} are the most", ids.len()),
        ));
    }
    let mut seen = HashSet::new();
    for twice in ids.iter().filter(|id| !seen.insert(id.as_str())) {
        faults.push(Fault::new("query fits", "named-twice", format!("`{}` is named twice", shown(twice))));
    }
    ids
}

fn shown(text: &str) -> String {
    text.chars().take(40).collect::<String>().escape_debug().to_string()
}

/// A fit beside the measurements: measured, simulated, residual and inputs. The free run is the one that the
/// stored errors were computed from. As CSV one column per line, with units in the header.
#[utoipa::path(
    get,
    path = "/fits/{id}/comparison",
    tag = "fits",
    params(("id" = String, Path), ComparisonQuery),
    responses(
        (status = 200, content((ComparisonDocument<'static> = "application/json"), (String = "text/csv"))),
        (
            status = 406,
            description = "Neither of the two forms is acceptable",
            body = Problem,
            content_type = PROBLEM_JSON
        ),
        Problems
    )
)]
async fn get_comparison(
    State(service): State<Shared>,
    Path(id): Path<String>,
    Wanted(format): Wanted,
    Query(query): Query<ComparisonQuery>,
) -> Result<Response, ApiError> {
    let mut faults = Vec::new();
    let asked = query.read(format, &mut faults);
    if !faults.is_empty() {
        return Err(ApiError::Invalid(faults));
    }
    Ok(rendered(format, shared_body(comparison::one(&service, &id, &asked).await?)))
}

/// Several fits of one system on one window: the same times, and a table of errors on the same samples. The
/// first time is never earlier than the latest start of a fit's window.
#[utoipa::path(
    get,
    path = "/compare",
    tag = "fits",
    params(CompareQuery),
    responses(
        (status = 200, content((ComparedDocument<'static> = "application/json"), (String = "text/csv"))),
        (
            status = 406,
            description = "Neither of the two forms is acceptable",
            body = Problem,
            content_type = PROBLEM_JSON
        ),
        Problems
    )
)]
async fn get_compare(
    State(service): State<Shared>,
    caller: Caller,
    Wanted(format): Wanted,
    Query(query): Query<CompareQuery>,
) -> Result<Response, ApiError> {
    let mut faults = Vec::new();
    let ids = read_fits(query.fits.as_deref(), &mut faults);
    let CompareQuery { from, to, mode, horizon, max_points, .. } = query;
    let asked = ComparisonQuery { from, to, mode, horizon, max_points }.read(format, &mut faults);
    if !faults.is_empty() {
        return Err(ApiError::Invalid(faults));
    }
    Ok(rendered(format, shared_body(comparison::several(&service, caller.reach(), &ids, &asked).await?)))
}
