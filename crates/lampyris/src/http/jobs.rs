//! Jobs: posted here, run elsewhere.

use super::access::Caller;
use super::batches::BatchAnswer;
use super::extract::{Asked, Empty, Json};
use super::page::{Page, PageQuery};
use super::problem::{ApiError, PROBLEM_JSON, Problem, Problems};
use super::shared::Shared;
use crate::service::Service;
use crate::service::queue::body::JobBody;
use crate::service::queue::request::{self, BatchJob, JobRequest, SystemJob};
use crate::service::queue::submit;
use crate::service::work::progress::ProgressReport;
use crate::store;
use crate::store::batches::SubmittedBatch;
use crate::store::jobs::{
    Filter, JobKind, JobOrder, JobRecord, JobResult, JobState, JobStatus, Origin, Outcome, Priority,
};
use crate::store::queue::Submitted;
use axum::extract::{Path, State};
use axum::http::{HeaderName, StatusCode, header};
use axum::response::{IntoResponse, Response};
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::estimate::tune::Tuning;
use lampyris_core::fault::Fault;
use lampyris_core::model::ModelId;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new()
        .routes(routes!(post_job, list_jobs))
        .routes(routes!(count_jobs))
        .routes(routes!(get_job))
        .routes(routes!(cancel_job))
        .routes(routes!(retry_job))
}

/// A job.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Job)]
pub struct JobAnswer {
    id: String,
    kind: JobKind,
    system: SystemId,
    model: ModelId,
    state: JobStatus,
    /// What it led to; `null` unless an estimate or a tuning succeeded.
    outcome: Option<Outcome>,
    experiment: bool,
    origin: Origin,
    priority: Priority,
    /// What was asked, with all defaults filled in.
    #[schema(value_type = Object)]
    request: Value,
    /// How far it has come, while it runs.
    progress: Option<ProgressReport>,
    /// Why the search ended.
    stopped_by: Option<String>,
    /// What the search cost.
    evaluations: Option<i64>,
    /// How long it ran, in seconds.
    wall_s: Option<f64>,
    /// What it found.
    fit: Option<String>,
    /// The revision that it published.
    revision: Option<i64>,
    /// Why it failed.
    error: Option<store::jobs::JobFailure>,
    /// How often it was started.
    attempt: i64,
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
    #[schema(value_type = Option<String>, format = DateTime)]
    started_at: Option<Timestamp>,
    #[schema(value_type = Option<String>, format = DateTime)]
    ended_at: Option<Timestamp>,
    /// The job that it repeats.
    retry_of: Option<String>,
    /// What it diagnosed, for the kind `diagnose`.
    diagnosis: Option<String>,
    /// The settings that it chose and how they fare on windows that the choice did not see, for the kind
    /// `tune`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<Tuning>)]
    tuning: Option<Value>,
    /// Where to go from here.
    links: BTreeMap<&'static str, String>,
}

/// What a request became: a job, or a batch of them.
#[derive(Serialize, ToSchema)]
#[schema(as = Submitted)]
#[serde(untagged)]
enum SubmittedAnswer {
    Job(Box<JobAnswer>),
    Batch(Box<BatchAnswer>),
}

/// Which jobs are listed.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct JobQuery {
    /// `submitted` by default; `turn` lists those that wait, `ended` those that have ended.
    #[param(inline)]
    order: Option<JobOrder>,
    /// Only those that stand so.
    state: Option<JobStatus>,
    /// Only those of this system.
    system: Option<SystemId>,
    /// Only those of this kind.
    kind: Option<JobKind>,
    /// Items per page, 50 by default, at most 500.
    #[param(minimum = 1, maximum = 500)]
    page_size: Option<i64>,
    /// The `next_page_token` of the page before.
    page_token: Option<String>,
}

impl JobAnswer {
    /// A job as it is shown.
    pub fn of(service: &Service, job: JobRecord) -> Self {
        let progress = match job.state {
            JobState::Running { .. } => service.board.report(&job.id),
            _ => None,
        };
        Self { progress, ..Self::without_progress(job) }
    }

    /// A job as its events tell of it: progress has events of its own, and all listeners hear the same of a
    /// start.
    pub fn without_progress(job: JobRecord) -> Self {
        let mut links = BTreeMap::from([
            ("self", format!("/jobs/{}", job.id)),
            ("events", format!("/jobs/{}/events", job.id)),
        ]);
        links.insert("params", format!("/params/{}", job.system));
        if job.kind == JobKind::Ladder {
            links.insert("ladder", format!("/systems/{}/ladder", job.system));
        }
        let started_at = job.state.started_at();
        let ended_at = job.state.ended().map(|ended| ended.at);
        let wall =
            started_at.zip(ended_at).map(|(start, end)| end.duration_since(start).as_secs_f64().max(0.0));
        let mut answer = Self {
            kind: job.kind,
            model: job.model,
            state: job.state.status(),
            outcome: job.state.outcome(),
            experiment: job.experiment,
            origin: job.origin,
            priority: job.priority,
            request: job.request,
            progress: None,
            stopped_by: None,
            evaluations: None,
            wall_s: wall,
            fit: None,
            revision: None,
            error: None,
            attempt: job.attempt,
            created_at: job.created_at,
            started_at,
            ended_at,
            retry_of: job.retry_of,
            diagnosis: None,
            tuning: None,
            links,
            system: job.system,
            id: job.id,
        };
        match job.state {
            JobState::Queued { .. } | JobState::Running { .. } | JobState::Cancelled { .. } => {}
            JobState::Succeeded { result, .. } => answer.add(result),
            JobState::Failed { failure, .. } => answer.error = Some(failure),
        }
        answer
    }

    /// Shows what the job came to, and where that is.
    fn add(&mut self, result: JobResult) {
        self.evaluations = Some(result.evaluations());
        if let Some(found) = result.found() {
            self.links.insert("fit", format!("/fits/{}", found.id));
            self.fit = Some(found.id.clone());
            self.revision = found.revision;
            self.stopped_by = Some(found.stopped_by.clone());
        }
        match result {
            JobResult::Estimated { .. } | JobResult::Climbed { .. } => {}
            JobResult::Diagnosed { diagnosis, .. } => {
                self.links.insert("diagnosis", format!("/diagnoses/{diagnosis}"));
                self.diagnosis = Some(diagnosis);
            }
            JobResult::Tuned { tuning, .. } => self.tuning = Some(tuning),
        }
    }
}

/// The job that must be there.
pub(crate) async fn require(service: &Service, id: &str) -> Result<JobRecord, ApiError> {
    store::jobs::get(&service.store, id).await?.ok_or_else(|| ApiError::NotFound("job", id.to_owned()))
}

/// Submits a job, or a batch of them.
#[utoipa::path(
    post,
    path = "/jobs",
    tag = "jobs",
    params(("Idempotency-Key" = Option<String>, Header)),
    request_body = JobBody,
    responses(
        (status = 200, description = "An equal job waits already", body = JobAnswer),
        (status = 202, description = "It waits; `Location` leads to it. Several systems answer with their \
            batch", body = SubmittedAnswer, headers(("Location" = String))),
        (
            status = 429,
            description = "So many jobs wait already; `Retry-After` says when to ask again",
            body = Problem,
            content_type = PROBLEM_JSON
        ),
        Problems,
    )
)]
async fn post_job(State(service): State<Shared>, caller: Caller, body: Json) -> Result<Response, ApiError> {
    caller.may_name(&service, &body.value)?;
    let asked = match request::read(body.value.clone()) {
        Ok(asked) => asked,
        Err(mut faults) => {
            faults.extend(submit::further_faults(&service, &body.value, &faults).await?);
            return Err(ApiError::Invalid(faults));
        }
    };
    match asked {
        JobRequest::One(SystemJob { kind, system, experiment, priority, settings }) => {
            let submitted =
                submit::one(&service, kind, &system, experiment, priority, &settings, body.key.as_ref())
                    .await?;
            job_answer(&service, submitted).await
        }
        JobRequest::Several(BatchJob { priority, batch }) => {
            caller.may_select(&batch.systems)?;
            let submitted = submit::several(&service, &batch, None, priority, body.key.as_ref()).await?;
            batch_answer(&service, submitted).await
        }
    }
}

/// The answer to a job that was submitted.
async fn job_answer(service: &Service, submitted: Submitted) -> Result<Response, ApiError> {
    let (status, job, replayed) = match submitted {
        Submitted::New(job) => (StatusCode::ACCEPTED, job, false),
        Submitted::Waiting(job) => (StatusCode::OK, job, false),
        Submitted::Earlier(earlier) => {
            (status(earlier.status), require(service, &earlier.resource).await?, true)
        }
    };
    let location = format!("/jobs/{}", job.id);
    let job = SubmittedAnswer::Job(Box::new(JobAnswer::of(service, job)));
    Ok(answer(status, location, replayed, job))
}

/// The answer to a batch that was submitted.
pub(crate) async fn batch_answer(service: &Service, submitted: SubmittedBatch) -> Result<Response, ApiError> {
    let (status, id, replayed) = match submitted {
        SubmittedBatch::New(id) => (StatusCode::ACCEPTED, id, false),
        SubmittedBatch::Earlier(earlier) => (status(earlier.status), earlier.resource, true),
    };
    let batch = store::batches::get(&service.store, &id).await?.ok_or(ApiError::NotFound("batch", id))?;
    let location = format!("/batches/{}", batch.id);
    let batch = SubmittedAnswer::Batch(Box::new(BatchAnswer::of(service, batch)));
    Ok(answer(status, location, replayed, batch))
}

fn answer(status: StatusCode, location: String, replayed: bool, submitted: SubmittedAnswer) -> Response {
    let mut response = (status, [(header::LOCATION, location)], axum::Json(submitted)).into_response();
    if replayed {
        response.headers_mut().insert(
            HeaderName::from_static("idempotency-replayed"),
            header::HeaderValue::from_static("true"),
        );
    }
    response
}

fn status(code: u16) -> StatusCode {
    StatusCode::from_u16(code).unwrap_or(StatusCode::OK)
}

/// Jobs, the one that was submitted last first, unless another `order` is asked for.
#[utoipa::path(
    get,
    path = "/jobs",
    tag = "jobs",
    params(JobQuery),
    responses((status = 200, body = Page<JobAnswer>), Problems)
)]
async fn list_jobs(
    State(service): State<Shared>,
    caller: Caller,
    Asked(query): Asked<JobQuery>,
) -> Result<axum::Json<Page<JobAnswer>>, ApiError> {
    let order = query.order.unwrap_or(JobOrder::Submitted);
    let belongs = |state: JobStatus| match order {
        JobOrder::Submitted => true,
        JobOrder::Turn => state == JobStatus::Queued,
        JobOrder::Ended => state.is_final(),
    };
    if let Some(state) = query.state.filter(|state| !belongs(*state)) {
        let detail = format!("no job that is {} is listed in the order {}", state.as_str(), order.as_str());
        return Err(ApiError::Invalid(vec![Fault::new("query order", "contradiction", detail)]));
    }
    let page = PageQuery { page_size: query.page_size, page_token: query.page_token };
    let filter =
        Filter { state: query.state, kind: query.kind, system: query.system, reach: caller.reach().clone() };
    let size = page.size()?;
    let behind = page.page_token.as_ref().map(|_| page.before()).transpose()?;
    let records = store::jobs::page(&service.store, &filter, order, behind, size + 1).await?;
    let place = |record: &JobRecord| match order {
        JobOrder::Submitted | JobOrder::Turn => record.sequence,
        JobOrder::Ended => record.state.end_sequence().unwrap_or_default(),
    };
    Ok(axum::Json(Page::of(
        records,
        size,
        |record| place(record).to_string(),
        |record| JobAnswer::of(&service, record),
    )))
}

/// How many jobs stand how.
#[utoipa::path(
    get,
    path = "/jobs/counts",
    tag = "jobs",
    responses((status = 200, body = BTreeMap<String, i64>), Problems)
)]
async fn count_jobs(
    State(service): State<Shared>,
    caller: Caller,
) -> Result<axum::Json<BTreeMap<&'static str, i64>>, ApiError> {
    let counts = store::jobs::counts(&service.store, caller.reach()).await?;
    Ok(axum::Json(counts.into_iter().map(|(state, count)| (state.as_str(), count)).collect()))
}

/// One job.
#[utoipa::path(
    get,
    path = "/jobs/{id}",
    tag = "jobs",
    params(("id" = String, Path)),
    responses((status = 200, body = JobAnswer), Problems)
)]
async fn get_job(
    State(service): State<Shared>,
    Path(id): Path<String>,
) -> Result<axum::Json<JobAnswer>, ApiError> {
    let job = require(&service, &id).await?;
    if job.state.is_final() {
        service.board.settled(&job.id).await;
    }
    Ok(axum::Json(JobAnswer::of(&service, job)))
}

/// Calls a job off. Where this answers 200 the job publishes nothing, whatever it has come to meanwhile;
/// where it has come to its result before, this answers 409. Calling it off twice changes nothing.
#[utoipa::path(
    post,
    path = "/jobs/{id}/cancel",
    tag = "jobs",
    params(("id" = String, Path)),
    responses(
        (
            status = 200,
            description = "The job as it is now; one that runs stops within half a second",
            body = JobAnswer
        ),
        (
            status = 409,
            description = "The job has come to its result (`already-deciding`)",
            body = Problem,
            content_type = PROBLEM_JSON
        ),
        Problems
    )
)]
async fn cancel_job(
    State(service): State<Shared>,
    Path(id): Path<String>,
    _body: Empty,
) -> Result<axum::Json<JobAnswer>, ApiError> {
    let job = submit::cancel(&service, &id).await?.ok_or(ApiError::NotFound("job", id))?;
    Ok(axum::Json(JobAnswer::of(&service, job)))
}

/// Does a job that has ended once more: a new job with the same request, which names it in `retry_of`.
#[utoipa::path(
    post,
    path = "/jobs/{id}/retry",
    tag = "jobs",
    params(("id" = String, Path), ("Idempotency-Key" = Option<String>, Header)),
    responses(
        (status = 200, description = "An equal job waits already", body = JobAnswer),
        (
            status = 202,
            description = "The new job waits; `Location` leads to it",
            body = JobAnswer,
            headers(("Location" = String))
        ),
        (
            status = 409,
            description = "The job has not ended",
            body = super::problem::Problem,
            content_type = "application/problem+json"
        ),
        Problems,
    )
)]
async fn retry_job(
    State(service): State<Shared>,
    Path(id): Path<String>,
    body: Empty,
) -> Result<Response, ApiError> {
    job_answer(&service, submit::retry(&service, &id, body.key.as_ref()).await?).await
}
