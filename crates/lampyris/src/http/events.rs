//! What happens, as server-sent events: `queued`, `started`, `progress`, `incumbent` and `finished` of jobs,
//! `params` and `state` of what is served, `changed` of a room that is another one.
//!
//! Every event has an id. A client that comes back with it (`Last-Event-ID`) is told what it has missed;
//! where the log no longer knows, also after a restart of the service, it is told how things stand: which
//! jobs wait and run, every end since, and what every system serves. No end is lost; around a return an event
//! may come twice.

use super::access::Caller;
use super::extract::Asked;
use super::jobs::{JobAnswer, require};
use super::places::{Connection, StreamPlace};
use super::problem::{ApiError, PROBLEM_JSON, Problem, Problems};
use super::shared::Shared;
use crate::service::changes::events::{Event as Happening, EventName, JobChange, Position, SystemChange};
use crate::service::changes::follow;
use crate::service::serving::snapshot::{ParamsChange, StateChange};
use crate::service::work::progress::ProgressReport;
use crate::store;
use crate::store::events::Missed;
use crate::store::jobs::{JobRecord, JobStatus};
use crate::store::reach::SystemScope;
use axum::Extension;
use axum::extract::{Path, State};
use axum::http::{HeaderMap, StatusCode};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use indexmap::IndexMap;
use lampyris_core::data::SystemId;
use lampyris_core::fault::Fault;
use serde::{Deserialize, Serialize};
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio_stream::wrappers::ReceiverStream;
use utoipa::{IntoParams, ToSchema};
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// A comment this often keeps proxies from closing an idle stream.
const KEEP_ALIVE: Duration = Duration::from_secs(15);
/// What a client is asked to wait before it comes back.
const RETRY: Duration = Duration::from_secs(1);
/// Events that may wait for a slow client; the rest stays in the log.
const AHEAD: usize = 16;
/// Jobs that are read from the database at once.
const CHUNK: i64 = 200;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_job_events)).routes(routes!(get_events))
}

/// Where a stream of one job begins.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct JobEventsQuery {
    /// As `Last-Event-ID`, which wins, for clients that cannot set a header.
    last_event_id: Option<String>,
}

/// Which events, and where they begin.
#[derive(Debug, Deserialize, IntoParams)]
#[serde(deny_unknown_fields)]
#[into_params(parameter_in = Query)]
struct EventsQuery {
    /// Only what happens to this system.
    #[param(value_type = Option<SystemId>)]
    system: Option<String>,
    /// As `Last-Event-ID`, which wins, for clients that cannot set a header.
    last_event_id: Option<String>,
}

/// Whose events are told.
#[derive(Debug)]
enum Whose {
    Job(String),
    System(SystemId),
    All,
}

/// One client.
struct Listener {
    service: Shared,
    whose: Whose,
    /// Of which systems it may hear.
    reach: SystemScope,
    sender: mpsc::Sender<Result<Event, Infallible>>,
    stopping: watch::Receiver<bool>,
    /// What it is counted by, until it leaves.
    _place: Option<StreamPlace>,
}

/// The data of `progress`.
#[derive(Debug, Serialize)]
struct ProgressData<'a> {
    job: &'a str,
    system: &'a SystemId,
    #[serde(flatten)]
    report: &'a ProgressReport,
}

/// The data of `incumbent`.
#[derive(Debug, Serialize)]
struct IncumbentData<'a> {
    job: &'a str,
    system: &'a SystemId,
    parameters: &'a IndexMap<String, f64>,
}

/// The data of `params`, `state` and `changed`.
#[derive(Debug, Serialize)]
struct ServedData<'a, T> {
    system: &'a SystemId,
    #[serde(flatten)]
    change: &'a T,
}

/// One event.
#[derive(Debug, ToSchema)]
struct StreamEvent {
    #[schema(inline)]
    event: EventName,
    /// `Last-Event-ID` with it leads on from there. What had happened before the stream began has none.
    id: Option<String>,
    /// JSON: a `Progress` of `progress`, the best parameters of `incumbent`, `system`, `revision` and
    /// `status` of `params`, `system`, `revision` and `at` of `state`, `system`, `fit`, `sentence` and
    /// `change` of `changed`, a `Job` of all others.
    data: String,
}

impl StreamEvent {
    /// A document that cannot be written ends the stream; the client comes back.
    fn of(event: EventName, data: &impl Serialize) -> Result<Self, Over> {
        Ok(Self { event, id: None, data: serde_json::to_string(data).map_err(|_| Over)? })
    }

    fn of_job(event: EventName, job: JobRecord) -> Result<Self, Over> {
        Self::of(event, &JobAnswer::without_progress(job))
    }

    fn at(self, position: Position) -> Self {
        Self { id: Some(position.to_string()), ..self }
    }
}

impl From<StreamEvent> for Event {
    fn from(StreamEvent { event, id, data }: StreamEvent) -> Self {
        let told = Event::default().event(event.as_str()).data(data);
        match id {
            Some(id) => told.id(id),
            None => told,
        }
    }
}

/// The events of a job until its end; then the stream ends.
///
/// `queued`, `started` and `finished` carry the job, `progress` how far it has come, `incumbent` the best
/// parameters so far by name. Progress and parameters come at most four times a second.
#[utoipa::path(
    get,
    path = "/jobs/{id}/events",
    tag = "jobs",
    params(
        ("id" = String, Path),
        JobEventsQuery,
        ("Last-Event-ID" = Option<String>, Header, description = "The id of the last event that was seen"),
    ),
    responses(
        (
            status = 200,
            description = "Server-sent events",
            body = StreamEvent,
            content_type = "text/event-stream"
        ),
        (status = 204, description = "The end was seen already: do not come back"),
        Problems,
    )
)]
async fn get_job_events(
    State(service): State<Shared>,
    caller: Caller,
    place: Option<Extension<Arc<Connection>>>,
    Path(id): Path<String>,
    Asked(query): Asked<JobEventsQuery>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let job = require(&service, &id).await?;
    let last = last_event(&headers, query.last_event_id.as_deref());
    if last.zip(job.state.ended()).is_some_and(|(last, end)| last.sequence >= end.sequence.unwrap_or(0)) {
        return Ok(StatusCode::NO_CONTENT.into_response());
    }
    stream(service, Whose::Job(id), &caller, place, last)
}

/// What happens to all systems, or to one, as it happens.
///
/// Of jobs, the events of `/jobs/{id}/events`. `params` says that `/params` answers something else than
/// before: a set was published, or its status has turned. `state` says that `/state` does.
/// `changed` says that a scheduled fit was the first to see that a parameter is another one. A first
/// connection is told which jobs run; one that has missed more than is kept is told `params` and `state` of
/// every system.
#[utoipa::path(
    get,
    path = "/events",
    tag = "jobs",
    params(EventsQuery, ("Last-Event-ID" = Option<String>, Header, description = "The id of the last event \
        that was seen")),
    responses(
        (
            status = 200,
            description = "Server-sent events",
            body = StreamEvent,
            content_type = "text/event-stream"
        ),
        (status = 404, description = "There is no such system", body = Problem, content_type = PROBLEM_JSON),
        Problems,
    )
)]
async fn get_events(
    State(service): State<Shared>,
    caller: Caller,
    place: Option<Extension<Arc<Connection>>>,
    Asked(query): Asked<EventsQuery>,
    headers: HeaderMap,
) -> Result<Response, ApiError> {
    let whose = match query.system {
        None => Whose::All,
        Some(text) => {
            let invalid = |detail: String| {
                ApiError::Invalid(vec![Fault::new("query system", "invalid-system", detail)])
            };
            let system: SystemId =
                text.parse().map_err(|error: lampyris_core::data::BadSystemId| invalid(error.to_string()))?;
            if service.params.slot(&text).is_none() || !caller.reach().covers(&system) {
                return Err(ApiError::NotFound("system", text));
            }
            Whose::System(system)
        }
    };
    let last = last_event(&headers, query.last_event_id.as_deref());
    stream(service, whose, &caller, place, last)
}

/// Where a client left off. An id that this service did not write is none.
fn last_event(headers: &HeaderMap, query: Option<&str>) -> Option<Position> {
    let header = headers.get("last-event-id").and_then(|value| value.to_str().ok());
    header.or(query).and_then(Position::read)
}

fn stream(
    service: Shared,
    whose: Whose,
    caller: &Caller,
    place: Option<Extension<Arc<Connection>>>,
    last: Option<Position>,
) -> Result<Response, ApiError> {
    // Who is in this process has no connection.
    let _place = place.map(|Extension(place)| place.stream().ok_or(ApiError::TooManyStreams)).transpose()?;
    let (sender, receiver) = mpsc::channel(AHEAD);
    let stopping = service.stopping.subscribe();
    let reach = caller.reach().clone();
    let mut listener = Listener { service, whose, reach, sender, stopping, _place };
    tokio::spawn(async move {
        // The client may go at any time; then there is nobody to tell.
        let _ = listener.listen(last).await;
    });
    let events = Sse::new(ReceiverStream::new(receiver));
    Ok(events.keep_alive(KeepAlive::new().interval(KEEP_ALIVE)).into_response())
}

/// Nobody listens any more, there is nothing left to say, or the service stops.
struct Over;

impl Listener {
    async fn listen(&mut self, mut last: Option<Position>) -> Result<(), Over> {
        let mut news = self.service.events.watch();
        self.send(Event::default().retry(RETRY)).await?;
        if let (None, Whose::Job(job)) = (last, &self.whose) {
            last = self.service.events.before(job);
        }
        loop {
            news.borrow_and_update();
            let after = last.and_then(|last| self.service.events.after(last, |event| self.wants(event)));
            let Some(handful) = after else {
                last = Some(self.tell_state(last).await?);
                continue;
            };
            for event in &handful.events {
                self.tell(event).await?;
            }
            last = Some(handful.position);
            if handful.is_all {
                tokio::select! {
                    changed = news.changed() => changed.map_err(|_| Over)?,
                    _ = self.stopping.wait_for(|stopping| *stopping) => return Err(Over),
                    () = self.sender.closed() => return Err(Over),
                }
            }
        }
    }

    fn wants(&self, event: &Happening) -> bool {
        self.reach.covers(&event.system)
            && match &self.whose {
                Whose::Job(job) => event.what.job() == Some(job),
                Whose::System(system) => event.system == *system,
                Whose::All => true,
            }
    }

    /// Tells how things stand to a client that the log cannot help, and says where the log goes on. Only ends
    /// have ids here: a client that is cut off in between is told the rest of them.
    async fn tell_state(&mut self, last: Option<Position>) -> Result<Position, Over> {
        let (mut position, mut running) = self.service.events.snapshot();
        if last.is_some_and(|last| last.sequence > position.sequence) {
            // Another node has told more than this one has heard by now, which must not be told again.
            follow::catch_up(&self.service).await.map_err(|_| Over)?;
            (position, running) = self.service.events.snapshot();
        }
        if let Whose::Job(id) = &self.whose {
            let job = require(&self.service, id).await.map_err(|_| Over)?;
            if let Some(end) = job.state.end_sequence() {
                self.tell_job(EventName::Finished, job, Some(Position::of_sequence(end))).await?;
                return Err(Over);
            }
            // What the log has not told yet, it will.
            if job.state.status() == JobStatus::Queued && job.sequence <= position.sequence {
                self.tell_job(EventName::Queued, job, None).await?;
            }
        } else if let Some(last) = last {
            self.tell_waiting(Missed { after: last.sequence, up_to: position.sequence }).await?;
        }
        for event in running {
            if self.wants(&event) {
                self.send(told(&event)?.into()).await?;
            }
        }
        if let (Some(last), Whose::All | Whose::System(_)) = (last, &self.whose) {
            self.tell_ended(Missed { after: last.sequence, up_to: position.sequence }).await?;
            self.tell_served().await?;
        }
        self.send(Event::default().id(position.to_string())).await?;
        Ok(position)
    }

    async fn tell_waiting(&mut self, missed: Missed) -> Result<(), Over> {
        let mut cursor = 0;
        loop {
            let waiting = store::events::waiting(&self.service.store, missed, self.system(), cursor, CHUNK)
                .await
                .map_err(|_| Over)?;
            let Some(newest) = waiting.last() else { return Ok(()) };
            cursor = newest.sequence;
            for job in waiting {
                if self.reach.covers(&job.system) {
                    self.tell_job(EventName::Queued, job, None).await?;
                }
            }
        }
    }

    async fn tell_ended(&mut self, mut missed: Missed) -> Result<(), Over> {
        loop {
            let ended = store::events::ended(&self.service.store, missed, self.system(), CHUNK)
                .await
                .map_err(|_| Over)?;
            let Some(newest) = ended.last().and_then(|job| job.state.end_sequence()) else { return Ok(()) };
            missed.after = newest;
            for job in ended {
                let position = job.state.end_sequence().map(Position::of_sequence);
                if self.reach.covers(&job.system) {
                    self.tell_job(EventName::Finished, job, position).await?;
                }
            }
        }
    }

    /// Tells what every system serves that this listener asks for.
    async fn tell_served(&mut self) -> Result<(), Over> {
        for (name, entry) in self.service.params.all() {
            let Ok(system) = name.parse::<SystemId>() else { continue };
            if !self.reach.covers(&system) || self.system().is_some_and(|only| *only != system) {
                continue;
            }
            if let Some(change) = ParamsChange::of(&entry) {
                let data = ServedData { system: &system, change: &change };
                self.send(StreamEvent::of(EventName::Params, &data)?.into()).await?;
            }
            if let Some(change) = StateChange::of(&entry) {
                let data = ServedData { system: &system, change: &change };
                self.send(StreamEvent::of(EventName::State, &data)?.into()).await?;
            }
        }
        Ok(())
    }

    fn system(&self) -> Option<&SystemId> {
        match &self.whose {
            Whose::System(system) => Some(system),
            Whose::Job(_) | Whose::All => None,
        }
    }

    /// Tells an event of the log. The end of its job is the end of the stream of a job.
    async fn tell(&mut self, event: &Happening) -> Result<(), Over> {
        self.send(told(event)?.at(event.position).into()).await?;
        match (&self.whose, &event.what) {
            (Whose::Job(_), SystemChange::Job(_, JobChange::Finished(_))) => Err(Over),
            _ => Ok(()),
        }
    }

    async fn tell_job(
        &mut self,
        name: EventName,
        job: JobRecord,
        position: Option<Position>,
    ) -> Result<(), Over> {
        let event = StreamEvent::of_job(name, job)?;
        let event = match position {
            Some(position) => event.at(position),
            None => event,
        };
        self.send(event.into()).await
    }

    /// Hands an event to the client, however slow it is, unless the service stops.
    async fn send(&mut self, event: Event) -> Result<(), Over> {
        tokio::select! {
            sent = self.sender.send(Ok(event)) => sent.map_err(|_| Over),
            _ = self.stopping.wait_for(|stopping| *stopping) => Err(Over),
        }
    }
}

/// An event of the log as it is told.
fn told(event: &Happening) -> Result<StreamEvent, Over> {
    let (name, system) = (event.what.name(), &event.system);
    match &event.what {
        SystemChange::Job(job, change) => match change {
            JobChange::Queued(record) | JobChange::Started(record) | JobChange::Finished(record) => {
                StreamEvent::of_job(name, JobRecord::clone(record))
            }
            JobChange::Progress(report) => StreamEvent::of(name, &ProgressData { job, system, report }),
            JobChange::Incumbent(parameters) => {
                StreamEvent::of(name, &IncumbentData { job, system, parameters })
            }
        },
        SystemChange::Params(change) => StreamEvent::of(name, &ServedData { system, change }),
        SystemChange::State(change) => StreamEvent::of(name, &ServedData { system, change }),
        SystemChange::Changed(change) => StreamEvent::of(name, &ServedData { system, change }),
    }
}
