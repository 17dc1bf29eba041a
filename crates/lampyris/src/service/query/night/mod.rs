//! What a night has come to: what changed, who was refused and why, who has turned stale, and what to do
//! next.
//!
//! The batches of schedules say what was done; what is served, and what the data say of effects, is read as
//! it is now. `report` is what is told, `outcomes` what the jobs have come to, `steps` what to do about it.

pub mod report;

mod outcomes;
mod steps;

use crate::service::catalogue::system::{Policy, document};
use crate::service::error::ServiceError;
use crate::service::query::matrix;
use crate::service::serving::body::Status;
use crate::service::serving::health::Served;
use crate::service::state::Service;
use crate::service::threads::blocking;
use crate::store;
use crate::store::batches::{BatchMember, BatchRecord};
use crate::store::jobs::Outcome;
use crate::store::reach::SystemScope;
use crate::store::systems::SystemRecord;
use jiff::tz::TimeZone;
use jiff::{Timestamp, Zoned};
use lampyris_core::data::SystemId;
use outcomes::{changed_system, gain, refusals, skipped, summary};
use report::{DoubtfulSystem, NightBatch, NightReport};
use std::cmp::Reverse;
use std::collections::HashMap;
use steps::{SampleAge, doubt, next_steps};

/// The batches of a night, and under which name it was asked for.
#[derive(Debug)]
pub struct Night {
    /// A day, or a batch.
    pub name: String,
    /// What was done.
    pub batches: Vec<BatchRecord>,
}

/// The first and the last instant of a day on the clock of the service.
pub fn bounds(day: jiff::civil::Date, zone: &str) -> Option<(Timestamp, Timestamp)> {
    let zone = TimeZone::get(zone).unwrap_or(TimeZone::UTC);
    let from = day.to_zoned(zone.clone()).ok()?.timestamp();
    Some((from, day.tomorrow().ok()?.to_zoned(zone).ok()?.timestamp()))
}

/// The day of an instant on the clock of the service.
pub fn day_of(at: Timestamp, zone: &str) -> String {
    Zoned::new(at, TimeZone::get(zone).unwrap_or(TimeZone::UTC)).date().to_string()
}

/// The report of a night, nothing where it has no batch.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn report(
    service: &Service,
    reach: &SystemScope,
    night: Night,
) -> Result<Option<NightReport>, ServiceError> {
    let Some(at) = night.batches.iter().map(|batch| batch.created_at).min() else { return Ok(None) };
    let jobs: Vec<&BatchMember> = night.batches.iter().flat_map(|batch| &batch.jobs).collect();
    let mut changed = Vec::new();
    let accepted: Vec<&BatchMember> =
        jobs.iter().copied().filter(|job| job.outcome == Some(Outcome::Accepted)).collect();
    let policies = policies(service, accepted.iter().map(|job| job.system.clone()).collect()).await?;
    for job in accepted {
        let horizon = policies.get(&job.system.to_string()).map(|policy| policy.horizon).unwrap_or_default();
        changed.push(changed_system(job, horizon));
    }
    changed.sort_by(|one, other| gain(other).total_cmp(&gain(one)).then(one.system.cmp(&other.system)));
    let confirmed = jobs
        .iter()
        .filter(|job| job.outcome == Some(Outcome::Unchanged))
        .map(|job| job.system.to_string())
        .collect();
    let waiting: Vec<String> =
        jobs.iter().filter(|job| job.waits).map(|job| job.system.to_string()).collect();
    let refused = refusals(&jobs);
    let doubtful = doubtful(service, reach).await?;
    let effects = matrix::summary(service, (reach, &SystemScope::ALL)).await?;
    let next = next_steps(&doubtful, &effects, &waiting, &refused);
    let entering = night.batches.iter().any(|batch| batch.entering);
    let batch = |batch: &BatchRecord| NightBatch {
        batch: batch.id.clone(),
        kind: batch.kind,
        schedule: batch.schedule.clone(),
        jobs: batch.jobs.len(),
        created_at: batch.created_at,
    };
    Ok(Some(NightReport {
        night: night.name,
        at,
        finished: !entering && jobs.iter().all(|job| job.state.is_final()),
        batches: night.batches.iter().map(batch).collect(),
        summary: summary(&jobs, &changed, &doubtful),
        skipped: skipped(&night.batches),
        changed,
        confirmed,
        refused,
        doubtful,
        next,
    }))
}

/// The policies of some systems, by name.
async fn policies(
    service: &Service,
    systems: Vec<SystemId>,
) -> Result<HashMap<String, Policy>, ServiceError> {
    let records = store::systems::some(&service.store, &SystemScope::ALL, &systems).await?;
    let read = |record: SystemRecord| Ok((record.system.to_string(), document(&record.document)?.policy));
    blocking(move || records.into_iter().map(read).collect::<Result<_, ServiceError>>()).await?
}

/// The systems whose parameters are not to be relied on now, degraded ones first.
async fn doubtful(service: &Service, reach: &SystemScope) -> Result<Vec<DoubtfulSystem>, ServiceError> {
    let found: Vec<(String, Status, Option<Timestamp>)> = service
        .params
        .all()
        .into_iter()
        .filter(|(name, _)| reach.is_all() || name.parse().is_ok_and(|system| reach.covers(&system)))
        .filter_map(|(name, entry)| {
            let rendered = entry.validated()?;
            let counts = matches!(rendered.status, Status::Degraded | Status::Stale);
            counts
                .then(|| (name, rendered.status, Served::of(rendered).and_then(|served| served.stale_after)))
        })
        .collect();
    let names: Vec<String> = found.iter().map(|(name, ..)| name.clone()).collect();
    let measured = store::measured::newest(&service.store, &names).await?;
    let known = names.iter().filter_map(|name| name.parse().ok()).collect();
    let policies = policies(service, known).await?;
    let now = service.now();
    let mut all: Vec<DoubtfulSystem> = found
        .into_iter()
        .map(|(system, status, since)| {
            let stale_after = policies.get(&system).map(|policy| policy.stale_after).unwrap_or_default();
            let measured = SampleAge { to: measured.get(&system).copied(), stale_after, now };
            doubt(system, status, since, &measured)
        })
        .collect();
    all.sort_by_key(|one| (one.status != Status::Degraded, !one.lost, Reverse(one.since)));
    Ok(all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_night_belongs_to_the_day_of_the_clock_of_the_service() {
        let (from, to) = bounds("2026-03-29".parse().unwrap(), "Europe/Copenhagen").unwrap();
        assert_eq!(to.duration_since(from).as_hours(), 23, "the day on which clocks go forward");
        assert_eq!(day_of(from, "Europe/Copenhagen"), "2026-03-29");
        assert_eq!(day_of("2026-01-31T23:30:00Z".parse().unwrap(), "Europe/Copenhagen"), "2026-02-01");
    }
}
