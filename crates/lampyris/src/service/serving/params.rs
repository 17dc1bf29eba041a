//! Keeps the snapshot behind `/params` and `/state` true to the database.
//!
//! One task, [`follow`], hears of every commit that changes what is served, or what is said of it, and makes
//! the entries of its systems from the database, whatever the reason; whoever has written waits for it.
//! Bodies therefore change at events only, and the turn to `stale` is an event of the same task.

use super::ageing::Ageing;
use super::body::{self, Status};
use super::snapshot::{Answer, Entry, ParamsChange, StateChange};
use super::states;
use crate::service::catalogue::system::document;
use crate::service::changes::events::SystemChange;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::service::threads::blocking;
use crate::store::params::{ServedState, standings, standings_after};
use crate::store::{Change, failpoint};
use jiff::{SignedDuration, Timestamp};
use lampyris_core::data::SystemId;
use lampyris_core::model::Catalogue;
use std::collections::{BTreeSet, HashSet};
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::mpsc::UnboundedReceiver;

/// The longest sleep of the follower: after a jump of the clock, or where the database could not be read,
/// nothing is later than this.
const LONGEST_SLEEP: Duration = Duration::from_secs(30);
/// By how much a clock may go another way than time itself between two looks; one that is further off was
/// set.
const LARGEST_SLIP: SignedDuration = SignedDuration::from_mins(1);
/// Systems that are read at once.
const AT_ONCE: usize = 256;

/// Makes all entries: at start, before anybody can ask, and where a clock was set. Says when they turn stale.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn load_all(service: &Service) -> Result<Ageing, ServiceError> {
    let (mut ageing, mut after) = (Ageing::default(), String::new());
    loop {
        let some = standings_after(&service.store, &after, AT_ONCE as i64).await?;
        let Some(last) = some.last() else { return Ok(ageing) };
        after = last.system.to_string();
        for (system, entry) in entries(service, some).await? {
            show(service, &system, entry?, &mut ageing);
        }
    }
}

/// Serves an entry, and tells those who listen what of it is news.
fn show(service: &Service, system: &SystemId, entry: Entry, ageing: &mut Ageing) {
    ageing.note(system, entry.turns_stale);
    let (params, state) = (ParamsChange::of(&entry), StateChange::of(&entry));
    let news = service.params.swap(system, entry);
    if let Some(params) = params.filter(|_| news.params) {
        service.events.publish(system, SystemChange::Params(params));
    }
    if let Some(state) = state.filter(|_| news.states) {
        service.events.publish(system, SystemChange::State(state));
    }
}

/// Has everything read anew, in turns.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn read_all_anew(service: &Service) -> Result<(), ServiceError> {
    for record in crate::store::systems::all(&service.store).await?.chunks(AT_ONCE) {
        service.store.read_anew(record.iter().map(|record| record.system.clone()).collect()).await;
    }
    Ok(())
}

/// Shows what was committed, and publishes the turn to `stale` when its time has come, until the service
/// stops. What cannot be read stays as it is and is tried again. A clock that was set makes every age another
/// one.
pub(crate) async fn follow(
    service: Arc<Service>,
    mut changes: UnboundedReceiver<Change>,
    mut ageing: Ageing,
) {
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
            match load_all(&service).await {
                Ok(anew) => ageing = anew,
                Err(error) => tracing::error!(%error, "the age of what is served could not be counted anew"),
            }
        }
        due.extend(ageing.due(now));
        let left = ageing.next(now).map_or(LONGEST_SLEEP, |turn| turn.duration_since(now).unsigned_abs());
        let next = left.clamp(Duration::from_millis(10), LONGEST_SLEEP);
        read(&service, &mut due, &mut ageing).await;
        tokio::select! {
            change = changes.recv() => {
                let Some(change) = change else { return };
                due.extend(change.systems.iter().cloned());
                read(&service, &mut due, &mut ageing).await;
                change.followed();
            }
            () = tokio::time::sleep(next) => {}
            _ = stopping.changed() => {}
        }
    }
}

/// Reads systems again; those that could not be read stay due.
async fn read(service: &Service, due: &mut BTreeSet<SystemId>, ageing: &mut Ageing) {
    let asked: Vec<SystemId> = std::mem::take(due).into_iter().collect();
    for some in asked.chunks(AT_ONCE) {
        if let Ok(failed) = read_some(service, some, ageing).await {
            due.extend(failed);
            continue;
        }
        // What cannot be read of one system holds no other up.
        for system in some {
            match read_some(service, std::slice::from_ref(system), ageing).await {
                Ok(failed) => due.extend(failed),
                Err(error) => {
                    tracing::error!(%error, %system, "what is served could not be read again");
                    due.insert(system.clone());
                }
            }
        }
    }
}

/// Makes the entries of some systems anew, and gives those of which that failed.
async fn read_some(
    service: &Service,
    systems: &[SystemId],
    ageing: &mut Ageing,
) -> Result<Vec<SystemId>, ServiceError> {
    let found = standings(&service.store, &systems.iter().collect::<Vec<_>>()).await?;
    let mut gone: HashSet<&SystemId> = systems.iter().collect();
    let mut failed = Vec::new();
    for (system, made) in entries(service, found).await? {
        gone.remove(&system);
        let entry = match made {
            Ok(entry) => entry,
            Err(error) => {
                tracing::error!(%error, %system, "what is served could not be made anew");
                failed.push(system);
                continue;
            }
        };
        let has_fallen =
            |entry: &Entry| entry.validated().is_some_and(|served| served.status == Status::Fallback);
        if has_fallen(&entry)
            && service.params.entry(&system.to_string()).is_some_and(|before| !has_fallen(&before))
        {
            service.metrics.fell_back();
        }
        failpoint::reached("before_swap");
        show(service, &system, entry, ageing);
    }
    for system in gone {
        service.params.forget(system);
        ageing.note(system, None);
    }
    Ok(failed)
}

/// The entries of some systems. Those that serve nothing yet show what their models say, which takes longer.
async fn entries(
    service: &Service,
    standings: Vec<ServedState>,
) -> Result<Vec<(SystemId, Result<Entry, ServiceError>)>, ServiceError> {
    let (catalogue, now) = (service.catalogue.current(), service.now());
    let make = move |standings: Vec<ServedState>| -> Vec<_> {
        let one = |standing: ServedState| (standing.system.clone(), entry(standing, &catalogue, now));
        standings.into_iter().map(one).collect()
    };
    if standings.iter().all(|standing| standing.revision.is_some()) {
        return Ok(make(standings));
    }
    blocking(move || make(standings)).await
}

fn entry(standing: ServedState, catalogue: &Catalogue, now: Timestamp) -> Result<Entry, ServiceError> {
    let document = document(&standing.document)?;
    let states = standing
        .state
        .as_ref()
        .and_then(|(revision, document)| states::rendered(&standing.system.to_string(), *revision, document));
    let Some(revision) = &standing.revision else {
        let nominal = body::nominal(standing.system, &document, catalogue)?;
        let answer = Answer::NeverValidated { latest_job: standing.latest_job, nominal };
        return Ok(Entry { answer, states, turns_stale: None });
    };
    let stale_after = body::stale_after(revision, &document, now);
    let stale = now >= stale_after;
    let rendered = body::validated(&standing, revision, stale_after, stale)?;
    Ok(Entry { answer: Answer::Validated(rendered), states, turns_stale: (!stale).then_some(stale_after) })
}
