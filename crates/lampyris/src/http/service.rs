//! The service about itself.

use super::problem::Problems;
use super::shared::Shared;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use std::sync::atomic::Ordering;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(healthz)).routes(routes!(readyz)).routes(routes!(version))
}

/// Whether the service can do its work.
#[derive(Debug, Serialize, ToSchema)]
struct Readiness {
    /// Whether all of it works.
    ready: bool,
    /// `writable`, or `unavailable`: then what is served stays served.
    database: &'static str,
    /// `alive`; `stopped`: then no job is run; or `stuck`: more jobs than there are workers were given up and
    /// hold their threads, until one of them ends or the service is started again.
    queue: &'static str,
    /// Workers that wait for jobs or run one.
    workers: usize,
    /// `loaded`: the service opens its door only then.
    parameters: &'static str,
}

/// What runs here.
#[derive(Debug, Serialize, ToSchema)]
struct Version {
    name: &'static str,
    version: &'static str,
}

/// The process lives.
#[utoipa::path(
    get,
    path = "/healthz",
    tag = "service",
    responses((status = 200, body = String, content_type = "text/plain"))
)]
async fn healthz() -> &'static str {
    "ok\n"
}

/// The service can do its work: the database can be written, the queue is served.
#[utoipa::path(
    get,
    path = "/readyz",
    tag = "service",
    responses((status = 200, body = Readiness), (status = 503, body = Readiness), Problems)
)]
async fn readyz(State(service): State<Shared>) -> Response {
    let writable = match service.store.writable().await {
        Ok(()) => true,
        Err(error) => {
            tracing::error!(%error, "the database cannot be written");
            false
        }
    };
    let workers = service.workers_alive.load(Ordering::Relaxed);
    let alive = workers > 0 && !service.is_stopping();
    let ready = writable && alive && !service.is_stuck();
    let body = Readiness {
        ready,
        database: if writable { "writable" } else { "unavailable" },
        queue: match (alive, service.is_stuck()) {
            (false, _) => "stopped",
            (true, true) => "stuck",
            (true, false) => "alive",
        },
        workers,
        parameters: "loaded",
    };
    (if ready { StatusCode::OK } else { StatusCode::SERVICE_UNAVAILABLE }, axum::Json(body)).into_response()
}

/// What runs here.
#[utoipa::path(get, path = "/version", tag = "service", responses((status = 200, body = Version)))]
async fn version() -> axum::Json<Version> {
    axum::Json(Version { name: env!("CARGO_PKG_NAME"), version: env!("CARGO_PKG_VERSION") })
}
