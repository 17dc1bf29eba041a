//! What came of asking other programs for measurements.

use super::lines::LineTally;
use jiff::Timestamp;
use serde::Serialize;
use std::sync::{Mutex, PoisonError};
use tokio::sync::Notify;
use utoipa::ToSchema;

/// What the latest question came to.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct PullOutcome {
    /// When.
    #[schema(value_type = String, format = DateTime)]
    pub at: Timestamp,
    /// Why it failed, in a sentence; `null` where it did not.
    pub error: Option<String>,
}

/// What came since the start.
#[derive(Debug, Default)]
pub struct Pulls {
    /// Values that came.
    pub lines: LineTally,
    latest: Mutex<Option<PullOutcome>>,
    changed: Notify,
}

impl Pulls {
    /// What the latest question came to.
    pub fn latest(&self) -> Option<PullOutcome> {
        // A panic while the lock was held can at most have lost an outcome.
        self.latest.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Remembers what a question came to.
    pub fn ended(&self, outcome: PullOutcome) {
        *self.latest.lock().unwrap_or_else(PoisonError::into_inner) = Some(outcome);
    }

    /// Says that another source is to be asked.
    pub fn changed(&self) {
        self.changed.notify_one();
    }

    /// Waits until another source is to be asked.
    pub async fn news(&self) {
        self.changed.notified().await;
    }
}
