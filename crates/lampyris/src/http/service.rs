//! The service about itself.

use super::problem::Problems;
use super::shared::Shared;
use super::storage;
use crate::store::StoreError;
use crate::store::workers::ProcessRole;
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
    /// `writable`, `full` until there is room, `read-only` until the next start, or `unavailable`: what is
    /// served stays served.
    database: &'static str,
    /// Why the database cannot be written, where it cannot.
    why: Option<String>,
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
    let (database, why) = match service.store.writable().await {
        Ok(()) => ("writable", None),
        Err(error) => {
            tracing::error!(%error, "the database cannot be written");
            let word = match &error {
                StoreError::Full(_) => "full",
                error if error.is_final() => "read-only",
                _ => "unavailable",
            };
            (word, Some(storage::detail(&error)))
        }
    };
    let workers = service.workers_alive.load(Ordering::Relaxed);
    let alive = (workers > 0 || !service.settings.has(ProcessRole::Worker)) && !service.is_stopping();
    let ready = why.is_none() && alive && !service.is_stuck();
    let body = Readiness {
        ready,
        database,
        why,
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
