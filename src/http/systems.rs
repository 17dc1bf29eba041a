//! Rooms and plants.

use super::Shared;
use super::description::With;
use super::extract::{Asked, Json, Named};
use super::page::{Page, PageQuery};
use super::problem::{ApiError, Problems};
use crate::data::SystemId;
use crate::jobs::params::Status;
use crate::jobs::systems::{self, SystemDocument, document};
use crate::model::ModelId;
use crate::store;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_system, put_system, delete_system)).routes(routes!(list_systems)).routes(routes!(get_state))
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
    /// The model whose fits are served.
    model: ModelId,
    /// How much to trust what is served; `null` where nothing was ever validated.
    status: Option<Status>,
    /// The revision that is served.
    revision: Option<i64>,
    /// The newest job.
    latest_job: Option<String>,
}

/// The states at the newest sample that a job has seen.
#[derive(Debug, ToSchema)]
#[expect(dead_code, reason = "describes a document whose fields are named by the model")]
struct StateAnswer {
    /// The instant of the sample.
    #[schema(format = DateTime)]
    at: String,
    /// Standard deviations by state.
    sd: std::collections::HashMap<String, f64>,
    /// The revision by whose parameters they were found.
    revision: i64,
}

/// All systems, one row each.
#[utoipa::path(get, path = "/systems", tag = "systems", params(PageQuery), responses((status = 200, body = Page<SystemRow>), Problems))]
async fn list_systems(State(service): State<Shared>, Asked(page): Asked<PageQuery>) -> Result<axum::Json<Page<SystemRow>>, ApiError> {
    let size = page.size()?;
    let after = page.page_token.unwrap_or_default();
    let records = store::systems::page(&service.store, &after, size + 1).await?;
    let row = |record: store::systems::SystemRecord| {
        let entry = service.params.entry(&record.system.to_string());
        let served = entry.as_ref().and_then(|entry| entry.validated());
        let latest_job = entry.as_ref().and_then(|entry| match &entry.answer {
            crate::jobs::params::Answer::NeverValidated { latest_job, .. } => latest_job.as_ref().map(|(id, _)| id.clone()),
            crate::jobs::params::Answer::Validated(_) => None,
        });
        SystemRow {
            status: served.map(|served| served.status),
            revision: served.and_then(|served| served.revision),
            label: document(&record.document).map(|document| document.label).unwrap_or_default(),
            model: record.model,
            latest_job,
            system: record.system,
        }
    };
    Ok(axum::Json(Page::of(records, size, |record| record.system.to_string(), row)))
}

/// One system.
#[utoipa::path(
    get,
    path = "/systems/{kind}/{id}",
    tag = "systems",
    params(("kind" = String, Path), ("id" = String, Path)),
    responses((status = 200, body = SystemAnswer), Problems)
)]
async fn get_system(State(service): State<Shared>, Named(system): Named) -> Result<axum::Json<SystemAnswer>, ApiError> {
    let document = systems::require(&service, &system).await?;
    Ok(axum::Json(With { own: SystemName { system }, document }))
}

/// Makes a system, or replaces its document.
#[utoipa::path(
    put,
    path = "/systems/{kind}/{id}",
    tag = "systems",
    params(("kind" = String, Path), ("id" = String, Path)),
    request_body = SystemDocument,
    responses((status = 200, description = "Replaced", body = SystemAnswer), (status = 201, description = "Made", body = SystemAnswer), Problems)
)]
async fn put_system(State(service): State<Shared>, Named(system): Named, body: Json) -> Result<Response, ApiError> {
    let (document, is_new) = systems::put(&service, &system, body.value).await?;
    let status = if is_new { StatusCode::CREATED } else { StatusCode::OK };
    let location = format!("/systems/{system}");
    Ok((status, [(header::LOCATION, location)], axum::Json(With { own: SystemName { system }, document })).into_response())
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

/// Deletes a system with everything that is its own: measurements, jobs, fits, revisions. `/params` then answers 404.
///
/// A system with fits or revisions, or on which others depend, goes only by `?force=true`; one whose jobs wait or
/// run does not go at all. Documents of other systems that name it stay as they are.
#[utoipa::path(
    delete,
    path = "/systems/{kind}/{id}",
    tag = "systems",
    params(("kind" = String, Path), ("id" = String, Path), DeleteQuery),
    responses(
        (status = 204, description = "It is gone"),
        (status = 409, description = "`system-busy`: `jobs` need it; `system-needed`: it has a history or `dependents`, and nobody forced it", body = super::problem::Problem, content_type = "application/problem+json"),
        Problems,
    )
)]
async fn delete_system(
    State(service): State<Shared>,
    Named(system): Named,
    Asked(query): Asked<DeleteQuery>,
) -> Result<StatusCode, ApiError> {
    systems::delete(&service, &system, query.force).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// The filtered states at the newest sample that a job has seen: what a controller needs beside the parameters.
#[utoipa::path(
    get,
    path = "/systems/{kind}/{id}/state",
    tag = "systems",
    params(("kind" = String, Path), ("id" = String, Path)),
    responses((status = 200, description = "The states by name, beside these fields", body = StateAnswer), Problems)
)]
async fn get_state(State(service): State<Shared>, Named(system): Named) -> Result<axum::Json<Value>, ApiError> {
    match store::params::state(&service.store, &system).await? {
        Some((revision, Value::Object(mut state))) => {
            state.insert("revision".to_owned(), revision.into());
            Ok(axum::Json(Value::Object(state)))
        }
        Some(_) => Err(ApiError::Internal("a stored state is no object".into())),
        None if service.params.entry(&system.to_string()).is_none() => Err(ApiError::NotFound("system", system.to_string())),
        None => Err(ApiError::NoState(system.to_string())),
    }
}
