//! An operator's word on a fit that waits for it.

use super::access::Caller;
use super::extract::Json;
use super::fits::{FitAnswer, answer};
use super::problem::{ApiError, PROBLEM_JSON, Problem, Problems};
use super::shared::Shared;
use crate::service::serving::decisions::{self, Reason};
use crate::store::decisions::Decision;
use axum::extract::{Path, State};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(promote_fit)).routes(routes!(reject_fit))
}

/// Serves a held or suggested fit. Nobody can promote one that the gate or an operator has rejected.
#[utoipa::path(
    post,
    path = "/fits/{id}/promote",
    tag = "fits",
    params(("id" = String, Path), ("Idempotency-Key" = Option<String>, Header)),
    request_body = Reason,
    responses(
        (status = 200, description = "It is served; promoting it twice changes nothing", body = FitAnswer),
        (status = 409, description = "`not-offered`, `already-decided`, `pinned` or `other-model`: it cannot \
            be served", body = Problem, content_type = PROBLEM_JSON),
        Problems,
    )
)]
async fn promote_fit(
    State(service): State<Shared>,
    caller: Caller,
    Path(id): Path<String>,
    body: Json,
) -> Result<axum::Json<FitAnswer>, ApiError> {
    decisions::decide(&service, &id, Decision::Promoted, body.value, body.key.as_ref(), caller.name())
        .await?;
    answer(&service, &id).await
}

/// Puts a held or suggested fit aside for good.
#[utoipa::path(
    post,
    path = "/fits/{id}/reject",
    tag = "fits",
    params(("id" = String, Path), ("Idempotency-Key" = Option<String>, Header)),
    request_body = Reason,
    responses(
        (
            status = 200,
            description = "It will never be served; rejecting it twice changes nothing",
            body = FitAnswer
        ),
        (
            status = 409,
            description = "`not-offered` or `already-decided`: it does not wait for a word",
            body = Problem,
            content_type = PROBLEM_JSON
        ),
        Problems,
    )
)]
async fn reject_fit(
    State(service): State<Shared>,
    caller: Caller,
    Path(id): Path<String>,
    body: Json,
) -> Result<axum::Json<FitAnswer>, ApiError> {
    decisions::decide(&service, &id, Decision::Rejected, body.value, body.key.as_ref(), caller.name())
        .await?;
    answer(&service, &id).await
}
