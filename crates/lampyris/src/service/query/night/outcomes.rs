//! What the jobs of a night have come to: who has new parameters, who was refused by which rule, who was left
//! out, and all of it in a sentence.

use super::report::{ChangedSystem, DoubtfulSystem, RefusalGroup, SkippedGroup};
use crate::service::serving::body::Status;
use crate::service::serving::health::ahead;
use crate::store::batches::{BatchMember, BatchRecord};
use crate::store::jobs::{JobStatus, Outcome};
use lampyris_core::data::Duration;
use std::cmp::Reverse;
use std::collections::{BTreeMap, HashMap};

/// A system that serves new parameters, with its errors at a horizon.
pub(super) fn changed_system(job: &BatchMember, horizon: Duration) -> ChangedSystem {
    let error = job.served_error.as_ref().and_then(|errors| errors.values().next());
    // A model without a filter makes no forecasts: what counts is its free run.
    let known = error.and_then(|error| match ahead(&error.ahead, horizon) {
        Some((name, rmse)) => Some((Some(name.to_owned()), *rmse)),
        None => error.validation_rmse.map(|rmse| (None, rmse)),
    });
    let after = known.as_ref().map(|(_, rmse)| *rmse);
    // The gate has compared at the horizon itself, and of several outputs all together.
    let outputs = job.served_error.as_ref().map_or(0, |errors| errors.len());
    let is_same = outputs == 1
        && match known.as_ref().and_then(|(name, _)| name.as_ref()) {
            Some(name) => name.parse() == Ok(horizon),
            None => true,
        };
    let ratio = job.error_ratio.filter(|ratio| is_same && *ratio > 0.0);
    ChangedSystem {
        system: job.system.to_string(),
        model: job.model.clone(),
        revision: job.revision,
        fit: job.fit.clone(),
        unit: error.map(|error| error.unit.clone()),
        horizon: known.and_then(|(name, _)| name),
        before: after.zip(ratio).map(|(after, ratio)| after / ratio),
        after,
    }
}

/// By how much the error has fallen.
pub(super) fn gain(changed: &ChangedSystem) -> f64 {
    changed.before.zip(changed.after).map_or(0.0, |(before, after)| before - after)
}

/// Fits that are not served and jobs that failed, by reason, the most frequent first.
pub(super) fn refusals(jobs: &[&BatchMember]) -> Vec<RefusalGroup> {
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

pub(super) fn skipped(batches: &[BatchRecord]) -> Vec<SkippedGroup> {
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

/// The report in a sentence.
pub(super) fn summary(
    jobs: &[&BatchMember],
    changed: &[ChangedSystem],
    doubtful: &[DoubtfulSystem],
) -> String {
    let count = |wanted: &dyn Fn(&BatchMember) -> bool| jobs.iter().filter(|job| wanted(job)).count();
    let with = |outcome: Outcome| count(&move |job| job.outcome == Some(outcome));
    let known = [
        (with(Outcome::Accepted), "new parameters"),
        (with(Outcome::Unchanged), "good already"),
        (with(Outcome::Rejected), "refused"),
        (with(Outcome::Held) + with(Outcome::Suggested), "waiting for an operator's word"),
        (count(&|job| job.diagnosis.is_some()), "diagnosed"),
        (count(&|job| job.state == JobStatus::Failed), "failed"),
        (count(&|job| job.state == JobStatus::Cancelled), "called off"),
        (count(&|job| !job.state.is_final()), "not done yet"),
    ];
    let parts: Vec<String> =
        known.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}")).collect();
    let noun = if jobs.len() == 1 { "job" } else { "jobs" };
    let mut said = match jobs.is_empty() {
        true => "Nothing was to be done.".to_owned(),
        false => format!("{} {noun}: {}.", jobs.len(), parts.join(", ")),
    };
    if let Some((before, after, unit, count)) = means(changed) {
        let of = if count == 1 { String::new() } else { format!(" in the mean of {count}") };
        said +=
            &format!(" The error on the same unseen data went from {before:.2} to {after:.2} {unit}{of}.");
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
            waits: outcome == Some(Outcome::Held),
            summary: Some("said".into()),
            error_ratio: Some(0.5),
            error: outcome.is_none().then_some(failure),
            diagnosis: None,
            model: "rc2".into(),
            revision: None,
            served_error: None,
            stopped: stopped
                .map(|(rule, comment)| FailedCheck { rule: rule.into(), comment: comment.into() }),
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
        let between = changed_system(&member, Duration::from_hours(12));
        assert_eq!((between.horizon.as_deref(), between.after), (Some("PT6H"), Some(0.3)));
        assert_eq!(between.before, None, "the gate has compared 12 h ahead, and that is not told");
        let changed = changed_system(&member, Duration::from_hours(6));
        assert!((changed.before.unwrap() - 0.6).abs() < 1e-12);
        assert_eq!(means(&[changed]).map(|(.., unit, count)| (unit, count)), Some(("K", 1)));
    }
}
