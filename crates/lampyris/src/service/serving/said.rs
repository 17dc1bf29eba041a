//! What forecasts said and nobody has kept yet.

use crate::store::said::quarter;
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::estimate::forecast::score::Said;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::Notify;

/// A forecast, as it was said.
#[derive(Debug)]
pub struct SaidForecast {
    /// When it was made.
    pub made_at: Timestamp,
    /// The revision that made it.
    pub revision: i64,
    /// What it said of each output.
    pub outputs: Vec<Said>,
}

/// What was said and is not kept yet. Of a system it is the first of each quarter of an hour.
#[derive(Debug, Clone, Default)]
pub struct SaidForecasts {
    newest: Arc<Mutex<NewestSaid>>,
    pub(super) told: Arc<Notify>,
}

#[derive(Debug, Default)]
struct NewestSaid {
    forecasts: BTreeMap<SystemId, SaidForecast>,
    quarters: BTreeMap<SystemId, i64>,
}

impl SaidForecasts {
    /// Notes what was said, if it is the first of its quarter of an hour.
    pub fn note(&self, system: &SystemId, said: SaidForecast) {
        let now = quarter(said.made_at);
        let mut newest = self.newest();
        if newest.quarters.insert(system.clone(), now) != Some(now) {
            newest.forecasts.insert(system.clone(), said);
            self.told.notify_one();
        }
    }

    /// Takes all that waits to be kept.
    pub(super) fn take(&self) -> BTreeMap<SystemId, SaidForecast> {
        std::mem::take(&mut self.newest().forecasts)
    }

    fn newest(&self) -> MutexGuard<'_, NewestSaid> {
        // A panic while this was held may have lost a forecast, and that is all.
        self.newest.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
