//! The snapshot behind `/params`: finished bodies with their tags, swapped in after the commit.
//! One task alone makes entries (`params`), so that an older one never comes last.
//!
//! A handler takes the body that is there: no SQL, no lock, no encoding.

use super::body::Rendered;
use crate::store::jobs::JobStatus;
use arc_swap::ArcSwap;
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use std::collections::HashMap;
use std::sync::Arc;
use tokio::sync::watch;

/// What `/params` serves, by the name of the system (`room/4`).
#[derive(Debug, Default)]
pub struct Snapshot {
    slots: ArcSwap<HashMap<String, Arc<Slot>>>,
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
    pub(super) turns_stale: Option<Timestamp>,
}

/// The parameters, or why there are none.
#[derive(Debug)]
pub enum Answer {
    /// A revision.
    Validated(Rendered),
    /// No fit was ever accepted.
    NeverValidated {
        /// The newest job.
        latest_job: Option<(String, JobStatus)>,
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
        let mut all: Vec<_> =
            self.slots.load().iter().map(|(system, slot)| (system.clone(), slot.entry.load_full())).collect();
        all.sort_by(|a, b| a.0.cmp(&b.0));
        all
    }

    /// The systems whose turn to `stale` has come, and when the next of the others comes.
    pub(super) fn turning(&self, now: Timestamp) -> (Vec<String>, Option<Timestamp>) {
        let (mut turned, mut next) = (Vec::new(), None::<Timestamp>);
        for (system, slot) in self.slots.load().iter() {
            match slot.entry.load().turns_stale {
                Some(turn) if turn <= now => turned.push(system.clone()),
                Some(turn) => next = Some(next.map_or(turn, |next| next.min(turn))),
                None => {}
            }
        }
        (turned, next)
    }

    /// Swaps an entry in, and wakes those who wait for it if it is another one.
    pub(super) fn swap(&self, system: &SystemId, entry: Entry) {
        let name = system.to_string();
        match self.slot(&name) {
            Some(slot) => {
                let is_news = !slot.entry.load().says_the_same(&entry);
                slot.entry.store(Arc::new(entry));
                if is_news {
                    slot.changed.send_replace(());
                }
            }
            None => {
                let slot =
                    Arc::new(Slot { entry: ArcSwap::from_pointee(entry), changed: watch::Sender::new(()) });
                self.slots.rcu(|slots| {
                    let mut more = HashMap::clone(slots);
                    more.insert(name.clone(), slot.clone());
                    more
                });
            }
        }
    }

    /// Takes a system out that is no longer there. Whoever still waits for it finds nothing to use.
    pub(super) fn forget(&self, system: &SystemId) {
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
            (
                Answer::NeverValidated { latest_job: mine, .. },
                Answer::NeverValidated { latest_job: theirs, .. },
            ) => mine == theirs,
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
