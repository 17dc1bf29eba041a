//! What handlers and workers share. Its parts know nothing of the whole.

use super::access::tokens::Tokens;
use super::catalogue::kept_posts::KeptPosts;
use super::catalogue::shared::SharedCatalogue;
use super::catalogue::turns::Turns;
use super::changes::events::Events;
use super::clock::Clock;
use super::observe::lines::LineTally;
use super::observe::metrics::Metrics;
use super::observe::pulls::Pulls;
use super::serving::arrivals::Arrivals;
use super::serving::kept::LiveSystems;
use super::serving::said::SaidForecasts;
use super::serving::snapshot::Snapshot;
use super::work::board::ProgressBoard;
use super::work::interactive::Interactive;
use super::work::membership::Membership;
use crate::settings::Settings;
use crate::store::Store;
use jiff::Timestamp;
use std::sync::atomic::AtomicUsize;
use tokio::sync::{Notify, watch};

/// Everything that handlers and workers share.
#[derive(Debug)]
pub struct Service {
    /// What the operator set.
    pub settings: Settings,
    /// The database.
    pub store: Store,
    /// Models and effects, built-in and of users.
    pub catalogue: SharedCatalogue,
    /// Who runs now.
    pub board: ProgressBoard,
    /// Short CPU work that somebody waits for.
    pub interactive: Interactive,
    /// The same of seconds.
    pub inquiries: Interactive,
    /// What happens to jobs.
    pub events: Events,
    /// Who may ask.
    pub tokens: Tokens,
    /// What is counted.
    pub metrics: Metrics,
    /// What came by the line protocol.
    pub lines: LineTally,
    /// What came of asking others for measurements.
    pub pulls: Pulls,
    /// What `/params` serves.
    pub params: Snapshot,
    /// Systems of which measurements have arrived.
    pub arrivals: Arrivals,
    /// The states of systems that live samples come from.
    pub live: LiveSystems,
    /// What forecasts said and nobody has kept yet.
    pub said: SaidForecasts,
    /// Whose turn it is to change measurements.
    pub turns: Turns,
    /// Live samples that may have to be laid in.
    pub kept_posts: KeptPosts,
    /// What time it is.
    pub clock: Clock,
    /// The right of this process to work.
    pub membership: Membership,
    /// Told when a job may be claimed.
    pub wake: Notify,
    /// Told when a schedule has changed.
    pub wake_schedule: Notify,
    /// True from the moment at which the service is asked to stop.
    pub stopping: watch::Sender<bool>,
    /// Workers whose loop is alive.
    pub workers_alive: AtomicUsize,
    /// Jobs that were given up and still hold the threads they had.
    pub abandoned: watch::Sender<usize>,
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

    /// Whether so many jobs were given up that some worker waits for its threads instead of replacing them.
    pub fn is_stuck(&self) -> bool {
        *self.abandoned.borrow() > self.settings.workers
    }

    /// Most jobs that wait, and most of one system.
    pub fn queue_limits(&self) -> (i64, i64) {
        let of_system = i64::try_from(self.settings.limits.queue_per_system).unwrap_or(i64::MAX);
        (self.queue_limit(), of_system)
    }

    /// Most jobs that wait.
    pub fn queue_limit(&self) -> i64 {
        i64::try_from(self.settings.limits.queue).unwrap_or(i64::MAX)
    }
}
