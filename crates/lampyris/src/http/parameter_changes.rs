//! Whether a parameter of a system has changed, since when and by how much.

use super::conditions::unless_known;
use super::extract::Named;
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use crate::service::query::parameter_changes::{SystemChanges, of_system};
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_changes))
}

/// Whether a parameter has changed within the newest six weeks, since when and by how much.
///
/// The record is looked at along the fit that is served, whose parameters need not be right: what is wrong
/// throughout is no change. At most one change is told, the surest.
#[utoipa::path(
    get,
    path = "/systems/{kind}/{id}/changes",
    tag = "systems",
    params(
        ("kind" = String, Path),
        ("id" = String, Path),
        ("If-None-Match" = Option<String>, Header, description = "The tag of the last answer"),
    ),
    responses(
        (status = 200, description = "The change", body = SystemChanges, headers(("ETag" = String))),
        (status = 304, description = "As it was"),
        Problems
    )
)]
async fn get_changes(
    State(service): State<Shared>,
    Named(system): Named,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    Ok(unless_known(&headers, "application/json", of_system(&service, &system).await?))
}
