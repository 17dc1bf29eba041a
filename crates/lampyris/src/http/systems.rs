//! Rooms and plants.

use super::access::Caller;
use super::conditions::{self, is_known};
use super::description::With;
use super::extract::{Asked, Json, Named};
use super::page::{Page, PageQuery};
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use crate::service::Service;
use crate::service::catalogue::system::{SystemDocument, document};
use crate::service::catalogue::systems;
use crate::service::serving::body::{Status, tag_of};
use crate::service::serving::health::{Health, Served, ahead, health};
use crate::store;
use crate::store::jobs::{JobRecord, JobStatus, Outcome};
use crate::store::systems::SystemRecord;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use indexmap::IndexMap;
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::estimate::gate::served::ServedError;
use lampyris_core::model::ModelId;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_system, put_system, delete_system)).routes(routes!(list_systems))
}

/// A system with its name.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = SystemAnswer)]
struct SystemName {
    /// Its name.
    system: SystemId,
}

type SystemAnswer = With<SystemName, SystemDocument>;

/// One system in a list: what it is and how it fares.
#[derive(Debug, Serialize, ToSchema)]
struct SystemRow {
    /// Its name.
    system: SystemId,
    /// A name for people.
    label: String,
    /// The model whose fits are served; `null` of a site that only holds measurements.
    model: Option<ModelId>,
    /// How it fares.
    health: Health,
    /// Why, in a sentence.
    why: String,
    /// How much to trust what is served; `null` where nothing was ever validated.
    status: Option<Status>,
    /// The revision that is served.
    revision: Option<i64>,
    /// Errors of what is served, by output.
    #[schema(value_type = HashMap<String, RowError>)]
    error: IndexMap<String, RowError>,
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
    /// The newest job of any kind.
    latest_job: Option<String>,
    /// Where that job stands.
    latest_state: Option<JobStatus>,
    /// What it led to.
    latest_outcome: Option<Outcome>,
    /// In which circumstances the served fit fails most, in a sentence; `null` where none stand out.
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

impl SystemRow {
    fn of(
        service: &Service,
        record: SystemRecord,
        newest: Option<JobRecord>,
        worst_regime: Option<String>,
    ) -> Self {
        let system = record.system.to_string();
        let entry = service.params.entry(&system);
        let rendered = entry.as_ref().and_then(|entry| entry.validated());
        let served = rendered.and_then(Served::of);
        let (health, why) = match &record.model {
            Some(_) => health(served.as_ref(), newest.as_ref()),
            None => (Health::Ok, "Its measurements are shared; there is nothing to estimate.".to_owned()),
        };
        let (label, horizon) = document(&record.document)
            .map(|document| (document.label, document.policy.horizon))
            .unwrap_or_default();
        let row_error = |error: &ServedError| {
            let (horizon, ahead) = ahead(error, horizon).unzip();
            RowError {
                unit: error.unit.clone(),
                validation_rmse: error.validation_rmse,
                horizon: horizon.map(str::to_owned),
                ahead,
            }
        };
        let errors = served
            .iter()
            .flat_map(|served| &served.error)
            .map(|(output, error)| (output.clone(), row_error(error)))
            .collect();
        let validated_at = served.as_ref().and_then(|served| served.validated_at);
        Self {
            label,
            model: record.model,
            health,
            why,
            status: rendered.map(|rendered| rendered.status),
            revision: rendered.and_then(|rendered| rendered.revision),
            error: errors,
            fitted_at: served.as_ref().and_then(|served| served.fitted_at),
            validated_at,
            age_s: validated_at.map(|instant| service.now().duration_since(instant).as_secs().max(0)),
            stale_after: served.as_ref().and_then(|served| served.stale_after),
            flags: served.map(|served| served.flags).unwrap_or_default(),
            latest_state: newest.as_ref().map(|job| job.state.status()),
            latest_outcome: newest.as_ref().and_then(|job| job.state.outcome()),
            latest_job: newest.map(|job| job.id),
            worst_regime,
            system: record.system,
        }
    }
}

/// All systems, one row each: health, error, status.
#[utoipa::path(
    get,
    path = "/systems",
    tag = "systems",
    params(PageQuery),
    responses((status = 200, body = Page<SystemRow>), Problems)
)]
async fn list_systems(
    State(service): State<Shared>,
    caller: Caller,
    Asked(page): Asked<PageQuery>,
) -> Result<axum::Json<Page<SystemRow>>, ApiError> {
    let size = page.size()?;
    let after = page.page_token.unwrap_or_default();
    let records = store::systems::page(&service.store, caller.reach(), &after, size + 1).await?;
    let names: Vec<String> = records.iter().map(|record| record.system.to_string()).collect();
    let newest = store::jobs::newest(&service.store, &names).await?;
    let worst = store::fits::worst_regimes(&service.store, &names).await?;
    let row = |record: SystemRecord| {
        let job = newest.iter().find(|job| job.system == record.system).cloned();
        let worst = worst.get(&record.system.to_string()).cloned();
        SystemRow::of(&service, record, job, worst)
    };
    Ok(axum::Json(Page::of(records, size, |record| record.system.to_string(), row)))
}

/// One system. Its tag says which document it has: with it in `If-Match` nobody else's change is overwritten.
#[utoipa::path(
    get,
    path = "/systems/{kind}/{id}",
    tag = "systems",
    params(("kind" = String, Path), ("id" = String, Path)),
    responses(
        (status = 200, body = SystemAnswer, headers(("ETag" = String))),
        (status = 304, description = "It is as it was"),
        Problems
    )
)]
async fn get_system(
    State(service): State<Shared>,
    Named(system): Named,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let document = systems::require(&service, &system).await?;
    let etag = etag_of(&document);
    if is_known(&headers, &etag) {
        return Ok((StatusCode::NOT_MODIFIED, [(header::ETAG, etag)]).into_response());
    }
    let answer = axum::Json(With { own: SystemName { system }, document });
    Ok(([(header::ETAG, etag)], answer).into_response())
}

/// The tag of a document of a system.
fn etag_of(document: &SystemDocument) -> String {
    // A document that was read can be written.
    tag_of(&serde_json::to_vec(document).unwrap_or_default())
}

/// Makes a system, or replaces its document.
///
/// With `If-None-Match: *` it is only made, with `If-Match` and the tag of a document only that one is
/// replaced.
#[utoipa::path(
    put,
    path = "/systems/{kind}/{id}",
    tag = "systems",
    params(
        ("kind" = String, Path),
        ("id" = String, Path),
        ("If-Match" = Option<String>, Header, description = "The tag of the document to be replaced"),
        ("If-None-Match" = Option<String>, Header, description = "`*`: there must be no such system"),
    ),
    request_body = SystemDocument,
    responses(
        (status = 200, description = "Replaced", body = SystemAnswer, headers(("ETag" = String))),
        (status = 201, description = "Made", body = SystemAnswer, headers(("ETag" = String))),
        (
            status = 412,
            description = "`not-as-expected`: there is such a system, or its document is another one",
            body = super::problem::Problem,
            content_type = "application/problem+json"
        ),
        Problems
    )
)]
async fn put_system(
    State(service): State<Shared>,
    caller: Caller,
    Named(system): Named,
    headers: HeaderMap,
    body: Json,
) -> Result<Response, ApiError> {
    let allows = |known: Option<&SystemDocument>| conditions::allow(&headers, known.map(etag_of).as_deref());
    let (document, is_new) = systems::put(&service, &system, body.value, caller.name(), allows).await?;
    let status = if is_new { StatusCode::CREATED } else { StatusCode::OK };
    let fields = [(header::LOCATION, format!("/systems/{system}")), (header::ETAG, etag_of(&document))];
    Ok((status, fields, axum::Json(With { own: SystemName { system }, document })).into_response())
}

/// Whether a deletion may take history along.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct DeleteQuery {
    /// Deletes fits and revisions, too, and a system that others name as a neighbour.
    #[serde(default)]
    force: bool,
}

/// Deletes a system with everything that is its own: measurements, jobs, fits, revisions. `/params` then
/// answers 404.
///
/// A system with fits or revisions, or on which others depend, goes only by `?force=true`; one whose jobs
/// wait or run does not go at all. Documents of other systems that name it stay as they are.
#[utoipa::path(
    delete,
    path = "/systems/{kind}/{id}",
    tag = "systems",
    params(("kind" = String, Path), ("id" = String, Path), DeleteQuery),
    responses(
        (status = 204, description = "It is gone"),
        (status = 409, description = "`system-busy`: `jobs` need it; `system-needed`: it has a history or \
            `dependents`, and nobody forced it", body = super::problem::Problem, content_type = "application/problem+json"),
        Problems,
    )
)]
async fn delete_system(
    State(service): State<Shared>,
    caller: Caller,
    Named(system): Named,
    Asked(query): Asked<DeleteQuery>,
) -> Result<StatusCode, ApiError> {
    systems::delete(&service, &system, query.force, caller.name()).await?;
    Ok(StatusCode::NO_CONTENT)
}
