//! When systems are recalibrated or diagnosed.

use super::access::{Caller, within};
use super::extract::{Asked, Empty, Json};
use super::jobs::batch_answer;
use super::page::{Page, PageQuery};
use super::problem::{ApiError, PROBLEM_JSON, Problem, Problems};
use super::shared::Shared;
use crate::service::queue::schedules::{self, ScheduleDocument, Ticks};
use crate::service::queue::submit;
use crate::store;
use crate::store::batches::BatchKind;
use crate::store::jobs::Priority;
use crate::store::schedules::{ScheduleRecord, TickResult};
use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use lampyris_core::data::SystemPattern;
use serde::Serialize;
use serde_json::Value;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// How many of the next ticks are shown.
const SHOWN_TICKS: usize = 5;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(list_schedules))
        .routes(routes!(get_schedule, put_schedule, delete_schedule))
        .routes(routes!(preview_schedule))
        .routes(routes!(run_schedule))
}

/// A schedule and what it has done.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Schedule)]
struct ScheduleAnswer {
    name: String,
    cron: String,
    /// The pattern in words.
    #[schema(example = "At 02:30.")]
    in_words: String,
    zone: String,
    /// What is done: estimates that are served where they are accepted, or diagnoses.
    kind: BatchKind,
    enabled: bool,
    /// Which systems.
    #[schema(value_type = Vec<SystemPattern>)]
    systems: Value,
    /// What is asked of each.
    #[schema(value_type = Object)]
    request: Value,
    /// Ticks that were missed while the service was down are made up for once.
    #[schema(example = "one_catch_up")]
    misfire: &'static str,
    /// The next five ticks; none while it is paused.
    #[schema(value_type = Vec<String>)]
    next_runs: Vec<Timestamp>,
    last_run: Option<LastRun>,
    /// `submitted`, `skipped_overlap` (the batch before still ran) or `nothing_to_do`.
    last_result: Option<TickResult>,
}

/// What a schedule would do.
#[derive(Debug, Serialize, ToSchema)]
struct SchedulePreview {
    /// The pattern in words.
    #[schema(example = "At 02:30.")]
    in_words: String,
    /// The zone of the pattern: that of the service where none is named.
    #[schema(example = "Europe/Copenhagen")]
    zone: String,
    /// The next five ticks, if it is not paused.
    #[schema(value_type = Vec<String>)]
    next_runs: Vec<Timestamp>,
}

/// The newest batch of a schedule.
#[derive(Debug, Serialize, ToSchema)]
struct LastRun {
    #[schema(value_type = String, format = DateTime)]
    at: Timestamp,
    batch: String,
}

impl ScheduleAnswer {
    fn of(record: ScheduleRecord, now: Timestamp) -> Self {
        let ticks = Ticks::read(&record.cron, &record.zone);
        let next_runs = match &ticks {
            Ok(ticks) if record.enabled => ticks.next(now, SHOWN_TICKS),
            _ => Vec::new(),
        };
        let in_words = ticks.map(|ticks| ticks.in_words()).unwrap_or_default();
        let mut request = record.request;
        let kind = request.as_object_mut().and_then(|fields| fields.shift_remove("kind"));
        let systems =
            request.as_object_mut().and_then(|fields| fields.shift_remove("systems")).unwrap_or_default();
        Self {
            name: record.name,
            cron: record.cron,
            in_words,
            zone: record.zone,
            kind: kind.and_then(|kind| serde_json::from_value(kind).ok()).unwrap_or(BatchKind::usual()),
            enabled: record.enabled,
            systems,
            request,
            misfire: "one_catch_up",
            next_runs,
            last_run: record.last_run_at.zip(record.last_batch).map(|(at, batch)| LastRun { at, batch }),
            last_result: record.last_result,
        }
    }
}

async fn require(service: &Shared, name: &str) -> Result<ScheduleRecord, ApiError> {
    store::schedules::get(&service.store, name)
        .await?
        .ok_or_else(|| ApiError::NotFound("schedule", name.to_owned()))
}

/// One schedule.
#[utoipa::path(
    get,
    path = "/schedules/{name}",
    tag = "schedules",
    params(("name" = String, Path, example = "nightly")),
    responses((status = 200, body = ScheduleAnswer), Problems)
)]
async fn get_schedule(
    State(service): State<Shared>,
    Path(name): Path<String>,
) -> Result<axum::Json<ScheduleAnswer>, ApiError> {
    Ok(axum::Json(ScheduleAnswer::of(require(&service, &name).await?, service.now())))
}

/// Makes or replaces a schedule. Its ticks count from now on.
#[utoipa::path(
    put,
    path = "/schedules/{name}",
    tag = "schedules",
    params(("name" = String, Path, pattern = "^[A-Za-z0-9_-]{1,64}$", example = "nightly")),
    request_body = ScheduleDocument,
    responses(
        (status = 200, description = "Replaced", body = ScheduleAnswer),
        (status = 201, description = "Made", body = ScheduleAnswer),
        Problems
    )
)]
async fn put_schedule(
    State(service): State<Shared>,
    caller: Caller,
    Path(name): Path<String>,
    body: Json,
) -> Result<Response, ApiError> {
    caller.may_select(&schedules::selected(&body.value))?;
    let is_new = schedules::put(&service, &name, body.value, caller.name()).await?;
    let answer = ScheduleAnswer::of(require(&service, &name).await?, service.now());
    Ok((if is_new { StatusCode::CREATED } else { StatusCode::OK }, axum::Json(answer)).into_response())
}

/// What a schedule would do: its next ticks, or every fault of it. Nothing is kept.
#[utoipa::path(
    post,
    path = "/schedules/{name}/preview",
    tag = "schedules",
    params(("name" = String, Path, pattern = "^[A-Za-z0-9_-]{1,64}$", example = "nightly")),
    request_body = ScheduleDocument,
    responses((status = 200, body = SchedulePreview), Problems)
)]
async fn preview_schedule(
    State(service): State<Shared>,
    Path(name): Path<String>,
    body: Json,
) -> Result<axum::Json<SchedulePreview>, ApiError> {
    let (zone, ticks) = schedules::preview(&service, &name, body.value)?;
    Ok(axum::Json(SchedulePreview {
        in_words: ticks.in_words(),
        zone,
        next_runs: ticks.next(service.now(), SHOWN_TICKS),
    }))
}

/// All schedules, by name.
#[utoipa::path(
    get,
    path = "/schedules",
    tag = "schedules",
    params(PageQuery),
    responses((status = 200, body = Page<ScheduleAnswer>), Problems)
)]
async fn list_schedules(
    State(service): State<Shared>,
    caller: Caller,
    Asked(page): Asked<PageQuery>,
) -> Result<axum::Json<Page<ScheduleAnswer>>, ApiError> {
    let size = page.size()?;
    let after = page.page_token.unwrap_or_default();
    let is_left = |record: &ScheduleRecord| record.name > after && within(caller.reach(), &record.request);
    let left: Vec<ScheduleRecord> =
        store::schedules::all(&service.store).await?.into_iter().filter(is_left).collect();
    Ok(axum::Json(Page::of(
        left,
        size,
        |record| record.name.clone(),
        |record| ScheduleAnswer::of(record, service.now()),
    )))
}

/// Removes a schedule; what it has submitted stays. The nightly one can be disabled, not removed.
#[utoipa::path(
    delete,
    path = "/schedules/{name}",
    tag = "schedules",
    params(("name" = String, Path, example = "nightly")),
    responses(
        (status = 204, description = "It is gone"),
        (
            status = 409,
            description = "`schedule-not-removable`: it is part of the service",
            body = Problem,
            content_type = PROBLEM_JSON
        ),
        Problems,
    )
)]
async fn delete_schedule(
    State(service): State<Shared>,
    caller: Caller,
    Path(name): Path<String>,
    _body: Empty,
) -> Result<StatusCode, ApiError> {
    schedules::delete(&service, &name, caller.name()).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Submits the batch of a schedule now, whatever its pattern says.
#[utoipa::path(
    post,
    path = "/schedules/{name}/run",
    tag = "schedules",
    params(("name" = String, Path, example = "nightly"), ("Idempotency-Key" = Option<String>, Header)),
    responses(
        (
            status = 202,
            description = "The batch; `Location` leads to it",
            body = super::batches::BatchAnswer,
            headers(("Location" = String))
        ),
        (
            status = 429,
            description = "So many jobs wait already; `Retry-After` says when to ask again",
            body = Problem,
            content_type = PROBLEM_JSON
        ),
        Problems,
    )
)]
async fn run_schedule(
    State(service): State<Shared>,
    Path(name): Path<String>,
    body: Empty,
) -> Result<Response, ApiError> {
    let record = require(&service, &name).await?;
    let request = schedules::request(&record)?;
    let submitted =
        submit::several(&service, &request, Some(&name), Priority::Operator, body.key.as_ref()).await?;
    batch_answer(&service, submitted).await
}
