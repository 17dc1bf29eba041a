//! What a model does: a short simulation for whoever edits it.

use super::access::Caller;
use super::extract::Json;
use super::negotiate::rendered;
use super::problem::{ApiError, Problems};
use super::shared::{Shared, shared_body};
use crate::service::catalogue::windows::Format;
use crate::service::query::preview::{self, Request};
use axum::extract::State;
use axum::response::Response;
use lampyris_core::estimate::assess::preview::Preview;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(preview_model))
}

/// Simulates a model once with nominal or given values. Nothing is kept.
///
/// Faults of a posted model name their places inside it (`/model/equations/T_r`), with line and column; so do
/// those of posted effects (`/effects/0/terms/T_r`). A model too large for its window is refused
/// (`too-expensive`).
#[utoipa::path(
    post,
    path = "/models/preview",
    tag = "models",
    request_body = Request,
    responses((status = 200, description = "What it does", body = Preview), Problems)
)]
async fn preview_model(
    State(service): State<Shared>,
    caller: Caller,
    body: Json,
) -> Result<Response, ApiError> {
    caller.may_name(&service, &body.value)?;
    let preview = preview::run(&service, body.value).await.map_err(ApiError::of_document)?;
    Ok(rendered(Format::Json, shared_body(preview)))
}
