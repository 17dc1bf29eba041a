//! Bad requests for jobs.

use super::{Case, Mutation, as_json};
use crate::support::TestApp;
use serde_json::{Value, json};

fn one(
    area: &'static str,
    faults: &'static [(&'static str, &'static str)],
    apply: fn(&mut Value),
) -> Mutation<Value> {
    Mutation { area, hides: &[], faults, apply }
}

/// What only the measurements can tell is looked for when all else is right.
fn last(
    area: &'static str,
    faults: &'static [(&'static str, &'static str)],
    apply: fn(&mut Value),
) -> Mutation<Value> {
    Mutation { area, hides: &["*"], faults, apply }
}

fn good() -> Value {
    json!({
        "kind": "estimate", "system": "room/1", "experiment": true, "model": "rc2",
        "window": {"from": "2026-01-01T00:00:00Z", "to": "2026-01-13T00:00:00Z"},
        "split": {"train": "P8D", "validation": "P4D"}, "objective": "mse", "prior": "none",
        "method": {"name": "lm_multistart", "seed": 1, "starts": 10, "local": {"iterations": 50}},
        "budget": {"evaluations": 500, "wall": "PT1M"}, "bounds": {"alpha_e": [0.01, 5.0]},
        "fixed": {"beta_e": 4.0}, "start_from": "nominal",
    })
}

fn mutations() -> Vec<Mutation<Value>> {
    vec![
        one("field", &[("/modle", "unknown-field")], |j| j["modle"] = json!("rc2")),
        one("systems", &[("/systems", "unknown-field")], |j| j["systems"] = json!(["room/*"])),
        one("kind", &[("/kind", "unknown-value")], |j| j["kind"] = json!("estimat")),
        one("kind", &[("/kind", "wrong-type")], |j| j["kind"] = json!(1)),
        one("system", &[("/system", "invalid-value")], |j| j["system"] = json!("room 1")),
        one("system", &[("/system", "missing-field")], |j| {
            drop(j.as_object_mut().unwrap().shift_remove("system"))
        }),
        one("system", &[("/system", "system-not-found")], |j| j["system"] = json!("room/77")),
        one("system", &[("/system", "no-data")], |j| j["system"] = json!("room/3")),
        one("experiment", &[("/experiment", "wrong-type")], |j| j["experiment"] = json!("no")),
        one("objective", &[("/objective", "unknown-value")], |j| j["objective"] = json!("sme")),
        one("prior", &[("/prior", "unknown-value")], |j| j["prior"] = json!("uniform")),
        one("start", &[("/start_from", "unknown-value")], |j| j["start_from"] = json!("random")),
        one("window", &[("/window/from", "bad-time")], |j| {
            j["window"]["from"] = json!("2026-10-25T02:30:00")
        }),
        one("window", &[("/window/to", "out-of-order")], |j| {
            j["window"]["to"] = json!("2025-01-01T00:00:00Z")
        }),
        one("window", &[("/window/last", "invalid-value")], |j| j["window"]["last"] = json!("P1M")),
        one("window", &[("/window", "contradiction")], |j| j["window"]["last"] = json!("P7D")),
        one("window", &[("/window/since", "unknown-field")], |j| {
            j["window"]["since"] = json!("2026-01-01T00:00:00Z")
        }),
        one("window", &[("/window", "wrong-type")], |j| j["window"] = json!(["2026-01-01T00:00:00Z"])),
        one("train", &[("/split/train", "invalid-value")], |j| j["split"]["train"] = json!("-P7D")),
        one("train", &[("/split/train", "out-of-range")], |j| j["split"]["train"] = json!("PT0S")),
        one("validation", &[("/split/validation", "wrong-type")], |j| j["split"]["validation"] = json!(7)),
        one("split", &[("/split/tests", "unknown-field")], |j| j["split"]["tests"] = json!("P1D")),
        one("method name", &[("/method/name", "unknown-value")], |j| {
            j["method"] = json!({"name": "annealing"})
        }),
        one("method name", &[("/method/name", "wrong-type")], |j| j["method"]["name"] = json!(3)),
        one("method name", &[("/method", "wrong-type")], |j| j["method"] = json!("cfa")),
        one(
            "method name",
            &[
                ("/method/seed", "wrong-type"),
                ("/method/starts", "out-of-range"),
                ("/method/fireflies", "unknown-field"),
            ],
            |j| {
                j["method"] = json!({"name": "lm_multistart", "seed": "one", "starts": 0, "fireflies": 7});
            },
        ),
        one(
            "method name",
            &[("/method/local/trials", "out-of-range"), ("/method/local/iteration", "unknown-field")],
            |j| {
                j["method"] = json!({"local": {"trials": 1000, "iteration": 5}});
            },
        ),
        one("method name", &[("/method/seed", "invalid-value")], |j| j["method"]["seed"] = json!(-1)),
        one("evaluations", &[("/budget/evaluations", "out-of-range")], |j| {
            j["budget"]["evaluations"] = json!(0)
        }),
        one("evaluations", &[("/budget/evaluations", "invalid-value")], |j| {
            j["budget"]["evaluations"] = json!(-5)
        }),
        one("evaluations", &[("/budget/evaluations", "wrong-type")], |j| {
            j["budget"]["evaluations"] = json!(2.5)
        }),
        one("wall", &[("/budget/wall", "out-of-range")], |j| j["budget"]["wall"] = json!("PT0S")),
        one("walls", &[("/budget/walls", "unknown-field")], |j| j["budget"]["walls"] = json!("PT1M")),
        one("bounds e", &[("/bounds/alpha_e", "out-of-order")], |j| j["bounds"]["alpha_e"] = json!([5, 1])),
        one("bounds e", &[("/bounds/alpha_e", "wrong-type")], |j| j["bounds"]["alpha_e"] = json!([1])),
        one("bounds e", &[("/bounds/alpha_e", "wrong-type")], |j| {
            j["bounds"]["alpha_e"] = json!({"lower": 1})
        }),
        one("fixed", &[("/fixed/beta_e", "wrong-type")], |j| j["fixed"]["beta_e"] = json!("5")),
        // Which parameters there are is known where there is a system and a model.
        Mutation {
            area: "bounds x",
            hides: &["model", "system"],
            faults: &[("/bounds/alpha_x", "unknown-parameter")],
            apply: |j| j["bounds"]["alpha_x"] = json!([1, 2]),
        },
        Mutation {
            area: "bounds a",
            hides: &["model", "system"],
            faults: &[("/bounds/alpha_a", "bounds")],
            apply: |j| j["bounds"]["alpha_a"] = json!([0, 2]),
        },
        Mutation {
            area: "fixed x",
            hides: &["model", "system"],
            faults: &[("/fixed/gamma", "unknown-parameter")],
            apply: |j| j["fixed"]["gamma"] = json!(1),
        },
        Mutation {
            area: "model",
            hides: &["system"],
            faults: &[("/model", "unknown-model")],
            apply: |j| j["model"] = json!("rc3"),
        },
        Mutation {
            area: "model",
            hides: &["system"],
            faults: &[("/model", "unknown-effect")],
            apply: |j| j["model"] = json!("rc2+wind"),
        },
        Mutation {
            area: "model",
            hides: &["system"],
            faults: &[("/model", "invalid-value")],
            apply: |j| j["model"] = json!("rc2 + wind"),
        },
        last("data", &[("/window", "no-data-in-range")], |j| {
            j["window"] = json!({"from": "2027-01-01T00:00:00Z", "to": "2027-02-01T00:00:00Z"})
        }),
        last("data", &[("/window", "too-short")], |j| {
            j["window"] = json!({"from": "2026-01-02T00:00:00Z", "to": "2026-01-02T02:00:00Z"})
        }),
        last("data", &[("/window", "no-data-in-range")], |j| {
            j["window"] = json!({"from": "2026-01-02T00:00:00Z", "to": "2026-01-02T00:00:00Z"})
        }),
        last("data", &[("/window", "too-short")], |j| {
            j["system"] = json!("room/2");
            j["window"] = json!(null);
        }),
        last("data", &[("/model", "missing-channel")], |j| j["model"] = json!("rc2+wind_infiltration")),
    ]
}

fn good_batch() -> Value {
    json!({
        "kind": "recalibrate", "systems": ["room/1"], "split": {"train": "P8D", "validation": "P4D"},
        "budget": {"evaluations": 500}
    })
}

fn batch_mutations() -> Vec<Mutation<Value>> {
    vec![
        one("field", &[("/system", "unknown-field")], |j| j["system"] = json!("room/1")),
        one("model", &[("/model", "unknown-field")], |j| j["model"] = json!("rc2")),
        one("experiment", &[("/experiment", "unknown-field")], |j| j["experiment"] = json!(true)),
        one("systems", &[("/systems", "empty")], |j| j["systems"] = json!([])),
        one("systems", &[("/systems", "wrong-type")], |j| j["systems"] = json!("room/*")),
        one("systems", &[("/systems/1", "invalid-value")], |j| j["systems"] = json!(["room/1", "rooms"])),
        one("systems", &[("/systems", "missing-field")], |j| {
            drop(j.as_object_mut().unwrap().shift_remove("systems"))
        }),
        one("split", &[("/split/train", "invalid-value")], |j| j["split"]["train"] = json!("eight days")),
        one("budget", &[("/budget/evaluations", "out-of-range")], |j| {
            j["budget"]["evaluations"] = json!(1_000_000_000)
        }),
        one("window", &[("/window/from", "bad-time")], |j| {
            j["window"] = json!({"from": "1969-12-31T00:00:00Z"})
        }),
        one("method", &[("/method/alpha", "wrong-type")], |j| j["method"] = json!({"alpha": "half"})),
    ]
}

pub fn cases() -> Vec<Case> {
    let mut cases = super::cases(&good(), &mutations(), 90, 21, as_json("POST", "/jobs"));
    cases.extend(super::cases(&good_batch(), &batch_mutations(), 25, 22, as_json("POST", "/jobs")));
    cases
}

pub fn check_good(app: &TestApp) {
    for body in [good(), good_batch()] {
        app.json("POST", "/jobs", &body).expect(202);
    }
}
