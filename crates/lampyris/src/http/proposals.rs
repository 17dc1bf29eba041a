//! Terms that no catalogue has and that the model of a fit may be missing.

use super::negotiate::rendered;
use super::problem::{ApiError, Problems};
use super::shared::{Shared, shared_body};
use crate::service::catalogue::windows::Format;
use crate::service::query::proposals::{ProposalsDocument, of_fit};
use axum::extract::{Path, State};
use axum::response::Response;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_proposals))
}

/// Terms that the model of a fit may be missing: at most three, each as a sentence, an equation and a
/// document that `POST /effects` takes.
///
/// Some thousands of terms of everything that was measured are tried, which takes seconds, and minutes on a
/// busy machine; the search ends when nobody waits for it any more. What is proposed explains more of the
/// error over the next 12 h than the best of as many does on the room's own errors shifted by whole days,
/// also beside parameters of its own.
#[utoipa::path(
    get,
    path = "/fits/{id}/proposals",
    tag = "fits",
    params(("id" = String, Path)),
    responses((status = 200, body = ProposalsDocument<'static>), Problems)
)]
async fn get_proposals(State(service): State<Shared>, Path(id): Path<String>) -> Result<Response, ApiError> {
    Ok(rendered(Format::Json, shared_body(of_fit(&service, &id).await?)))
}
