//! `/docs`: the description of the surface, readable in a browser. The page is part of the binary and asks
//! this service alone.

use super::problem::{ApiError, Problems};
use super::shared::Shared;
use axum::extract::Path;
use axum::http::header;
use axum::response::{IntoResponse, Response};
use rust_embed::RustEmbed;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// Everything comes from this service, and nothing may frame the page.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src \
    data:; base-uri 'none'; form-action 'self'; frame-ancestors 'none'";

#[derive(RustEmbed)]
#[folder = "../../web/docs"]
struct Files;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_docs)).routes(routes!(get_docs_file))
}

/// This description as a page.
#[utoipa::path(
    get,
    path = "/docs",
    tag = "service",
    responses((status = 200, body = String, content_type = "text/html"))
)]
async fn get_docs() -> Result<Response, ApiError> {
    file("index.html")
}

/// The parts of that page.
#[utoipa::path(
    get,
    path = "/docs/{name}",
    tag = "service",
    params(("name" = String, Path, example = "docs.js")),
    responses(
        (
            status = 200,
            description = "A script or a style sheet",
            body = String,
            content_type = "text/javascript"
        ),
        Problems
    )
)]
async fn get_docs_file(Path(name): Path<String>) -> Result<Response, ApiError> {
    file(&name)
}

fn file(name: &str) -> Result<Response, ApiError> {
    let media_type = match name.rsplit_once('.') {
        Some((_, "html")) => "text/html; charset=utf-8",
        Some((_, "css")) => "text/css; charset=utf-8",
        _ => "text/javascript; charset=utf-8",
    };
    let file = Files::get(name).ok_or_else(|| ApiError::NotFound("file", name.to_owned()))?;
    let headers = [
        (header::CONTENT_TYPE, media_type),
        (header::CONTENT_SECURITY_POLICY, POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::CACHE_CONTROL, "no-cache"),
    ];
    Ok((headers, file.data).into_response())
}
