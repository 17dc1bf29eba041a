//! The same over HTTP: a bad fit leaves what the controller reads as it was, and says why.

use crate::support::rooms::{csv_of, room, stuck_csv};
use crate::support::{TestApp, quick};
use serde_json::{Value, json};

/// What is served, without what says that a newer fit was refused.
fn served(app: &TestApp) -> Value {
    let mut body = app.get("/params/room/1").expect(200).json();
    for field in ["status", "fallback"] {
        body.as_object_mut().unwrap().shift_remove(field);
    }
    body
}

#[test]
fn a_refused_fit_moves_nothing_and_is_explained_to_the_controller() {
    let app = TestApp::start();
    app.room("1", 1);
    assert_eq!(app.ended(&app.estimate("room/1", json!({})))["outcome"], "accepted");
    let before = served(&app);
    let requests = [
        // A house of paper, a castle, a house without walls, and one that is heated by the frost.
        (json!({"fixed": {"alpha_a": 14.0, "alpha_e": 14.0}}), "G4"),
        (json!({"fixed": {"beta_e": 4000.0, "alpha_a": 0.0001}}), "G"),
        (json!({"fixed": {"alpha_e": 0.001}}), "G4"),
        (json!({"fixed": {"alpha_a": -0.1}}), "G"),
        (json!({"split": {"train": "PT8H", "validation": "P2D"}, "fixed": {"alpha_a": 1.5}}), "G4"),
        (json!({"split": {"train": "P9D", "validation": "P0D"}}), "G8 unseen data"),
    ];
    for (change, rule) in &requests {
        let mut body = quick("room/1");
        body.as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
        let ended = app.ended(&app.post_job(&body));
        assert_eq!(
            (&ended["state"], &ended["outcome"]),
            (&json!("succeeded"), &json!("rejected")),
            "{change}: {ended}"
        );
        let params = app.get("/params/room/1").expect(200).json();
        assert_eq!(params["status"], "fallback", "{change}");
        assert_eq!(params["fallback"]["reason"], "validation_failed", "{change}");
        let failed = params["fallback"]["failed_checks"].as_array().unwrap();
        assert!(failed.iter().any(|name| name.as_str().unwrap().starts_with(rule)), "{change}: {failed:?}");
        assert_eq!(served(&app), before, "{change}");
        let fit = format!("/fits/{}", params["fallback"]["fit"].as_str().unwrap());
        app.json("POST", &format!("{fit}/promote"), &json!({"reason": "it looks fine"})).expect(409);
    }
    // Measurements in Fahrenheit do not get as far as a fit.
    let fahrenheit: Vec<_> =
        room(3, 2).into_iter().map(|(time, room, out)| (time, room * 1.8 + 60.0, out)).collect();
    let csv = csv_of(&fahrenheit).replace("2026-01", "2026-02");
    app.csv("/systems/room/1/windows", &csv).problem(422, "invalid-request");
    // A sensor that hangs gets as far as the gate.
    app.csv("/systems/room/1/windows", &stuck_csv()).expect(201);
    assert_eq!(app.ended(&app.post_job(&quick("room/1")))["outcome"], "rejected");
    let params = app.get("/params/room/1").expect(200).json();
    assert!(
        params["fallback"]["failed_checks"].as_array().unwrap().contains(&json!("G8 not stuck")),
        "{params}"
    );
    assert_eq!(served(&app), before);
    println!("GATE-1: {} bad fits over HTTP, none served", requests.len() + 1);
}
