//! `/language`: the language of model documents, for programs that write or read them.

use super::constant::ConstantBody;
use super::description::With;
use super::problem::Problems;
use super::shared::Shared;
use crate::service::catalogue::models::LONGEST_DOCUMENT;
use axum::http::HeaderMap;
use axum::response::Response;
use lampyris_core::data::{COMPUTED, ComputedChannel};
use lampyris_core::model::language::{Language, LanguageLimit, language};
use serde::Serialize;
use std::sync::LazyLock;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The page of the book that explains all of it.
pub(super) const PAGE: &str = "/docs/book/reference/model-language.html";

static BODY: LazyLock<ConstantBody> = LazyLock::new(|| {
    // It is made of texts and numbers, so writing it cannot fail.
    ConstantBody::new("language.json", serde_json::to_vec(&answer()).unwrap_or_default())
});

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_language))
}

/// The language, with what a service adds to it.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ModelLanguage)]
struct LanguageNotes {
    /// The page of the book that explains it, with examples.
    see: &'static str,
    /// Channels that an input may read without anybody measuring them.
    computed: [ComputedChannel; 5],
}

type LanguageAnswer = With<LanguageNotes, Language>;

fn answer() -> LanguageAnswer {
    let mut language = language();
    language.limits.push(LanguageLimit {
        name: "json_document",
        value: LONGEST_DOCUMENT as f64,
        unit: "B",
        meaning: "a document in JSON, without spaces",
    });
    With { own: LanguageNotes { see: PAGE, computed: COMPUTED }, document: language }
}

/// The language of models and effects: its grammar, functions, units, documents with all fields, and limits.
///
/// It is the same for everybody as long as the program is.
#[utoipa::path(
    get,
    path = "/language",
    tag = "models",
    responses((status = 200, body = LanguageAnswer, headers(("ETag" = String))), Problems)
)]
async fn get_language(headers: HeaderMap) -> Response {
    BODY.answer(None, &headers)
}
