//! `/ui/`: the page. It is part of the binary, asks this service alone, and carries what it shows in its
//! address, so that every address under `/ui/` that names no file answers with the same document.

use super::params::matches;
use super::problem::ApiError;
use super::shared::Shared;
use axum::Router;
use axum::extract::Path;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Redirect, Response};
use axum::routing::get;
use rust_embed::{EmbeddedFile, RustEmbed};
use std::borrow::Cow;
use tower_http::compression::CompressionLayer;

/// Everything comes from this service, no text is ever a script or a style, and nothing may frame the page.
/// Pictures and tables that it saves are made in the page itself (`blob:`).
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src \
    'self' data: blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
const DOCUMENT: &str = "index.html";

#[derive(RustEmbed)]
#[folder = "../../web/ui"]
struct Files;

/// The text of a part of the page, such as `pages/fit.js`, for reports that stand on their own.
pub fn page_part(path: &str) -> Option<Cow<'static, str>> {
    match Files::get(path)?.data {
        Cow::Borrowed(bytes) => std::str::from_utf8(bytes).ok().map(Cow::Borrowed),
        Cow::Owned(bytes) => String::from_utf8(bytes).ok().map(Cow::Owned),
    }
}

/// The page and its parts. They are no part of the described surface: their queries are the page's own.
pub fn router() -> Router<Shared> {
    Router::new()
        .route("/", get(async || Redirect::temporary("/ui/")))
        .route("/ui", get(async || Redirect::temporary("/ui/")))
        .route("/ui/", get(async |headers: HeaderMap| answer(DOCUMENT, &headers)))
        .route(
            "/ui/{*path}",
            get(async |Path(path): Path<String>, headers: HeaderMap| answer(&path, &headers)),
        )
        .layer(CompressionLayer::new())
}

/// A file, or the document where the last part of the path is no name of a file.
fn answer(path: &str, headers: &HeaderMap) -> Response {
    if let Some(file) = Files::get(path) {
        return embedded(path, file, headers);
    }
    let named = path.rsplit('/').next().is_some_and(|last| last.contains('.'));
    match Files::get(DOCUMENT) {
        Some(document) if !named => embedded(DOCUMENT, document, headers),
        _ => ApiError::NotFound("file", path.to_owned()).into_response(),
    }
}

fn embedded(name: &str, file: EmbeddedFile, headers: &HeaderMap) -> Response {
    let hash = file.metadata.sha256_hash();
    sent(name, file.data, &hash, headers)
}

/// A part of a page under the policy of all pages; one that the browser has already is not sent again. The
/// name says what it is, the hash which one.
pub(super) fn sent(name: &str, bytes: Cow<'static, [u8]>, hash: &[u8], headers: &HeaderMap) -> Response {
    let media_type = match name.rsplit_once('.') {
        Some((_, "html")) => "text/html; charset=utf-8",
        Some((_, "css")) => "text/css; charset=utf-8",
        Some((_, "js" | "mjs")) => "text/javascript; charset=utf-8",
        Some((_, "svg")) => "image/svg+xml",
        Some((_, "png")) => "image/png",
        Some((_, "json")) => "application/json",
        _ => "text/plain; charset=utf-8",
    };
    let hash: String = hash.iter().take(16).map(|byte| format!("{byte:02x}")).collect();
    let tag = format!("\"{hash}\"");
    // Weak, because the same file may be sent compressed.
    let fixed = [
        (header::ETAG, format!("W/{tag}")),
        (header::CACHE_CONTROL, "no-cache".to_owned()),
        (header::CONTENT_SECURITY_POLICY, POLICY.to_owned()),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff".to_owned()),
        (header::REFERRER_POLICY, "no-referrer".to_owned()),
    ];
    if matches(headers, &tag) {
        return (StatusCode::NOT_MODIFIED, fixed).into_response();
    }
    (fixed, [(header::CONTENT_TYPE, media_type)], bytes).into_response()
}
