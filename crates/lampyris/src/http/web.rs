//! `/ui/`: the page. It is part of the binary, asks this service alone, and carries what it shows in its
//! address, so that every address under `/ui/` that names no file answers with the same document.

use super::constant::{ConstantBody, constants};
use super::problem::ApiError;
use super::shared::Shared;
use axum::Router;
use axum::extract::Path;
use axum::http::HeaderMap;
use axum::response::{IntoResponse, Redirect, Response};
use axum::routing::get;
use rust_embed::RustEmbed;
use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::LazyLock;

/// Everything comes from this service, no text is ever a script or a style, and nothing may frame the page.
/// Pictures and tables that it saves are made in the page itself (`blob:`).
pub(super) const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src \
    'self' data: blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
const DOCUMENT: &str = "index.html";

/// The files by their paths below `/ui/`.
static FILES: LazyLock<HashMap<String, ConstantBody>> = LazyLock::new(constants::<Files>);

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
}

/// A file, or the document where the last part of the path is no name of a file.
fn answer(path: &str, headers: &HeaderMap) -> Response {
    let named = path.rsplit('/').next().is_some_and(|last| last.contains('.'));
    let file = FILES.get(path).or_else(|| FILES.get(DOCUMENT).filter(|_| !named));
    match file {
        Some(file) => file.answer(Some(POLICY), headers),
        None => ApiError::NotFound("file", path.to_owned()).into_response(),
    }
}
