//! What was found, and what the gate says of it.

use super::access::Caller;
use super::description::With;
use super::extract::Asked;
use super::page::{Page, PageQuery};
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use crate::service::Service;
use crate::store;
use crate::store::decisions::Decision;
use crate::store::fits::{FitEntry, FitRecord};
use axum::extract::{Path, State};
use indexmap::IndexMap;
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::estimate::Fit;
use lampyris_core::estimate::fit::covariance::Covariance;
use lampyris_core::estimate::fit::{OutputMetrics, Parts};
use lampyris_core::estimate::gate::check::CheckResult;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(list_fits)).routes(routes!(get_fit)).routes(routes!(get_covariance))
}

/// A fit with its verdict.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Fit)]
pub struct FitVerdict {
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
    /// Whether it passed and waits for an operator: `POST /fits/{id}/promote` or `reject`.
    waits_for_operator: bool,
    /// What an operator has said.
    decision: Option<DecisionAnswer>,
    /// The uploaded windows whose samples it has seen, in the order of upload. None of them can be deleted
    /// unless the fit was rejected.
    windows: Vec<String>,
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
}

/// An operator's word.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = FitDecision)]
struct DecisionAnswer {
    /// `promoted` or `rejected`.
    decision: Decision,
    /// Why.
    reason: String,
    /// When.
    #[schema(value_type = String, format = DateTime)]
    decided_at: Timestamp,
}

pub type FitAnswer = With<FitVerdict, Fit>;

/// One fit in a list; `/fits/{id}` has all of it.
#[derive(Debug, Serialize, ToSchema)]
struct FitRow {
    id: String,
    /// The job that found it.
    job: String,
    /// The system.
    system: SystemId,
    /// The model.
    model: String,
    /// `accepted`, `unchanged`, `held` or `rejected`.
    verdict: String,
    /// The verdict in a sentence.
    summary: String,
    /// Whether its parameters are served now.
    served: bool,
    /// Whether it passed and waits for an operator: `POST /fits/{id}/promote` or `reject`.
    waits_for_operator: bool,
    /// Errors by output channel.
    #[schema(value_type = HashMap<String, OutputMetrics>)]
    metrics: IndexMap<String, OutputMetrics>,
    /// The parts of the window.
    parts: Parts,
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
}

/// Which fits.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct FitQuery {
    /// Those of this system; all by default.
    system: Option<SystemId>,
    /// Items per page, 50 by default, at most 500.
    #[param(minimum = 1, maximum = 500)]
    page_size: Option<i64>,
    /// The `next_page_token` of the page before.
    page_token: Option<String>,
}

/// Fits, newest first.
#[utoipa::path(
    get,
    path = "/fits",
    tag = "fits",
    params(FitQuery),
    responses((status = 200, body = Page<FitRow>), Problems)
)]
async fn list_fits(
    State(service): State<Shared>,
    caller: Caller,
    Asked(query): Asked<FitQuery>,
) -> Result<axum::Json<Page<FitRow>>, ApiError> {
    let page = PageQuery { page_size: query.page_size, page_token: query.page_token };
    let size = page.size()?;
    let entries =
        store::fits::page(&service.store, caller.reach(), query.system.as_ref(), page.before()?, size + 1)
            .await?;
    let row = |entry: FitEntry| FitRow {
        id: entry.id,
        job: entry.job,
        system: entry.system,
        model: entry.model,
        verdict: entry.verdict,
        summary: entry.summary,
        served: entry.served,
        waits_for_operator: entry.waits,
        metrics: entry.metrics,
        parts: entry.parts,
        created_at: entry.created_at,
    };
    Ok(axum::Json(Page::of(entries, size, |entry| entry.place.to_string(), row)))
}

/// One fit.
#[utoipa::path(
    get,
    path = "/fits/{id}",
    tag = "fits",
    params(("id" = String, Path)),
    responses((status = 200, body = FitAnswer), Problems)
)]
async fn get_fit(
    State(service): State<Shared>,
    Path(id): Path<String>,
) -> Result<axum::Json<FitAnswer>, ApiError> {
    answer(&service, &id).await
}

/// The values that a covariance is about, and what it says.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = FitCovarianceAnswer)]
struct Spread {
    /// The fit.
    fit: String,
    /// The system.
    system: SystemId,
    /// The estimates, in the order of the rows.
    values: Vec<f64>,
    /// Their units.
    units: Vec<String>,
    /// What the data leave open, in a sentence; `null` where they determine everything.
    sentence: Option<String>,
}

type CovarianceAnswer = With<Spread, Covariance>;

/// How the estimates of a fit err together: their covariance, and the combinations of parameters that the
/// data do not determine.
///
/// It is that of the errors of measurement and of what the model lacks, as far as these show in the residuals
/// of the fit's own window.
#[utoipa::path(
    get,
    path = "/fits/{id}/covariance",
    tag = "fits",
    params(("id" = String, Path)),
    responses(
        (status = 200, body = CovarianceAnswer),
        (
            status = 404,
            description = "`fit-not-found`; `no-covariance`: the data do not say, or an older version made \
                the fit",
            body = super::problem::Problem,
            content_type = "application/problem+json"
        ),
        Problems
    )
)]
async fn get_covariance(
    State(service): State<Shared>,
    Path(id): Path<String>,
) -> Result<axum::Json<CovarianceAnswer>, ApiError> {
    let record = require(&service, &id).await?;
    let Some(document) = record.fit.covariance else {
        return Err(ApiError::NoCovariance(id));
    };
    let estimates = document.parameters.iter().filter_map(|name| record.fit.parameters.get(name));
    let (values, units) = estimates.map(|estimate| (estimate.value, estimate.unit.clone())).unzip();
    let own = Spread { fit: record.id, system: record.system, values, units, sentence: document.sentence() };
    Ok(axum::Json(With { own, document }))
}

/// The fit that must be there.
async fn require(service: &Service, id: &str) -> Result<FitRecord, ApiError> {
    store::fits::get(&service.store, id).await?.ok_or_else(|| ApiError::NotFound("fit", id.to_owned()))
}

/// A fit as it is shown.
pub(crate) async fn answer(service: &Service, id: &str) -> Result<axum::Json<FitAnswer>, ApiError> {
    let record = require(service, id).await?;
    let (waits_for_operator, decision) = store::decisions::of(&service.store, id).await?;
    let windows = store::windows::cited(&service.store, id).await?;
    let own = FitVerdict {
        windows,
        id: record.id,
        job: record.job,
        system: record.system,
        verdict: record.verdict,
        summary: record.summary,
        checks: record.checks,
        waits_for_operator,
        decision: decision.map(|record| DecisionAnswer {
            decision: record.decision,
            reason: record.reason,
            decided_at: record.decided_at,
        }),
        created_at: record.created_at,
    };
    Ok(axum::Json(With { own, document: record.fit }))
}
