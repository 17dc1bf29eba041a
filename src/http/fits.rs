//! What was found, and what the gate says of it.

use super::Shared;
use super::problem::{ApiError, Problems};
use crate::estimate::Fit;
use crate::store;
use axum::extract::{Path, State};
use jiff::Timestamp;
use serde::Serialize;
use serde_json::Value;
use std::collections::HashMap;
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
struct FitAnswer {
    id: String,
    /// The job that found it.
    job: String,
    /// The system.
    system: String,
    /// `accepted`, `unchanged`, `held` or `rejected`.
    verdict: String,
    /// The verdict in a sentence.
    summary: String,
    /// Every check: name, statistic, operator, threshold, unit, pass, comment.
    #[schema(value_type = Vec<Object>)]
    checks: Value,
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
    #[serde(flatten)]
    #[schema(value_type = FitBody)]
    fit: Fit,
}

/// What was found.
#[derive(Debug, ToSchema)]
#[expect(dead_code, reason = "describes `estimate::Fit`, which knows nothing of HTTP")]
struct FitBody {
    /// The model.
    model: String,
    /// Hash of its content.
    model_hash: String,
    /// What was left out because its channels are not there.
    dropped: Vec<String>,
    /// Value, unit, ci95, bounds, at_bound and fixed by name.
    #[schema(value_type = HashMap<String, Object>)]
    parameters: HashMap<String, Value>,
    /// Pairs that the data can hardly tell apart.
    #[schema(value_type = Vec<Object>)]
    correlated: Vec<Value>,
    /// The name of the optimiser.
    method: String,
    /// The objective: `mse`, `swmse` or `nmse`.
    objective: String,
    /// The best cost.
    cost: f64,
    /// Why the search ended.
    stopped_by: String,
    /// The seed of the search.
    seed: u64,
    /// Single-candidate simulations.
    evaluations: u64,
    /// The best cost after so many evaluations.
    #[schema(value_type = Vec<Object>)]
    trace: Vec<Value>,
    /// Errors by output channel.
    #[schema(value_type = HashMap<String, Object>)]
    metrics: HashMap<String, Value>,
    /// The parts of the window.
    #[schema(value_type = Object)]
    parts: Value,
    /// Hash of the stitched input.
    input_hash: String,
    /// What a user should know.
    remarks: Vec<String>,
    /// Parameters that were fixed because the data do not determine them.
    non_identifiable: Vec<String>,
}

/// One fit.
#[utoipa::path(get, path = "/fits/{id}", tag = "fits", params(("id" = String, Path)), responses((status = 200, body = FitAnswer), Problems))]
async fn get_fit(State(service): State<Shared>, Path(id): Path<String>) -> Result<axum::Json<FitAnswer>, ApiError> {
    let record = store::fits::get(&service.store, &id).await?.ok_or(ApiError::NotFound("fit", id))?;
    Ok(axum::Json(FitAnswer {
        id: record.id,
        job: record.job,
        system: record.system.to_string(),
        verdict: record.verdict,
        summary: record.summary,
        checks: record.checks,
        created_at: record.created_at,
        fit: record.fit,
    }))
}
