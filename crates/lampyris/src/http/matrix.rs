//! Which systems lack which effects.

use super::access::Caller;
use super::description::With;
use super::extract::Asked;
use super::page::{Page, PageQuery};
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use crate::service::query::matrix;
use crate::service::query::matrix::cells::MatrixRow;
use crate::service::query::matrix::effects::MatrixEffect;
use crate::store::reach::SystemScope;
use axum::extract::State;
use lampyris_core::data::SystemPattern;
use lampyris_core::fault::Fault;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_matrix))
}

/// Whose effects are told.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct MatrixQuery {
    /// Patterns of systems, with commas between them; all systems by default.
    #[param(example = "room/*")]
    systems: Option<String>,
    /// Items per page, 50 by default, at most 500.
    #[param(minimum = 1, maximum = 500)]
    page_size: Option<i64>,
    /// The `next_page_token` of the page before.
    page_token: Option<String>,
}

/// Every effect beside every system: a page of the systems by name.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = EffectMatrix)]
struct EffectSums {
    /// The effects over all systems of the selection, what saves most first; `null` on all pages but the
    /// first.
    effects: Option<Vec<MatrixEffect>>,
}

type EffectMatrix = With<EffectSums, Page<MatrixRow>>;

/// The systems that a list of patterns selects, all of them where there is none.
fn selection(text: Option<&str>) -> Result<SystemScope, ApiError> {
    let patterns = text.unwrap_or_default().split(',').map(str::trim).filter(|text| !text.is_empty());
    let read = patterns.map(str::parse::<SystemPattern>).collect::<Result<Vec<_>, _>>().map_err(|error| {
        ApiError::Invalid(vec![Fault::new("query systems", "invalid-pattern", error.to_string())])
    })?;
    Ok(SystemScope::of(read))
}

/// Which systems lack which effects, by their newest diagnoses and by what their windows show together.
///
/// An effect that was named carries what adding it saves: the error on unseen data without it less that with
/// it, as the diagnosis has measured both.
#[utoipa::path(
    get,
    path = "/evidence/matrix",
    tag = "diagnoses",
    params(MatrixQuery),
    responses((status = 200, body = EffectMatrix), Problems)
)]
async fn get_matrix(
    State(service): State<Shared>,
    caller: Caller,
    Asked(query): Asked<MatrixQuery>,
) -> Result<axum::Json<EffectMatrix>, ApiError> {
    let page = PageQuery { page_size: query.page_size, page_token: query.page_token };
    let (size, selected) = (page.size()?, selection(query.systems.as_deref())?);
    let scopes = (caller.reach(), &selected);
    let effects = match page.page_token {
        None => Some(matrix::summary(&service, scopes).await?),
        Some(_) => None,
    };
    let after = page.page_token.unwrap_or_default();
    let rows = matrix::rows(&service, scopes, &after, size + 1).await?;
    let page = Page::of(rows, size, |row| row.system.to_string(), |row| row);
    Ok(axum::Json(With { own: EffectSums { effects }, document: page }))
}
