//! How well a fit follows its measurements.

use super::chart::{ProvenanceBody, SkillBody};
use super::extract::Asked as Query;
use super::negotiate::rendered;
use super::problem::{ApiError, Problems};
use super::shared::{Shared, shared_body};
use crate::service::catalogue::windows::Format;
use crate::service::query::diagnostics;
use axum::extract::{Path, State};
use axum::response::Response;
use lampyris_core::diagnose::failures::{DayOfErrors, Episode};
use lampyris_core::diagnose::spectrum::{InputLag, Spectrum};
use lampyris_core::estimate::assess::regimes::Regime;
use serde::Deserialize;
use std::collections::HashMap;
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_diagnostics))
}

/// Which output is looked at closely.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct DiagnosticsQuery {
    /// An output of the model, such as `S_NH_e`; the first one by default. Skill is told of all of them in
    /// any case.
    #[param(example = "T_room")]
    output: Option<String>,
}

/// How well a fit follows its measurements.
#[derive(Debug, ToSchema)]
#[schema(as = Diagnostics)]
#[expect(dead_code, reason = "describes what `query::diagnostics` writes; a test keeps the two alike")]
struct DiagnosticsBody {
    fit: String,
    system: String,
    model: String,
    /// What the numbers say, in plain sentences.
    summary: String,
    provenance: ProvenanceBody,
    /// The free run of each output in the parts of the fit's window.
    skill: HashMap<String, PartSkillBody>,
    /// The part that `by_horizon` was judged on: `validation`, or `train` where nothing else is there.
    judged_on: String,
    /// The skill of each output 1, 6 and 24 hours ahead and of its free run, beside persistence.
    by_horizon: HashMap<String, Vec<HorizonSkillBody>>,
    /// The output that the summary and all that follows is about, as asked for; the first one where none was.
    output: String,
    /// Free-run error over the deviation of the noise that is left in it, by output; above 1.6 something
    /// physical is probably missing.
    rho: HashMap<String, Option<f64>>,
    /// Root mean square of the one-step innovations, by output.
    noise_floor: HashMap<String, Option<f64>>,
    /// The free run of the output by circumstances, over the fit's window and in the light of all channels,
    /// the most telling first. All errors are measured minus simulated.
    by_regime: Vec<Regime>,
    /// Its mean error by day and hour of the local clock.
    hour_by_date: Vec<DayOfErrors>,
    /// Its worst six hours, several times, with the channels that are unusual then.
    episodes: Vec<Episode>,
    /// Its residual against each measured channel, with the lag at which they go together most.
    residual_by_input: Vec<InputLag>,
    /// Autocorrelation and cumulated periodogram of the one-step innovations.
    innovations: Spectrum,
}

/// The free run of one output by part.
#[derive(Debug, ToSchema)]
#[schema(as = PartSkill)]
#[expect(dead_code, reason = "describes `estimate::skill::PartSkill`")]
struct PartSkillBody {
    /// Unit of the errors.
    unit: String,
    train: Option<SkillBody>,
    validation: Option<SkillBody>,
    test: Option<SkillBody>,
}

/// The skill at one horizon.
#[derive(Debug, ToSchema)]
#[schema(as = HorizonSkill)]
#[expect(dead_code, reason = "describes `estimate::skill::HorizonSkill`")]
struct HorizonSkillBody {
    /// `PT1H`, `PT6H`, `PT24H` or `free_run`.
    horizon: String,
    n: u64,
    bias: f64,
    rmse: f64,
    urmse: f64,
    mae: f64,
    r2: Option<f64>,
    /// The error of the value measured at the origin, held, on the same samples.
    persistence_rmse: Option<f64>,
}

/// How well a fit follows its measurements: skill by part and by horizon, and what it means.
#[utoipa::path(
    get,
    path = "/fits/{id}/diagnostics",
    tag = "fits",
    params(("id" = String, Path), DiagnosticsQuery),
    responses((status = 200, body = DiagnosticsBody), Problems)
)]
async fn get_diagnostics(
    State(service): State<Shared>,
    Path(id): Path<String>,
    Query(query): Query<DiagnosticsQuery>,
) -> Result<Response, ApiError> {
    Ok(rendered(Format::Json, shared_body(diagnostics::diagnostics(&service, &id, query.output).await?)))
}
