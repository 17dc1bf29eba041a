//! Forgets what is old, as far as the settings say so: after the tick of the nightly schedule.

use crate::service::access::tokens::SERVICE;
use crate::service::catalogue::windows;
use crate::service::error::ServiceError;
use crate::service::state::Service;
use crate::store;
use crate::store::windows::WindowDeletion;
use jiff::{SignedDuration, Timestamp};

/// How long an upload that went on with another window is known by its own id.
const ALIASES_KEPT: SignedDuration = SignedDuration::from_hours(30 * 24);

/// What was forgotten.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Forgotten {
    /// Jobs, with their fits and diagnoses.
    pub jobs: u64,
    /// Batches of which no job was left.
    pub batches: u64,
    /// Windows.
    pub windows: u64,
    /// Months of samples, or days of systems where they are not kept by month.
    pub samples: u64,
    /// Fits that were shortened to what decides.
    pub traces: u64,
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
        forgotten.windows = forget_windows(service, before, kept.windows_days).await?;
    }
    if let Some(before) = before(kept.samples_days) {
        let gone = store::expiry::forget(&service.store, before).await?;
        forgotten.windows += gone.windows;
        forgotten.samples = gone.parts;
    }
    if let Some(before) = before(kept.traces_days) {
        forgotten.traces = store::retention::shorten_fits(&service.store, before).await?;
    }
    let before = now.saturating_sub(ALIASES_KEPT).unwrap_or(Timestamp::MIN);
    store::uploads::forget_aliases(&service.store, before).await?;
    store::said::forget_old(&service.store, now).await?;
    store::idempotency::forget_old(&service.store, now).await?;
    store::queue::forget_tenants(&service.store).await?;
    if forgotten != Forgotten::default() {
        tracing::info!(
            jobs = forgotten.jobs,
            batches = forgotten.batches,
            windows = forgotten.windows,
            samples = forgotten.samples,
            traces = forgotten.traces,
            "forgot what was old"
        );
    }
    Ok(forgotten)
}

/// Removes windows, each with a note of it; says how many.
async fn forget_windows(service: &Service, before: Timestamp, days: u32) -> Result<u64, ServiceError> {
    let reason =
        format!("older than {days} days or covered by newer windows, and no fit that counts has read it");
    let (mut gone, mut after) = (0, 0);
    loop {
        let found = store::retention::dispensable_windows(&service.store, before, days, after).await?;
        let Some((last, _)) = found.last() else { return Ok(gone) };
        after = *last;
        for (_, id) in found {
            // What a running job may read stays until the next night.
            let removed = windows::remove(service, &id, SERVICE, Some(&reason)).await?;
            gone += u64::from(removed == WindowDeletion::Gone);
        }
    }
}
