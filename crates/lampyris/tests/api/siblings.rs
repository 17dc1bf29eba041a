//! A system with little data starts from what the others in its building have.

use crate::support::TestApp;
use crate::support::rooms::room_csv;
use crate::support::schema::disagreements;
use serde_json::{Value, json};

/// A room of a group with so many days, and the fit of its estimate.
fn fitted(app: &TestApp, id: &str, seed: u64, days: usize, more: Value) -> Value {
    let mut document = json!({"model": "rc2", "policy": {"mode": "auto"}});
    document.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
    app.json("PUT", &format!("/systems/room/{id}"), &document).expect(201);
    app.csv(&format!("/systems/room/{id}/windows"), &room_csv(seed, days)).expect(201);
    let (train, validation) = (format!("P{}D", days - 2), "P2D");
    let split = json!({"split": {"train": train, "validation": validation}});
    let job = app.ended(&app.estimate(&format!("room/{id}"), split));
    app.get(&format!("/fits/{}", job["fit"].as_str().unwrap())).expect(200).json()
}

fn of(group: &str) -> Value {
    json!({"group": group})
}

#[test]
fn a_new_room_learns_from_its_building_and_says_so() {
    let app = TestApp::at("2026-02-12T00:00:00Z", |_| {});
    let siblings = ["1", "2", "3"];
    for (seed, id) in (1..).zip(siblings) {
        let fit = fitted(&app, id, seed, 14, of("North house/1"));
        assert_eq!((&fit["verdict"], &fit["prior"]), (&json!("accepted"), &Value::Null), "{fit}");
    }
    // Of a group of its own, and with a prior of its own, nobody learns.
    assert_eq!(fitted(&app, "4", 4, 5, of("North house 2"))["prior"], Value::Null);
    assert_eq!(
        fitted(&app, "5", 4, 5, json!({"group": "North house", "prior": "none"}))["prior"],
        Value::Null
    );

    let fit = fitted(&app, "6", 4, 5, of("North house/2"));
    let schemas = lampyris::http::described_documents();
    assert_eq!(disagreements(&fit, &schemas["Fit"], &schemas, ""), [""; 0]);
    assert_eq!(fit["prior"]["from"], json!(["room/1", "room/2", "room/3", "room/5"]), "{fit}");
    let known = fit["prior"]["parameters"].as_object().unwrap();
    for (name, known) in known {
        assert!(
            fit["parameters"][name]["fixed"] == json!(false) && known["deviation"].as_f64().unwrap() > 0.0
        );
    }
    assert!(!known.is_empty(), "{fit}");
    let said = fit["remarks"].as_array().unwrap();
    assert!(said.iter().any(|one| one.as_str().unwrap().contains("4 other systems")), "{said:?}");
    // The whole building can be told not to.
    let alone = TestApp::at("2026-02-12T00:00:00Z", |settings| settings.estimate.borrow = false);
    for (seed, id) in (1..).zip(siblings) {
        fitted(&alone, id, seed, 14, of("North house/1"));
    }
    assert_eq!(fitted(&alone, "6", 4, 5, of("North house/2"))["prior"], Value::Null);
}

#[test]
fn a_prior_that_is_written_down_is_checked_and_kept_to() {
    let app = TestApp::at("2026-02-12T00:00:00Z", |_| {});
    let written = |value: f64, deviation: f64, name: &str| {
        json!({"model": "rc2",
            "prior": {"known": {"parameters": {name: {"value": value, "deviation": deviation}}}}})
    };
    for (value, deviation, field) in [(-1.0, 0.1, "value"), (1.0, 0.0, "deviation")] {
        let answer = app.json("PUT", "/systems/room/1", &written(value, deviation, "alpha_e"));
        let problem = answer.problem(422, "invalid-request");
        let pointer = problem["errors"][0]["pointer"].as_str().unwrap();
        assert!(pointer.ends_with(&format!("/parameters/alpha_e/{field}")), "{problem}");
    }
    app.json("PUT", "/systems/room/1", &written(1.0, 0.1, "alpha_x")).problem(422, "invalid-request");

    // So sure that the data have no say.
    let prior = written(0.123, 1e-4, "alpha_e")["prior"].clone();
    let fit = fitted(&app, "2", 1, 14, json!({"prior": prior}));
    let found = fit["parameters"]["alpha_e"]["value"].as_f64().unwrap();
    assert!((found / 0.123 - 1.0).abs() < 0.01, "{found}");
    assert_eq!(fit["prior"]["parameters"]["alpha_e"]["value"], json!(0.123));
}
