//! Measurements as clients of InfluxDB send them, and the rules that say where they belong.

use super::access::Caller;
use super::dialect::{InfluxError, InfluxRefusal};
use super::extract::{Asked, Json, Packed};
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use crate::service::catalogue::line_rules::{self, LineRules};
use crate::service::catalogue::lines::{self, TakenLines};
use crate::service::observe::lines::UntakenLine;
use crate::service::serving::live;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use lampyris_core::data::TimePrecision;
use lampyris_core::fault::Fault;
use serde::{Deserialize, Serialize};
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(write_lines))
        .routes(routes!(write_lines_v2))
        .routes(routes!(ping))
        .routes(routes!(get_influx, put_influx))
}

/// What a client says of its lines. The places that it names, such as `db` and `bucket`, mean nothing here.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
#[expect(dead_code, reason = "they are taken, and mean nothing")]
struct WriteQuery {
    /// The unit of the times: `ns` by default, `us`, `ms`, `s`; of version 1 also `n`, `u`, `m` and `h`.
    #[param(inline, value_type = Option<String>, example = "s")]
    precision: Option<String>,
    /// A database of version 1.
    db: Option<String>,
    /// A retention policy of version 1.
    rp: Option<String>,
    /// How many nodes of a cluster must have it.
    consistency: Option<String>,
    /// A user of version 1.
    u: Option<String>,
    /// A password of version 1: a token. In the head it is seen by fewer.
    p: Option<String>,
    /// An organisation of version 2.
    org: Option<String>,
    /// The id of an organisation.
    #[serde(rename = "orgID")]
    #[param(rename = "orgID")]
    org_id: Option<String>,
    /// A bucket of version 2.
    bucket: Option<String>,
}

/// Takes measurements in line protocol, as InfluxDB 1 does.
///
/// `PUT /sources/influx` says which values belong to which systems. What no rule takes is counted and is no
/// error, and texts are left out. Lines that cannot be read are named with a 400; all others are taken. A
/// line without a time is of now. The body may be packed (`Content-Encoding: gzip`).
#[utoipa::path(
    post,
    path = "/write",
    tag = "windows",
    params(WriteQuery),
    request_body(content = Option<String>, content_type = "text/plain"),
    responses(
        (status = 204, description = "Taken"),
        (status = 400, description = "`invalid`: these lines cannot be read; the others were taken", body = InfluxError),
        (status = 401, description = "No token that is good was sent", body = InfluxError),
        (status = 403, description = "The token is not good for this", body = InfluxError),
        (status = 413, description = "The body is too large", body = InfluxError),
        (status = 429, description = "Too many wrong tokens came from this address", body = InfluxError),
        (status = 503, description = "It cannot be done now: send it again", body = InfluxError),
    )
)]
async fn write_lines(
    service: State<Shared>,
    caller: Caller,
    query: Result<Asked<WriteQuery>, ApiError>,
    body: Result<Packed, ApiError>,
) -> Result<StatusCode, InfluxRefusal> {
    write(&service, &caller, query?.0, body?).await
}

/// Takes measurements in line protocol, as InfluxDB 2 does: as `POST /write`.
#[utoipa::path(
    post,
    path = "/api/v2/write",
    tag = "windows",
    params(WriteQuery),
    request_body(content = Option<String>, content_type = "text/plain"),
    responses(
        (status = 204, description = "Taken"),
        (status = 400, description = "`invalid`: these lines cannot be read; the others were taken", body = InfluxError),
        (status = 401, description = "No token that is good was sent", body = InfluxError),
        (status = 403, description = "The token is not good for this", body = InfluxError),
        (status = 413, description = "The body is too large", body = InfluxError),
        (status = 429, description = "Too many wrong tokens came from this address", body = InfluxError),
        (status = 503, description = "It cannot be done now: send it again", body = InfluxError),
    )
)]
async fn write_lines_v2(
    service: State<Shared>,
    caller: Caller,
    query: Result<Asked<WriteQuery>, ApiError>,
    body: Result<Packed, ApiError>,
) -> Result<StatusCode, InfluxRefusal> {
    write(&service, &caller, query?.0, body?).await
}

async fn write(
    service: &Shared,
    caller: &Caller,
    query: WriteQuery,
    body: Packed,
) -> Result<StatusCode, InfluxRefusal> {
    let precision = match query.precision.as_deref() {
        None | Some("") => TimePrecision::default(),
        Some(word) => TimePrecision::of_word(word).ok_or_else(|| {
            let detail = "a precision is ns, us, ms or s";
            ApiError::Invalid(vec![Fault::new("query precision", "unknown-value", detail)])
        })?,
    };
    let TakenLines { systems, faults } = lines::take(service, body.0, precision, caller.reach()).await?;
    live::go_on_behind(service, systems);
    if faults.count == 0 {
        return Ok(StatusCode::NO_CONTENT);
    }
    let mut listed = faults.listed;
    if faults.count > listed.len() {
        let more = format!("and {} lines more", faults.count - listed.len());
        listed.push(Fault::new("lines", "more-faults", more));
    }
    Err(ApiError::Invalid(listed).into())
}

/// Whether somebody is there, as clients of InfluxDB ask it.
#[utoipa::path(
    get,
    path = "/ping",
    tag = "service",
    responses((
        status = 204,
        description = "Somebody is",
        headers(("X-Influxdb-Version" = String, description = "The version of this service"))
    ))
)]
async fn ping() -> Response {
    let version = concat!("lampyris-", env!("CARGO_PKG_VERSION"));
    (StatusCode::NO_CONTENT, [("x-influxdb-version", version)]).into_response()
}

/// The rules, and what they do not take.
#[derive(Debug, Serialize, ToSchema)]
struct InfluxSource {
    /// The rules.
    #[serde(flatten)]
    #[schema(inline)]
    rules: LineRules,
    /// Under which name they were changed last; `null` where nobody has written any.
    changed_by: Option<String>,
    /// When.
    #[schema(value_type = Option<String>, format = DateTime)]
    changed_at: Option<Timestamp>,
    /// Values that were taken since the start of the service.
    taken: u64,
    /// Values that were not.
    untaken: u64,
    /// Whose values were not, the latest first; 200 names at most.
    latest_untaken: Vec<UntakenLine>,
}

/// Where the measurements of `POST /write` belong, and the names of the latest that no rule takes.
#[utoipa::path(
    get,
    path = "/sources/influx",
    tag = "windows",
    responses((status = 200, body = InfluxSource), Problems)
)]
async fn get_influx(State(service): State<Shared>) -> Result<axum::Json<InfluxSource>, ApiError> {
    shown(&service).await
}

/// Says where the measurements of `POST /write` belong. The first rule that takes a value counts.
///
/// The rules count from the next write on.
#[utoipa::path(
    put,
    path = "/sources/influx",
    tag = "windows",
    request_body = LineRules,
    responses((status = 200, description = "They are kept", body = InfluxSource), Problems)
)]
async fn put_influx(
    State(service): State<Shared>,
    caller: Caller,
    body: Json,
) -> Result<axum::Json<InfluxSource>, ApiError> {
    line_rules::put(&service, body.value, caller.name()).await?;
    shown(&service).await
}

async fn shown(service: &Shared) -> Result<axum::Json<InfluxSource>, ApiError> {
    let (rules, record) = line_rules::get(service).await?;
    let (taken, untaken) = service.lines.counts();
    let (changed_by, changed_at) = record.map(|record| (record.changed_by, record.changed_at)).unzip();
    let latest_untaken = service.lines.untaken();
    Ok(axum::Json(InfluxSource { rules, changed_by, changed_at, taken, untaken, latest_untaken }))
}
