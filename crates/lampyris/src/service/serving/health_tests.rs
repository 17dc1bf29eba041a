//! What decides how a system fares, one reason after another.

use super::health::{
    Facts, Health, NextCode, Served, SystemHealth, ahead, health_of, health_of_site, worst_output,
};
use crate::store::diagnoses::MissingEffect;
use crate::store::fits::ListedFit;
use crate::store::jobs::{Ended, FoundFit, JobFailure, JobKind, JobRecord, JobResult, JobState};
use crate::store::jobs::{Origin, Outcome, Priority};
use crate::store::overview::PresentDiagnosis;
use jiff::Timestamp;
use lampyris_core::data::{Duration, SystemId};
use lampyris_core::diagnose::Adequacy;
use lampyris_core::diagnose::report::EffectSize;
use serde_json::{Value, json};

/// A served set whose fields are changed so.
fn served(change: Value) -> Served {
    let mut body = json!({
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

/// The errors of an output: `rho`, and an hour ahead beside persistence.
fn output(rho: f64, rmse: f64, persistence: f64) -> Value {
    json!({
        "unit": "K", "train_rmse": 0.2, "validation_rmse": 0.3, "test_rmse": null,
        "ahead": {"PT1H": {"rmse": rmse, "persistence": persistence, "n": 100}},
        "day_ahead_mse": null, "noise_floor": 0.1, "rho": rho
    })
}

fn fit(metrics: Value) -> ListedFit {
    let train = json!({"from": "2026-01-01T00:00:00Z", "to": "2026-01-02T00:00:00Z"});
    let parts = json!({"train": train, "validation": null, "test": null});
    serde_json::from_value(json!({"metrics": metrics, "parts": parts})).unwrap()
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

fn running() -> JobState {
    JobState::Running { boot: 1, started_at: Timestamp::UNIX_EPOCH, cancelling: false }
}

fn room() -> SystemId {
    "room/4".parse().unwrap()
}

fn job(state: JobState) -> JobRecord {
    JobRecord {
        id: "job_2".into(),
        sequence: 2,
        kind: JobKind::Estimate,
        system: room(),
        model: "rc2".parse().unwrap(),
        request: Value::Null,
        experiment: false,
        origin: Origin::Posted,
        priority: Priority::Operator,
        created_at: Timestamp::UNIX_EPOCH,
        attempt: 1,
        retry_of: None,
        state,
    }
}

/// A room of which nothing is known, on the third of January.
fn facts(system: &SystemId) -> Facts<'_> {
    Facts {
        system,
        served: None,
        newest: None,
        waits: false,
        fit: None,
        diagnosis: None,
        measured_to: Some("2026-01-02T23:00:00Z".parse().unwrap()),
        stale_after: Duration::from_days(3),
        now: "2026-01-03T00:00:00Z".parse().unwrap(),
    }
}

fn of_served(change: Value) -> SystemHealth {
    health_of(&Facts { served: Some(&served(change)), ..facts(&room()) })
}

fn of_quality(metrics: Value, diagnosis: Option<&PresentDiagnosis>) -> SystemHealth {
    let (served, fit) = (served(json!({})), fit(metrics));
    health_of(&Facts { served: Some(&served), fit: Some(&fit), diagnosis, ..facts(&room()) })
}

#[test]
fn what_is_served_decides_first() {
    let word = |change: Value| {
        let SystemHealth { health, next, .. } = of_served(change);
        (health, next.code)
    };
    let reason = |reason: &str| json!({"reason": reason, "job": "job_2"});
    assert_eq!(word(json!({})), (Health::Ok, NextCode::None));
    assert_eq!(word(json!({"status": "pinned"})), (Health::Attention, NextCode::Unpin));
    assert_eq!(word(json!({"status": "degraded"})), (Health::Bad, NextCode::Refit));
    let fallen = of_served(json!({"status": "fallback", "fallback": reason("validation_failed")}));
    assert_eq!(
        (fallen.health, fallen.why.as_str(), fallen.next.href.as_str()),
        (
            Health::Attention,
            "The previous parameters are served: the newest fit was rejected.",
            "/ui/systems/room/4/parameters"
        )
    );
    let failed = of_served(json!({"status": "fallback", "fallback": reason("job_failed")}));
    assert_eq!((failed.next.code, failed.next.href.as_str()), (NextCode::Refit, "/ui/jobs/job_2"));
}

#[test]
fn flags_ask_for_a_look_where_somebody_can_do_something() {
    let word = |flags: Value| {
        let SystemHealth { health, next, .. } = of_served(json!({ "flags": flags }));
        (health, next.code)
    };
    let harmless =
        ["non_identifiable:beta_e", "undetermined:alpha_e", "unseen:wind_speed", "waived:G8 excited"];
    assert_eq!(word(json!(harmless)), (Health::Ok, NextCode::None));
    assert_eq!(word(json!(["at_bound:alpha_e"])), (Health::Attention, NextCode::Look));
    assert_eq!(word(json!(["low_confidence"])), (Health::Attention, NextCode::Refit));
    let unseen = of_served(json!({"flags": ["undetermined:k", "unseen:P_heater"]}));
    assert_eq!(
        (unseen.why.as_str(), unseen.next.text.as_str()),
        ("The gate has flagged the parameters: unseen:P_heater.", "Check the channel P_heater")
    );
}

#[test]
fn errors_decide_and_a_diagnosis_says_what_to_do() {
    let good = json!({"T_room": output(1.2, 0.1, 0.2)});
    let lost = json!({"T_room": output(1.2, 0.3, 0.2)});
    let noisy = json!({"T_room": output(4.0, 0.1, 0.2)});
    assert_eq!(of_quality(good.clone(), None).health, Health::Ok);
    let worse = of_quality(lost.clone(), None);
    assert_eq!((worse.health, worse.next.code), (Health::Attention, NextCode::Diagnose));
    assert!(
        worse.why.starts_with("1 h ahead, holding the last measurement of T_room errs less (0.20 K)"),
        "{worse:?}"
    );
    let far = of_quality(noisy.clone(), None);
    assert_eq!(
        far.why,
        "The error of T_room is 4.0 times what noise would leave, and nobody has looked for what its model \
        is missing."
    );
    let found = |verdict, missing| PresentDiagnosis { verdict, missing };
    let step = |metrics: &Value, verdict| of_quality(metrics.clone(), Some(&found(verdict, None))).next.code;
    assert_eq!(step(&noisy, Adequacy::Unknown), NextCode::Look);
    assert_eq!(step(&noisy, Adequacy::NotEnoughData), NextCode::Upload);
    // Nobody can do anything about noise.
    assert_eq!(step(&lost, Adequacy::Adequate), NextCode::None);
    assert_eq!(step(&good, Adequacy::Unknown), NextCode::None);
    let size = EffectSize { hours: 12.0, value: 0.35, ci95: None, unit: "K".into() };
    let wind = MissingEffect {
        effect: "wind_infiltration".into(),
        title: "Wind infiltration".into(),
        size: Some(size),
    };
    let named = of_quality(good, Some(&found(Adequacy::Named, Some(wind))));
    assert_eq!((named.health, named.next.code), (Health::Attention, NextCode::AddEffect));
    assert_eq!(
        (named.why.as_str(), named.next.text.as_str(), named.next.href.as_str()),
        (
            "Wind infiltration is missing. Left out, it puts forecasts over the next 12 h wrong by 0.35 K.",
            "Add wind infiltration",
            "/ui/systems/room/4/missing"
        )
    );
}

#[test]
fn the_worst_of_several_outputs_is_told() {
    let metrics =
        json!({"T_1": output(1.5, 0.1, 0.2), "T_2": output(6.0, 0.1, 0.2), "T_3": output(6.0, 0.1, 0.2)});
    let told = of_quality(metrics.clone(), None).why;
    assert!(told.starts_with("The error of T_2 is 6.0 times"), "{told}");
    assert_eq!(worst_output(&fit(metrics).metrics).unwrap().0, "T_2");
}

#[test]
fn age_is_no_fault_of_the_parameters() {
    let (system, stale) = (room(), served(json!({"status": "stale"})));
    let of = |measured_to: &str| {
        let measured_to = Some(measured_to.parse().unwrap());
        let now = "2026-01-20T00:00:00Z".parse().unwrap();
        health_of(&Facts { served: Some(&stale), measured_to, now, ..facts(&system) })
    };
    let silent = of("2026-01-12T08:00:00Z");
    assert_eq!((silent.health, silent.next.code), (Health::Attention, NextCode::Upload));
    assert_eq!(silent.why, "No new measurements since 12 Jan 2026.");
    let idle = of("2026-01-19T23:00:00Z");
    assert_eq!(
        (idle.why.as_str(), idle.next.code),
        ("It was last validated on 2 Jan 2026, and there are newer measurements.", NextCode::Refit)
    );
    let site = health_of_site(&Facts { measured_to: None, ..facts(&system) });
    assert_eq!((site.health, site.next.code), (Health::Ok, NextCode::None));
}

#[test]
fn the_newest_job_decides_where_nothing_is_served() {
    let system = room();
    let of = |newest: Option<&JobRecord>| {
        let SystemHealth { health, next, .. } = health_of(&Facts { newest, ..facts(&system) });
        (health, next.code)
    };
    let word = |state| of(Some(&job(state)));
    assert_eq!(of(None), (Health::Unknown, NextCode::Refit));
    let empty = health_of(&Facts { measured_to: None, ..facts(&system) });
    assert_eq!(empty.next.code, NextCode::Upload);
    assert_eq!(word(running()), (Health::Unknown, NextCode::Wait));
    assert_eq!(word(failed()), (Health::Bad, NextCode::Look));
    assert_eq!(word(succeeded(Outcome::Rejected)), (Health::Bad, NextCode::Look));
    // Also where an experiment came behind it.
    let held = job(succeeded(Outcome::Held));
    for newest in [held.clone(), JobRecord { experiment: true, ..held }] {
        let waits = |waits| health_of(&Facts { newest: Some(&newest), waits, ..facts(&system) }).next.code;
        assert_eq!((waits(true), waits(false)), (NextCode::Promote, NextCode::Refit), "until it is decided");
    }
    let experiment = JobRecord { experiment: true, ..job(failed()) };
    assert_eq!(of(Some(&experiment)).0, Health::Unknown);
}

#[test]
fn a_job_that_waits_or_runs_is_waited_for() {
    let (system, served) = (room(), served(json!({"status": "degraded"})));
    let newest = job(running());
    let refitted = health_of(&Facts { served: Some(&served), newest: Some(&newest), ..facts(&system) });
    assert_eq!((refitted.health, refitted.next.code), (Health::Bad, NextCode::Wait));
    assert_eq!(refitted.next.href, "/ui/jobs/job_2");
    let diagnosed = JobRecord { kind: JobKind::Diagnose, ..newest };
    let other = health_of(&Facts { served: Some(&served), newest: Some(&diagnosed), ..facts(&system) });
    assert_eq!(other.next.code, NextCode::Refit);
}

#[test]
fn a_fit_that_waits_shows_until_somebody_has_decided() {
    let (system, served) = (room(), served(json!({})));
    let newest = job(succeeded(Outcome::Suggested));
    let of = |waits| {
        let facts = Facts { served: Some(&served), newest: Some(&newest), waits, ..facts(&system) };
        health_of(&facts).next.code
    };
    assert_eq!((of(true), of(false)), (NextCode::Promote, NextCode::None));
}

#[test]
fn the_horizon_of_the_policy_is_met_from_below() {
    let served = served(json!({}));
    let at = |hours| ahead(&served.error["T_room"].ahead, Duration::from_hours(hours)).unwrap();
    assert_eq!((at(6), at(12), at(48)), (("PT6H", &0.2), ("PT6H", &0.2), ("PT24H", &0.3)));
    assert_eq!(ahead(&served.error["T_room"].ahead, Duration::from_seconds(60)), Some(("PT1H", &0.1)));
}
