//! The right of this process to work: a row with a lease, where several may share the database.
//!
//! A process that cannot renew its lease stops its own jobs before the lease ends, by its monotonic clock:
//! then others take them over, and what it would write is refused. When the database is there again it enters
//! as another process.

use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::settings::{Role, Settings};
use crate::store::queue::Recovered;
use crate::store::{self, Store, StoreError, queue, workers};
use jiff::Timestamp;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How often it is tried again where that failed, and how often others are looked after.
const LOOK: Duration = Duration::from_secs(2);
/// A lease is renewed three times while it lasts.
const RENEWALS: u32 = 3;
/// The last sixth of a lease is in doubt: what is computed hears it by then.
const DOUBTED: u32 = 6;
/// How long one question to the database may take.
const PATIENCE: Duration = Duration::from_secs(5);

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

    fn holds_since(&self, asked: Instant) {
        *self.renewed.lock().unwrap_or_else(PoisonError::into_inner) = Some(asked);
    }
}

async fn enlist(store: &Store, settings: &Settings, now: Timestamp) -> Result<i64, StoreError> {
    let host = rustix::system::uname().nodename().to_string_lossy().into_owned();
    let name = format!("{host}/{}", std::process::id());
    let roles: Vec<&str> = settings.roles.iter().map(|role| role.as_str()).collect();
    workers::enlist(store, (&name, &roles.join(",")), settings.lease(), now).await
}

/// Takes over what processes that are gone have left, and says so.
///
/// # Errors
/// Where the database fails.
pub async fn recover(store: &Store, now: Timestamp) -> Result<Recovered, StoreError> {
    let recovered = queue::recover(store, now).await?;
    if !recovered.requeued.is_empty() || !recovered.failed.is_empty() {
        tracing::warn!(
            requeued = recovered.requeued.len(),
            failed = recovered.failed.len(),
            "jobs of a process that is gone were found running"
        );
    }
    Ok(recovered)
}

/// Keeps the lease, and takes over what others leave, until the service stops.
pub async fn keep(service: Arc<Service>) {
    let mut stopping = service.stopping.subscribe();
    let mut renewed = Instant::now();
    while !*stopping.borrow_and_update() {
        let asked = Instant::now();
        if renewed.elapsed() >= service.membership.lease / RENEWALS || service.membership.is_in_doubt() {
            match tokio::time::timeout(PATIENCE, renew(&service, asked)).await {
                Ok(Ok(())) => renewed = asked,
                Ok(Err(error)) => tracing::error!(%error, "the lease of this process could not be renewed"),
                Err(_) => tracing::error!("the database does not answer, and the lease was not renewed"),
            }
        }
        match tokio::time::timeout(PATIENCE, look_after(&service)).await {
            Ok(Ok(())) | Err(_) => {}
            Ok(Err(error)) => tracing::error!(%error, "processes that are gone could not be looked for"),
        }
        tokio::select! {
            () = tokio::time::sleep(LOOK) => {}
            _ = stopping.changed() => {}
        }
    }
}

/// Renews the lease; where it has ended, this process is another one from now on.
async fn renew(service: &Service, asked: Instant) -> Result<(), ServiceError> {
    let membership = &service.membership;
    if !workers::renew(&service.store, membership.worker(), membership.lease).await? {
        let worker = enlist(&service.store, &service.settings, service.now()).await?;
        let before = membership.worker.swap(worker, Ordering::AcqRel);
        tracing::warn!(before, worker, "the lease had ended: others may have taken the jobs over");
    }
    membership.holds_since(asked);
    Ok(())
}

async fn look_after(service: &Service) -> Result<(), ServiceError> {
    let store = &service.store;
    if workers::somebody_is_silent(store).await? && !recover(store, service.now()).await?.requeued.is_empty()
    {
        service.wake.notify_one();
    }
    let schedules = service.settings.has(Role::Scheduler);
    let word = Role::Scheduler.as_str();
    let leads = schedules && workers::is_eldest(store, service.membership.worker(), word).await?;
    if service.membership.leads.swap(leads, Ordering::Relaxed) != leads {
        tracing::info!(leads, "what one does for all is done by the eldest");
        if leads {
            service.wake_schedule.notify_one();
            for system in store::degradations::outdated(store).await? {
                service.arrivals.note(&system);
            }
        }
    }
    Ok(())
}
