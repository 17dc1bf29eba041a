//! Rooms and plants.

use super::access::Caller;
use super::conditions::{self, is_known};
use super::description::With;
use super::extract::{Asked, Json, Named};
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use crate::service::catalogue::system::SystemDocument;
use crate::service::catalogue::systems;
use crate::service::serving::body::tag_of;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};
use lampyris_core::data::SystemId;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_system, put_system, delete_system))
}

/// A system with its name.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = SystemAnswer)]
struct SystemName {
    /// Its name.
    system: SystemId,
}

type SystemAnswer = With<SystemName, SystemDocument>;

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
