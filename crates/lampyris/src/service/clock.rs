//! What time it is. Nothing below this stage knows it.

use jiff::{SignedDuration, Timestamp};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};

/// The clock of a service: that of the system, which tests of nights and months set ahead.
#[derive(Debug, Clone, Default)]
pub struct Clock {
    ahead_ms: Arc<AtomicI64>,
}

impl Clock {
    /// The time by this clock.
    pub fn now(&self) -> Timestamp {
        now()
            .saturating_add(SignedDuration::from_millis(self.ahead_ms.load(Ordering::Relaxed)))
            .unwrap_or(Timestamp::MAX)
    }

    /// Sets the clock; from there it goes on.
    pub fn set(&self, time: Timestamp) {
        self.ahead_ms.store(time.as_millisecond() - now().as_millisecond(), Ordering::Relaxed);
    }
}

/// The time by the system. Nothing below this stage knows it.
pub fn now() -> Timestamp {
    Timestamp::now()
}
