//! Keeps the snapshot behind `/params` and `/state` true to the database.
//!
//! One task, [`follow`], hears of every commit that changes what is served, or what is said of it, and makes
//! the entries of its systems from the database, whatever the reason; whoever has written waits for it.
//! Bodies therefore change at events only, and the turn to `stale` is an event of the same task.

use super::body::{self, Status};
use super::snapshot::{Answer, Entry, ParamsChange, StateChange};
use super::states;
use crate::service::catalogue::system::document;
use crate::service::changes::events::SystemChange;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::threads::blocking;
use crate::store::params::{ServedState, standing, standings};
use crate::store::{Change, failpoint};
use jiff::{SignedDuration, Timestamp};
use lampyris_core::data::SystemId;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::mpsc::UnboundedReceiver;

/// The longest sleep of the follower: after a jump of the clock, or where the database could not be read,
/// nothing is later than this.
const LONGEST_SLEEP: Duration = Duration::from_secs(30);
/// By how much a clock may go another way than time itself between two looks; one that is further off was
/// set.
const LARGEST_SLIP: SignedDuration = SignedDuration::from_mins(1);

/// Makes all entries: at start, before anybody can ask, and where a clock was set.
///
/// # Errors
/// Where the database fails.
pub async fn load_all(service: &Service) -> Result<(), ServiceError> {
    for standing in standings(&service.store).await? {
        let system = standing.system.clone();
        let entry = entry(service, standing).await?;
        show(service, &system, entry);
    }
    Ok(())
}

/// Serves an entry, and tells those who listen what of it is news.
fn show(service: &Service, system: &SystemId, entry: Entry) {
    let (params, state) = (ParamsChange::of(&entry), StateChange::of(&entry));
    let news = service.params.swap(system, entry);
    if let Some(params) = params.filter(|_| news.params) {
        service.events.publish(system, SystemChange::Params(params));
    }
    if let Some(state) = state.filter(|_| news.states) {
        service.events.publish(system, SystemChange::State(state));
    }
}

/// Shows what was committed, and publishes the turn to `stale` when its time has come, until the service
/// stops. What cannot be read stays as it is and is tried again. A clock that was set makes every age another
/// one.
pub async fn follow(service: Arc<Service>, mut changes: UnboundedReceiver<Change>) {
    let mut stopping = service.stopping.subscribe();
    let mut known = (service.now(), Instant::now());
    let mut due = BTreeSet::new();
    while !*stopping.borrow_and_update() {
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
        let next = turning(&service, now, &mut due);
        read(&service, &mut due).await;
        tokio::select! {
            change = changes.recv() => {
                let Some(change) = change else { return };
                due.extend(change.systems.iter().cloned());
                read(&service, &mut due).await;
                change.followed();
            }
            () = tokio::time::sleep(next) => {}
            _ = stopping.changed() => {}
        }
    }
}

/// Adds the systems whose turn to `stale` has come, and says how long it is to the next one.
fn turning(service: &Service, now: Timestamp, due: &mut BTreeSet<SystemId>) -> Duration {
    let (turned, next) = service.params.turning(now);
    due.extend(turned.iter().flat_map(|system| system.parse::<SystemId>()));
    let left = next.map_or(LONGEST_SLEEP, |turn| turn.duration_since(now).unsigned_abs());
    left.clamp(Duration::from_millis(10), LONGEST_SLEEP)
}

/// Reads systems again; those that could not be read stay due.
async fn read(service: &Service, due: &mut BTreeSet<SystemId>) {
    for system in std::mem::take(due) {
        if let Err(error) = refresh(service, &system).await {
            tracing::error!(%error, %system, "what is served could not be read again");
            due.insert(system);
        }
    }
}

/// Makes the entry of a system anew.
async fn refresh(service: &Service, system: &SystemId) -> Result<(), ServiceError> {
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
            show(service, system, entry);
        }
        None => service.params.forget(system),
    }
    Ok(())
}

async fn entry(service: &Service, standing: ServedState) -> Result<Entry, ServiceError> {
    let document = document(&standing.document)?;
    let states = standing
        .state
        .as_ref()
        .and_then(|(revision, document)| states::rendered(&standing.system.to_string(), *revision, document));
    match &standing.revision {
        Some(revision) => {
            let now = service.now();
            let stale_after = body::stale_after(revision, &document, now);
            let stale = now >= stale_after;
            let rendered = body::validated(&standing, revision, stale_after, stale)?;
            Ok(Entry {
                answer: Answer::Validated(rendered),
                states,
                turns_stale: (!stale).then_some(stale_after),
            })
        }
        None => {
            let catalogue = service.catalogue.current();
            let system = standing.system;
            let nominal = blocking(move || body::nominal(system, &document, &catalogue)).await??;
            Ok(Entry {
                answer: Answer::NeverValidated { latest_job: standing.latest_job, nominal },
                states,
                turns_stale: None,
            })
        }
    }
}
