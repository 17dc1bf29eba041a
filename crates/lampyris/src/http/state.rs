//! Where a system is now: what a controller starts its forecasts from.

use super::conditions::{is_known, not_modified, set_tag};
use super::extract::Named;
use super::problem::{ApiError, Problems};
use super::shared::{Shared, shared_body};
use super::waiting::newest;
use crate::service::serving::snapshot::Entry;
use crate::service::serving::states::StateBody;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::Response;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_state))
}

/// The states at the newest sample that the inputs lead to: what a controller needs beside the parameters.
/// They are filtered and go on with every live sample, or, of a model without a filter, those of a free run.
///
/// `If-None-Match` with the tag of the last answer gives 304 while nothing has changed; with `Prefer: wait=N`
/// the answer waits up to N seconds (60 at most) for newer states, or for the first.
#[utoipa::path(
    get,
    path = "/systems/{kind}/{id}/state",
    tag = "systems",
    params(
        ("kind" = String, Path),
        ("id" = String, Path),
        ("If-None-Match" = Option<String>, Header, description = "The tag of the last answer"),
        ("Prefer" = Option<String>, Header, description = "`wait=N`: wait up to N seconds for newer states"),
    ),
    responses(
        (status = 200, description = "The states", body = StateBody, headers(("ETag" = String))),
        (status = 304, description = "As they were"),
        Problems
    )
)]
async fn get_state(
    State(service): State<Shared>,
    Named(system): Named,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let name = system.to_string();
    let gone = || ApiError::NotFound("system", name.clone());
    let slot = service.params.slot(&name).ok_or_else(gone)?;
    let is_old = |entry: &Entry| entry.states.as_ref().is_none_or(|states| is_known(&headers, &states.etag));
    let entry = newest(&service, &name, slot, &headers, is_old).await.ok_or_else(gone)?;
    let states = entry.states.as_ref().ok_or_else(|| ApiError::NoState(name.clone()))?;
    if is_known(&headers, &states.etag) {
        return Ok(not_modified(&states.etag));
    }
    let mut response = Response::new(shared_body(states.body.clone()));
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("application/json"));
    set_tag(&mut response, &states.etag);
    Ok(response)
}
