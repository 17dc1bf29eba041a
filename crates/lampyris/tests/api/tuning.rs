//! Tuning: settings of the search, chosen on a system's own past, and what becomes of them.

use crate::support::TestApp;
use jiff::Timestamp;
use serde_json::{Value, json};

/// A tuning that takes seconds.
fn quick(system: &str, seed: u64) -> Value {
    json!({
        "kind": "tune", "system": system, "method": {"seed": seed}, "split": {"train": "P3D"},
        "budget": {"evaluations": 400}
    })
}

fn method(app: &TestApp, system: &str) -> Value {
    app.get(&format!("/systems/{system}")).expect(200).json()["method"].clone()
}

/// The method with which an estimate that names none would search.
fn method_of_an_estimate(app: &TestApp, system: &str, asked: Option<Value>) -> Value {
    let mut body =
        json!({"kind": "estimate", "system": system, "experiment": true, "budget": {"evaluations": 50}});
    if let Some(asked) = asked {
        body["method"] = asked;
    }
    let job = app.json("POST", "/jobs", &body).json();
    app.ended(job["id"].as_str().unwrap())["request"]["method"].clone()
}

#[test]
fn a_tuning_replaces_poor_settings_and_keeps_good_ones_with_a_reason() {
    let app = TestApp::start();
    app.room("4", 1);
    // A swarm that takes longer than the whole budget never comes to its local stage.
    let poor = json!({"name": "cfa", "seed": 0, "n": 100, "swarm": 5000});
    app.json("PUT", "/systems/room/4", &json!({"model": "rc2", "label": "Room 4", "method": poor}))
        .expect(200);
    let job = app.ended(&app.post_job(&quick("room/4", 1)));
    assert_eq!(
        (job["state"].as_str(), job["outcome"].as_str()),
        (Some("succeeded"), Some("accepted")),
        "{job}"
    );
    assert!(
        job["fit"].is_null() && job["stopped_by"].is_null() && job["evaluations"].as_i64().unwrap() > 1000,
        "{job}"
    );
    let tuning = &job["tuning"];
    assert_eq!(
        (tuning["better"].as_bool(), &tuning["before"]["swarm"]),
        (Some(true), &json!(5000)),
        "{tuning}"
    );
    assert_eq!(
        (tuning["windows"].as_array().unwrap().len(), tuning["unseen"].as_array().unwrap().len()),
        (2, 2),
        "{tuning}"
    );
    let at = |span: &Value, end: &str| span[end].as_str().unwrap().parse::<Timestamp>().unwrap();
    assert!(at(&tuning["windows"][1], "to") < at(&tuning["unseen"][0], "from"), "{tuning}");
    assert!(tuning["judged"]["ratio"].as_f64().unwrap() < 0.5, "{tuning}");
    assert_eq!(tuning["changes"]["swarm"][1], tuning["tuned"]["swarm"]);

    // They are the system's now, which is noted, and the next estimate searches with them. Nothing was
    // served.
    assert_eq!(method(&app, "room/4"), tuning["tuned"]);
    assert_eq!(app.get("/systems/room/4").json()["label"], "Room 4");
    let deed = &app.get("/audit?system=room/4").json()["items"][0];
    assert_eq!(
        (&deed["who"], deed["action"].as_str(), &deed["reason"]),
        (&job["id"], Some("put_system"), &tuning["summary"]),
        "{deed}"
    );
    assert_eq!(method_of_an_estimate(&app, "room/4", None), tuning["tuned"]);
    app.get("/params/room/4").problem(404, "no-validated-parameters");

    // The same again starts from them: whatever it finds, what it says is what it does.
    let job = app.ended(&app.post_job(&quick("room/4", 1)));
    let again = &job["tuning"];
    assert_eq!(again["before"], tuning["tuned"], "{job}");
    let (outcome, now) =
        if again["better"] == true { ("accepted", &again["tuned"]) } else { ("unchanged", &again["before"]) };
    assert_eq!((job["outcome"].as_str(), &method(&app, "room/4")), (Some(outcome), now), "{job}");
    assert!(again["better"] == true || again["summary"].as_str().unwrap().contains("stay"), "{job}");
}

#[test]
fn estimates_search_with_the_settings_of_their_system() {
    let app = TestApp::start();
    app.room("4", 1);
    let usual = method_of_an_estimate(&app, "room/4", None);
    assert_eq!((&usual["name"], &usual["n"], &usual["seed"]), (&json!("cfa"), &json!(40), &json!(0)));
    let document = json!({
        "model": "rc2", "policy": {"mode": "suggest"},
        "method": {"name": "cfa", "n": 20, "local": {"trials": 2}}
    });
    app.json("PUT", "/systems/room/4", &document).expect(200);
    let own = method_of_an_estimate(&app, "room/4", None);
    assert_eq!((&own["n"], &own["local"]["trials"]), (&json!(20), &json!(2)), "{own}");
    // A seed alone is no method; anything else is.
    let seeded = method_of_an_estimate(&app, "room/4", Some(json!({"seed": 9})));
    assert_eq!((&seeded["n"], &seeded["seed"]), (&json!(20), &json!(9)), "{seeded}");
    assert_eq!(method_of_an_estimate(&app, "room/4", Some(json!({"name": "cfa"})))["n"], 40);
    assert_eq!(method_of_an_estimate(&app, "room/4", Some(json!({"name": "pso"})))["name"], "pso");

    // A tuning starts from these settings, and here an operator decides about better ones.
    let job = app.ended(&app.post_job(&quick("room/4", 1)));
    assert_eq!(
        (&job["request"]["method"]["n"], &job["tuning"]["before"]["n"]),
        (&json!(20), &json!(20)),
        "{job}"
    );
    assert!(["suggested", "unchanged"].contains(&job["outcome"].as_str().unwrap()), "{job}");
    assert_eq!(method(&app, "room/4")["n"], 20);
}

#[test]
fn what_cannot_be_tuned_is_said_at_once() {
    let app = TestApp::start();
    app.room("4", 1);
    for method in ["pso", "ctsm"] {
        let problem = app
            .json("POST", "/jobs", &json!({"kind": "tune", "system": "room/4", "method": {"name": method}}))
            .problem(422, "invalid-request");
        assert_eq!(problem["errors"][0]["pointer"], "/method/name", "{problem}");
    }
    for (method, pointer) in [
        (json!({"name": "ctsm"}), "/method/name"),
        (json!({"n": 1}), "/method"),
        (json!({"wings": 4}), "/method"),
    ] {
        let problem = app
            .json("PUT", "/systems/room/4", &json!({"model": "rc2", "method": method}))
            .problem(422, "invalid-request");
        assert!(problem["errors"][0]["pointer"].as_str().unwrap().starts_with(pointer), "{problem}");
    }
    // A cancelled tuning has no result.
    let endless = json!({"agreement": {"confirmations": 1000, "patience": 1_000_000}});
    let job = app.post_job(&json!({
        "kind": "tune", "system": "room/4", "method": endless, "budget": {"evaluations": 10_000_000}
    }));
    app.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
    app.post(&format!("/jobs/{job}/cancel")).expect(200);
    let job = app.ended(&job);
    assert_eq!(
        (job["state"].as_str(), &job["outcome"], &job["tuning"]),
        (Some("cancelled"), &Value::Null, &Value::Null),
        "{job}"
    );
}
