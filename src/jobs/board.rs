//! Who runs now: progress for those who watch, and the switch that calls a job off.
//!
//! Progress lives here and never in the database: a watcher wants the newest value, not all of them.

use crate::estimate::Progress;
use crate::store::jobs::Lease;
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Instant;
use tokio::sync::watch;

/// The jobs that run or are watched.
#[derive(Debug, Default)]
pub struct Board {
    live: Mutex<HashMap<String, Arc<Live>>>,
}

/// One job that runs or is watched.
#[derive(Debug)]
pub struct Live {
    cancelled: AtomicBool,
    stage: watch::Sender<Stage>,
}

/// How far a job has come, as far as this process knows.
#[derive(Debug, Clone, Default)]
pub enum Stage {
    /// Nobody has it.
    #[default]
    Waiting,
    /// A worker has it.
    Running {
        /// The right to end it.
        lease: Lease,
        /// When this attempt started.
        since: Instant,
        /// How far the search has come.
        progress: Option<Progress>,
    },
    /// Nothing more will happen; the database knows how it ended.
    Ended,
}

impl Board {
    fn live(&self) -> MutexGuard<'_, HashMap<String, Arc<Live>>> {
        // A panic while the map was held cannot have left it half-changed: every use is one call.
        self.live.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The place of a job, made if need be.
    pub fn place(&self, job: &str) -> Arc<Live> {
        let fresh = || Arc::new(Live { cancelled: AtomicBool::new(false), stage: watch::Sender::new(Stage::Waiting) });
        self.live().entry(job.to_owned()).or_insert_with(fresh).clone()
    }

    /// What is known of a job without making a place for it.
    pub fn stage(&self, job: &str) -> Option<Stage> {
        let live = self.live().get(job).cloned()?;
        let stage = live.stage.borrow().clone();
        Some(stage)
    }

    /// Tells a running job to stop. The place is made if need be: the worker that has just claimed the job
    /// finds it there.
    pub fn cancel(&self, job: &str) {
        self.place(job).cancelled.store(true, Ordering::Relaxed);
    }

    /// Tells the watchers that a job has ended and forgets it. To be called after the end is in the database.
    pub fn end(&self, job: &str) {
        if let Some(live) = self.live().remove(job) {
            live.stage.send_replace(Stage::Ended);
        }
    }

    /// Puts a job back among the waiting ones.
    pub fn put_back(&self, job: &str) {
        if let Some(live) = self.live().get(job) {
            live.stage.send_replace(Stage::Waiting);
        }
    }

    /// The leases of all jobs that run.
    pub fn leases(&self) -> Vec<Lease> {
        let lease = |live: &Arc<Live>| match &*live.stage.borrow() {
            Stage::Running { lease, .. } => Some(lease.clone()),
            Stage::Waiting | Stage::Ended => None,
        };
        self.live().values().filter_map(lease).collect()
    }
}

impl Live {
    /// Watches the stages; only the newest is seen.
    pub fn watch(&self) -> watch::Receiver<Stage> {
        self.stage.subscribe()
    }

    /// Notes that a worker has the job.
    pub fn start(&self, lease: Lease) {
        self.stage.send_replace(Stage::Running { lease, since: Instant::now(), progress: None });
    }

    /// Notes how far the search has come.
    pub fn report(&self, news: &Progress) {
        self.stage.send_modify(|stage| {
            if let Stage::Running { progress, .. } = stage {
                *progress = Some(*news);
            }
        });
    }

    /// Whether somebody called the job off.
    pub fn is_cancelled(&self) -> bool {
        self.cancelled.load(Ordering::Relaxed)
    }
}
