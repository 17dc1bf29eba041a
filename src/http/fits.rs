//! What was found, and what the gate says of it.

use super::Shared;
use super::description::With;
use super::problem::{ApiError, Problems};
use crate::data::SystemId;
use crate::estimate::Fit;
use crate::estimate::validate::CheckResult;
use crate::store;
use axum::extract::{Path, State};
use jiff::Timestamp;
use serde::Serialize;
use serde_json::Value;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_fit))
}

/// A fit with its verdict.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Fit)]
struct FitVerdict {
    id: String,
    /// The job that found it.
    job: String,
    /// The system.
    system: SystemId,
    /// `accepted`, `unchanged`, `held` or `rejected`.
    verdict: String,
    /// The verdict in a sentence.
    summary: String,
    /// Every check of the gate.
    #[schema(value_type = Vec<CheckResult>)]
    checks: Value,
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
}

type FitAnswer = With<FitVerdict, Fit>;

/// One fit.
#[utoipa::path(get, path = "/fits/{id}", tag = "fits", params(("id" = String, Path)), responses((status = 200, body = FitAnswer), Problems))]
async fn get_fit(State(service): State<Shared>, Path(id): Path<String>) -> Result<axum::Json<FitAnswer>, ApiError> {
    let record = store::fits::get(&service.store, &id).await?.ok_or(ApiError::NotFound("fit", id))?;
    let own = FitVerdict {
        id: record.id,
        job: record.job,
        system: record.system,
        verdict: record.verdict,
        summary: record.summary,
        checks: record.checks,
        created_at: record.created_at,
    };
    Ok(axum::Json(With { own, document: record.fit }))
}
