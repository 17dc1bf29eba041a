//! What the parameters in force say of the hours to come.

use super::conditions::unless_known;
use super::extract::{Asked, Json, Named};
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use crate::service::ServiceError;
use crate::service::catalogue::systems;
use crate::service::query::forecast::{self, HoursToCome, STEP, SystemForecast, SystemLinearisation};
use crate::service::query::scores::{self, SystemScores};
use crate::store;
use crate::store::forecast_inputs::KeptInput;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use jiff::Timestamp;
use lampyris_core::data::{Duration, Length, read_time, rfc3339};
use lampyris_core::estimate::forecast::LONGEST;
use lampyris_core::fault::Fault;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

const JSON: &str = "application/json";

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(get_forecast, post_forecast))
        .routes(routes!(get_forecast_inputs))
        .routes(routes!(get_forecast_scores))
        .routes(routes!(get_linearisation, post_linearisation))
}

/// How far ahead a forecast looks.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct ForecastQuery {
    /// How far ahead, a day by default, ten at most.
    #[param(value_type = Option<Length>, example = "PT24H")]
    horizon: Option<String>,
    /// The step between instants, a quarter of an hour by default.
    #[param(value_type = Option<Length>, example = "PT15M")]
    step: Option<String>,
}

/// A forecast of outputs and states with the parameters that are served and the inputs that are kept.
///
/// What was measured of an input counts as far as it reaches, and what was uploaded as a forecast behind
/// that. Otherwise it is the forecast that `POST` gives without `inputs`, and its tag.
#[utoipa::path(
    get,
    path = "/systems/{kind}/{id}/forecast",
    tag = "systems",
    params(
        ("kind" = String, Path, example = "room"),
        ("id" = String, Path, example = "4"),
        ForecastQuery,
        ("If-None-Match" = Option<String>, Header, description = "The tag of the last answer"),
    ),
    responses(
        (status = 200, description = "What is to come", body = SystemForecast, headers(("ETag" = String))),
        (status = 304, description = "As it was"),
        Problems
    )
)]
async fn get_forecast(
    State(service): State<Shared>,
    Named(system): Named,
    headers: HeaderMap,
    Asked(query): Asked<ForecastQuery>,
) -> Result<Response, ApiError> {
    let fields = [("horizon", query.horizon), ("step", query.step)];
    let given = fields.into_iter().filter_map(|(name, text)| Some((name.to_owned(), Value::from(text?))));
    let asked = forecast::ahead(&service, &system, Value::Object(given.collect())).await;
    Ok(unless_known(&headers, JSON, asked.map_err(in_query)?))
}

/// Faults of fields that came in the query.
fn in_query(error: ServiceError) -> ServiceError {
    let place = |fault: Fault| match fault.pointer.as_str() {
        "/horizon" | "/step" => Fault { pointer: fault.pointer.replacen('/', "query ", 1), ..fault },
        _ => fault,
    };
    match error {
        ServiceError::Faults(faults) => ServiceError::Faults(faults.into_iter().map(place).collect()),
        other => other,
    }
}

/// What is kept as a forecast of one input.
#[derive(Debug, Serialize, ToSchema)]
struct InputForecast {
    /// The channel.
    channel: String,
    /// When its newest issue came.
    #[schema(value_type = String, format = DateTime)]
    issued_at: Timestamp,
    /// The first instant of which something is said, by this issue or an older one.
    #[schema(format = DateTime)]
    from: String,
    /// The last one.
    #[schema(format = DateTime)]
    to: String,
}

/// What was uploaded as forecasts of inputs, by channel. A forecast uses it behind what was measured.
#[utoipa::path(
    get,
    path = "/systems/{kind}/{id}/forecast/inputs",
    tag = "systems",
    params(("kind" = String, Path, example = "room"), ("id" = String, Path, example = "4")),
    responses((status = 200, description = "A row per channel", body = Vec<InputForecast>), Problems)
)]
async fn get_forecast_inputs(
    State(service): State<Shared>,
    Named(system): Named,
) -> Result<axum::Json<Vec<InputForecast>>, ApiError> {
    systems::require(&service, &system).await?;
    let shown = |input: KeptInput| InputForecast {
        from: rfc3339(input.from_ms),
        to: rfc3339(input.to_ms),
        channel: input.channel,
        issued_at: input.issued_at,
    };
    let inputs = store::forecast_inputs::of(&service.store, &system).await?;
    Ok(axum::Json(inputs.into_iter().map(shown).collect()))
}

/// How far off forecasts were, by how far ahead they looked: what was said beside what came.
///
/// Forecasts that were asked for are kept for thirty days, of a system at most one in a quarter of an hour,
/// and are compared with measurements as these arrive. One under inputs that were given is compared as it was
/// said, whether they came to pass or not. Beside each error stands that of holding the newest measurement.
/// With the tag of the last answer in `If-None-Match` the answer is 304 while nothing has changed.
#[utoipa::path(
    get,
    path = "/systems/{kind}/{id}/forecast/scores",
    tag = "systems",
    params(
        ("kind" = String, Path, example = "room"),
        ("id" = String, Path, example = "4"),
        ("If-None-Match" = Option<String>, Header, description = "The tag of the last answer"),
    ),
    responses(
        (status = 200, description = "The errors by lead", body = SystemScores, headers(("ETag" = String))),
        (status = 304, description = "As they were"),
        Problems
    )
)]
async fn get_forecast_scores(
    State(service): State<Shared>,
    Named(system): Named,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    Ok(unless_known(&headers, JSON, scores::answer(&service, &system).await?))
}

/// A forecast of outputs and states with the parameters that are served, from the states at the newest
/// measurement.
///
/// The mean is the free run of the model from there. The standard deviations know of the states at the start,
/// of the process noise since, of the parameters where the fit has a covariance, and, for outputs, of the
/// sensor. Inputs that `inputs` does not have are those that were measured ahead, and behind these what was
/// uploaded as a forecast. Inputs that end before the forecast does are refused by name (`input-ends`). With
/// the tag of the last answer in `If-None-Match` the answer is 304 while nothing has changed.
#[utoipa::path(
    post,
    path = "/systems/{kind}/{id}/forecast",
    tag = "systems",
    params(
        ("kind" = String, Path, example = "room"),
        ("id" = String, Path, example = "4"),
        ("If-None-Match" = Option<String>, Header, description = "The tag of the last answer"),
    ),
    request_body = HoursToCome,
    responses(
        (status = 200, description = "What is to come", body = SystemForecast, headers(("ETag" = String))),
        (status = 304, description = "As it was"),
        Problems
    )
)]
async fn post_forecast(
    State(service): State<Shared>,
    Named(system): Named,
    headers: HeaderMap,
    body: Json,
) -> Result<Response, ApiError> {
    Ok(unless_known(&headers, JSON, forecast::ahead(&service, &system, body.value).await?))
}

/// Where the model is linearised.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct LinearisationQuery {
    /// The length of a step, a quarter of an hour by default.
    #[param(value_type = Option<Length>, example = "PT15M")]
    step: Option<String>,
    /// The instant; the newest measurement until there counts, the newest of all by default.
    #[param(value_type = Option<String>, format = DateTime)]
    at: Option<String>,
}

/// The model in force as a linear discrete one: its matrices at the newest measurement, for one step.
///
/// `x(k+1) = a x(k) + b u(k) + e w(k) + e_next w(k+1) + offset`, `y(k) = c x(k) + d_held u(k) + d_moving
/// w(k) + output_offset`: `held` are the inputs u, which stay as they are over a step, and `moving` are w,
/// which go in a straight line to their next value. Units are those of the lists, and `q` and `r` are the
/// covariances of the process noise of a step and of the sensors. Inputs stand still where they were last
/// measured, but for the sun and the clock. A model with constant coefficients is exact, any other one in
/// small changes around `states`, `held` and `moving`. With the tag of the last answer in `If-None-Match`
/// the answer is 304 while nothing has changed.
#[utoipa::path(
    get,
    path = "/systems/{kind}/{id}/linearisation",
    tag = "systems",
    params(
        ("kind" = String, Path, example = "room"),
        ("id" = String, Path, example = "4"),
        LinearisationQuery,
        ("If-None-Match" = Option<String>, Header, description = "The tag of the last answer"),
    ),
    responses(
        (status = 200, description = "The matrices", body = SystemLinearisation, headers(("ETag" = String))),
        (status = 304, description = "As they were"),
        Problems
    )
)]
async fn get_linearisation(
    State(service): State<Shared>,
    Named(system): Named,
    headers: HeaderMap,
    Asked(query): Asked<LinearisationQuery>,
) -> Result<Response, ApiError> {
    let mut faults = Vec::new();
    let step = match query.step.as_deref().map(str::parse::<Duration>) {
        None => STEP,
        Some(Ok(step)) => step,
        Some(Err(error)) => {
            faults.push(Fault::new("query step", "invalid-duration", error.to_string()));
            STEP
        }
    };
    let at = query
        .at
        .as_deref()
        .and_then(|text| read_time("query at", text).map_err(|fault| faults.push(fault)).ok());
    if step.is_zero() || step > LONGEST {
        let detail = format!("a step is at most {LONGEST}, and longer than nothing");
        faults.push(Fault::new("query step", "out-of-range", detail));
    }
    if !faults.is_empty() {
        return Err(ApiError::Invalid(faults));
    }
    Ok(unless_known(&headers, JSON, forecast::now(&service, &system, step, at).await?))
}

/// The model in force as a linear discrete one along a forecast, step by step.
///
/// The request is that of a forecast, and each step is linearised where that forecast is at its start. The
/// matrices are those of `GET`.
#[utoipa::path(
    post,
    path = "/systems/{kind}/{id}/linearisation",
    tag = "systems",
    params(
        ("kind" = String, Path, example = "room"),
        ("id" = String, Path, example = "4"),
        ("If-None-Match" = Option<String>, Header, description = "The tag of the last answer"),
    ),
    request_body = HoursToCome,
    responses(
        (status = 200, description = "The matrices", body = SystemLinearisation, headers(("ETag" = String))),
        (status = 304, description = "As they were"),
        Problems
    )
)]
async fn post_linearisation(
    State(service): State<Shared>,
    Named(system): Named,
    headers: HeaderMap,
    body: Json,
) -> Result<Response, ApiError> {
    Ok(unless_known(&headers, JSON, forecast::along(&service, &system, body.value).await?))
}
