//! What was found, and what the gate says of it.

use super::Shared;
use super::extract::Asked;
use super::page::{Page, PageQuery};
use super::problem::{ApiError, Problems};
use crate::data::SystemId;
use crate::estimate::Fit;
use crate::fault::Fault;
use crate::store;
use crate::store::fits::FitEntry;
use axum::extract::{Path, State};
use jiff::Timestamp;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::HashMap;
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(list_fits)).routes(routes!(get_fit))
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
    /// Every check of the gate.
    #[schema(value_type = Vec<CheckBody>)]
    checks: Value,
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
    #[serde(flatten)]
    #[schema(value_type = FitBody)]
    fit: Fit,
}

/// One check of the gate.
#[derive(Debug, ToSchema)]
#[schema(as = Check)]
#[expect(dead_code, reason = "describes `estimate::validate::CheckResult`; a test keeps the two alike")]
struct CheckBody {
    /// The rule.
    #[schema(example = "G4 beats persistence")]
    name: String,
    /// What was measured; `null` where it could not be.
    statistic: Option<f64>,
    /// How it is compared with the threshold.
    #[schema(example = "<=")]
    operator: String,
    /// The limit.
    threshold: Option<f64>,
    /// Unit of both.
    unit: String,
    /// Whether the fit passes.
    pass: bool,
    /// What a failure does: `reject`, `hold` or `flag`.
    severity: String,
    /// A sentence that an operator understands.
    comment: String,
}

/// What was found.
#[derive(Debug, ToSchema)]
#[expect(dead_code, reason = "describes `estimate::Fit`, which knows nothing of HTTP; a test keeps the two alike")]
struct FitBody {
    /// The model.
    model: String,
    /// Hash of its content.
    model_hash: String,
    /// What was left out because its channels are not there.
    dropped: Vec<String>,
    /// Estimates by name, in the model's order.
    parameters: HashMap<String, EstimateBody>,
    /// Pairs that the data can hardly tell apart.
    correlated: Vec<CorrelatedBody>,
    /// The name of the optimiser.
    method: String,
    /// The objective.
    objective: String,
    /// The best cost.
    cost: f64,
    /// Why the search ended: `converged`, `stalled`, `budget`, `deadline`, `cancelled` or `target`.
    stopped_by: String,
    /// The seed of the search.
    seed: u64,
    /// Single-candidate simulations.
    evaluations: u64,
    /// The best cost after so many evaluations.
    trace: Vec<TraceBody>,
    /// Errors by output channel.
    metrics: HashMap<String, MetricsBody>,
    /// Seconds between samples.
    sample_s: i64,
    /// Internal steps per sample.
    substeps: u64,
    /// Largest difference to a run with half the step, in the output's unit; `null` where one of the two left the
    /// numbers.
    discretisation_error: Option<f64>,
    /// Process noise of the filter, per square root of an hour.
    process_noise: f64,
    /// The parts of the window.
    parts: PartsBody,
    /// Hash of the stitched input.
    input_hash: String,
    /// What the problem was put together from: `from`, `to`, `channels`, `sets`, `location`.
    #[schema(value_type = Option<Object>)]
    basis: Option<Value>,
    /// What a user should know.
    remarks: Vec<String>,
    /// Parameters that were fixed because the data do not determine them.
    non_identifiable: Vec<String>,
}

/// One estimated or fixed parameter.
#[derive(Debug, ToSchema)]
#[schema(as = Estimate)]
#[expect(dead_code, reason = "describes `estimate::fit::Estimate`; a test keeps the two alike")]
struct EstimateBody {
    value: f64,
    unit: String,
    /// The 95 % confidence interval; `null` where the data do not determine the parameter.
    ci95: Option<[f64; 2]>,
    /// The interval that was searched.
    bounds: [f64; 2],
    /// Whether the value lies within one per cent of a bound, on the parameter's scale.
    at_bound: bool,
    /// Whether it was held fixed.
    fixed: bool,
}

/// Two parameters that the data can hardly tell apart.
#[derive(Debug, ToSchema)]
#[schema(as = CorrelatedPair)]
#[expect(dead_code, reason = "describes `estimate::fit::CorrelatedPair`; a test keeps the two alike")]
struct CorrelatedBody {
    parameters: [String; 2],
    correlation: f64,
}

/// The best cost after so many evaluations.
#[derive(Debug, ToSchema)]
#[schema(as = TracePoint)]
#[expect(dead_code, reason = "describes `estimate::fit::TracePoint`; a test keeps the two alike")]
struct TraceBody {
    evaluations: u64,
    best: f64,
}

/// The errors of one output. Free-run errors come from one simulation from the start of the window.
#[derive(Debug, ToSchema)]
#[schema(as = OutputMetrics)]
#[expect(dead_code, reason = "describes `estimate::fit::OutputMetrics`; a test keeps the two alike")]
struct MetricsBody {
    /// Unit of the errors.
    unit: String,
    /// Free run over the training part.
    train_rmse: f64,
    /// Free run over the validation part.
    validation_rmse: Option<f64>,
    /// Free run over the test part.
    test_rmse: Option<f64>,
    /// Forecasts over the validation part by horizon: `rmse`, `persistence`, `n`.
    #[schema(value_type = HashMap<String, Object>)]
    ahead: HashMap<String, Value>,
    /// Mean square of all 24-hour forecasts from midnight in the validation part.
    day_ahead_mse: Option<f64>,
    /// Root mean square of the one-step innovations.
    noise_floor: Option<f64>,
    /// Free-run error over the deviation of the noise that is left in it.
    rho: Option<f64>,
}

/// The parts of a window.
#[derive(Debug, ToSchema)]
#[schema(as = Parts)]
#[expect(dead_code, reason = "describes `estimate::fit::Parts`; a test keeps the two alike")]
struct PartsBody {
    train: SpanBody,
    validation: Option<SpanBody>,
    test: Option<SpanBody>,
}

/// A part of a window.
#[derive(Debug, ToSchema)]
#[schema(as = Span)]
#[expect(dead_code, reason = "describes `estimate::fit::Span`; a test keeps the two alike")]
struct SpanBody {
    #[schema(format = DateTime)]
    from: String,
    #[schema(format = DateTime)]
    to: String,
}

/// One fit in a list; `/fits/{id}` has all of it.
#[derive(Debug, Serialize, ToSchema)]
struct FitRow {
    id: String,
    /// The job that found it.
    job: String,
    /// The system.
    system: String,
    /// The model.
    model: String,
    /// `accepted`, `unchanged`, `held` or `rejected`.
    verdict: String,
    /// The verdict in a sentence.
    summary: String,
    /// Whether its parameters are served now.
    served: bool,
    /// Errors by output channel.
    #[schema(value_type = HashMap<String, MetricsBody>)]
    metrics: Value,
    /// The parts of the window.
    #[schema(value_type = PartsBody)]
    parts: Value,
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
}

/// Which fits.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct FitQuery {
    /// Those of this system; all by default.
    #[param(example = "room/4")]
    system: Option<String>,
    /// Items per page, 50 by default, at most 500.
    #[param(minimum = 1, maximum = 500)]
    page_size: Option<i64>,
    /// The `next_page_token` of the page before.
    page_token: Option<String>,
}

/// Fits, newest first.
#[utoipa::path(get, path = "/fits", tag = "fits", params(FitQuery), responses((status = 200, body = Page<FitRow>), Problems))]
async fn list_fits(State(service): State<Shared>, Asked(query): Asked<FitQuery>) -> Result<axum::Json<Page<FitRow>>, ApiError> {
    let page = PageQuery { page_size: query.page_size, page_token: query.page_token };
    let system = query.system.as_deref().map(str::parse::<SystemId>).transpose();
    let system = system.map_err(|error| ApiError::Invalid(vec![Fault::new("query system", "invalid-system", error.to_string())]))?;
    let size = page.size()?;
    let entries = store::fits::page(&service.store, system.as_ref(), page.before()?, size + 1).await?;
    let row = |entry: FitEntry| FitRow {
        id: entry.id,
        job: entry.job,
        system: entry.system.to_string(),
        model: entry.model,
        verdict: entry.verdict,
        summary: entry.summary,
        served: entry.served,
        metrics: entry.metrics,
        parts: entry.parts,
        created_at: entry.created_at,
    };
    Ok(axum::Json(Page::of(entries, size, |entry| entry.place.to_string(), row)))
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
