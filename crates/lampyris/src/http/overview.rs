//! All systems, a row each: what it is, how it fares, and what to do about it.

use super::access::Caller;
use super::extract::Asked;
use super::page::{Page, PageQuery};
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use crate::service::catalogue::system::document;
use crate::service::serving::body::Status;
use crate::service::serving::health::{
    Facts, Health, NextStep, Served, SystemHealth, ahead, health_of, health_of_site, worst_output,
};
use crate::service::{Service, blocking};
use crate::store;
use crate::store::StoreError;
use crate::store::fits::ListedFit;
use crate::store::jobs::{JobRecord, JobStatus, Outcome};
use crate::store::overview::Overview;
use crate::store::systems::SystemRecord;
use axum::extract::State;
use indexmap::IndexMap;
use jiff::Timestamp;
use lampyris_core::data::{Duration, SystemId};
use lampyris_core::estimate::gate::served::ServedError;
use lampyris_core::fault::Fault;
use lampyris_core::model::ModelId;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// Most systems that one request may name.
const MOST_NAMED: usize = 100;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(list_systems))
}

/// Which systems, and what of them.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct OverviewQuery {
    /// Only these, with commas between them: at most 100, all on one page.
    #[param(example = "room/4,room/5")]
    systems: Option<String>,
    /// `trend`: the last validation errors as well.
    #[param(inline)]
    with: Option<RowExtra>,
    /// Items per page, 50 by default, at most 500.
    #[param(minimum = 1, maximum = 500)]
    page_size: Option<i64>,
    /// The `next_page_token` of the page before.
    page_token: Option<String>,
}

/// What rows have where it is asked for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
enum RowExtra {
    /// The last validation errors.
    Trend,
}

/// One system in a list: what it is and how it fares.
#[derive(Debug, Serialize, ToSchema)]
struct SystemRow {
    /// Its name.
    system: SystemId,
    /// A name for people.
    label: String,
    /// Where people look for it, the levels with `/` between them; empty where nobody has said it.
    group: String,
    /// The model whose fits are served; `null` of a site that only holds measurements.
    model: Option<ModelId>,
    /// How it fares.
    health: Health,
    /// Why, in a sentence.
    why: String,
    /// What to do about it.
    next: NextStep,
    /// How much to trust what is served; `null` where nothing was ever validated.
    status: Option<Status>,
    /// The revision that is served.
    revision: Option<i64>,
    /// Errors of what is served, by output.
    #[schema(value_type = HashMap<String, RowError>)]
    error: IndexMap<String, RowError>,
    /// The output that fares worst of what is served; where nothing is, of the newest fit of the model.
    quality: Option<Quality>,
    /// The validation errors of the first output, of the last 14 fits of the model that are no experiments
    /// and kept no test part aside, the newest at the end; only `with=trend`.
    #[serde(skip_serializing_if = "Option::is_none")]
    trend: Option<Vec<f64>>,
    /// What the gate wants said of it.
    flags: Vec<String>,
    /// When it was found.
    #[schema(value_type = Option<String>, format = DateTime)]
    fitted_at: Option<Timestamp>,
    /// When the gate last found it fit to be served.
    #[schema(value_type = Option<String>, format = DateTime)]
    validated_at: Option<Timestamp>,
    /// Seconds since then.
    age_s: Option<i64>,
    /// When it turns stale.
    #[schema(value_type = Option<String>, format = DateTime)]
    stale_after: Option<Timestamp>,
    /// The newest sample.
    #[schema(value_type = Option<String>, format = DateTime)]
    measured_to: Option<Timestamp>,
    /// The newest job of any kind.
    latest_job: Option<String>,
    /// Where that job stands.
    latest_state: Option<JobStatus>,
    /// What it led to.
    latest_outcome: Option<Outcome>,
    /// In which circumstances that fit fails most, in a sentence; `null` where none stand out.
    worst_regime: Option<String>,
}

/// The errors of one output on data that the search has not seen.
#[derive(Debug, Serialize, ToSchema)]
struct RowError {
    /// Unit of the errors.
    unit: String,
    /// Of a free run.
    validation_rmse: Option<f64>,
    /// The horizon of the policy, or the longest known one below it.
    #[schema(example = "PT6H")]
    horizon: Option<String>,
    /// Of forecasts at that horizon.
    ahead: Option<f64>,
}

/// How good a fit is, by the output that fares worst.
#[derive(Debug, Serialize, ToSchema)]
struct Quality {
    /// That output.
    output: String,
    /// How many there are.
    outputs: usize,
    /// Unit of the errors.
    unit: String,
    /// The error of a free run over data that the search has not seen.
    validation_rmse: Option<f64>,
    /// The horizon of the policy, or the longest known one below it.
    #[schema(example = "PT6H")]
    horizon: Option<String>,
    /// The error of forecasts at that horizon.
    ahead: Option<f64>,
    /// The same for the last measurement, held.
    persistence: Option<f64>,
    /// Root mean square of the one-step innovations.
    noise_floor: Option<f64>,
    /// How many times the error is what noise would leave.
    rho: Option<f64>,
}

impl Quality {
    fn of(fit: &ListedFit, horizon: Duration) -> Option<Self> {
        let (output, metrics) = worst_output(&fit.metrics)?;
        let (name, error) = ahead(&metrics.ahead, horizon).unzip();
        Some(Self {
            output: output.to_owned(),
            outputs: fit.metrics.len(),
            unit: metrics.unit.clone(),
            validation_rmse: metrics.validation_rmse,
            horizon: name.map(str::to_owned),
            ahead: error.map(|error| error.rmse),
            persistence: error.map(|error| error.persistence),
            noise_floor: metrics.noise_floor,
            rho: metrics.rho,
        })
    }
}

/// What is read of a page of systems.
struct ReadPage {
    newest: HashMap<SystemId, JobRecord>,
    overview: Overview,
    trends: Option<HashMap<String, Vec<f64>>>,
}

impl ReadPage {
    async fn of(service: &Service, records: &[SystemRecord], with_trend: bool) -> Result<Self, StoreError> {
        let names: Vec<String> = records.iter().map(|record| record.system.to_string()).collect();
        let newest = store::jobs::newest(&service.store, &names).await?;
        Ok(Self {
            newest: newest.into_iter().map(|job| (job.system.clone(), job)).collect(),
            overview: store::overview::read(&service.store, &names).await?,
            trends: match with_trend {
                true => Some(store::overview::trends(&service.store, &names).await?),
                false => None,
            },
        })
    }

    /// A row. Reading what was read is work for a blocking thread.
    fn row(&self, service: &Service, record: SystemRecord) -> Result<SystemRow, StoreError> {
        let system = record.system.to_string();
        let entry = service.params.entry(&system);
        let rendered = entry.as_ref().and_then(|entry| entry.validated());
        let served = rendered.and_then(Served::of);
        let newest = self.newest.get(&record.system);
        let fit = self.overview.fits.get(&system).map(|text| text.read()).transpose()?;
        let (label, group, policy) = document(&record.document)
            .map(|document| (document.label, document.group, document.policy))
            .unwrap_or_default();
        let facts = Facts {
            system: &record.system,
            served: served.as_ref(),
            newest,
            waits: self.overview.waiting.contains(&system),
            fit: fit.as_ref(),
            diagnosis: self.overview.diagnoses.get(&system),
            measured_to: self.overview.measured_to.get(&system).copied(),
            stale_after: policy.stale_after,
            now: service.now(),
        };
        let SystemHealth { health, why, next } = match &record.model {
            Some(_) => health_of(&facts),
            None => health_of_site(&facts),
        };
        let row_error = |error: &ServedError| {
            let (horizon, ahead) = ahead(&error.ahead, policy.horizon).unzip();
            RowError {
                unit: error.unit.clone(),
                validation_rmse: error.validation_rmse,
                horizon: horizon.map(str::to_owned),
                ahead: ahead.copied(),
            }
        };
        let errors = served.iter().flat_map(|served| &served.error);
        let validated_at = served.as_ref().and_then(|served| served.validated_at);
        let trend = |trends: &HashMap<String, Vec<f64>>| trends.get(&system).cloned().unwrap_or_default();
        Ok(SystemRow {
            label,
            group,
            model: record.model,
            health,
            why,
            next,
            status: rendered.map(|rendered| rendered.status),
            revision: rendered.and_then(|rendered| rendered.revision),
            error: errors.map(|(output, error)| (output.clone(), row_error(error))).collect(),
            quality: fit.as_ref().and_then(|fit| Quality::of(fit, policy.horizon)),
            trend: self.trends.as_ref().map(trend),
            fitted_at: served.as_ref().and_then(|served| served.fitted_at),
            validated_at,
            age_s: validated_at.map(|instant| service.now().duration_since(instant).as_secs().max(0)),
            stale_after: served.as_ref().and_then(|served| served.stale_after),
            measured_to: facts.measured_to,
            latest_state: newest.map(|job| job.state.status()),
            latest_outcome: newest.and_then(|job| job.state.outcome()),
            latest_job: newest.map(|job| job.id.clone()),
            worst_regime: fit.and_then(|fit| fit.worst_regime),
            flags: served.map(|served| served.flags).unwrap_or_default(),
            system: record.system,
        })
    }
}

/// The systems of a list of names.
fn named(text: &str) -> Result<Vec<SystemId>, ApiError> {
    let fault = |code, detail: String| {
        let fault = Fault::new("query systems", code, detail);
        ApiError::Invalid(vec![fault.suggest("such as `systems=room/4,room/5`")])
    };
    let named: Vec<SystemId> = text
        .split(',')
        .map(|name| name.trim().parse().map_err(|error| fault("invalid-name", format!("{error}"))))
        .collect::<Result<_, _>>()?;
    if named.len() > MOST_NAMED {
        let detail = format!("{} systems are named, {MOST_NAMED} are the most", named.len());
        return Err(fault("out-of-range", detail));
    }
    Ok(named)
}

/// All systems, one row each: health and why, the next step, error, status.
#[utoipa::path(
    get,
    path = "/systems",
    tag = "systems",
    params(OverviewQuery),
    responses((status = 200, body = Page<SystemRow>), Problems)
)]
async fn list_systems(
    State(service): State<Shared>,
    caller: Caller,
    Asked(query): Asked<OverviewQuery>,
) -> Result<axum::Json<Page<SystemRow>>, ApiError> {
    let page = PageQuery { page_size: query.page_size, page_token: query.page_token };
    let size = page.size()?;
    let (size, records) = match query.systems.as_deref().map(named).transpose()? {
        Some(named) => {
            (MOST_NAMED as i64, store::systems::some(&service.store, caller.reach(), &named).await?)
        }
        None => {
            let after = page.page_token.unwrap_or_default();
            (size, store::systems::page(&service.store, caller.reach(), &after, size + 1).await?)
        }
    };
    let read = ReadPage::of(&service, &records, query.with.is_some()).await?;
    let rows = blocking(move || {
        let rows = records.into_iter().map(|record| read.row(&service, record));
        rows.collect::<Result<Vec<_>, _>>()
    });
    let rows = rows.await??;
    Ok(axum::Json(Page::of(rows, size, |row| row.system.to_string(), |row| row)))
}
