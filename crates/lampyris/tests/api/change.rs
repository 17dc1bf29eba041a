//! What is trusted only so far: steps that go far together, and measurements for which nothing older speaks.

use crate::support::TestApp;
use crate::support::rooms::{csv_of, room_that_changes};
use serde_json::{Value, json};

/// Two weeks of the same weather in a room that loses so much to the outdoors in 1/h.
fn losing(alpha_a: f64) -> String {
    csv_of(&room_that_changes(1, 14, |_| alpha_a))
}

fn check(app: &TestApp, job: &Value, name: &str) -> Value {
    let fit = app.get(&format!("/fits/{}", job["fit"].as_str().unwrap())).expect(200).json();
    fit["checks"].as_array().unwrap().iter().find(|check| check["name"] == name).cloned().unwrap_or_default()
}

fn summary(app: &TestApp, job: &Value) -> String {
    app.get(&format!("/fits/{}", job["fit"].as_str().unwrap())).json()["summary"].as_str().unwrap().to_owned()
}

#[test]
fn many_small_steps_are_one_large_one() {
    let then = "the parameters served 30 days ago";
    let confirmed = "the last parameters that an operator confirmed";
    let app = TestApp::at("2026-01-15T00:00:00Z", |_| {});
    // The temperature of the room alone leaves its three coefficients on a ridge, where fits may jump.
    let system = json!({"model": "rc2", "fixed": {"alpha_e": 0.8}, "policy": {"refit_when_degraded": false}});
    app.json("PUT", "/systems/room/1", &system).expect(201);
    let fitted = |alpha_a: f64| {
        app.csv("/systems/room/1/windows", &losing(alpha_a)).expect(201);
        app.ended(&app.estimate("room/1", json!({})))
    };
    assert_eq!(fitted(0.15)["outcome"], "accepted");
    app.clock.set("2026-02-13T00:00:00Z".parse().unwrap());
    // Not twice as far as the step before: each is nothing to hold.
    let second = fitted(0.36);
    assert_eq!(second["outcome"], "accepted", "{}", summary(&app, &second));
    assert_eq!(
        check(&app, &second, &format!("G6 jump from {then}")),
        Value::Null,
        "nothing is as old as that"
    );
    app.clock.set("2026-02-15T00:00:00Z".parse().unwrap());
    let third = fitted(0.9);
    assert_eq!(third["outcome"], "held", "{}", summary(&app, &third));
    assert_eq!(check(&app, &third, "G6 jump")["pass"], true);
    let said = summary(&app, &third);
    assert!(
        said.starts_with(&format!(
            "held by G6 jump from {then}: the free run differs from that of {then} by "
        )),
        "{said}"
    );

    // An operator's word ends what was before, and is what later fits are compared with.
    app.json(
        "POST",
        &format!("/fits/{}/promote", third["fit"].as_str().unwrap()),
        &json!({"reason": "new windows"}),
    )
    .expect(200);
    let fourth = fitted(0.4);
    assert_eq!(fourth["outcome"], "accepted", "{}", summary(&app, &fourth));
    assert_eq!(check(&app, &fourth, &format!("G6 jump from {then}")), Value::Null);
    assert_eq!(
        check(&app, &fourth, &format!("G6 jump from {confirmed}")),
        Value::Null,
        "it is what is served"
    );
    let fifth = fitted(0.17);
    assert_eq!(
        (&fifth["outcome"], &check(&app, &fifth, "G6 jump")["pass"]),
        (&json!("held"), &json!(true)),
        "{}",
        summary(&app, &fifth)
    );
    assert!(
        summary(&app, &fifth).starts_with(&format!("held by G6 jump from {confirmed}: ")),
        "{}",
        summary(&app, &fifth)
    );
}

#[test]
fn days_that_contradict_what_is_served_are_not_believed_alone() {
    let app = TestApp::at("2026-01-18T00:00:00Z", |_| {});
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "policy": {"refit_when_degraded": false}}))
        .expect(201);
    // A window stands open from the fifteenth on.
    let samples = room_that_changes(1, 18, |day| if day < 14 { 0.15 } else { 0.5 });
    app.csv("/systems/room/1/windows", &csv_of(&samples[..14 * 48])).expect(201);
    assert_eq!(app.ended(&app.estimate("room/1", json!({})))["outcome"], "accepted");
    app.csv("/systems/room/1/windows", &csv_of(&samples[14 * 48..])).expect(201);
    // The night comes at once: nobody has looked at the new days before.
    let night = |split: Value| {
        let request = json!({"method": {"name": "lm_multistart", "seed": 1}, "split": split});
        app.json(
            "PUT",
            "/schedules/nightly",
            &json!({"cron": "30 2 * * *", "systems": ["room/*"], "request": request}),
        )
        .expect(200);
        let batch = app.post("/schedules/nightly/run").expect(202).json();
        app.ended(batch["jobs"][0]["job"].as_str().unwrap())
    };
    let held = night(json!({"train": "P6D", "validation": "P1D"}));
    assert_eq!(held["outcome"], "held", "{}", summary(&app, &held));
    let said = summary(&app, &held);
    assert!(said.contains("only the days since 2026-01-15T00:00:00Z speak for these parameters"), "{said}");
    assert!(check(&app, &held, "G6 older days")["statistic"].as_f64().unwrap() > 1.25, "{held}");
    assert_eq!(app.get("/params/room/1").expect(200).json()["status"], "degraded");
    // A record that holds nothing else is worth no more.
    let held = night(json!({"train": "P3D", "validation": "P1D"}));
    assert_eq!(held["outcome"], "held", "{}", summary(&app, &held));
    assert!(summary(&app, &held).contains("no two days from before"), "{}", summary(&app, &held));
    // Whoever posts a job may know why the room has changed.
    let posted = app.ended(&app.estimate("room/1", json!({"split": {"train": "P3D", "validation": "P1D"}})));
    assert_eq!(check(&app, &posted, "G6 older days"), Value::Null);
    // A fit for which the older days speak as well is judged like any other.
    let both = night(json!({"train": "P13D", "validation": "P5D"}));
    assert!(
        check(&app, &both, "G6 older days")["pass"] == true
            || app.get("/params/room/1").json()["degraded"].is_null(),
        "{both}"
    );
}
