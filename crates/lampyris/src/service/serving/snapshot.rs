//! The snapshot behind `/params` and `/state`: finished bodies with their tags, swapped in after the commit.
//! One task alone makes entries (`params`), so that an older one never comes last.
//!
//! A handler takes the body that is there: no SQL, no lock, no encoding. The map of systems takes a new one
//! without being copied, however many there are.

use super::body::{Rendered, Status};
use super::states::RenderedStates;
use crate::store::jobs::JobStatus;
use arc_swap::ArcSwap;
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use papaya::HashMap;
use serde::Serialize;
use std::sync::Arc;
use tokio::sync::watch;

/// What `/params` and `/state` serve, by the name of the system (`room/4`).
#[derive(Debug, Default)]
pub struct Snapshot {
    slots: Arc<HashMap<String, Arc<Slot>>>,
}

/// The systems that are there.
#[derive(Debug, Clone)]
pub struct KnownSystems(Arc<HashMap<String, Arc<Slot>>>);

impl KnownSystems {
    /// Whether a system of this name is among them.
    pub fn has(&self, system: &str) -> bool {
        self.0.pin().contains_key(system)
    }
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
    /// The states at the newest measurement, where there are any.
    pub states: Option<RenderedStates>,
    /// When the status turns to `stale`.
    pub(super) turns_stale: Option<Timestamp>,
}

/// What is served now.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ParamsChange {
    /// The revision.
    pub revision: i64,
    /// How much to trust it.
    pub status: Status,
}

/// Which states there are now.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StateChange {
    /// The revision by whose parameters they were found.
    pub revision: i64,
    /// The instant of the sample, RFC 3339.
    pub at: String,
}

/// What of an entry is another than it was.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(super) struct EntryNews {
    /// The parameters, or what is said of them.
    pub params: bool,
    /// The states.
    pub states: bool,
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
    /// The systems that are there now.
    pub fn known(&self) -> KnownSystems {
        KnownSystems(self.slots.clone())
    }

    /// The slot of a system, if there is such a system.
    pub fn slot(&self, system: &str) -> Option<Arc<Slot>> {
        self.slots.pin().get(system).cloned()
    }

    /// The entry of a system, if there is such a system.
    pub fn entry(&self, system: &str) -> Option<Arc<Entry>> {
        self.slots.pin().get(system).map(|slot| slot.entry.load_full())
    }

    /// All systems with their entries, by name.
    pub fn all(&self) -> Vec<(String, Arc<Entry>)> {
        let mut all: Vec<_> =
            self.slots.pin().iter().map(|(system, slot)| (system.clone(), slot.entry.load_full())).collect();
        all.sort_by(|a, b| a.0.cmp(&b.0));
        all
    }

    /// Swaps an entry in, wakes those who wait for it if it is another one, and says in what. There is no
    /// news of a system that comes.
    pub(super) fn swap(&self, system: &SystemId, entry: Entry) -> EntryNews {
        let name = system.to_string();
        match self.slot(&name) {
            Some(slot) => {
                let news = entry.news_after(&slot.entry.load());
                slot.entry.store(Arc::new(entry));
                if news != EntryNews::default() {
                    slot.changed.send_replace(());
                }
                news
            }
            None => {
                let slot =
                    Arc::new(Slot { entry: ArcSwap::from_pointee(entry), changed: watch::Sender::new(()) });
                self.slots.pin().insert(name, slot);
                EntryNews::default()
            }
        }
    }

    /// Takes a system out that is no longer there. Whoever still waits for it finds nothing to use.
    pub(super) fn forget(&self, system: &SystemId) {
        let name = system.to_string();
        if let Some(slot) = self.slots.pin().remove(&name) {
            let answer = Answer::NeverValidated { latest_job: None, nominal: None };
            slot.entry.store(Arc::new(Entry { answer, states: None, turns_stale: None }));
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

impl ParamsChange {
    /// What an entry tells of, unless nothing was ever validated.
    pub fn of(entry: &Entry) -> Option<Self> {
        let served = entry.validated()?;
        Some(Self { revision: served.revision?, status: served.status })
    }
}

impl StateChange {
    /// What an entry tells of, where it has states.
    pub fn of(entry: &Entry) -> Option<Self> {
        entry.states.as_ref().map(|states| Self { revision: states.revision, at: states.at.clone() })
    }
}

impl Entry {
    fn news_after(&self, before: &Entry) -> EntryNews {
        let tag = |entry: &Entry| entry.states.as_ref().map(|states| states.etag.clone());
        EntryNews { params: !self.says_the_same(before), states: tag(self) != tag(before) }
    }

    /// Whether the parameters are the same, and what is said of them.
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
