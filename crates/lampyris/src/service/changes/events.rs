//! What happens to jobs and to what is served, as a numbered log that any number of listeners follow, each at
//! its own pace.
//!
//! Submissions and ends are read from the database in the order of their commits
//! ([`catch_up`](super::follow::catch_up)), so none is lost and none is told twice, whoever caused it. Starts
//! and progress live in memory alone, and so does the news of parameters and states. The log keeps the newest
//! events; a listener that has fallen behind it, or comes from an earlier start of the service, is told how
//! things stand now: its [`Position`] says which submissions and ends it has missed.

use crate::service::serving::snapshot::{ParamsChange, StateChange};
use crate::service::work::progress::ProgressReport;
use crate::store::events::Missed;
use crate::store::jobs::JobRecord;
use indexmap::IndexMap;
use lampyris_core::data::SystemId;
use lampyris_core::estimate::fit::parameter_change::ParameterChange;
use serde::Serialize;
use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::{Mutex as AsyncMutex, Notify, watch};
use utoipa::ToSchema;

/// Events that are kept for listeners that come back.
const KEPT: usize = 2048;
/// Most events that a listener is handed at once.
const HANDFUL: usize = 256;

/// The log of one start of the service.
#[derive(Debug)]
pub struct Events {
    boot: i64,
    log: Mutex<Log>,
    newest: watch::Sender<u64>,
    /// Told when a job was submitted or has ended.
    pub(super) hint: Notify,
    /// The database is read by one at a time, so that its order is kept.
    pub(super) reading: AsyncMutex<()>,
}

#[derive(Debug)]
struct Log {
    kept: VecDeque<Arc<Event>>,
    /// The number of the newest event.
    number: u64,
    /// Submissions and ends up to this number of the database are in the log.
    sequence: i64,
    /// What was last told of each job that runs: its start, progress, best parameters.
    running: HashMap<String, Vec<Arc<Event>>>,
}

/// A place in the order of events, as listeners carry it: `boot.number.sequence`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Position {
    /// The start of the service whose log is meant.
    pub boot: i64,
    /// The number of the event in that log.
    pub number: u64,
    /// All submissions and ends up to this number of the database came before.
    pub sequence: i64,
}

/// Something that happened to a system.
#[derive(Debug, Clone, PartialEq)]
pub struct Event {
    /// Its place.
    pub position: Position,
    /// The system.
    pub system: SystemId,
    /// What happened.
    pub what: SystemChange,
}

/// What happened to a system.
#[derive(Debug, Clone, PartialEq)]
pub enum SystemChange {
    /// Something to one of its jobs.
    Job(String, JobChange),
    /// The parameters that are served are others, or what is said of them is.
    Params(ParamsChange),
    /// Its states are newer.
    State(StateChange),
    /// A parameter is another one since a day, as a fit has seen.
    Changed(Box<ChangeSeen>),
}

/// A change that a fit was the first to see.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChangeSeen {
    /// The fit.
    pub fit: String,
    /// What it says, in a plain sentence.
    pub sentence: String,
    /// The change.
    pub change: ParameterChange,
}

/// What happened to a job.
#[derive(Debug, Clone, PartialEq)]
pub enum JobChange {
    /// It entered the queue.
    Queued(Box<JobRecord>),
    /// A worker has it.
    Started(Box<JobRecord>),
    /// It has come so far.
    Progress(Box<ProgressReport>),
    /// The best parameters so far, by name.
    Incumbent(Arc<IndexMap<String, f64>>),
    /// Nothing more will happen.
    Finished(Box<JobRecord>),
}

/// Some events, and the place after them.
#[derive(Debug, Clone, PartialEq)]
pub struct EventBatch {
    /// Those that were asked for.
    pub events: Vec<Arc<Event>>,
    /// The place of the last one that was looked at.
    pub position: Position,
    /// Whether there are no more.
    pub is_all: bool,
}

/// What an event is called.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum EventName {
    /// A job entered the queue.
    Queued,
    /// A worker has it.
    Started,
    /// It has come so far.
    Progress,
    /// The best parameters so far.
    Incumbent,
    /// Nothing more will happen.
    Finished,
    /// The parameters that are served are others, or what is said of them is.
    Params,
    /// The states of a system are newer.
    State,
    /// A parameter of a system is another one since a day.
    Changed,
}

impl EventName {
    /// The word in the stream.
    pub const fn as_str(self) -> &'static str {
        match self {
            EventName::Queued => "queued",
            EventName::Started => "started",
            EventName::Progress => "progress",
            EventName::Incumbent => "incumbent",
            EventName::Finished => "finished",
            EventName::Params => "params",
            EventName::State => "state",
            EventName::Changed => "changed",
        }
    }
}

impl JobChange {
    /// The name of the event.
    pub const fn name(&self) -> EventName {
        match self {
            JobChange::Queued(_) => EventName::Queued,
            JobChange::Started(_) => EventName::Started,
            JobChange::Progress(_) => EventName::Progress,
            JobChange::Incumbent(_) => EventName::Incumbent,
            JobChange::Finished(_) => EventName::Finished,
        }
    }
}

impl SystemChange {
    /// The name of the event.
    pub const fn name(&self) -> EventName {
        match self {
            SystemChange::Job(_, change) => change.name(),
            SystemChange::Params(_) => EventName::Params,
            SystemChange::State(_) => EventName::State,
            SystemChange::Changed(_) => EventName::Changed,
        }
    }

    /// The job that it happened to.
    pub fn job(&self) -> Option<&str> {
        match self {
            SystemChange::Job(job, _) => Some(job),
            SystemChange::Params(_) | SystemChange::State(_) | SystemChange::Changed(_) => None,
        }
    }
}

impl std::fmt::Display for Position {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}.{}.{}", self.boot, self.number, self.sequence)
    }
}

impl Position {
    /// Reads a place. Whatever this service did not write is none.
    pub fn read(text: &str) -> Option<Self> {
        let mut parts = text.trim().splitn(3, '.');
        let position = Self {
            boot: parts.next()?.parse().ok()?,
            number: parts.next()?.parse().ok()?,
            sequence: parts.next()?.parse().ok()?,
        };
        Some(position)
    }

    /// The place of a submission or an end that is known by its number alone.
    pub const fn of_sequence(sequence: i64) -> Self {
        Self { boot: 0, number: 0, sequence }
    }
}

impl Events {
    /// An empty log of a start of the service that begins after a number of the database.
    pub fn new(boot: i64, sequence: i64) -> Self {
        let log = Log { kept: VecDeque::new(), number: 0, sequence, running: HashMap::new() };
        Self {
            boot,
            log: Mutex::new(log),
            newest: watch::Sender::new(0),
            hint: Notify::new(),
            reading: AsyncMutex::new(()),
        }
    }

    fn log(&self) -> MutexGuard<'_, Log> {
        // A panic while the log was held cannot have left it half-changed: nothing in between can panic.
        self.log.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Says that a job was submitted or has ended.
    pub fn hint(&self) {
        self.hint.notify_one();
    }

    /// How many watch.
    pub fn listeners(&self) -> usize {
        self.newest.receiver_count()
    }

    /// Watches the number of the newest event.
    pub fn watch(&self) -> watch::Receiver<u64> {
        self.newest.subscribe()
    }

    /// Adds an event that the database does not know of.
    pub fn publish(&self, system: &SystemId, what: SystemChange) {
        let number = self.log().push(self.boot, system, what);
        self.newest.send_replace(number);
    }

    /// Submissions and ends up to this number of the database are in the log.
    pub(super) fn sequence(&self) -> i64 {
        self.log().sequence
    }

    /// Adds what the database says between two numbers, of which the first is the last one that was added.
    pub(super) fn publish_news(&self, jobs: Vec<JobRecord>, missed: Missed) {
        let mut log = self.log();
        let mut news: Vec<(i64, JobChange)> = Vec::new();
        for job in jobs {
            if missed.has(job.sequence) {
                news.push((job.sequence, JobChange::Queued(Box::new(job.clone()))));
            }
            if let Some(end) = job.state.end_sequence().filter(|end| missed.has(*end)) {
                news.push((end, JobChange::Finished(Box::new(job))));
            }
        }
        news.sort_by_key(|(sequence, _)| *sequence);
        let mut number = log.number;
        for (sequence, what) in news {
            log.sequence = sequence;
            if let JobChange::Queued(job) | JobChange::Finished(job) = &what {
                let (id, system) = (job.id.clone(), job.system.clone());
                number = log.push(self.boot, &system, SystemChange::Job(id, what));
            }
        }
        log.sequence = missed.up_to;
        drop(log);
        self.newest.send_replace(number);
    }

    /// The newest place, and what was last told of the jobs that run.
    pub fn snapshot(&self) -> (Position, Vec<Arc<Event>>) {
        let log = self.log();
        let mut running: Vec<Arc<Event>> = log.running.values().flatten().cloned().collect();
        running.sort_by_key(|event| event.position.number);
        (log.position(self.boot), running)
    }

    /// Events after a place that satisfy a condition, or nothing where the log does not reach back so far.
    pub fn after(&self, position: Position, wanted: impl Fn(&Event) -> bool) -> Option<EventBatch> {
        let log = self.log();
        let first = log.number - log.kept.len() as u64;
        if position.boot != self.boot || position.number < first || position.number > log.number {
            return None;
        }
        let from = usize::try_from(position.number - first).unwrap_or(usize::MAX);
        let mut handful = EventBatch { events: Vec::new(), position, is_all: true };
        for event in log.kept.iter().skip(from) {
            if handful.events.len() == HANDFUL {
                handful.is_all = false;
                break;
            }
            handful.position = event.position;
            if wanted(event) {
                handful.events.push(event.clone());
            }
        }
        Some(handful)
    }

    /// The place before a job entered the queue, as far as the log reaches back.
    pub fn before(&self, job: &str) -> Option<Position> {
        let log = self.log();
        let entry = log
            .kept
            .iter()
            .find(|event| event.what.job() == Some(job) && event.what.name() == EventName::Queued)?;
        Some(Position {
            number: entry.position.number - 1,
            sequence: entry.position.sequence - 1,
            ..entry.position
        })
    }
}

impl Log {
    fn position(&self, boot: i64) -> Position {
        Position { boot, number: self.number, sequence: self.sequence }
    }

    fn push(&mut self, boot: i64, system: &SystemId, what: SystemChange) -> u64 {
        self.number += 1;
        let event = Arc::new(Event { position: self.position(boot), system: system.clone(), what });
        if let SystemChange::Job(job, change) = &event.what {
            match change {
                JobChange::Queued(_) => {}
                JobChange::Started(_) => {
                    self.running.insert(job.clone(), vec![event.clone()]);
                }
                JobChange::Progress(_) | JobChange::Incumbent(_) => {
                    if let Some(told) = self.running.get_mut(job) {
                        told.retain(|earlier| earlier.what.name() != event.what.name());
                        told.push(event.clone());
                    }
                }
                JobChange::Finished(_) => {
                    self.running.remove(job);
                }
            }
        }
        if self.kept.len() == KEPT {
            self.kept.pop_front();
        }
        self.kept.push_back(event);
        self.number
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::jobs::{Ended, JobKind, JobState, Origin, Priority};

    fn job(sequence: i64, end_sequence: Option<i64>) -> JobRecord {
        let at = jiff::Timestamp::UNIX_EPOCH;
        JobRecord {
            id: format!("job_{sequence}"),
            sequence,
            kind: JobKind::Estimate,
            system: "room/1".parse().unwrap(),
            model: "rc2".parse().unwrap(),
            request: serde_json::Value::Null,
            experiment: false,
            origin: Origin::Posted,
            priority: Priority::Operator,
            created_at: at,
            attempt: 0,
            retry_of: None,
            state: match end_sequence {
                None => JobState::Queued { started_at: None },
                sequence => JobState::Cancelled { ended: Ended { started_at: None, at, sequence } },
            },
        }
    }

    fn told(handful: &EventBatch) -> Vec<(&str, &str)> {
        handful
            .events
            .iter()
            .map(|event| (event.what.name().as_str(), event.what.job().unwrap_or_default()))
            .collect()
    }

    #[test]
    fn the_database_is_told_in_its_order_and_once() {
        let events = Events::new(7, 10);
        let start = events.snapshot().0;
        let missed = Missed { after: 10, up_to: 14 };
        events
            .publish_news(vec![job(12, None), job(5, Some(11)), job(13, Some(14)), job(9, Some(10))], missed);
        let handful = events.after(start, |_| true).unwrap();
        assert_eq!(
            told(&handful),
            [("finished", "job_5"), ("queued", "job_12"), ("queued", "job_13"), ("finished", "job_13")]
        );
        assert_eq!(handful.position, Position { boot: 7, number: 4, sequence: 14 });
        // The rows are read again with the next news; what was told stays told.
        events.publish_news(vec![job(12, Some(15)), job(13, Some(14))], Missed { after: 14, up_to: 15 });
        assert_eq!(told(&events.after(handful.position, |_| true).unwrap()), [("finished", "job_12")]);
        assert_eq!(events.before("job_13").unwrap(), Position { boot: 7, number: 2, sequence: 12 });
        assert_eq!(events.before("job_5"), None);
    }

    #[test]
    fn a_listener_that_fell_behind_the_log_is_told_so() {
        let events = Events::new(2, 0);
        let start = events.snapshot().0;
        let count = KEPT as i64 + 3;
        let missed = Missed { after: 0, up_to: count };
        events.publish_news((1..=count).map(|sequence| job(sequence, None)).collect(), missed);
        assert_eq!(events.after(start, |_| true), None);
        let oldest = Position { number: 3, ..start };
        let mut handful = events.after(oldest, |_| true).unwrap();
        assert_eq!(
            (handful.events[0].what.job(), handful.events.len(), handful.is_all),
            (Some("job_4"), HANDFUL, false)
        );
        let mut heard = handful.events.len();
        while !handful.is_all {
            handful = events.after(handful.position, |_| true).unwrap();
            heard += handful.events.len();
        }
        let last = format!("job_{count}");
        assert_eq!((heard, handful.events.last().unwrap().what.job()), (KEPT, Some(last.as_str())));
        // Whoever wants one job only looks at all others, too.
        let one = events.after(oldest, |event| event.what.job() == Some("job_9")).unwrap();
        assert_eq!(
            (told(&one), one.position.number, one.is_all),
            (vec![("queued", "job_9")], KEPT as u64 + 3, true)
        );
        for other in [
            Position { boot: 1, ..oldest },
            Position { number: u64::MAX, ..oldest },
            Position::of_sequence(4),
        ] {
            assert_eq!(events.after(other, |_| true), None, "{other}");
        }
    }

    #[test]
    fn a_newcomer_is_told_the_newest_of_each_kind() {
        let events = Events::new(1, 0);
        let system: SystemId = "room/1".parse().unwrap();
        let report = |evaluations| ProgressReport {
            generation: 1,
            evaluations,
            best_train: None,
            best_validation: None,
            eta_s: None,
            trials: None,
        };
        let publish = |change| events.publish(&system, SystemChange::Job("job_1".to_owned(), change));
        publish(JobChange::Progress(Box::new(report(1))));
        assert!(events.snapshot().1.is_empty(), "progress of a job that does not run is none");
        publish(JobChange::Started(Box::new(job(1, None))));
        for evaluations in [10, 20] {
            publish(JobChange::Progress(Box::new(report(evaluations))));
            publish(JobChange::Incumbent(Arc::default()));
        }
        let (_, running) = events.snapshot();
        let words: Vec<&str> = running.iter().map(|event| event.what.name().as_str()).collect();
        assert_eq!(words, ["started", "progress", "incumbent"]);
        assert_eq!(
            running[1].what,
            SystemChange::Job("job_1".to_owned(), JobChange::Progress(Box::new(report(20))))
        );
        publish(JobChange::Finished(Box::new(job(1, Some(2)))));
        assert!(events.snapshot().1.is_empty());
    }

    #[test]
    fn a_place_is_read_as_it_is_written() {
        let position = Position { boot: 3, number: 44, sequence: 555 };
        assert_eq!((position.to_string().as_str(), Position::read("3.44.555")), ("3.44.555", Some(position)));
        for text in ["", "3.44", "finished", "3.-1.5", "3.44.555.6", "99999999999999999999.1.1"] {
            assert_eq!(Position::read(text), None, "{text}");
        }
    }
}
