//! Forgets what is old, as far as the settings say so: after the tick of the nightly schedule.

use crate::service::access::tokens::SERVICE;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::store;
use jiff::{SignedDuration, Timestamp};

/// What was forgotten.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Forgotten {
    /// Jobs, with their fits and diagnoses.
    pub jobs: u64,
    /// Batches of which no job was left.
    pub batches: u64,
    /// Windows.
    pub windows: u64,
}

/// Forgets what is older than the settings say and what nothing names that is kept.
///
/// # Errors
/// Where the database fails; what is gone by then stays so.
pub async fn forget(service: &Service, now: Timestamp) -> Result<Forgotten, ServiceError> {
    let kept = &service.settings.retention;
    let before = |days: u32| {
        (days > 0).then(|| {
            now.saturating_sub(SignedDuration::from_hours(24 * i64::from(days))).unwrap_or(Timestamp::MIN)
        })
    };
    let mut forgotten = Forgotten {
        jobs: store::retention::forget_jobs(
            &service.store,
            before(kept.jobs_days),
            before(kept.diagnoses_days),
        )
        .await?,
        ..Forgotten::default()
    };
    if let Some(before) = before(kept.jobs_days) {
        forgotten.batches = store::retention::forget_batches(&service.store, before).await?;
    }
    if let Some(before) = before(kept.windows_days) {
        forgotten.windows =
            store::retention::forget_windows(&service.store, before, kept.windows_days, SERVICE, now).await?;
    }
    store::idempotency::forget_old(&service.store, now).await?;
    if forgotten != Forgotten::default() {
        tracing::info!(
            jobs = forgotten.jobs,
            batches = forgotten.batches,
            windows = forgotten.windows,
            "forgot what was old"
        );
    }
    Ok(forgotten)
}
