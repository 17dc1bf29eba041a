//! Models with their parameters, written for other programs.

use super::conditions::unless_known;
use super::extract::{Asked, Named};
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use crate::service::ServiceError;
use crate::service::query::export::{self, FittedModel};
use crate::service::work::interactive::RenderedAnswer;
use axum::extract::{Path, State};
use axum::http::HeaderMap;
use axum::response::Response;
use lampyris_core::model::ModelId;
use lampyris_core::model::export::{EquationFormat, ExportFormat};
use serde::Deserialize;
use utoipa::IntoParams;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The media type of all texts.
const TEXT: &str = "text/plain; charset=utf-8";

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(get_fit_model))
        .routes(routes!(get_model_in_force))
        .routes(routes!(get_equations))
}

/// How a model is written.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct ExportQuery {
    /// `json` by default; `python` (numpy, with the stepper of the service), `casadi`, `modelica`, `latex`
    /// and `mathml` are texts.
    #[param(inline)]
    format: Option<ExportFormat>,
}

/// The model of a fit with its parameters, as other programs take it: equations, units, holds and starts.
///
/// Variants are chosen, sets written out and effects merged. Rates are per hour.
#[utoipa::path(
    get,
    path = "/fits/{id}/model",
    tag = "fits",
    params(
        ("id" = String, Path),
        ExportQuery,
        ("If-None-Match" = Option<String>, Header, description = "The tag of the last answer"),
    ),
    responses(
        (
            status = 200,
            description = "The model",
            content((FittedModel = "application/json"), (String = "text/plain")),
            headers(("ETag" = String))
        ),
        (status = 304, description = "As it was"),
        Problems
    )
)]
async fn get_fit_model(
    State(service): State<Shared>,
    Path(id): Path<String>,
    headers: HeaderMap,
    Asked(query): Asked<ExportQuery>,
) -> Result<Response, ApiError> {
    let format = query.format.unwrap_or_default();
    Ok(written(&headers, format, export::of_fit(&service, &id, format).await?))
}

/// The model in force: that of the parameters which are served, as other programs take it.
///
/// A controller keeps the tag and asks again with `If-None-Match`: 304 while the same revision is served.
#[utoipa::path(
    get,
    path = "/systems/{kind}/{id}/model",
    tag = "systems",
    params(
        ("kind" = String, Path, example = "room"),
        ("id" = String, Path, example = "4"),
        ExportQuery,
        ("If-None-Match" = Option<String>, Header, description = "The tag of the last answer"),
    ),
    responses(
        (
            status = 200,
            description = "The model",
            content((FittedModel = "application/json"), (String = "text/plain")),
            headers(("ETag" = String))
        ),
        (status = 304, description = "As it was"),
        Problems
    )
)]
async fn get_model_in_force(
    State(service): State<Shared>,
    Named(system): Named,
    headers: HeaderMap,
    Asked(query): Asked<ExportQuery>,
) -> Result<Response, ApiError> {
    let format = query.format.unwrap_or_default();
    Ok(written(&headers, format, export::in_force(&service, &system, format).await?))
}

/// How equations are typeset.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct EquationsQuery {
    /// `latex` by default.
    #[param(inline)]
    format: Option<EquationFormat>,
}

/// The equations of a model, typeset: derivatives, outputs, and what these have in common.
///
/// Without measurements every variant is the first, and sets have no members.
#[utoipa::path(
    get,
    path = "/models/{id}/equations",
    tag = "models",
    params(
        ("id" = String, Path, example = "room3"),
        EquationsQuery,
        ("If-None-Match" = Option<String>, Header, description = "The tag of the last answer"),
    ),
    responses(
        (
            status = 200,
            description = "The equations",
            content((String = "text/plain")),
            headers(("ETag" = String))
        ),
        (status = 304, description = "As they were"),
        Problems
    )
)]
async fn get_equations(
    State(service): State<Shared>,
    Path(id): Path<String>,
    headers: HeaderMap,
    Asked(query): Asked<EquationsQuery>,
) -> Result<Response, ApiError> {
    let unknown = || ApiError::NotFound("model", id.clone());
    let model: ModelId = id.parse().map_err(|_| unknown())?;
    match export::of_model(&service, model, query.format.unwrap_or_default()).await {
        // Documents that do not agree are no model, as everywhere.
        Err(ServiceError::Faults(_)) => Err(unknown()),
        answer => Ok(unless_known(&headers, TEXT, answer?)),
    }
}

/// A written model as its media type.
fn written(headers: &HeaderMap, format: ExportFormat, answer: RenderedAnswer) -> Response {
    let kind = match format {
        ExportFormat::Json => "application/json",
        _ => TEXT,
    };
    unless_known(headers, kind, answer)
}
