//! What flows into a room that its model does not know of.

use super::extract::Asked as Query;
use super::negotiate::{Wanted, rendered};
use super::problem::{ApiError, PROBLEM_JSON, Problem, Problems};
use super::shared::{Shared, shared_body};
use crate::service::query::missing_heat::{MissingHeatDocument, MissingHeatWanted, of_diagnosis, of_fit};
use axum::extract::{Path, State};
use axum::response::Response;
use serde::Deserialize;
use utoipa::IntoParams;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_missing_heat)).routes(routes!(get_missing_heat_of_diagnosis))
}

/// Into which state it flows.
#[derive(Debug, Default, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct MissingHeatQuery {
    /// An output of the model that shows a state; the first such one by default.
    #[param(example = "T_room")]
    output: Option<String>,
}

/// The missing heat of a fit: what flows into a measured state that its model does not know of, hour by hour
/// with bands, the events in it, and the mean week.
///
/// All of it is what this model lacks with these parameters. What the fit has taken up into them is not
/// missing. As CSV a row for each known hour, which a window takes as it is.
#[utoipa::path(
    get,
    path = "/fits/{id}/missing-heat",
    tag = "fits",
    params(("id" = String, Path), MissingHeatQuery),
    responses(
        (status = 200, content((MissingHeatDocument<'static> = "application/json"), (String = "text/csv"))),
        (
            status = 406,
            description = "Neither of the two forms is acceptable",
            body = Problem,
            content_type = PROBLEM_JSON
        ),
        Problems
    )
)]
async fn get_missing_heat(
    State(service): State<Shared>,
    Path(id): Path<String>,
    Query(query): Query<MissingHeatQuery>,
    Wanted(format): Wanted,
) -> Result<Response, ApiError> {
    let wanted = MissingHeatWanted { output: query.output, format };
    Ok(rendered(format, shared_body(of_fit(&service, &id, wanted).await?)))
}

/// The missing heat of the fit that a diagnosis starts from.
#[utoipa::path(
    get,
    path = "/diagnoses/{id}/missing-heat",
    tag = "diagnoses",
    params(("id" = String, Path), MissingHeatQuery),
    responses(
        (status = 200, content((MissingHeatDocument<'static> = "application/json"), (String = "text/csv"))),
        (
            status = 406,
            description = "Neither of the two forms is acceptable",
            body = Problem,
            content_type = PROBLEM_JSON
        ),
        Problems
    )
)]
async fn get_missing_heat_of_diagnosis(
    State(service): State<Shared>,
    Path(id): Path<String>,
    Query(query): Query<MissingHeatQuery>,
    Wanted(format): Wanted,
) -> Result<Response, ApiError> {
    let wanted = MissingHeatWanted { output: query.output, format };
    Ok(rendered(format, shared_body(of_diagnosis(&service, &id, wanted).await?)))
}
