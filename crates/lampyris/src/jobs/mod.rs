//! Owns the CPU pools and the clock, and stands between the surface and the store.
//!
//! A request becomes a row of the queue (`submit`), a `worker` claims it and runs `estimate` on its pool, the
//! end is one transaction of the store, and `params` then swaps what `/params` serves: commit first, then swap.
//!
//! | file | what it does |
//! |---|---|
//! | `decode`, `strict` | JSON with all its faults |
//! | `systems`, `models`, `windows` | documents and measurements: checked here, kept by the store |
//! | `layout` | rooms and neighbours proposed from one window of many sensors |
//! | `series` | the stitched view of all windows of a system |
//! | `body`, `request`, `submit` | what a job is asked to do, how that is read, and how it enters the queue |
//! | `board` | who runs now: progress, cancellation |
//! | `events` | what happens to jobs, for those who listen |
//! | `worker`, `input`, `estimate`, `diagnose` | from the claim to the verdict, and to what is missing |
//! | `tune` | settings of the search for a system |
//! | `poison` | a hook for tests: jobs that go wrong on purpose |
//! | `preview` | one simulation for whoever edits a model |
//! | `interactive` | short CPU work that somebody waits for: first in line, bounded, kept |
//! | `metrics` | what is counted |
//! | `comparison`, `chart` | fits beside the measurements as lines: the work, and the documents |
//! | `diagnostics` | the same as numbers and sentences |
//! | `params` | the snapshot behind `/params` and the timer that turns it stale |
//! | `decisions` | an operator's word: promote, reject, pin, roll back |
//! | `degradations` | compares newer measurements with what is served |
//! | `health` | how a system fares, in a word and a sentence |
//! | `schedule` | submits ordinary jobs when a row says so |
//! | `retention` | forgets what is old |
//! | `tokens` | who may ask |

pub mod board;
pub mod body;
mod chart;
pub mod comparison;
pub mod decisions;
pub mod decode;
pub mod degradations;
pub mod diagnose;
pub mod diagnostics;
pub mod estimate;
pub mod events;
pub mod health;
pub mod input;
pub mod interactive;
pub mod layout;
pub mod metrics;
pub mod models;
pub mod params;
mod poison;
pub mod preview;
pub mod request;
pub mod retention;
pub mod schedule;
pub mod series;
mod strict;
pub mod submit;
pub mod systems;
pub mod tokens;
mod tune;
pub mod windows;
pub mod worker;

use crate::settings::Settings;
use crate::store::jobs::JobState;
use crate::store::{Store, StoreError};
use jiff::{SignedDuration, Timestamp};
use lampyris_core::data::SystemId;
use lampyris_core::fault::Fault;
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, AtomicUsize, Ordering};
use tokio::sync::{Notify, watch};

/// Everything that handlers and workers share.
#[derive(Debug)]
pub struct Service {
    /// What the operator set.
    pub settings: Settings,
    /// The database.
    pub store: Store,
    /// Models and effects, built-in and of users.
    pub catalogue: models::SharedCatalogue,
    /// Who runs now.
    pub board: board::Board,
    /// Short CPU work that somebody waits for.
    pub interactive: interactive::Interactive,
    /// What happens to jobs.
    pub events: events::Events,
    /// Who may ask.
    pub tokens: tokens::Tokens,
    /// What is counted.
    pub metrics: metrics::Metrics,
    /// What `/params` serves.
    pub params: params::Snapshot,
    /// Systems of which measurements have arrived.
    pub arrivals: degradations::Arrivals,
    /// What time it is.
    pub clock: Clock,
    /// The number of this start.
    pub boot: i64,
    /// Told when a job may be claimed.
    pub wake: Notify,
    /// Told when a schedule has changed.
    pub wake_schedule: Notify,
    /// True from the moment at which the service is asked to stop.
    pub stopping: watch::Sender<bool>,
    /// Workers whose loop is alive.
    pub workers_alive: AtomicUsize,
}

/// Why something could not be done.
#[derive(Debug)]
pub enum JobsError {
    /// What was sent is no JSON.
    Malformed(Fault),
    /// What was sent has faults.
    Faults(Vec<Fault>),
    /// There is no such system.
    NoSystem(SystemId),
    /// There is no such thing: what, and which.
    NotFound(&'static str, String),
    /// Another document has this id: what, and which.
    Conflict(&'static str, String),
    /// It cannot be done as things stand.
    Refused(Refusal),
    /// The idempotency key belongs to another request.
    KeyReused,
    /// The job waits or runs.
    NotFinished(String, JobState),
    /// So many jobs wait already.
    QueueFull(i64),
    /// Too many answers are being computed already.
    Busy,
    /// The database failed.
    Store(StoreError),
    /// Something that cannot happen did.
    Internal(String),
}

/// Why something that makes sense cannot be done as things stand.
#[derive(Debug)]
pub struct Refusal {
    /// A stable slug for programs.
    pub slug: &'static str,
    /// A sentence about this case, with what to do about it.
    pub detail: String,
    /// What stands in the way, where it has names: a field, and its members.
    pub because: Option<(&'static str, Vec<String>)>,
}

impl Refusal {
    /// A refusal that names nothing in the way.
    pub fn new(slug: &'static str, detail: impl Into<String>) -> Self {
        Self { slug, detail: detail.into(), because: None }
    }
}

impl From<Refusal> for JobsError {
    fn from(refusal: Refusal) -> Self {
        JobsError::Refused(refusal)
    }
}

impl std::fmt::Display for JobsError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            JobsError::Malformed(fault) => fault.fmt(f),
            JobsError::Faults(faults) => write!(f, "{} faults", faults.len()),
            JobsError::NoSystem(system) => write!(f, "there is no system `{system}`"),
            JobsError::NotFound(what, which) => write!(f, "there is no {what} `{which}`"),
            JobsError::Conflict(what, which) => write!(f, "there is another {what} `{which}`"),
            JobsError::Refused(refusal) => f.write_str(&refusal.detail),
            JobsError::KeyReused => f.write_str("the idempotency key was used for another request"),
            JobsError::NotFinished(job, state) => write!(f, "the job `{job}` has not ended: it is {}", state.word()),
            JobsError::QueueFull(limit) => write!(f, "{limit} jobs wait already"),
            JobsError::Busy => f.write_str("too many answers are being computed already"),
            JobsError::Store(error) => error.fmt(f),
            JobsError::Internal(detail) => f.write_str(detail),
        }
    }
}

impl std::error::Error for JobsError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            JobsError::Store(error) => Some(error),
            _ => None,
        }
    }
}

impl From<StoreError> for JobsError {
    fn from(error: StoreError) -> Self {
        JobsError::Store(error)
    }
}

impl From<crate::store::jobs::SubmitError> for JobsError {
    fn from(error: crate::store::jobs::SubmitError) -> Self {
        use crate::store::jobs::SubmitError;
        match error {
            SubmitError::Store(error) => JobsError::Store(error),
            SubmitError::QueueFull(limit) => JobsError::QueueFull(limit),
            SubmitError::KeyReused => JobsError::KeyReused,
        }
    }
}

/// The clock of a service: that of the system, which tests of nights and months set ahead.
#[derive(Debug, Clone, Default)]
pub struct Clock {
    ahead_ms: Arc<AtomicI64>,
}

impl Clock {
    /// The time by this clock.
    pub fn now(&self) -> Timestamp {
        now().saturating_add(SignedDuration::from_millis(self.ahead_ms.load(Ordering::Relaxed))).unwrap_or(Timestamp::MAX)
    }

    /// Sets the clock; from there it goes on.
    pub fn set(&self, time: Timestamp) {
        self.ahead_ms.store(time.as_millisecond() - now().as_millisecond(), Ordering::Relaxed);
    }
}

impl Service {
    /// The time by the clock of this service.
    pub fn now(&self) -> Timestamp {
        self.clock.now()
    }

    /// Whether the service is asked to stop.
    pub fn is_stopping(&self) -> bool {
        *self.stopping.borrow()
    }

    /// Most jobs that wait.
    pub fn queue_limit(&self) -> i64 {
        i64::try_from(self.settings.limits.queue).unwrap_or(i64::MAX)
    }
}

/// The time by the system. Nothing below this layer knows it.
pub fn now() -> Timestamp {
    Timestamp::now()
}

/// Runs something short that must not hold an async thread, such as unpacking a window. Jobs have pools of their own.
///
/// # Errors
/// Where it panicked.
pub async fn blocking<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> Result<T, JobsError> {
    tokio::task::spawn_blocking(work).await.map_err(|error| JobsError::Internal(format!("a short task failed: {error}")))
}
