//! The right of this process to work: a row with a lease, where several may share the database.
//!
//! A process that cannot renew its lease (`renewal`) stops its own jobs before the lease ends, by its
//! monotonic clock: then others take them over, and what it would write is refused.

use crate::settings::Settings;
use crate::store::workers;
use crate::store::{Store, StoreError};
use jiff::Timestamp;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// The last sixth of a lease is in doubt: what is computed hears it by then.
const DOUBTED: u32 = 6;

/// The right of this process to work.
#[derive(Debug)]
pub struct Membership {
    /// How long a lease lasts.
    lease: Duration,
    /// The number of its row.
    worker: AtomicI64,
    /// When the lease was last renewed, or none where it does not end.
    renewed: Mutex<Option<Instant>>,
    /// Whether this process does what one does for all.
    leads: AtomicBool,
}

impl Membership {
    /// Of a process on a disk that takes no writes: it works on nothing.
    pub fn none() -> Self {
        Self {
            lease: Duration::MAX,
            worker: AtomicI64::new(0),
            renewed: Mutex::new(None),
            leads: AtomicBool::new(false),
        }
    }

    /// Enters this process.
    ///
    /// # Errors
    /// Where the database fails.
    pub async fn enter(store: &Store, settings: &Settings, now: Timestamp) -> Result<Self, StoreError> {
        let asked = Instant::now();
        let worker = enlist(store, settings, now).await?;
        Ok(Self {
            lease: settings.lease(),
            worker: AtomicI64::new(worker),
            renewed: Mutex::new(store.is_shared().then_some(asked)),
            leads: AtomicBool::new(!store.is_shared()),
        })
    }

    /// The number by which jobs are claimed and ended.
    pub fn worker(&self) -> i64 {
        self.worker.load(Ordering::Acquire)
    }

    /// Whether the lease may have ended.
    pub fn is_in_doubt(&self) -> bool {
        let renewed = *self.renewed.lock().unwrap_or_else(PoisonError::into_inner);
        renewed.is_some_and(|renewed| renewed.elapsed() > self.lease - self.lease / DOUBTED)
    }

    /// Whether what was claimed by a number is, or may be, in other hands.
    pub fn has_lost(&self, worker: i64) -> bool {
        worker != self.worker() || self.is_in_doubt()
    }

    /// Whether this process does what one does for all: schedules, sources, looks at what has arrived.
    pub fn leads(&self) -> bool {
        self.leads.load(Ordering::Relaxed)
    }

    /// How long a lease lasts.
    pub(super) const fn lease(&self) -> Duration {
        self.lease
    }

    /// Notes what this process does for all; says whether that is new.
    pub(super) fn set_leads(&self, leads: bool) -> bool {
        self.leads.swap(leads, Ordering::Relaxed) != leads
    }

    /// Goes on by another number; gives the one before.
    pub(super) fn go_on_as(&self, worker: i64) -> i64 {
        self.worker.swap(worker, Ordering::AcqRel)
    }

    /// Notes that the lease was renewed when it was asked for at this instant.
    pub(super) fn holds_since(&self, asked: Instant) {
        *self.renewed.lock().unwrap_or_else(PoisonError::into_inner) = Some(asked);
    }
}

/// Enters this process, which is another one from then on.
pub(super) async fn enlist(store: &Store, settings: &Settings, now: Timestamp) -> Result<i64, StoreError> {
    let host = rustix::system::uname().nodename().to_string_lossy().into_owned();
    let name = format!("{host}/{}", std::process::id());
    let roles: Vec<&str> = settings.roles.iter().map(|role| role.as_str()).collect();
    workers::enlist(store, (&name, &roles.join(",")), settings.lease(), now).await
}
