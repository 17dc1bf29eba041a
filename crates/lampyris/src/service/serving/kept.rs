//! The filters that are kept in memory, each at the newest sample that it has seen.

use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::estimate::assess::live::LiveStates;
use lampyris_core::estimate::assess::metrics::CurrentState;
use std::collections::HashMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Most systems whose filters are kept: of others the whole record is looked at.
const MOST: usize = 20_000;

/// The filters that are kept, by system.
#[derive(Debug, Default)]
pub struct LiveSystems(Mutex<HashMap<SystemId, Arc<KeptFilter>>>);

/// A filter that is kept.
#[derive(Debug)]
pub struct KeptFilter {
    /// The revision whose parameters it uses.
    pub(super) revision: i64,
    /// When the whole record was looked at.
    pub(super) looked_at: Timestamp,
    standing: Mutex<FilterEnd>,
}

/// Where a filter stands.
#[derive(Debug)]
pub(super) struct FilterEnd {
    /// Its end; `None` where the model has no filter.
    pub end: Option<LiveStates>,
    /// The states as they are told.
    pub told: Option<CurrentState>,
}

impl KeptFilter {
    /// What a look at the whole record has found.
    pub(super) fn new(
        revision: i64,
        looked_at: Timestamp,
        end: Option<LiveStates>,
        told: Option<CurrentState>,
    ) -> Self {
        Self { revision, looked_at, standing: Mutex::new(FilterEnd { end, told }) }
    }

    /// Where it stands, for whoever is the only one to change it.
    pub(super) fn standing(&self) -> MutexGuard<'_, FilterEnd> {
        // Whatever panicked while it was held has left both fields whole.
        self.standing.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl LiveSystems {
    fn all(&self) -> MutexGuard<'_, HashMap<SystemId, Arc<KeptFilter>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The filter of a system.
    pub(super) fn get(&self, system: &SystemId) -> Option<Arc<KeptFilter>> {
        self.all().get(system).cloned()
    }

    /// Keeps what a look has found.
    pub(super) fn put(&self, system: &SystemId, live: KeptFilter) {
        let mut all = self.all();
        if all.len() < MOST || all.contains_key(system) {
            all.insert(system.clone(), Arc::new(live));
        }
    }
}
