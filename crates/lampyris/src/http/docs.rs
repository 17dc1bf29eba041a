//! `/docs`: the description of the surface, readable in a browser. The page is part of the binary and asks
//! this service alone.

use super::constant::{ConstantBody, constants};
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use axum::extract::Path;
use axum::http::HeaderMap;
use axum::response::Response;
use rust_embed::RustEmbed;
use std::collections::HashMap;
use std::sync::LazyLock;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// Everything comes from this service, and nothing may frame the page.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src \
    data:; base-uri 'none'; form-action 'self'; frame-ancestors 'none'";

static FILES: LazyLock<HashMap<String, ConstantBody>> = LazyLock::new(constants::<Files>);

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
async fn get_docs(headers: HeaderMap) -> Result<Response, ApiError> {
    file("index.html", &headers)
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
async fn get_docs_file(Path(name): Path<String>, headers: HeaderMap) -> Result<Response, ApiError> {
    file(&name, &headers)
}

fn file(name: &str, headers: &HeaderMap) -> Result<Response, ApiError> {
    let file = FILES.get(name).ok_or_else(|| ApiError::NotFound("file", name.to_owned()))?;
    Ok(file.answer(Some(POLICY), headers))
}
