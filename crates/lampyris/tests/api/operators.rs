//! What operators decide, and what newer measurements say of what is served.

use crate::support::TestApp;
use crate::support::rooms::{csv_of, room, room_that_changes};
use serde_json::{Value, json};

fn params(app: &TestApp) -> Value {
    app.get("/params/room/1").expect(200).json()
}

/// A room whose heat loss is six times as large from the given day on: as if a window stood open.
fn leaky(days: usize, from: usize) -> Vec<(String, f64, f64)> {
    room_that_changes(1, days, |day| if day < from { 0.15 } else { 0.9 })
}

fn history(app: &TestApp) -> Vec<Value> {
    app.get("/params/room/1/history").expect(200).json()["items"].as_array().unwrap().clone()
}

#[test]
fn a_suggested_fit_is_served_on_an_operators_word() {
    let app = TestApp::start();
    app.room("1", 1);
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "policy": {"mode": "suggest"}})).expect(200);
    let job = app.ended(&app.estimate("room/1", json!({})));
    assert_eq!(job["outcome"], "suggested", "{job}");
    let fit = job["fit"].as_str().unwrap();
    assert_eq!(app.get(&format!("/fits/{fit}")).json()["waits_for_operator"], true);

    let promote = format!("/fits/{fit}/promote");
    let faults = app.json("POST", &promote, &json!({"why": "x"})).problem(422, "invalid-request");
    let pointers: Vec<&str> =
        faults["errors"].as_array().unwrap().iter().map(|fault| fault["pointer"].as_str().unwrap()).collect();
    assert!(pointers.contains(&"/why") && faults["errors"].to_string().contains("reason"), "{faults}");
    app.json("POST", &promote, &json!({"reason": " "})).problem(422, "invalid-request");
    app.get("/params/room/1").problem(404, "no-validated-parameters");
    app.json("POST", "/fits/fit_none/promote", &json!({"reason": "x"})).problem(404, "fit-not-found");

    let key = [("idempotency-key", "promote")];
    for _ in 0..2 {
        let reason = json!({"reason": "looks right"});
        let promoted = app.json_with("POST", &promote, &key, &reason).expect(200).json();
        assert_eq!(
            (&promoted["decision"]["decision"], &promoted["waits_for_operator"]),
            (&json!("promoted"), &json!(false))
        );
    }
    let served = params(&app);
    assert_eq!(
        (served["fit"].as_str(), served["revision"].as_i64(), served["status"].as_str()),
        (Some(fit), Some(1), Some("fresh"))
    );
    let reject = format!("/fits/{fit}/reject");
    app.json("POST", &reject, &json!({"reason": "no"})).problem(409, "already-decided");
    app.json_with("POST", &reject, &key, &json!({"reason": "no"})).problem(422, "idempotency-key-reused");
    let past = history(&app);
    assert_eq!(
        (past.len(), &past[0]["cause"], &past[0]["reason"]),
        (1, &json!("promoted"), &json!("looks right"))
    );
    assert!(app.get("/systems/room/1/state").expect(200).json()["states"]["T_e"].is_number());
}

#[test]
fn a_search_that_somebody_has_narrowed_waits_for_an_operators_word() {
    let app = TestApp::start();
    app.room("1", 1);
    app.ended(&app.estimate("room/1", json!({})));
    for narrowed in [json!({"bounds": {"alpha_a": [0.1, 0.3]}}), json!({"fixed": {"alpha_a": 0.151}})] {
        let job = app.ended(&app.estimate("room/1", narrowed));
        let fit = app.get(&format!("/fits/{}", job["fit"].as_str().unwrap())).json();
        assert_eq!(
            (&job["outcome"], &fit["verdict"]),
            (&json!("suggested"), &json!("accepted")),
            "{}",
            fit["summary"]
        );
        assert!(
            fit["summary"].as_str().unwrap().ends_with("values of its own: it waits for an operator's word"),
            "{}",
            fit["summary"]
        );
        assert_eq!((params(&app)["revision"].as_i64(), &fit["waits_for_operator"]), (Some(1), &json!(true)));
    }
    // What is known of the room itself narrows every search of it, and publishes as usual.
    let bad =
        json!({"model": "rc2", "bounds": {"alpha_x": [1, 2], "alpha_a": [0.3, 0.1]}, "fixed": {"beta_x": 1}});
    let faults = app.json("PUT", "/systems/room/1", &bad).problem(422, "invalid-request");
    let pointers: Vec<&str> =
        faults["errors"].as_array().unwrap().iter().map(|fault| fault["pointer"].as_str().unwrap()).collect();
    assert_eq!(pointers, ["/bounds/alpha_x", "/fixed/beta_x", "/bounds/alpha_a"], "{faults}");
    app.json(
        "PUT",
        "/systems/room/1",
        &json!({"model": "rc2", "bounds": {"alpha_a": [0.1, 0.3]}, "fixed": {"beta_e": 4.0}}),
    )
    .expect(200);
    let own = app.ended(&app.estimate("room/1", json!({"start_from": "nominal"})));
    assert!(["accepted", "unchanged"].contains(&own["outcome"].as_str().unwrap()), "{own}");
    let asked = &own["request"];
    assert_eq!(
        (&asked["bounds"], &asked["fixed"]),
        (&json!({"alpha_a": [0.1, 0.3]}), &json!({"beta_e": 4.0})),
        "{asked}"
    );
    // Another model has other parameters.
    let other = app.ended(&app.estimate("room/1", json!({"model": "rc1", "experiment": true})));
    assert_eq!((&other["state"], &other["request"]["bounds"]), (&json!("succeeded"), &json!({})), "{other}");
}

#[test]
fn what_an_operator_or_the_gate_has_rejected_stays_so() {
    let app = TestApp::start();
    app.room("1", 1);
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "policy": {"mode": "suggest"}})).expect(200);
    let suggested = app.ended(&app.estimate("room/1", json!({})));
    let fit = suggested["fit"].as_str().unwrap();
    let step = || app.get("/systems").json()["items"][0]["next"]["code"].clone();
    assert_eq!(step(), "promote");
    app.json("POST", &format!("/fits/{fit}/reject"), &json!({"reason": "summer settings"})).expect(200);
    assert_ne!(step(), "promote", "nothing waits any more");
    app.json("POST", &format!("/fits/{fit}/promote"), &json!({"reason": "after all"}))
        .problem(409, "already-decided");

    let hopeless = app.ended(&app.estimate("room/1", json!({"fixed": {"alpha_a": 14.0, "alpha_e": 14.0}})));
    assert_eq!(hopeless["outcome"], "rejected", "{hopeless}");
    let refused = app.json(
        "POST",
        &format!("/fits/{}/promote", hopeless["fit"].as_str().unwrap()),
        &json!({"reason": "please"}),
    );
    assert!(refused.problem(409, "not-offered")["detail"].as_str().unwrap().contains("nobody"));

    let experiment = app.ended(&app.estimate("room/1", json!({"experiment": true})));
    app.json(
        "POST",
        &format!("/fits/{}/promote", experiment["fit"].as_str().unwrap()),
        &json!({"reason": "x"}),
    )
    .problem(409, "not-offered");
    app.get("/params/room/1").problem(404, "no-validated-parameters");
}

#[test]
fn a_held_fit_waits_and_is_flagged_when_it_is_let_out() {
    let app = TestApp::with(|_| {});
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "policy": {"refit_when_degraded": false}}))
        .expect(201);
    app.csv("/systems/room/1/windows", &csv_of(&room(1, 14))).expect(201);
    app.ended(&app.estimate("room/1", json!({})));
    let before = params(&app);
    // The same weather, a room that loses six times as much: the fit is good, and far from what is served.
    app.csv("/systems/room/1/windows", &csv_of(&leaky(14, 0))).expect(201);
    let held = app.ended(&app.estimate("room/1", json!({})));
    assert_eq!(
        held["outcome"],
        "held",
        "{}",
        app.get(&format!("/fits/{}", held["fit"].as_str().unwrap())).text
    );
    assert_eq!(params(&app)["parameters"], before["parameters"]);
    let fit = held["fit"].as_str().unwrap();
    app.json("POST", &format!("/fits/{fit}/promote"), &json!({"reason": "the window frames were taken out"}))
        .expect(200);
    let after = params(&app);
    assert_eq!((after["fit"].as_str(), after["revision"].as_i64()), (Some(fit), Some(2)));
    assert!(after["flags"].as_array().unwrap().contains(&json!("promoted_by_operator")), "{after}");
}

#[test]
fn a_pin_rolls_back_under_a_new_number_and_holds() {
    let app = TestApp::at("2026-01-24T00:00:00Z", |_| {});
    app.room("1", 1);
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "policy": {"stale_after": "P30D"}}))
        .expect(200);
    app.json("PUT", "/params/room/1/pin", &json!({"reason": "x"})).problem(409, "never-served");
    app.json("PUT", "/params/room/2/pin", &json!({"reason": "x"})).problem(404, "system-not-found");
    app.ended(&app.estimate("room/1", json!({})));
    let first = params(&app);
    // A week later the room is known better.
    app.csv("/systems/room/1/windows", &csv_of(&room(1, 21))).expect(201);
    app.ended(&app.estimate("room/1", json!({"split": {"train": "P14D", "validation": "P7D"}})));
    let second = params(&app);
    assert_eq!(second["revision"], 2, "{second}");

    let body = json!({"fit": first["fit"], "reason": "the controller swings"});
    let pinned = app.json("PUT", "/params/room/1/pin", &body).expect(200).json();
    assert_eq!(pinned, params(&app));
    assert_eq!((pinned["revision"].as_i64(), pinned["status"].as_str()), (Some(3), Some("pinned")));
    assert_eq!(
        (&pinned["fit"], &pinned["parameters"], &pinned["validated_at"]),
        (&first["fit"], &first["parameters"], &first["validated_at"])
    );
    assert_eq!(pinned["pin"]["reason"], "the controller swings");
    assert_eq!(
        app.json("PUT", "/params/room/1/pin", &body).expect(200).json(),
        pinned,
        "the same pin again changes nothing"
    );
    app.json("PUT", "/params/room/1/pin", &json!({"fit": "fit_none", "reason": "x"}))
        .problem(409, "never-served");

    app.csv("/systems/room/1/windows", &csv_of(&room(1, 23))).expect(201);
    let job = app.ended(&app.estimate(
        "room/1",
        json!({"split": {"train": "P16D", "validation": "P7D"}, "start_from": "nominal"}),
    ));
    assert!(["suggested", "unchanged"].contains(&job["outcome"].as_str().unwrap()), "{job}");
    assert_eq!(params(&app)["fit"], first["fit"]);
    if job["outcome"] == "suggested" {
        let fit = job["fit"].as_str().unwrap();
        app.json("POST", &format!("/fits/{fit}/promote"), &json!({"reason": "x"})).problem(409, "pinned");
    }

    for _ in 0..2 {
        app.send("DELETE", "/params/room/1/pin", &[], None).unwrap().expect(204);
    }
    let free = params(&app);
    assert_eq!(
        (free["revision"].as_i64(), free["status"].as_str(), &free["pin"]),
        (Some(3), Some("fresh"), &Value::Null)
    );
    let causes: Vec<Value> = history(&app)
        .iter()
        .map(|revision| json!([revision["revision"], revision["cause"], revision["current"]]))
        .collect();
    assert_eq!(
        causes,
        [json!([3, "pinned", true]), json!([2, "accepted", false]), json!([1, "accepted", false])]
    );
    let page = app.get("/params/room/1/history?page_size=2").expect(200).json();
    let rest = app
        .get(&format!(
            "/params/room/1/history?page_size=2&page_token={}",
            page["next_page_token"].as_str().unwrap()
        ))
        .json();
    assert_eq!((rest["items"][0]["revision"].as_i64(), &rest["next_page_token"]), (Some(1), &Value::Null));

    // A system goes with everything that was decided about it.
    app.json("PUT", "/params/room/1/pin", &json!({"reason": "x"})).expect(200);
    app.send("DELETE", "/systems/room/1?force=true", &[], None).unwrap().expect(204);
    app.get("/params/room/1").problem(404, "system-not-found");
}

#[test]
fn newer_measurements_that_contradict_what_is_served_say_so_and_submit_a_job() {
    let app = TestApp::at("2026-01-19T00:00:00Z", |_| {});
    app.room("1", 1);
    app.ended(&app.estimate("room/1", json!({})));
    let fresh = app.get("/params/room/1").expect(200);
    let before = app.get("/systems/room/1/state").json();
    // A day that goes on as before: the states move, nothing else does.
    app.csv("/systems/room/1/windows", &csv_of(&room(1, 16)[14 * 48..])).expect(201);
    let state = app.until("/systems/room/1/state", |state| state["at"] != before["at"]);
    assert_eq!(state["at"], "2026-01-16T23:30:00Z");
    assert_eq!(app.get("/params/room/1").text, fresh.text);
    // Three days with a window open.
    app.csv("/systems/room/1/windows", &csv_of(&leaky(19, 16)[16 * 48..])).expect(201);
    let degraded = app
        .get_with("/params/room/1", &[("if-none-match", fresh.header("etag")), ("prefer", "wait=60")])
        .expect(200);
    assert_eq!(degraded.header("params-status"), "degraded");
    let (old, new) = (fresh.json(), degraded.json());
    assert_eq!((&new["parameters"], &new["revision"]), (&old["parameters"], &old["revision"]));
    let found = &new["degraded"];
    assert!(
        found["error"].as_f64() > found["limit"].as_f64()
            && found["unit"] == "K"
            && found["horizon"] == "PT6H",
        "{found}"
    );
    let metrics = app.get("/metrics").expect(200).text;
    assert!(
        metrics.contains(&format!(
            "lampyris_live_rmse{{system=\"room/1\",horizon=\"PT6H\"}} {}\n",
            found["error"]
        )),
        "{metrics}"
    );
    let jobs = app.until("/jobs?system=room/1", |jobs| jobs["items"].as_array().unwrap().len() == 2);
    assert_eq!(
        (&jobs["items"][0]["origin"], &jobs["items"][0]["priority"]),
        (&json!("scheduled"), &json!("nightly"))
    );
}

#[test]
fn a_policy_may_want_no_job_and_a_good_week_ends_the_degradation() {
    let app = TestApp::at("2026-01-17T00:00:00Z", |_| {});
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "policy": {"refit_when_degraded": false}}))
        .expect(201);
    app.csv("/systems/room/1/windows", &csv_of(&room(1, 14))).expect(201);
    app.ended(&app.estimate("room/1", json!({})));
    app.csv("/systems/room/1/windows", &csv_of(&leaky(17, 14)[14 * 48..])).expect(201);
    app.until("/params/room/1", |params| params["status"] == "degraded");
    // The measurements were those of another room; here are the right ones.
    app.csv("/systems/room/1/windows", &csv_of(&room(1, 17)[14 * 48..])).expect(201);
    let params = app.until("/params/room/1", |params| params["status"] == "fresh");
    assert!(params["degraded"].is_null());
    assert_eq!(app.get("/jobs?system=room/1").json()["items"].as_array().unwrap().len(), 1);
}
