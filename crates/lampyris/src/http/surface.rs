//! The surface: every path with the layers around it, and the description of all of them.

use super::constant::ConstantBody;
use super::problem::ApiError;
use super::shared::Shared;
use super::{
    access, audit, batches, book, comparison, decisions, description, diagnoses, diagnostics, docs, effects,
    events, evidence, experiments, export, extract, fits, forecast, history, influx, jobs, language, layout,
    matrix, metrics, missing_heat, models, nights, overview, parameter_changes, params, preview, problem,
    prometheus, proposals, samples, schedules, series, service, state, systems, web, windows,
};
use crate::service::query::matrix::cells::MatrixRow;
use axum::Router;
use axum::extract::Request;
use axum::http::{HeaderMap, StatusCode};
use axum::response::{IntoResponse, Response};
use std::any::Any;
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::compression::CompressionLayer;
use tower_http::timeout::TimeoutLayer;
use tower_http::trace::TraceLayer;
use utoipa::OpenApi;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// How long a request may take until its answer begins, beside the time that its body may take. Long polls
/// and searches for terms lie outside, event streams begin at once.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(30);

/// The frame of the description; the handlers fill it.
#[derive(OpenApi)]
#[openapi(
    info(
        title = "Lampyris",
        description = "Estimation service for model predictive control: measurements in, validated grey-box \
            parameters out. Errors are problem documents (RFC 9457) that list all faults at once."
    ),
    components(schemas(problem::Problem, MatrixRow))
)]
struct Frame;

/// The paths that a controller polls.
fn lean() -> OpenApiRouter<Shared> {
    OpenApiRouter::with_openapi(Frame::openapi()).merge(params::router())
}

/// Those that wait longer than a request may take: for news, and for a search that ends when its last client
/// has gone.
fn patient() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().merge(state::router()).merge(proposals::router())
}

/// All others.
fn layered() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .merge(overview::router())
        .merge(systems::router())
        .merge(windows::router())
        .merge(influx::router())
        .merge(prometheus::router())
        .merge(samples::router())
        .merge(series::router())
        .merge(layout::router())
        .merge(models::router())
        .merge(effects::router())
        .merge(language::router())
        .merge(preview::router())
        .merge(jobs::router())
        .merge(events::router())
        .merge(batches::router())
        .merge(nights::router())
        .merge(fits::router())
        .merge(decisions::router())
        .merge(diagnoses::router())
        .merge(evidence::router())
        .merge(matrix::router())
        .merge(history::router())
        .merge(comparison::router())
        .merge(forecast::router())
        .merge(experiments::router())
        .merge(export::router())
        .merge(diagnostics::router())
        .merge(missing_heat::router())
        .merge(parameter_changes::router())
        .merge(schedules::router())
        .merge(audit::router())
        .merge(service::router())
        .merge(own())
        .merge(metrics::router())
        .merge(docs::router())
}

/// The paths of this file.
fn own() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(openapi)).routes(routes!(openapi_as_json))
}

/// The whole surface.
pub fn router(service: Shared) -> Router {
    let (layered, mut described) = layered().split_for_parts();
    let (patient, mut awaited) = patient().split_for_parts();
    // Those ask the guard themselves.
    let (lean, _) = lean().split_for_parts();
    let known: Vec<_> = [&mut described, &mut awaited].into_iter().flat_map(description::ids).collect();
    let patience = REQUEST_TIMEOUT + Duration::from_secs(service.settings.limits.body_seconds);
    let guard =
        axum::middleware::from_fn_with_state(access::Gate::new(service.clone(), known), access::guard);
    let asking = Arc::new(description::queries(described));
    // The layer that is named last is the outermost.
    let guarded = |router: Router<Shared>| {
        router
            .layer(axum::middleware::from_fn_with_state(asking.clone(), extract::refuse_unknown))
            .layer(guard.clone())
            .layer(CatchPanicLayer::custom(panicked))
    };
    guarded(layered)
        .layer(TimeoutLayer::with_status_code(StatusCode::SERVICE_UNAVAILABLE, patience))
        .merge(guarded(patient))
        .layer(axum::middleware::map_response(problem::as_problem))
        .layer(CompressionLayer::new())
        // Without the query, in which clients of InfluxDB may show a token.
        .layer(TraceLayer::new_for_http().make_span_with(|request: &Request| {
            tracing::debug_span!("request", method = %request.method(), path = request.uri().path())
        }))
        .layer(axum::middleware::from_fn_with_state(service.clone(), metrics::measure))
        .merge(lean)
        .merge(web::router())
        .merge(book::router())
        .fallback(async || ApiError::NoSuchPath)
        .method_not_allowed_fallback(async || ApiError::NoSuchMethod)
        .with_state(service)
}

fn described() -> utoipa::openapi::OpenApi {
    description::completed(lean().merge(patient()).merge(layered()).into_openapi())
}

/// The description of the surface, as it is committed.
pub fn openapi_yaml() -> String {
    // The description is made of texts and numbers; a failure to print it shows in the test that compares it.
    described().to_yaml().unwrap_or_default()
}

/// The same as JSON, for the page that shows it.
pub fn openapi_json() -> String {
    described().to_json().unwrap_or_default()
}

/// This description of the surface.
#[utoipa::path(
    get,
    path = "/openapi.yaml",
    tag = "service",
    responses((status = 200, body = String, content_type = "application/yaml"))
)]
async fn openapi(headers: HeaderMap) -> Response {
    // A static that names its initialiser brings the whole surface into every program of this crate.
    static TEXT: OnceLock<ConstantBody> = OnceLock::new();
    TEXT.get_or_init(|| ConstantBody::new("openapi.yaml", openapi_yaml())).answer(None, &headers)
}

/// This description of the surface as JSON.
#[utoipa::path(get, path = "/openapi.json", tag = "service", responses((status = 200, body = Object)))]
async fn openapi_as_json(headers: HeaderMap) -> Response {
    static TEXT: OnceLock<ConstantBody> = OnceLock::new();
    TEXT.get_or_init(|| ConstantBody::new("openapi.json", openapi_json())).answer(None, &headers)
}

/// Every path with its methods in lower case, for the tests of the description.
pub fn described_paths() -> Vec<(String, Vec<String>)> {
    let description = serde_json::to_value(described()).unwrap_or_default();
    let paths = description.get("paths").and_then(serde_json::Value::as_object).cloned().unwrap_or_default();
    paths
        .into_iter()
        .map(|(path, item)| {
            (path, item.as_object().map(|item| item.keys().cloned().collect()).unwrap_or_default())
        })
        .collect()
}

/// The described documents by name, as JSON schemas, for the tests of the description.
pub fn described_documents() -> serde_json::Value {
    let description = serde_json::to_value(described()).unwrap_or_default();
    description.pointer("/components/schemas").cloned().unwrap_or_default()
}

fn panicked(panic: Box<dyn Any + Send + 'static>) -> Response {
    let said = panic
        .downcast_ref::<&str>()
        .map(|text| (*text).to_owned())
        .or_else(|| panic.downcast_ref::<String>().cloned());
    ApiError::Internal(format!("a handler panicked: {}", said.unwrap_or_default())).into_response()
}
