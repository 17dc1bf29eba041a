//! The only axum. Each file owns its paths: router, request and response types, handlers.
//!
//! A handler checks, asks `service` or `store`, and answers; long work is for the CPU pools. The guard (`access`) lies around
//! every operation. The controller's paths (`params`) lie outside of all other layers, so that a poll costs no more than
//! its body; the page (`web`) holds no data and lies outside of all.

mod access;
mod audit;
mod batches;
mod chart;
mod comparison;
mod decisions;
mod description;
mod diagnoses;
mod diagnostics;
mod docs;
mod events;
mod evidence;
mod examples;
mod extract;
mod fits;
mod history;
mod jobs;
mod layout;
mod listen;
mod metrics;
mod models;
mod negotiate;
mod page;
mod params;
mod preview;
mod problem;
mod schedules;
mod series;
mod service;
mod systems;
mod web;
mod windows;

pub use listen::listen;
pub use models::document as model_document;
pub use web::page_part;

use crate::service::Service;
use axum::Router;
use axum::body::{Body, Bytes};
use axum::http::StatusCode;
use axum::response::IntoResponse;
use problem::ApiError;
use std::any::Any;
use std::sync::{Arc, LazyLock};
use std::time::Duration;
use tower_http::catch_panic::CatchPanicLayer;
use tower_http::compression::CompressionLayer;
use tower_http::timeout::TimeoutLayer;
use tower_http::trace::TraceLayer;
use utoipa::OpenApi;
use utoipa_axum::router::OpenApiRouter;

/// What every handler is given.
pub type Shared = Arc<Service>;

/// How long a request may take until its answer begins, beside the time that its body may take. Long polls lie outside, event streams begin at once.
const REQUEST_TIMEOUT: Duration = Duration::from_secs(30);

/// The frame of the description; the handlers fill it.
#[derive(OpenApi)]
#[openapi(
    info(
        title = "Lampyris",
        description = "Estimation service for model predictive control: measurements in, validated grey-box parameters out. Errors are problem documents (RFC 9457) that list all faults at once."
    ),
    components(schemas(problem::Problem))
)]
struct Frame;

/// The paths that a controller polls.
fn lean() -> OpenApiRouter<Shared> {
    OpenApiRouter::with_openapi(Frame::openapi()).merge(params::router())
}

/// All others.
fn layered() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .merge(systems::router())
        .merge(windows::router())
        .merge(series::router())
        .merge(layout::router())
        .merge(models::router())
        .merge(preview::router())
        .merge(jobs::router())
        .merge(events::router())
        .merge(batches::router())
        .merge(fits::router())
        .merge(decisions::router())
        .merge(diagnoses::router())
        .merge(evidence::router())
        .merge(history::router())
        .merge(comparison::router())
        .merge(diagnostics::router())
        .merge(schedules::router())
        .merge(audit::router())
        .merge(service::router())
        .merge(metrics::router())
        .merge(docs::router())
}

/// The whole surface.
pub fn router(service: Shared) -> Router {
    let (layered, mut described) = layered().split_for_parts();
    let (lean, mut polled) = lean().split_for_parts();
    let known: Vec<_> = description::ids(&mut described).into_iter().chain(description::ids(&mut polled)).collect();
    let patience = REQUEST_TIMEOUT + Duration::from_secs(service.settings.limits.body_seconds);
    let guard = axum::middleware::from_fn_with_state(access::Gate::new(service.clone(), known), access::guard);
    let asking = Arc::new(description::queries(described));
    // The layer that is named last is the outermost.
    layered
        .layer(axum::middleware::from_fn_with_state(asking, extract::refuse_unknown))
        .layer(guard.clone())
        .layer(CatchPanicLayer::custom(panicked))
        .layer(TimeoutLayer::with_status_code(StatusCode::SERVICE_UNAVAILABLE, patience))
        .layer(axum::middleware::map_response(problem::as_problem))
        .layer(CompressionLayer::new())
        .layer(TraceLayer::new_for_http())
        .layer(axum::middleware::from_fn_with_state(service.clone(), metrics::measure))
        .merge(lean.layer(guard))
        .merge(web::router())
        .fallback(async || ApiError::NoSuchPath)
        .method_not_allowed_fallback(async || ApiError::NoSuchMethod)
        .with_state(service)
}

fn described() -> utoipa::openapi::OpenApi {
    description::completed(lean().merge(layered()).into_openapi())
}

/// The description of the surface, as it is served and committed.
pub fn openapi_yaml() -> String {
    static TEXT: LazyLock<String> = LazyLock::new(|| {
        // The description is made of texts and numbers; a failure to print it shows in the test that compares it.
        described().to_yaml().unwrap_or_default()
    });
    TEXT.clone()
}

/// The same as JSON, for the page that shows it.
pub fn openapi_json() -> String {
    static TEXT: LazyLock<String> = LazyLock::new(|| described().to_json().unwrap_or_default());
    TEXT.clone()
}

/// Every path with its methods in lower case, for the tests of the description.
pub fn described_paths() -> Vec<(String, Vec<String>)> {
    let description = serde_json::to_value(described()).unwrap_or_default();
    let paths = description.get("paths").and_then(serde_json::Value::as_object).cloned().unwrap_or_default();
    paths.into_iter().map(|(path, item)| (path, item.as_object().map(|item| item.keys().cloned().collect()).unwrap_or_default())).collect()
}

/// The described documents by name, as JSON schemas, for the tests of the description.
pub fn described_documents() -> serde_json::Value {
    let description = serde_json::to_value(described()).unwrap_or_default();
    description.pointer("/components/schemas").cloned().unwrap_or_default()
}

/// A body that many answers share; it is not copied.
fn shared_body(body: Arc<[u8]>) -> Body {
    struct Shared(Arc<[u8]>);
    impl AsRef<[u8]> for Shared {
        fn as_ref(&self) -> &[u8] {
            &self.0
        }
    }
    Body::from(Bytes::from_owner(Shared(body)))
}

fn panicked(panic: Box<dyn Any + Send + 'static>) -> axum::response::Response {
    let said = panic.downcast_ref::<&str>().map(|text| (*text).to_owned()).or_else(|| panic.downcast_ref::<String>().cloned());
    ApiError::Internal(format!("a handler panicked: {}", said.unwrap_or_default())).into_response()
}
