//! What the nights have come to, for programs and for people.

use super::access::{Caller, within};
use super::batches::BatchListRow;
use super::description::With;
use super::extract::{Asked, accepted};
use super::night_page;
use super::page::{Page, PageQuery};
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use crate::service::query::night::report::NightReport;
use crate::service::query::night::{self, Night};
use crate::store;
use crate::store::batches::BatchSummary;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{Html, IntoResponse, Response};
use jiff::civil::Date;
use serde::Serialize;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The page of a night runs no scripts and loads nothing; its styles stand in it, as mail programs want them.
const POLICY: &str = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'";

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(list_nights)).routes(routes!(get_night))
}

/// A batch that a schedule has submitted, in a list of nights.
type NightRow = With<NightDay, BatchListRow>;

/// When a batch was submitted.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = NightRow)]
struct NightDay {
    /// The day on the clock of the service; several batches may have one.
    #[schema(format = Date, example = "2026-11-26")]
    night: String,
}

/// What schedules have done, newest first: a row for each batch, with the day that it belongs to.
#[utoipa::path(
    get,
    path = "/nights",
    tag = "nights",
    params(PageQuery),
    responses((status = 200, body = Page<NightRow>), Problems)
)]
async fn list_nights(
    State(service): State<Shared>,
    caller: Caller,
    Asked(page): Asked<PageQuery>,
) -> Result<axum::Json<Page<NightRow>>, ApiError> {
    let size = page.size()?;
    let records =
        store::batches::page(&service.store, caller.reach(), true, page.before()?, size + 1).await?;
    let row = |record: BatchSummary| NightRow {
        own: NightDay { night: night::day_of(record.created_at, &service.settings.zone) },
        document: record.into(),
    };
    Ok(axum::Json(Page::of(records, size, |record| record.sequence.to_string(), row)))
}

/// What a night has come to: what changed, who was refused and why, who has turned stale, what to do next.
///
/// A night is a day on the clock of the service, with all that schedules have submitted then, or one batch.
/// As `text/html` it is a page by itself that can be sent as a mail.
#[utoipa::path(
    get,
    path = "/nights/{id}",
    tag = "nights",
    params(("id" = String, Path, description = "A day, such as `2026-11-26`, or the id of a batch",
        example = "2026-11-26")),
    responses(
        (status = 200, content((NightReport = "application/json"), (String = "text/html"))),
        Problems
    )
)]
async fn get_night(
    State(service): State<Shared>,
    caller: Caller,
    Path(id): Path<String>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let form = accepted(&headers, &["application/json", "text/html"])?;
    let reach = caller.reach();
    let ids = match id.parse::<Date>().ok().and_then(|day| night::bounds(day, &service.settings.zone)) {
        Some((from, to)) => store::batches::of_schedules(&service.store, from, to).await?,
        None => vec![id.clone()],
    };
    let mut batches = Vec::new();
    for batch in &ids {
        let found = store::batches::get(&service.store, batch).await?;
        batches.extend(found.filter(|found| within(reach, &found.request)));
    }
    let report = night::report(&service, reach, Night { name: id.clone(), batches }).await?;
    let report = report.ok_or(ApiError::NotFound("night", id))?;
    let mut response = if form == "text/html" {
        let mut page = Html(night_page::page(&report, &night_page::base(&service, &headers))).into_response();
        page.headers_mut().insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(POLICY));
        page
    } else {
        axum::Json(report).into_response()
    };
    response.headers_mut().insert(header::VARY, HeaderValue::from_static("accept"));
    Ok(response)
}
