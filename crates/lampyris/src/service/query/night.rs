//! What a night has come to: what changed, who was refused and why, who has turned stale, and what to do next.
//!
//! The batches of schedules say what was done; what is served, and what the data say of effects, is read as it
//! is now.

use super::matrix::{self, MatrixEffect};
use crate::service::catalogue::system::document;
use crate::service::error::ServiceError;
use crate::service::serving::body::Status;
use crate::service::serving::health::{Served, ahead};
use crate::service::state::Service;
use crate::store;
use crate::store::batches::{BatchKind, BatchMember, BatchRecord};
use crate::store::jobs::{JobStatus, Outcome};
use crate::store::reach::SystemScope;
use jiff::tz::TimeZone;
use jiff::{Timestamp, Zoned};
use lampyris_core::data::{Duration, SystemId};
use serde::Serialize;
use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap};
use utoipa::ToSchema;

/// Measurements that are older than this are lost, in hours.
const LOST_HOURS: i64 = 24;
/// Effects that are proposed at most.
const PROPOSED: usize = 3;
/// A mean saving below this is not worth a proposal, in the unit of the output.
const WORTHWHILE: f64 = 0.005;

/// What a night has come to.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct NightReport {
    /// The day on the clock of the service, or the batch that was asked for.
    pub night: String,
    /// When the first batch was submitted.
    #[schema(value_type = String, format = DateTime)]
    pub at: Timestamp,
    /// Whether all jobs have ended.
    pub finished: bool,
    /// What was done.
    pub batches: Vec<NightBatch>,
    /// The report in a sentence.
    pub summary: String,
    /// Systems that serve new parameters.
    pub changed: Vec<ChangedSystem>,
    /// Systems whose parameters were good already.
    pub confirmed: Vec<String>,
    /// Fits that are not served and jobs that failed, by reason, the most frequent first.
    pub refused: Vec<RefusalGroup>,
    /// Systems that were left out, by reason.
    pub skipped: Vec<SkippedGroup>,
    /// What is not to be relied on now: degraded systems, then stale ones.
    pub doubtful: Vec<DoubtfulSystem>,
    /// What to do, the most valuable first: what misleads a controller now, then what saves most.
    pub next: Vec<NextStep>,
}

/// A batch of a night.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct NightBatch {
    /// Its id.
    pub batch: String,
    /// What its jobs do.
    pub kind: BatchKind,
    /// The schedule that submitted it.
    pub schedule: Option<String>,
    /// How many jobs it has.
    pub jobs: usize,
    /// When it was submitted.
    #[schema(value_type = String, format = DateTime)]
    pub created_at: Timestamp,
}

/// A system that serves new parameters.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ChangedSystem {
    /// The system.
    pub system: String,
    /// The model that was fitted.
    pub model: String,
    /// The revision that the night has made.
    pub revision: Option<i64>,
    /// The fit behind it.
    pub fit: Option<String>,
    /// The horizon of the errors.
    #[schema(example = "PT6H")]
    pub horizon: Option<String>,
    /// The unit of the errors, of the first output.
    pub unit: Option<String>,
    /// The error of forecasts by the parameters before, on the same unseen data; `null` where there were none.
    pub before: Option<f64>,
    /// The same by the new ones.
    pub after: Option<f64>,
}

/// Systems that keep what they had, for one reason.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct RefusalGroup {
    /// The rule of the gate, or the code of a failure.
    #[schema(example = "G9 heating")]
    pub rule: String,
    /// `rejected` for good, `held` for an operator, or `failed` without a fit.
    #[schema(value_type = String, example = "held")]
    pub outcome: &'static str,
    /// Who.
    pub systems: Vec<String>,
    /// The reason of the first of them, in a sentence.
    pub why: String,
}

/// Systems that were left out, for one reason.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct SkippedGroup {
    /// A sentence.
    pub why: String,
    /// Who.
    pub systems: Vec<String>,
}

/// A system whose parameters are not to be relied on now.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct DoubtfulSystem {
    /// The system.
    pub system: String,
    /// `degraded` or `stale`.
    pub status: Status,
    /// Since when it is stale.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub since: Option<Timestamp>,
    /// The newest measurement; `null` where there is none.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub measured_to: Option<Timestamp>,
    /// Whether its measurements have stopped.
    pub lost: bool,
    /// In a sentence.
    pub why: String,
}

/// Something worth doing.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct NextStep {
    /// What to do, in a sentence.
    pub what: String,
    /// Whom it is about.
    pub systems: Vec<String>,
    /// Where on the page, as a path of this service.
    #[schema(example = "/ui/building?effect=wind_infiltration")]
    pub link: String,
}

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
pub async fn report(
    service: &Service,
    reach: &SystemScope,
    night: Night,
) -> Result<Option<NightReport>, ServiceError> {
    let Some(at) = night.batches.iter().map(|batch| batch.created_at).min() else { return Ok(None) };
    let jobs: Vec<&BatchMember> = night.batches.iter().flat_map(|batch| &batch.jobs).collect();
    let mut changed = Vec::new();
    for job in jobs.iter().filter(|job| job.outcome == Some(Outcome::Accepted)) {
        changed.push(changed_system(job, horizon(service, &job.system).await?));
    }
    changed.sort_by(|one, other| gain(other).total_cmp(&gain(one)).then(one.system.cmp(&other.system)));
    let confirmed = jobs
        .iter()
        .filter(|job| job.outcome == Some(Outcome::Unchanged))
        .map(|job| job.system.to_string())
        .collect();
    let waiting: Vec<String> = jobs
        .iter()
        .filter(|job| matches!(job.outcome, Some(Outcome::Held | Outcome::Suggested)))
        .map(|job| job.system.to_string())
        .collect();
    let refused = refusals(&jobs);
    let doubtful = doubtful(service, reach).await?;
    let effects = matrix::effects(service, (reach, &SystemScope::ALL)).await?;
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

/// The horizon of a system's policy.
async fn horizon(service: &Service, system: &SystemId) -> Result<Duration, ServiceError> {
    let record = store::systems::get(&service.store, system).await?;
    let known = record.map(|record| document(&record.document)).transpose()?;
    Ok(known.map(|document| document.policy.horizon).unwrap_or_default())
}

fn changed_system(job: &BatchMember, horizon: Duration) -> ChangedSystem {
    let error = job.served_error.as_ref().and_then(|errors| errors.values().next());
    // A model without a filter makes no forecasts: what counts is its free run.
    let known = error.and_then(|error| match ahead(error, horizon) {
        Some((name, rmse)) => Some((Some(name.to_owned()), rmse)),
        None => error.validation_rmse.map(|rmse| (None, rmse)),
    });
    let after = known.as_ref().map(|(_, rmse)| *rmse);
    ChangedSystem {
        system: job.system.to_string(),
        model: job.model.clone(),
        revision: job.revision,
        fit: job.fit.clone(),
        unit: error.map(|error| error.unit.clone()),
        horizon: known.and_then(|(name, _)| name),
        before: after.zip(job.error_ratio.filter(|ratio| *ratio > 0.0)).map(|(after, ratio)| after / ratio),
        after,
    }
}

/// By how much the error has fallen.
fn gain(changed: &ChangedSystem) -> f64 {
    changed.before.zip(changed.after).map_or(0.0, |(before, after)| before - after)
}

/// Fits that are not served and jobs that failed, by reason, the most frequent first.
fn refusals(jobs: &[&BatchMember]) -> Vec<RefusalGroup> {
    let mut groups: BTreeMap<(&'static str, String), RefusalGroup> = BTreeMap::new();
    for job in jobs {
        let Some((outcome, rule, why)) = refusal(job) else { continue };
        let group = groups.entry((outcome, rule.clone())).or_insert_with(|| RefusalGroup {
            rule,
            outcome,
            systems: Vec::new(),
            why,
        });
        group.systems.push(job.system.to_string());
    }
    let mut groups: Vec<RefusalGroup> = groups.into_values().collect();
    groups.sort_by_key(|group| Reverse(group.systems.len()));
    groups
}

/// How a job has left its system with what it had, by which rule, and why.
fn refusal(job: &BatchMember) -> Option<(&'static str, String, String)> {
    if let (JobStatus::Failed, Some(error)) = (job.state, &job.error) {
        return Some(("failed", error.code.clone(), error.detail.clone()));
    }
    let outcome = job.outcome.filter(|outcome| matches!(outcome, Outcome::Rejected | Outcome::Held))?;
    let said = job.summary.clone().unwrap_or_default();
    let (rule, why) = match &job.stopped {
        Some(check) => (check.rule.clone(), check.comment.clone()),
        None => (outcome.as_str().to_owned(), said),
    };
    Some((outcome.as_str(), rule, why))
}

fn skipped(batches: &[BatchRecord]) -> Vec<SkippedGroup> {
    let mut groups: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for one in batches.iter().flat_map(|batch| &batch.skipped) {
        let systems = groups.entry(&one.why).or_default();
        let name = one.system.to_string();
        if !systems.contains(&name) {
            systems.push(name);
        }
    }
    let mut groups: Vec<SkippedGroup> =
        groups.into_iter().map(|(why, systems)| SkippedGroup { why: why.to_owned(), systems }).collect();
    groups.sort_by_key(|group| Reverse(group.systems.len()));
    groups
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
            counts.then(|| (name, rendered.status, Served::of(rendered).and_then(|served| served.stale_after)))
        })
        .collect();
    let names: Vec<String> = found.iter().map(|(name, ..)| name.clone()).collect();
    let measured = store::measured::newest(&service.store, &names).await?;
    let now = service.now();
    let mut all: Vec<DoubtfulSystem> = found
        .into_iter()
        .map(|(system, status, since)| {
            let to = measured.get(&system).and_then(|millis| Timestamp::from_millisecond(*millis).ok());
            doubt(system, status, since, to, now)
        })
        .collect();
    all.sort_by_key(|one| (one.status != Status::Degraded, !one.lost, Reverse(one.since)));
    Ok(all)
}

fn doubt(
    system: String,
    status: Status,
    since: Option<Timestamp>,
    measured_to: Option<Timestamp>,
    now: Timestamp,
) -> DoubtfulSystem {
    let lost = measured_to.is_none_or(|to| now.duration_since(to).as_hours() >= LOST_HOURS);
    let minute = |at: Timestamp| at.strftime("%-d %B %Y %H:%M UTC");
    let why = match (status, lost, measured_to) {
        (Status::Degraded, ..) => {
            "The error on new measurements is far above that of the validation.".to_owned()
        }
        (_, true, Some(to)) => format!("Nothing was measured since {}.", minute(to)),
        (_, true, None) => "It has no measurements.".to_owned(),
        _ => "It is measured, and no fit was validated for longer than its policy wants.".to_owned(),
    };
    let since = since.filter(|_| status == Status::Stale);
    DoubtfulSystem { system, status, since, measured_to, lost: lost && status == Status::Stale, why }
}

/// The report in a sentence.
fn summary(jobs: &[&BatchMember], changed: &[ChangedSystem], doubtful: &[DoubtfulSystem]) -> String {
    let count = |wanted: &dyn Fn(&BatchMember) -> bool| jobs.iter().filter(|job| wanted(job)).count();
    let with = |outcome: Outcome| count(&move |job| job.outcome == Some(outcome));
    let known = [
        (with(Outcome::Accepted), "new parameters"),
        (with(Outcome::Unchanged), "good already"),
        (with(Outcome::Rejected), "refused"),
        (with(Outcome::Held) + with(Outcome::Suggested), "waiting for an operator's word"),
        (count(&|job| job.diagnosis.is_some()), "diagnosed"),
        (count(&|job| job.state == JobStatus::Failed), "failed"),
        (count(&|job| !job.state.is_final()), "not done yet"),
    ];
    let parts: Vec<String> =
        known.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}")).collect();
    let noun = if jobs.len() == 1 { "job" } else { "jobs" };
    let mut said = match parts.is_empty() {
        true => "Nothing was to be done.".to_owned(),
        false => format!("{} {noun}: {}.", jobs.len(), parts.join(", ")),
    };
    if let Some((before, after, unit, count)) = means(changed) {
        let of = if count == 1 { String::new() } else { format!(" in the mean of {count}") };
        said += &format!(" The error on the same unseen data went from {before:.2} to {after:.2} {unit}{of}.");
    }
    let of_status = |status| doubtful.iter().filter(|one| one.status == status).count();
    for (status, word) in [(Status::Degraded, "degraded"), (Status::Stale, "stale")] {
        match of_status(status) {
            0 => {}
            1 => said += &format!(" 1 system is {word}."),
            count => said += &format!(" {count} systems are {word}."),
        }
    }
    said
}

/// The mean errors before and after, of the unit that most have, and of how many.
fn means(changed: &[ChangedSystem]) -> Option<(f64, f64, &str, usize)> {
    let mut by_unit: HashMap<&str, Vec<(f64, f64)>> = HashMap::new();
    for one in changed {
        if let (Some(unit), Some(pair)) = (&one.unit, one.before.zip(one.after)) {
            by_unit.entry(unit).or_default().push(pair);
        }
    }
    let (unit, pairs) = by_unit.into_iter().max_by_key(|(unit, pairs)| (pairs.len(), Reverse(*unit)))?;
    let mean = |of: fn(&(f64, f64)) -> f64| pairs.iter().map(of).sum::<f64>() / pairs.len() as f64;
    Some((mean(|pair| pair.0), mean(|pair| pair.1), unit, pairs.len()))
}

/// What to do: what misleads a controller now, then what is not measured any more, then what saves most, then
/// what waits for a word, then what the gate has refused.
fn next_steps(
    doubtful: &[DoubtfulSystem],
    effects: &[MatrixEffect],
    waiting: &[String],
    refused: &[RefusalGroup],
) -> Vec<NextStep> {
    let names = |wanted: &dyn Fn(&DoubtfulSystem) -> bool| -> Vec<String> {
        doubtful.iter().filter(|one| wanted(one)).map(|one| one.system.clone()).collect()
    };
    let degraded = names(&|one| one.status == Status::Degraded);
    let lost = names(&|one| one.lost);
    let mut steps = Vec::new();
    if !degraded.is_empty() {
        let what = format!("Look at {}: its forecasts no longer fit what is measured.", counted(&degraded));
        steps.push(NextStep { what, link: place(&degraded, "fails", "/ui/?health=bad"), systems: degraded });
    }
    if !lost.is_empty() {
        let what = format!("Find out why {} sends no measurements.", counted(&lost));
        steps.push(NextStep { what, link: place(&lost, "data", "/ui/?health=attention"), systems: lost });
    }
    let worthwhile = |one: &&MatrixEffect| one.lacking > 0 && one.mean_saving.is_some_and(|s| s >= WORTHWHILE);
    for effect in effects.iter().filter(worthwhile).take(PROPOSED) {
        let what = format!("Add an effect: {}.", effect.sentence);
        let link = format!("/ui/building?effect={}", effect.effect);
        steps.push(NextStep { what, link, systems: Vec::new() });
    }
    if !waiting.is_empty() {
        let what = format!("Say yes or no to the fit of {}: the gate leaves it to you.", counted(waiting));
        let link = place(waiting, "parameters", "/ui/?health=attention");
        steps.push(NextStep { what, link, systems: waiting.to_vec() });
    }
    for group in refused.iter().filter(|group| group.outcome != Outcome::Held.as_str()) {
        let what = format!("Look at {}: {} ({}).", counted(&group.systems), group.why, group.rule);
        let link = place(&group.systems, "parameters", "/ui/?health=attention");
        steps.push(NextStep { what, link, systems: group.systems.clone() });
    }
    steps
}

/// One system by its name, several by their number.
fn counted(systems: &[String]) -> String {
    match systems {
        [one] => one.clone(),
        many => format!("each of {} systems", many.len()),
    }
}

/// The page of one system, or the list for several.
fn place(systems: &[String], tab: &str, list: &str) -> String {
    match systems {
        [one] => format!("/ui/systems/{one}/{tab}"),
        _ => list.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::batches::FailedCheck;
    use crate::store::jobs::JobFailure;

    fn job(system: &str, outcome: Option<Outcome>, stopped: Option<(&str, &str)>) -> BatchMember {
        let state = if outcome.is_some() { JobStatus::Succeeded } else { JobStatus::Failed };
        let failure = JobFailure { code: "diverged".into(), detail: "no numbers".into(), errors: Vec::new() };
        BatchMember {
            job: format!("job_{system}"),
            system: system.parse().unwrap(),
            state,
            outcome,
            fit: None,
            summary: Some("said".into()),
            error_ratio: Some(0.5),
            error: outcome.is_none().then_some(failure),
            diagnosis: None,
            model: "rc2".into(),
            revision: None,
            served_error: None,
            stopped: stopped.map(|(rule, comment)| FailedCheck { rule: rule.into(), comment: comment.into() }),
        }
    }

    #[test]
    fn reasons_are_grouped_by_rule_and_the_most_frequent_comes_first() {
        let all = [
            job("room/1", Some(Outcome::Accepted), None),
            job("room/2", Some(Outcome::Rejected), Some(("G4 beats persistence", "no better"))),
            job("room/3", Some(Outcome::Held), Some(("G9 heating", "T_forward does not drive T_room"))),
            job("room/4", Some(Outcome::Held), Some(("G9 heating", "another one's words"))),
            job("room/5", None, None),
            job("room/6", Some(Outcome::Unchanged), None),
        ];
        let jobs: Vec<&BatchMember> = all.iter().collect();
        let groups = refusals(&jobs);
        let told: Vec<_> =
            groups.iter().map(|group| (group.rule.as_str(), group.outcome, group.systems.len())).collect();
        assert_eq!(
            told,
            [("G9 heating", "held", 2), ("diverged", "failed", 1), ("G4 beats persistence", "rejected", 1)]
        );
        assert_eq!(groups[0].why, "T_forward does not drive T_room");
        let said = summary(&jobs, &[], &[]);
        assert_eq!(
            said,
            "6 jobs: 1 new parameters, 1 good already, 1 refused, 2 waiting for an operator's word, 1 failed."
        );
    }

    #[test]
    fn the_error_before_is_on_the_same_data_as_the_error_after() {
        let error = serde_json::json!({"T_room": {
            "unit": "K", "train_rmse": 0.2, "validation_rmse": 0.4, "ahead": {"PT1H": 0.1, "PT6H": 0.3}
        }});
        let served_error = serde_json::from_value(error).unwrap();
        let member = BatchMember { served_error, ..job("room/1", Some(Outcome::Accepted), None) };
        let changed = changed_system(&member, Duration::from_hours(12));
        assert_eq!((changed.horizon.as_deref(), changed.after), (Some("PT6H"), Some(0.3)));
        assert!((changed.before.unwrap() - 0.6).abs() < 1e-12);
        assert_eq!(means(&[changed]).map(|(.., unit, count)| (unit, count)), Some(("K", 1)));
    }

    #[test]
    fn what_misleads_a_controller_comes_before_what_saves() {
        let now: Timestamp = "2026-02-10T06:00:00Z".parse().unwrap();
        let day = |text: &str| text.parse::<Timestamp>().ok();
        let stale = doubt("room/1".into(), Status::Stale, day("2026-02-04T00:00:00Z"), day("2026-02-01T00:00:00Z"), now);
        assert!(stale.lost && stale.why == "Nothing was measured since 1 February 2026 00:00 UTC.", "{stale:?}");
        let unfitted = doubt("room/2".into(), Status::Stale, None, day("2026-02-10T05:00:00Z"), now);
        assert!(!unfitted.lost);
        let degraded = doubt("room/3".into(), Status::Degraded, None, None, now);
        let effect = MatrixEffect {
            effect: "wind_infiltration".into(),
            title: "Wind infiltration".into(),
            lacking: 2,
            in_model: 0,
            not_testable: 0,
            diagnosed: 3,
            mean_saving: Some(0.2),
            total_saving: Some(0.4),
            unit: Some("K".into()),
            sentence: "2 of 3 rooms lack wind infiltration".into(),
        };
        let steps = next_steps(&[degraded, stale, unfitted], &[effect], &["room/4".into(), "room/5".into()], &[]);
        let links: Vec<&str> = steps.iter().map(|step| step.link.as_str()).collect();
        assert_eq!(
            links,
            [
                "/ui/systems/room/3/fails",
                "/ui/systems/room/1/data",
                "/ui/building?effect=wind_infiltration",
                "/ui/?health=attention"
            ]
        );
    }

    #[test]
    fn a_night_belongs_to_the_day_of_the_clock_of_the_service() {
        let (from, to) = bounds("2026-03-29".parse().unwrap(), "Europe/Copenhagen").unwrap();
        assert_eq!(to.duration_since(from).as_hours(), 23, "the day on which clocks go forward");
        assert_eq!(day_of(from, "Europe/Copenhagen"), "2026-03-29");
        assert_eq!(day_of("2026-01-31T23:30:00Z".parse().unwrap(), "Europe/Copenhagen"), "2026-02-01");
    }
}
