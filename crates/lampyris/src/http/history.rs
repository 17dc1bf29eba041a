//! What was served before, and what an operator keeps in service.

use super::access::Caller;
use super::extract::{Asked, Empty, Json, Named};
use super::page::{Page, PageQuery};
use super::problem::{ApiError, PROBLEM_JSON, Problem, Problems};
use super::shared::Shared;
use crate::service::catalogue::systems;
use crate::service::serving::body::Body as ParamsBody;
use crate::service::serving::decisions::{self, PinBody};
use crate::store;
use crate::store::revisions::{Cause, Revision};
use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use lampyris_core::estimate::gate::served::ServedError;
use lampyris_core::model::ModelId;
use serde::Serialize;
use serde_json::Value;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_history)).routes(routes!(put_pin, delete_pin))
}

/// A set that is or was served.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Revision)]
struct RevisionAnswer {
    /// Its number; a system's revisions count up by one and never go back.
    revision: i64,
    /// Whether it is served now.
    current: bool,
    /// How it came to be served: `accepted` by the gate, `promoted` or `pinned` by an operator.
    #[schema(value_type = String, example = "accepted")]
    cause: Cause,
    /// The operator's reason, where there was one.
    reason: Option<String>,
    /// The fit behind it.
    fit: String,
    /// The job that found the fit.
    job: String,
    /// The gate's verdict on the fit.
    verdict: String,
    /// The verdict in a sentence.
    summary: String,
    /// The model.
    #[schema(value_type = ModelId)]
    model: Value,
    /// Values by name.
    #[schema(value_type = HashMap<String, f64>)]
    parameters: Value,
    /// 95 % confidence intervals by name.
    #[schema(value_type = HashMap<String, Option<[f64; 2]>>)]
    ci95: Value,
    /// What the controller was told beside.
    #[schema(value_type = Vec<String>)]
    flags: Value,
    /// Errors by output channel.
    #[schema(value_type = HashMap<String, ServedError>)]
    error: Value,
    /// First instant of the measurements.
    #[schema(format = DateTime)]
    from: String,
    /// Last instant.
    #[schema(format = DateTime)]
    to: String,
    /// When the fit was found.
    #[schema(value_type = String, format = DateTime)]
    fitted_at: Timestamp,
    /// When a gate last found it fit to be served.
    #[schema(value_type = String, format = DateTime)]
    validated_at: Timestamp,
    /// When it was published.
    #[schema(value_type = String, format = DateTime)]
    published_at: Timestamp,
}

impl RevisionAnswer {
    fn of(mut record: Revision) -> Self {
        let mut served = |field: &str| record.served.get_mut(field).map(Value::take).unwrap_or_default();
        Self {
            model: served("model"),
            parameters: served("parameters"),
            ci95: served("ci95"),
            flags: served("flags"),
            error: served("error"),
            revision: record.revision,
            current: record.current,
            cause: record.cause,
            reason: record.reason,
            fit: record.fit,
            job: record.job,
            verdict: record.verdict,
            summary: record.summary,
            from: record.window_from,
            to: record.window_to,
            fitted_at: record.fitted_at,
            validated_at: record.validated_at,
            published_at: record.published_at,
        }
    }
}

/// Everything that a system ever served, newest first, with verdicts and operators' reasons.
#[utoipa::path(
    get,
    path = "/params/{kind}/{id}/history",
    tag = "params",
    params(("kind" = String, Path), ("id" = String, Path), PageQuery),
    responses((status = 200, body = Page<RevisionAnswer>), Problems)
)]
async fn get_history(
    State(service): State<Shared>,
    Named(system): Named,
    Asked(page): Asked<PageQuery>,
) -> Result<axum::Json<Page<RevisionAnswer>>, ApiError> {
    systems::require(&service, &system).await?;
    let size = page.size()?;
    let records = store::revisions::page(&service.store, &system, page.before()?, size + 1).await?;
    Ok(axum::Json(Page::of(records, size, |record| record.revision.to_string(), RevisionAnswer::of)))
}

/// Keeps a set in service until the pin is taken away: what is served now, or an earlier fit to roll back to.
///
/// The pin makes a new revision that names the old fit. Fits that the gate accepts meanwhile are suggested,
/// not published.
#[utoipa::path(
    put,
    path = "/params/{kind}/{id}/pin",
    tag = "params",
    params(("kind" = String, Path), ("id" = String, Path)),
    request_body = PinBody,
    responses(
        (status = 200, description = "What is served now", body = ParamsBody),
        (
            status = 409,
            description = "`never-served`: the system has never served this fit",
            body = Problem,
            content_type = PROBLEM_JSON
        ),
        Problems,
    )
)]
async fn put_pin(
    State(service): State<Shared>,
    caller: Caller,
    Named(system): Named,
    body: Json,
) -> Result<Response, ApiError> {
    decisions::pin(&service, &system, body.value, caller.name()).await?;
    let entry = service
        .params
        .entry(&system.to_string())
        .ok_or_else(|| ApiError::NotFound("system", system.to_string()))?;
    let served =
        entry.validated().ok_or_else(|| ApiError::Internal("a pinned system serves nothing".into()))?;
    let mut response = Body::from(Bytes::copy_from_slice(&served.body)).into_response();
    response.headers_mut().insert(header::CONTENT_TYPE, HeaderValue::from_static("application/json"));
    Ok(response)
}

/// Takes a pin away. What is served stays until the next accepted fit; without a pin nothing changes.
#[utoipa::path(
    delete,
    path = "/params/{kind}/{id}/pin",
    tag = "params",
    params(("kind" = String, Path), ("id" = String, Path)),
    responses((status = 204, description = "There is no pin any more"), Problems)
)]
async fn delete_pin(
    State(service): State<Shared>,
    caller: Caller,
    Named(system): Named,
    _body: Empty,
) -> Result<StatusCode, ApiError> {
    decisions::unpin(&service, &system, caller.name()).await?;
    Ok(StatusCode::NO_CONTENT)
}
