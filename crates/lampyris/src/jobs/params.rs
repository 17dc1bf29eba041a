//! The snapshot behind `/params`: finished bodies with their tags, swapped in after the commit.
//!
//! A handler takes the body that is there: no SQL, no lock, no encoding. One function, [`refresh`], makes an
//! entry from the database, whatever the reason; bodies therefore change at events only, and the turn to
//! `stale` is an event that [`keep_fresh`] makes.

mod body;

pub use body::{Body, Rendered, Status};

use super::systems::document;
use super::{JobsError, Service, blocking};
use crate::store::failpoint;
use crate::store::jobs::JobState;
use crate::store::params::{Standing, standing, standings};
use arc_swap::ArcSwap;
use jiff::{SignedDuration, Timestamp};
use lampyris_core::data::SystemId;
use std::collections::HashMap;
use std::pin::pin;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tokio::sync::{Mutex, Notify, watch};

/// The longest sleep of the timer: after a jump of the clock nothing is later than this.
const LONGEST_SLEEP: Duration = Duration::from_secs(30);
/// By how much a clock may go another way than time itself between two looks; one that is further off was set.
const LARGEST_SLIP: SignedDuration = SignedDuration::from_mins(1);

/// What `/params` serves, by the name of the system (`room/4`).
#[derive(Debug, Default)]
pub struct Snapshot {
    slots: ArcSwap<HashMap<String, Arc<Slot>>>,
    /// Entries are read from the database and swapped in by one at a time, so that an older one never comes last.
    refreshing: Mutex<()>,
    /// Told when an entry may turn stale earlier than the timer expects.
    retime: Notify,
}

/// The place of one system. It stays; its entry is swapped.
#[derive(Debug)]
pub struct Slot {
    entry: ArcSwap<Entry>,
    changed: watch::Sender<()>,
}

/// What is served for one system.
#[derive(Debug)]
pub struct Entry {
    /// The parameters, or why there are none.
    pub answer: Answer,
    /// When the status turns to `stale`.
    turns_stale: Option<Timestamp>,
}

/// The parameters, or why there are none.
#[derive(Debug)]
pub enum Answer {
    /// A revision.
    Validated(Rendered),
    /// No fit was ever accepted.
    NeverValidated {
        /// The newest job.
        latest_job: Option<(String, JobState)>,
        /// The nominal values of the model, for those who accept them.
        nominal: Option<Rendered>,
    },
}

impl Snapshot {
    /// The slot of a system, if there is such a system.
    pub fn slot(&self, system: &str) -> Option<Arc<Slot>> {
        self.slots.load().get(system).cloned()
    }

    /// The entry of a system, if there is such a system.
    pub fn entry(&self, system: &str) -> Option<Arc<Entry>> {
        self.slots.load().get(system).map(|slot| slot.entry.load_full())
    }

    /// All systems with their entries, by name.
    pub fn all(&self) -> Vec<(String, Arc<Entry>)> {
        let mut all: Vec<_> = self.slots.load().iter().map(|(system, slot)| (system.clone(), slot.entry.load_full())).collect();
        all.sort_by(|a, b| a.0.cmp(&b.0));
        all
    }

    /// Swaps an entry in, and wakes those who wait for it if it is another one.
    fn swap(&self, system: &SystemId, entry: Entry) {
        let name = system.to_string();
        self.retime.notify_one();
        match self.slot(&name) {
            Some(slot) => {
                let is_news = !slot.entry.load().says_the_same(&entry);
                slot.entry.store(Arc::new(entry));
                if is_news {
                    slot.changed.send_replace(());
                }
            }
            None => {
                let slot = Arc::new(Slot { entry: ArcSwap::from_pointee(entry), changed: watch::Sender::new(()) });
                self.slots.rcu(|slots| {
                    let mut more = HashMap::clone(slots);
                    more.insert(name.clone(), slot.clone());
                    more
                });
            }
        }
    }

    /// Takes a system out that is no longer there. Whoever still waits for it finds nothing to use.
    fn forget(&self, system: &SystemId) {
        let name = system.to_string();
        if let Some(slot) = self.slot(&name) {
            self.slots.rcu(|slots| {
                let mut fewer = HashMap::clone(slots);
                fewer.remove(&name);
                fewer
            });
            let answer = Answer::NeverValidated { latest_job: None, nominal: None };
            slot.entry.store(Arc::new(Entry { answer, turns_stale: None }));
            slot.changed.send_replace(());
        }
    }
}

impl Slot {
    /// What is served now.
    pub fn entry(&self) -> Arc<Entry> {
        self.entry.load_full()
    }

    /// Changes from now on.
    pub fn watch(&self) -> watch::Receiver<()> {
        self.changed.subscribe()
    }
}

impl Entry {
    fn says_the_same(&self, other: &Entry) -> bool {
        match (&self.answer, &other.answer) {
            (Answer::Validated(mine), Answer::Validated(theirs)) => mine.etag == theirs.etag,
            (Answer::NeverValidated { latest_job: mine, .. }, Answer::NeverValidated { latest_job: theirs, .. }) => mine == theirs,
            _ => false,
        }
    }

    /// The revision that is served, if there is one.
    pub fn validated(&self) -> Option<&Rendered> {
        match &self.answer {
            Answer::Validated(rendered) => Some(rendered),
            Answer::NeverValidated { .. } => None,
        }
    }
}

/// Makes the entry of a system anew. To be called after every commit that may change it.
///
/// # Errors
/// Where the database fails.
pub async fn refresh(service: &Service, system: &SystemId) -> Result<(), JobsError> {
    let _one_at_a_time = service.params.refreshing.lock().await;
    match standing(&service.store, system).await? {
        Some(standing) => {
            let entry = entry(service, standing).await?;
            let has_fallen = |entry: &Entry| entry.validated().is_some_and(|served| served.status == Status::Fallback);
            if has_fallen(&entry) && service.params.entry(&system.to_string()).is_some_and(|before| !has_fallen(&before)) {
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
pub async fn load_all(service: &Service) -> Result<(), JobsError> {
    let _one_at_a_time = service.params.refreshing.lock().await;
    for standing in standings(&service.store).await? {
        let system = standing.system.clone();
        let entry = entry(service, standing).await?;
        service.params.swap(&system, entry);
    }
    Ok(())
}

/// Publishes the turn to `stale` when its time has come, until the service stops. A clock that was set makes every age another one.
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
            tracing::warn!("the clock was set by {jump:#}, to {now}: the age of everything that is served is counted anew");
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

async fn entry(service: &Service, standing: Standing) -> Result<Entry, JobsError> {
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
            Ok(Entry { answer: Answer::NeverValidated { latest_job: standing.latest_job, nominal }, turns_stale: None })
        }
    }
}
