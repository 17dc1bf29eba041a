//! Keeps the lease of this process, and takes over what others leave. Where the lease has ended, this process
//! enters as another one when the database is there again.

use super::membership;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::store::queue::Recovered;
use crate::store::workers::{self, ProcessRole};
use crate::store::{self, Store, StoreError, queue};
use jiff::Timestamp;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A lease is renewed three times while it lasts.
const RENEWALS: u32 = 3;
/// How often it is tried again where that failed, and how often others are looked after.
const LOOK: Duration = Duration::from_secs(2);
/// How long one question to the database may take.
const PATIENCE: Duration = Duration::from_secs(5);

/// Takes over what processes that are gone have left, and says so.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn recover(store: &Store, now: Timestamp) -> Result<Recovered, StoreError> {
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
pub(crate) async fn keep(service: Arc<Service>) {
    let mut stopping = service.stopping.subscribe();
    let mut renewed = Instant::now();
    while !*stopping.borrow_and_update() {
        let asked = Instant::now();
        if renewed.elapsed() >= service.membership.lease() / RENEWALS || service.membership.is_in_doubt() {
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
    let own = &service.membership;
    if !workers::renew(&service.store, own.worker(), own.lease()).await? {
        let worker = membership::enlist(&service.store, &service.settings, service.now()).await?;
        let before = own.go_on_as(worker);
        tracing::warn!(before, worker, "the lease had ended: others may have taken the jobs over");
    }
    own.holds_since(asked);
    Ok(())
}

async fn look_after(service: &Service) -> Result<(), ServiceError> {
    let store = &service.store;
    if workers::somebody_is_silent(store).await? && !recover(store, service.now()).await?.requeued.is_empty()
    {
        service.wake.notify_one();
    }
    let schedules = service.settings.has(ProcessRole::Scheduler);
    let word = ProcessRole::Scheduler.as_str();
    let leads = schedules && workers::is_eldest(store, service.membership.worker(), word).await?;
    if service.membership.set_leads(leads) {
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
