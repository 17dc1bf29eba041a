//! Systems whose newest measurements nobody has looked at yet.

use lampyris_core::data::SystemId;
use std::collections::BTreeSet;
use std::sync::{Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;

/// Systems of which measurements have arrived. Several arrivals before a look are one.
#[derive(Debug, Default)]
pub struct Arrivals {
    systems: Mutex<BTreeSet<SystemId>>,
    pub(super) told: Notify,
}

impl Arrivals {
    pub(super) fn systems(&self) -> MutexGuard<'_, BTreeSet<SystemId>> {
        // A panic while the set was held cannot have left it half-changed: every use is one call.
        self.systems.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Notes an arrival.
    pub fn note(&self, system: &SystemId) {
        self.systems().insert(system.clone());
        self.told.notify_one();
    }
}
