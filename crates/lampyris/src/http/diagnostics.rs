//! How well a fit follows its measurements.

use super::extract::Asked as Query;
use super::negotiate::rendered;
use super::problem::{ApiError, Problems};
use super::shared::{Shared, shared_body};
use crate::service::catalogue::windows::Format;
use crate::service::query::diagnostics::{self, DiagnosticsDocument};
use axum::extract::{Path, State};
use axum::response::Response;
use serde::Deserialize;
use utoipa::IntoParams;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_diagnostics))
}

/// Which output is looked at closely.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct DiagnosticsQuery {
    /// An output of the model, such as `S_NH_e`; the first one by default. Skill is told of all of them in
    /// any case.
    #[param(example = "T_room")]
    output: Option<String>,
}

/// How well a fit follows its measurements: skill by part and by horizon, and what it means.
#[utoipa::path(
    get,
    path = "/fits/{id}/diagnostics",
    tag = "fits",
    params(("id" = String, Path), DiagnosticsQuery),
    responses((status = 200, body = DiagnosticsDocument<'static>), Problems)
)]
async fn get_diagnostics(
    State(service): State<Shared>,
    Path(id): Path<String>,
    Query(query): Query<DiagnosticsQuery>,
) -> Result<Response, ApiError> {
    Ok(rendered(Format::Json, shared_body(diagnostics::diagnostics(&service, &id, query.output).await?)))
}
