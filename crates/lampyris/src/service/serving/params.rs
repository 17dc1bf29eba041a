//! Keeps the snapshot behind `/params` true to the database.
//!
//! One function, [`refresh`], makes an entry from the database, whatever the reason; bodies therefore change
//! at events only, and the turn to `stale` is an event that [`keep_fresh`] makes.

use super::body::{self, Status};
use super::snapshot::{Answer, Entry};
use crate::service::catalogue::system::document;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::threads::blocking;
use crate::store::failpoint;
use crate::store::params::{ServedState, standing, standings};
use jiff::SignedDuration;
use lampyris_core::data::SystemId;
use std::pin::pin;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// The longest sleep of the timer: after a jump of the clock nothing is later than this.
const LONGEST_SLEEP: Duration = Duration::from_secs(30);
/// By how much a clock may go another way than time itself between two looks; one that is further off was
/// set.
const LARGEST_SLIP: SignedDuration = SignedDuration::from_mins(1);

/// Makes the entry of a system anew. To be called after every commit that may change it.
///
/// # Errors
/// Where the database fails.
pub async fn refresh(service: &Service, system: &SystemId) -> Result<(), ServiceError> {
    let _one_at_a_time = service.params.refreshing.lock().await;
    match standing(&service.store, system).await? {
        Some(standing) => {
            let entry = entry(service, standing).await?;
            let has_fallen =
                |entry: &Entry| entry.validated().is_some_and(|served| served.status == Status::Fallback);
            if has_fallen(&entry)
                && service.params.entry(&system.to_string()).is_some_and(|before| !has_fallen(&before))
            {
                service.metrics.fell_back();
            }
            failpoint::reached("before_swap");
            service.params.swap(system, entry);
        }
        None => service.params.forget(system),
    }
    Ok(())
}

/// Makes all entries: at start, before anybody can ask.
///
/// # Errors
/// Where the database fails.
pub async fn load_all(service: &Service) -> Result<(), ServiceError> {
    let _one_at_a_time = service.params.refreshing.lock().await;
    for standing in standings(&service.store).await? {
        let system = standing.system.clone();
        let entry = entry(service, standing).await?;
        service.params.swap(&system, entry);
    }
    Ok(())
}

/// Publishes the turn to `stale` when its time has come, until the service stops. A clock that was set makes
/// every age another one.
pub async fn keep_fresh(service: Arc<Service>) {
    let mut stopping = service.stopping.subscribe();
    let mut known = (service.now(), Instant::now());
    while !*stopping.borrow_and_update() {
        let mut retimed = pin!(service.params.retime.notified());
        retimed.as_mut().enable();
        let now = service.now();
        let passed = SignedDuration::try_from(known.1.elapsed()).unwrap_or(SignedDuration::MAX);
        let jump = now.duration_since(known.0) - passed;
        known = (now, Instant::now());
        if jump.abs() > LARGEST_SLIP {
            tracing::warn!(
                "the clock was set by {jump:#}, to {now}: the age of everything that is served is counted \
                anew"
            );
            if let Err(error) = load_all(&service).await {
                tracing::error!(%error, "the age of what is served could not be counted anew");
            }
        }
        let mut next = LONGEST_SLEEP;
        for (system, entry) in service.params.all() {
            match entry.turns_stale.map(|turn| turn.duration_since(now)) {
                Some(left) if left <= SignedDuration::ZERO => {
                    let turned = match system.parse() {
                        Ok(system) => refresh(&service, &system).await.map_err(|error| error.to_string()),
                        Err(error) => Err(error.to_string()),
                    };
                    if let Err(error) = turned {
                        tracing::error!(error, system, "the turn to stale could not be published");
                    }
                }
                Some(left) => next = next.min(left.unsigned_abs().max(Duration::from_millis(10))),
                None => {}
            }
        }
        tokio::select! {
            () = retimed => {}
            () = tokio::time::sleep(next) => {}
            _ = stopping.changed() => {}
        }
    }
}

async fn entry(service: &Service, standing: ServedState) -> Result<Entry, ServiceError> {
    let document = document(&standing.document)?;
    match &standing.revision {
        Some(revision) => {
            let now = service.now();
            let stale_after = body::stale_after(revision, &document, now);
            let stale = now >= stale_after;
            let rendered = body::validated(&standing, revision, stale_after, stale)?;
            Ok(Entry { answer: Answer::Validated(rendered), turns_stale: (!stale).then_some(stale_after) })
        }
        None => {
            let catalogue = service.catalogue.current();
            let system = standing.system;
            let nominal = blocking(move || body::nominal(system, &document, &catalogue)).await??;
            Ok(Entry {
                answer: Answer::NeverValidated { latest_job: standing.latest_job, nominal },
                turns_stale: None,
            })
        }
    }
}
