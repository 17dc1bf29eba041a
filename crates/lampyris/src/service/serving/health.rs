//! How a system fares, in a word and a sentence: what a list of systems is for.
//!
//! It is read off the body that `/params` serves, so that the two cannot disagree, and off the newest job.

use super::body::Rendered;
use crate::store::jobs::{JobRecord, JobState, Outcome};
use indexmap::IndexMap;
use jiff::Timestamp;
use lampyris_core::data::Duration;
use lampyris_core::estimate::gate::served::ServedError;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A flag about single parameters that takes nothing from the forecasts.
const HARMLESS: [&str; 2] = ["non_identifiable:", "undetermined:"];

/// What is wrong with a system whose parameters are stale.
const OLD: &str = "The parameters, or the measurements behind them, are older than the policy wants";

/// How a system fares.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Health {
    /// Nothing to do.
    Ok,
    /// Somebody should look at it in daylight.
    Attention,
    /// What is served is not to be relied on, or nothing can be served.
    Bad,
    /// Nothing was ever validated, and nothing has failed yet.
    Unknown,
}

/// What the list says of what is served.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct Served {
    status: String,
    job: Option<String>,
    fallback: Option<FallbackReason>,
    /// What the gate wants said.
    pub flags: Vec<String>,
    /// Errors by output.
    pub error: IndexMap<String, ServedError>,
    /// When it was found.
    pub fitted_at: Option<Timestamp>,
    /// When the gate last found it fit to be served.
    pub validated_at: Option<Timestamp>,
    /// When it turns stale.
    pub stale_after: Option<Timestamp>,
}

#[derive(Debug, Clone, PartialEq, Deserialize)]
struct FallbackReason {
    reason: String,
}

impl Served {
    /// Reads the body that is served; nothing where it cannot be read.
    pub fn of(rendered: &Rendered) -> Option<Self> {
        serde_json::from_slice(&rendered.body).ok()
    }
}

/// The forecast error at a horizon, or at the longest one below it that is known; else at the shortest.
pub fn ahead(error: &ServedError, horizon: Duration) -> Option<(&str, f64)> {
    let known = || {
        error
            .ahead
            .iter()
            .filter_map(|(name, rmse)| Some((name.parse::<Duration>().ok()?, name.as_str(), *rmse)))
    };
    let below = known().filter(|(length, ..)| *length <= horizon).max_by_key(|(length, ..)| *length);
    below.or_else(|| known().min_by_key(|(length, ..)| *length)).map(|(_, name, rmse)| (name, rmse))
}

/// How a system fares, and why.
pub fn health(served: Option<&Served>, newest: Option<&JobRecord>) -> (Health, String) {
    // An experiment says nothing about what is served.
    let newest = newest.filter(|job| !job.experiment);
    let Some(served) = served else {
        return never_validated(newest);
    };
    let waits = newest
        .filter(|job| served.job.as_ref() != Some(&job.id))
        .is_some_and(|job| matches!(job.state.outcome(), Some(Outcome::Held | Outcome::Suggested)));
    let failure = served.fallback.as_ref().map(|fallback| match fallback.reason.as_str() {
        "validation_failed" => "the newest fit was rejected",
        _ => "the newest job failed",
    });
    let asks = |flag: &&str| !HARMLESS.iter().any(|harmless| flag.starts_with(harmless));
    let flags: Vec<&str> = served.flags.iter().map(String::as_str).filter(asks).collect();
    match (served.status.as_str(), failure) {
        ("degraded", _) => {
            (Health::Bad, "The error on new measurements is far above that of the validation.".to_owned())
        }
        ("stale", Some(failure)) => (Health::Bad, format!("{OLD}, and {failure}.")),
        ("stale", None) => (Health::Attention, format!("{OLD}.")),
        ("pinned", _) => (Health::Attention, "An operator holds the parameters.".to_owned()),
        (_, Some(failure)) => (Health::Attention, format!("The previous parameters are served: {failure}.")),
        (_, None) if waits => (Health::Attention, "A fit waits for an operator.".to_owned()),
        (_, None) if !flags.is_empty() => {
            (Health::Attention, format!("The gate has flagged the parameters: {}.", flags.join(", ")))
        }
        (_, None) => (Health::Ok, "The parameters are fresh.".to_owned()),
    }
}

fn never_validated(newest: Option<&JobRecord>) -> (Health, String) {
    let Some(job) = newest else {
        return (Health::Unknown, "Nothing was estimated yet.".to_owned());
    };
    let (health, why) = match &job.state {
        JobState::Queued { .. } | JobState::Running { .. } => {
            (Health::Unknown, "the newest job has not ended")
        }
        JobState::Cancelled { .. } => (Health::Unknown, "the newest job was cancelled"),
        JobState::Failed { .. } => (Health::Bad, "the newest job failed"),
        JobState::Succeeded { result, .. } => match result.outcome() {
            Some(Outcome::Held | Outcome::Suggested) => (Health::Attention, "a fit waits for an operator"),
            Some(Outcome::Rejected) => (Health::Bad, "the newest fit was rejected"),
            _ => (Health::Unknown, "the newest fit does not count for what is served"),
        },
    };
    (health, format!("No fit was ever accepted, and {why}."))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::store::jobs::{Ended, FoundFit, JobFailure, JobKind, JobResult, Origin, Priority};

    fn served(change: serde_json::Value) -> Served {
        let mut body = serde_json::json!({
            "system": "room/4", "status": "fresh", "job": "job_1", "fallback": null, "flags": [],
            "fitted_at": "2026-01-01T00:00:00Z",
            "validated_at": "2026-01-02T00:00:00Z", "stale_after": null,
            "error": {"T_room": {
                "unit": "K", "train_rmse": 0.2, "validation_rmse": 0.3,
                "ahead": {"PT1H": 0.1, "PT6H": 0.2, "PT24H": 0.3}
            }},
        });
        body.as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
        serde_json::from_value(body).unwrap()
    }

    const ENDED: Ended = Ended { started_at: None, at: Timestamp::UNIX_EPOCH, sequence: None };

    fn failed() -> JobState {
        let failure = JobFailure { code: "panic".into(), detail: String::new(), errors: Vec::new() };
        JobState::Failed { failure, ended: ENDED }
    }

    fn succeeded(outcome: Outcome) -> JobState {
        let (id, stopped_by) = ("fit_2".into(), "budget".into());
        let found = FoundFit { id, revision: None, stopped_by, evaluations: 600 };
        JobState::Succeeded { result: JobResult::Estimated { outcome, found }, ended: ENDED }
    }

    fn job(state: JobState) -> JobRecord {
        JobRecord {
            id: "job_2".into(),
            sequence: 2,
            kind: JobKind::Estimate,
            system: "room/4".parse().unwrap(),
            model: "rc2".parse().unwrap(),
            request: serde_json::Value::Null,
            experiment: false,
            origin: Origin::Posted,
            priority: Priority::Operator,
            created_at: Timestamp::UNIX_EPOCH,
            attempt: 1,
            retry_of: None,
            state,
        }
    }

    #[test]
    fn what_is_served_decides_first() {
        let word = |change: serde_json::Value| health(Some(&served(change)), None).0;
        let reason = |reason: &str| serde_json::json!({"reason": reason, "job": "job_2"});
        assert_eq!(word(serde_json::json!({})), Health::Ok);
        let harmless = serde_json::json!({"flags": ["non_identifiable:beta_e", "undetermined:alpha_e"]});
        assert_eq!(word(harmless), Health::Ok);
        assert_eq!(word(serde_json::json!({"flags": ["at_bound:alpha_e"]})), Health::Attention);
        assert_eq!(word(serde_json::json!({"status": "stale"})), Health::Attention);
        assert_eq!(word(serde_json::json!({"status": "pinned"})), Health::Attention);
        assert_eq!(word(serde_json::json!({"status": "degraded"})), Health::Bad);
        assert_eq!(
            word(serde_json::json!({"status": "stale", "fallback": reason("job_failed")})),
            Health::Bad
        );
        let (word, why) = health(
            Some(&served(serde_json::json!({"status": "fallback", "fallback": reason("validation_failed")}))),
            None,
        );
        assert_eq!(
            (word, why.as_str()),
            (Health::Attention, "The previous parameters are served: the newest fit was rejected.")
        );
    }

    #[test]
    fn the_newest_job_decides_where_nothing_is_served() {
        let running = JobState::Running { boot: 1, started_at: Timestamp::UNIX_EPOCH, cancelling: false };
        let word = |state| health(None, Some(&job(state))).0;
        assert_eq!(health(None, None).0, Health::Unknown);
        assert_eq!(word(running), Health::Unknown);
        assert_eq!(word(failed()), Health::Bad);
        assert_eq!(word(succeeded(Outcome::Rejected)), Health::Bad);
        assert_eq!(word(succeeded(Outcome::Held)), Health::Attention);
        let experiment = JobRecord { experiment: true, ..job(failed()) };
        assert_eq!(health(None, Some(&experiment)).0, Health::Unknown);
        // A fit that waits shows beside a fresh set, unless it is the very one that is served.
        let waiting = job(succeeded(Outcome::Suggested));
        assert_eq!(health(Some(&served(serde_json::json!({}))), Some(&waiting)).0, Health::Attention);
        assert_eq!(health(Some(&served(serde_json::json!({"job": "job_2"}))), Some(&waiting)).0, Health::Ok);
    }

    #[test]
    fn the_horizon_of_the_policy_is_met_from_below() {
        let served = served(serde_json::json!({}));
        let at = |hours| ahead(&served.error["T_room"], Duration::from_hours(hours)).unwrap();
        assert_eq!((at(6), at(12), at(48)), (("PT6H", 0.2), ("PT6H", 0.2), ("PT24H", 0.3)));
        assert_eq!(ahead(&served.error["T_room"], Duration::from_seconds(60)), Some(("PT1H", 0.1)));
    }
}
