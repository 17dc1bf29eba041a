//! A Prometheus that is asked for measurements.

use super::access::Caller;
use super::extract::Json;
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use crate::service::catalogue::prometheus::{self, PrometheusSource};
use crate::service::observe::lines::UntakenLine;
use crate::service::observe::pulls::PullOutcome;
use axum::extract::State;
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_prometheus, put_prometheus))
}

/// Whom is asked, and what came of it.
#[derive(Debug, Serialize, ToSchema)]
struct PrometheusState {
    /// Whom, and for what; `null` where nobody has said it.
    source: Option<PrometheusSource>,
    /// Under which name it was changed last.
    changed_by: Option<String>,
    /// When.
    #[schema(value_type = Option<String>, format = DateTime)]
    changed_at: Option<Timestamp>,
    /// What the latest question since the start of the service came to.
    latest: Option<PullOutcome>,
    /// Values that were taken since the start of the service.
    taken: u64,
    /// Values that were not.
    untaken: u64,
    /// Whose values were not, the latest first; 200 names at most.
    latest_untaken: Vec<UntakenLine>,
}

/// The Prometheus that is asked for measurements, and the names of the latest that no rule takes.
#[utoipa::path(
    get,
    path = "/sources/prometheus",
    tag = "windows",
    responses((status = 200, body = PrometheusState), Problems)
)]
async fn get_prometheus(State(service): State<Shared>) -> Result<axum::Json<PrometheusState>, ApiError> {
    shown(&service).await
}

/// Says which Prometheus is asked for measurements, and which of its series belong to which systems.
///
/// A VictoriaMetrics, a Mimir or a Thanos answers the same `query_range`. What comes is taken as live samples
/// are. It is asked at once, from `lookback` ago on, and then `every` so often for what is new; a document
/// without `queries` asks nobody.
#[utoipa::path(
    put,
    path = "/sources/prometheus",
    tag = "windows",
    request_body = PrometheusSource,
    responses((status = 200, description = "It is kept", body = PrometheusState), Problems)
)]
async fn put_prometheus(
    State(service): State<Shared>,
    caller: Caller,
    body: Json,
) -> Result<axum::Json<PrometheusState>, ApiError> {
    prometheus::put(&service, body.value, caller.name()).await?;
    shown(&service).await
}

async fn shown(service: &Shared) -> Result<axum::Json<PrometheusState>, ApiError> {
    let (source, record) = prometheus::get(service).await?.unzip();
    let (taken, untaken) = service.pulls.lines.counts();
    let (changed_by, changed_at) = record.map(|record| (record.changed_by, record.changed_at)).unzip();
    Ok(axum::Json(PrometheusState {
        source,
        changed_by,
        changed_at,
        latest: service.pulls.latest(),
        taken,
        untaken,
        latest_untaken: service.pulls.lines.untaken(),
    }))
}
