//! Measurements.

use super::access::Caller;
use super::description::{Stored, With};
use super::extract::{Asked, Named, Raw};
use super::page::{Page, PageQuery};
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use crate::service::catalogue::forecasts::{self, TakenIssue, TakenParts};
use crate::service::catalogue::systems;
use crate::service::catalogue::windows::{self, BodyAsked, Format};
use crate::store;
use crate::store::windows::WindowRecord;
use axum::extract::{Path, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use lampyris_core::data::{
    ColumnRole, DateForm, DecimalMark, DialectAsked, FileReading, SystemId, WindowDocument, WindowReport,
};
use lampyris_core::schema::Csv;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(post_window, list_windows))
        .routes(routes!(get_window, delete_window))
        .routes(routes!(recognise_window))
}

/// A window: not its samples, but what was found in them.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Window)]
struct WindowName {
    /// `win_` and a hash of system and content.
    id: String,
    /// The system.
    system: SystemId,
    /// When the newest of its uploads came.
    #[schema(value_type = String, format = DateTime)]
    uploaded_at: Timestamp,
    /// How many uploads it is made of. Those that repeat the newest window of the same day and add to it are
    /// one window with it.
    uploads: i64,
    /// Whether this upload is a window that was there already, and counts again where a newer one had covered
    /// it. `false` wherever nothing was uploaded.
    again: bool,
    /// What this upload has forecast beside that.
    #[serde(skip_serializing_if = "Option::is_none")]
    forecast: Option<IssueAnswer>,
}

/// Forecasts of inputs that were taken: not their samples, but what was found in them.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = ForecastIssue)]
struct IssueName {
    /// The system.
    system: SystemId,
    /// When they came. Where they overlap older ones, they count.
    #[schema(value_type = String, format = DateTime)]
    issued_at: Timestamp,
}

/// Forecasts as they are shown.
type IssueAnswer = With<IssueName, WindowReport>;

/// What was taken: a window, or forecasts alone.
#[derive(Debug, Serialize, ToSchema)]
#[serde(untagged)]
enum TakenBody {
    /// Measurements, and what was forecast beside them.
    Window(Box<WindowAnswer>),
    /// Forecasts of inputs.
    Forecast(Box<IssueAnswer>),
}

/// A window as it is shown: not its samples, but what was found in them.
type WindowAnswer = With<WindowName, Stored<WindowReport>>;

/// How a body of measurements is written, by its media type.
///
/// # Errors
/// 415 where it is neither CSV nor JSON.
pub fn format(raw: &Raw) -> Result<Format, ApiError> {
    match raw.media_type.as_str() {
        "text/csv" => Ok(Format::Csv),
        "application/json" => Ok(Format::Json),
        _ => Err(ApiError::MediaType("text/csv or application/json")),
    }
}

fn shown(window: WindowRecord, again: bool) -> WindowAnswer {
    With {
        own: WindowName {
            id: window.id,
            system: window.system,
            uploaded_at: window.uploaded_at,
            uploads: window.uploads,
            again,
            forecast: None,
        },
        document: Stored::of(window.report),
    }
}

/// What is said of a body, beside the body.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct UploadQuery {
    /// What columns are that say nothing of it: `forecast` takes the whole body as a forecast of inputs.
    role: Option<ColumnRole>,
    /// The IANA zone of times without offset in a CSV; that of the system where it is not said.
    zone: Option<String>,
    /// The mark before decimals in a CSV, where it cannot be recognised.
    decimal: Option<DecimalMark>,
    /// The form of the dates in a CSV, where days and months could change places.
    dates: Option<DateForm>,
    /// Which columns of a CSV count; all of them by default.
    #[param(inline)]
    columns: Option<WhichColumns>,
}

/// Which columns of a file are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
enum WhichColumns {
    /// All of them.
    All,
    /// Those that the system binds, as where several rooms share a file.
    Bound,
}

impl UploadQuery {
    fn asked(self) -> BodyAsked {
        let Self { role, zone, decimal, dates, columns } = self;
        let dialect = DialectAsked { zone, decimal, dates, only: None };
        BodyAsked { role, dialect, bound_only: columns == Some(WhichColumns::Bound) }
    }
}

/// How a file would be read.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct ReadingQuery {
    /// The IANA zone of times without offset.
    zone: Option<String>,
    /// The mark before decimals.
    decimal: Option<DecimalMark>,
    /// The form of the dates.
    dates: Option<DateForm>,
}

/// Says how a CSV file would be read, and proposes what its columns are. Nothing is stored.
///
/// Encoding, separator, decimal comma and form of the dates are recognised; `asks` names what the file leaves
/// open. Channels and units are proposed from names and values; where several rooms share the file, so are
/// they and their neighbours.
#[utoipa::path(
    post,
    path = "/windows/recognise",
    tag = "windows",
    params(ReadingQuery),
    request_body(content((Csv = "text/csv"))),
    responses((status = 200, description = "How it is read; nothing is stored", body = FileReading), Problems)
)]
async fn recognise_window(
    Asked(query): Asked<ReadingQuery>,
    raw: Raw,
) -> Result<axum::Json<FileReading>, ApiError> {
    if format(&raw)? != Format::Csv {
        return Err(ApiError::MediaType("text/csv"));
    }
    let ReadingQuery { zone, decimal, dates } = query;
    let asked = DialectAsked { zone, decimal, dates, only: None };
    Ok(axum::Json(windows::reading(raw.body, asked).await?))
}

/// Takes measurements. The same content again is the same window.
///
/// It becomes the newest again where another has covered it. What repeats the newest window of the same day
/// and adds to it is one window with it.
///
/// Columns whose role is `forecast` (`roles` in JSON, `T_out[degC](forecast)` in the header of a CSV text, or
/// `?role=forecast` for all) are forecasts of inputs, of up to ten days ahead. They are kept apart from
/// measurements: no fit sees them. The newest issue counts from its first sample to its last.
///
/// A CSV may be written as other programs do: encoding, separator, decimal comma and form of the dates are
/// recognised, and its first warning says how it was read.
#[utoipa::path(
    post,
    path = "/systems/{kind}/{id}/windows",
    tag = "windows",
    params(
        ("kind" = String, Path),
        ("id" = String, Path),
        UploadQuery,
        ("Idempotency-Key" = Option<String>, Header)
    ),
    request_body(content((WindowDocument = "application/json"), (Csv = "text/csv"))),
    responses(
        (status = 200, description = "It was there already", body = WindowAnswer),
        (
            status = 201,
            description = "Taken; `Location` leads to it",
            body = TakenBody,
            headers(("Location" = String))
        ),
        Problems
    )
)]
async fn post_window(
    State(service): State<Shared>,
    Named(system): Named,
    Asked(query): Asked<UploadQuery>,
    raw: Raw,
) -> Result<Response, ApiError> {
    let format = format(&raw)?;
    let taken =
        forecasts::take(&service, &system, (format, query.asked()), raw.body, raw.key.as_ref()).await?;
    let issue = |issue: TakenIssue| With {
        own: IssueName { system: system.clone(), issued_at: issue.issued_at },
        document: issue.report,
    };
    let (status, location, body) = match taken {
        TakenParts::Window(taken, forecast) => {
            let status = if taken.is_new { StatusCode::CREATED } else { StatusCode::OK };
            let location = format!("/windows/{}", taken.window.id);
            let mut answer = shown(taken.window, taken.again);
            answer.own.forecast = forecast.map(issue);
            (status, location, TakenBody::Window(Box::new(answer)))
        }
        TakenParts::Forecast(taken) => {
            let location = format!("/systems/{system}/forecast/inputs");
            (StatusCode::CREATED, location, TakenBody::Forecast(Box::new(issue(taken))))
        }
    };
    Ok((status, [(header::LOCATION, location)], axum::Json(body)).into_response())
}

/// The windows of a system, newest upload first.
#[utoipa::path(
    get,
    path = "/systems/{kind}/{id}/windows",
    tag = "windows",
    params(("kind" = String, Path), ("id" = String, Path), PageQuery),
    responses((status = 200, body = Page<WindowAnswer>), Problems)
)]
async fn list_windows(
    State(service): State<Shared>,
    Named(system): Named,
    Asked(page): Asked<PageQuery>,
) -> Result<axum::Json<Page<WindowAnswer>>, ApiError> {
    systems::require(&service, &system).await?;
    let size = page.size()?;
    let records = store::windows::page(&service.store, &system, page.before()?, size + 1).await?;
    Ok(axum::Json(Page::of(
        records,
        size,
        |record| record.sequence.to_string(),
        |window| shown(window, false),
    )))
}

/// One window.
#[utoipa::path(
    get,
    path = "/windows/{id}",
    tag = "windows",
    params(("id" = String, Path)),
    responses((status = 200, body = WindowAnswer), Problems)
)]
async fn get_window(
    State(service): State<Shared>,
    Path(id): Path<String>,
) -> Result<axum::Json<WindowAnswer>, ApiError> {
    let window = store::windows::get(&service.store, &id).await?.ok_or(ApiError::NotFound("window", id))?;
    Ok(axum::Json(shown(window, false)))
}

/// Deletes a window that no fit cites. The measurements that it covered show again.
///
/// Fits that were rejected cite nothing that has to stay.
#[utoipa::path(
    delete,
    path = "/windows/{id}",
    tag = "windows",
    params(("id" = String, Path)),
    responses(
        (status = 204, description = "It is gone"),
        (status = 409, description = "`window-cited`: `fits` cite it; `window-in-use`: `jobs` may be reading \
            it", body = super::problem::Problem, content_type = "application/problem+json"),
        Problems,
    )
)]
async fn delete_window(
    State(service): State<Shared>,
    caller: Caller,
    Path(id): Path<String>,
) -> Result<StatusCode, ApiError> {
    windows::delete(&service, &id, caller.name()).await?;
    Ok(StatusCode::NO_CONTENT)
}
