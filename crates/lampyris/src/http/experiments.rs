//! Plans of experiments: which inputs to drive for a few days, and what that would teach.

use super::extract::{Json, Named};
use super::negotiate::{Wanted, rendered};
use super::problem::{ApiError, PROBLEM_JSON, Problem, Problems};
use super::shared::{Shared, shared_body};
use crate::service::query::experiments::{ExperimentRequest, SystemExperiment, plans};
use axum::extract::State;
use axum::response::Response;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(post_experiments))
}

/// Which inputs to drive for a few days, so that parameters or effects that are tied can be told apart.
///
/// The best plan of each of three families (steps, a random binary sequence, pulses at night) with what each
/// would teach: the widths of the 95 % intervals now and behind the experiment, and the t of what it is
/// about. Sequences whose predicted outputs leave the comfort bounds are left out. What is promised rests on
/// the model in force, the noise of the days that were measured and the weather that the answer names. When
/// the days have come, send the widths back as `promised`: `learnt` says what became of them. Nothing is
/// stored. As CSV a row for each instant with the inputs of one plan, for whoever drives them.
#[utoipa::path(
    post,
    path = "/systems/{kind}/{id}/experiments",
    tag = "systems",
    params(("kind" = String, Path, example = "room"), ("id" = String, Path, example = "4")),
    request_body = ExperimentRequest,
    responses(
        (status = 200, content((SystemExperiment = "application/json"), (String = "text/csv"))),
        (
            status = 406,
            description = "Neither of the two forms is acceptable",
            body = Problem,
            content_type = PROBLEM_JSON
        ),
        Problems
    )
)]
async fn post_experiments(
    State(service): State<Shared>,
    Named(system): Named,
    Wanted(format): Wanted,
    body: Json,
) -> Result<Response, ApiError> {
    Ok(rendered(format, shared_body(plans(&service, &system, body.value, format).await?)))
}
