//! The events of a job as they happen: `queued`, `started`, `progress` and `finished`.
//!
//! Every event has an id that says where the job stood, so a client that comes back with `Last-Event-ID` is
//! told only what it has missed. Progress comes at most four times a second, and always the newest.

use super::Shared;
use super::jobs::{JobAnswer, ProgressAnswer, budget, require};
use super::problem::{ApiError, Problems};
use crate::jobs::board::Stage;
use crate::store::jobs::{JobRecord, JobState};
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use std::convert::Infallible;
use std::time::Duration;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The pause between two looks at the board.
const PACE: Duration = Duration::from_millis(250);
/// A comment this often keeps proxies from closing an idle stream.
const KEEP_ALIVE: Duration = Duration::from_secs(15);
/// The id of the last event of every job.
const FINISHED: &str = "finished";

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_events))
}

/// One event of a job.
#[derive(ToSchema)]
#[expect(dead_code, reason = "describes the lines of the stream")]
struct JobEvent {
    #[schema(inline)]
    event: JobEventName,
    /// Where the job stood; `Last-Event-ID` with it leads on from there.
    id: String,
    /// JSON: a `Progress` of `progress`, a `Job` of all others.
    data: String,
}

#[derive(ToSchema)]
#[serde(rename_all = "lowercase")]
#[expect(dead_code, reason = "describes the lines of the stream")]
enum JobEventName {
    Queued,
    Started,
    Progress,
    Finished,
}

/// The events of a job: `queued`, `started`, `progress` at most four times a second, `finished`; then the stream ends.
#[utoipa::path(
    get,
    path = "/jobs/{id}/events",
    tag = "jobs",
    params(("id" = String, Path), ("Last-Event-ID" = Option<String>, Header, description = "The id of the last event that was seen")),
    responses(
        (status = 200, description = "Server-sent events", body = JobEvent, content_type = "text/event-stream"),
        (status = 204, description = "The end was seen already: do not come back"),
        Problems,
    )
)]
async fn get_events(State(service): State<Shared>, Path(id): Path<String>, headers: HeaderMap) -> Result<Response, ApiError> {
    let seen = headers.get("last-event-id").and_then(|value| value.to_str().ok()).unwrap_or_default().to_owned();
    if seen == FINISHED {
        require(&service, &id).await?;
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    let job = require(&service, &id).await?;
    let (sender, receiver) = mpsc::channel(4);
    tokio::spawn(async move {
        // The client may go at any time; then there is nobody to tell.
        let _ = tell(&service, job, &seen, &sender).await;
    });
    Ok(Sse::new(ReceiverStream::new(receiver)).keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response())
}

/// Nobody listens any more, or there is nothing left to say.
struct Over;

impl<T> From<mpsc::error::SendError<T>> for Over {
    fn from(_: mpsc::error::SendError<T>) -> Self {
        Over
    }
}

type Sender = mpsc::Sender<Result<Event, Infallible>>;

async fn tell(service: &Shared, job: JobRecord, seen: &str, sender: &Sender) -> Result<(), Over> {
    // The listener is registered before the job is read, so that an end in between is not missed.
    let mut stages = service.board.place(&job.id).watch();
    let mut stopping = service.stopping.subscribe();
    let mut last_progress = 0;
    let mut told_attempt =
        seen.strip_prefix("started-").or(seen.strip_prefix("progress-")).and_then(|rest| rest.split('-').next()?.parse().ok());
    if seen.is_empty() {
        send(sender, "queued", "queued".to_owned(), &JobAnswer::of(service, job.clone())).await?;
    }
    loop {
        let job = require(service, &job.id).await.map_err(|_| Over)?;
        if job.state.is_final() {
            service.board.end(&job.id);
            return send(sender, FINISHED, FINISHED.to_owned(), &JobAnswer::of(service, job)).await;
        }
        if job.state == JobState::Running && told_attempt != Some(job.attempt) {
            told_attempt = Some(job.attempt);
            last_progress = 0;
            send(sender, "started", format!("started-{}", job.attempt), &JobAnswer::of(service, job.clone())).await?;
        }
        // As long as the stage stays, only progress can be news, and the database need not be asked.
        loop {
            tokio::select! {
                changed = stages.changed() => changed.map_err(|_| Over)?,
                _ = stopping.wait_for(|stopping| *stopping) => return Ok(()),
                () = sender.closed() => return Err(Over),
            }
            let stage = stages.borrow_and_update().clone();
            let Some(progress) = ProgressAnswer::of(&stage, budget(&job)) else {
                break;
            };
            let Stage::Running { lease, progress: Some(reported), .. } = &stage else {
                break;
            };
            if told_attempt != Some(lease.attempt) {
                break;
            }
            if reported.evaluations > last_progress {
                last_progress = reported.evaluations;
                send(sender, "progress", format!("progress-{}-{last_progress}", lease.attempt), &progress).await?;
                tokio::time::sleep(PACE).await;
            }
        }
    }
}

async fn send(sender: &Sender, name: &str, id: String, data: &impl Serialize) -> Result<(), Over> {
    let Ok(event) = Event::default().event(name).id(id).json_data(data) else {
        return Err(Over);
    };
    Ok(sender.send(Ok(event)).await?)
}
