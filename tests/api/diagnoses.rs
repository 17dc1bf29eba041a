//! Compare, see which effect is missing, add it, watch the error fall: over HTTP, on a room with a hidden effect.

use crate::support::TestApp;
use lampyris::twin::{Level, WorldRequest, world};
use serde_json::{Value, json};

/// A room of the model room3 with these hidden effects and four weeks of measurements.
fn twin(app: &TestApp, id: &str, seed: u64, effects: &[&str]) {
    let world = world(&WorldRequest::new(seed, effects, Level::Matched)).unwrap();
    let neighbours: Vec<String> = world.neighbours.iter().map(|name| format!("room/{name}")).collect();
    let document = json!({"model": "room3", "location": {"lat": 56.5, "lon": 10.0}, "neighbours": neighbours});
    app.json("PUT", &format!("/systems/room/{id}"), &document).expect(201);
    app.csv(&format!("/systems/room/{id}/windows"), &world.csv).expect(201);
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

#[test]
fn the_hidden_effect_is_named_added_and_the_error_falls() {
    let app = TestApp::start();
    twin(&app, "windy", 7, &["wind_infiltration"]);
    let job = app.ended(&app.post_job(&json!({"kind": "diagnose", "system": "room/windy", "method": {"seed": 3}})));
    assert_eq!(
        (job["state"].as_str(), &job["outcome"], job["kind"].as_str()),
        (Some("succeeded"), &Value::Null, Some("diagnose")),
        "{job}"
    );
    app.get("/params/room/windy").problem(404, "no-validated-parameters");

    let diagnosis = app.get(job["links"]["diagnosis"].as_str().unwrap()).expect(200).json();
    assert_eq!((diagnosis["id"].as_str(), &diagnosis["fit"]), (job["diagnosis"].as_str(), &job["fit"]));
    assert_eq!((diagnosis["verdict"].as_str(), diagnosis["system"].as_str()), (Some("named"), Some("room/windy")), "{diagnosis}");
    let finding = &diagnosis["findings"][0];
    assert_eq!(finding["effect"], "wind_infiltration", "{diagnosis}");
    let [before, after] = [0, 1].map(|side| number(&finding["rmse"]["test"][side]));
    assert!(after < 0.9 * before, "{finding}");
    assert_eq!(app.get("/diagnoses?system=room/windy").json()["items"][0]["id"], diagnosis["id"]);

    // One request adds it; the rest is an ordinary job.
    let model = app.json("POST", "/models/room3/effects", &json!({"effect": finding["effect"]})).expect(201).json();
    assert_eq!(model["id"], "room3+wind_infiltration");
    let split = json!({"train": "P14D", "validation": "P7D", "test": "P7D"});
    let errors = |model: &str| {
        let body = json!({"kind": "estimate", "system": "room/windy", "model": model, "split": split, "experiment": true});
        let job = app.ended(&app.post_job(&body));
        let fit = app.get(&format!("/fits/{}", job["fit"].as_str().unwrap())).json();
        ["train_rmse", "validation_rmse", "test_rmse"].map(|part| number(&fit["metrics"]["T_room"][part]))
    };
    let (old, new) = (errors("room3"), errors("room3+wind_infiltration"));
    assert!(old.iter().zip(&new).all(|(old, new)| *new < 0.9 * old), "{old:?} -> {new:?}");
}

#[test]
fn a_ladder_keeps_what_helps_on_unseen_data() {
    let app = TestApp::start();
    twin(&app, "sunny", 11, &["wind_infiltration"]);
    app.get("/systems/room/sunny/ladder").problem(404, "ladder-not-found");
    let job = app.ended(&app.post_job(&json!({"kind": "ladder", "system": "room/sunny"})));
    assert_eq!(job["state"], "succeeded", "{job}");
    let ladder = app.get(job["links"]["ladder"].as_str().unwrap()).expect(200).json();
    assert_eq!((&ladder["job"], ladder["system"].as_str()), (&job["id"], Some("room/sunny")));
    let steps = ladder["steps"].as_array().unwrap();
    assert_eq!((steps[0]["model"].as_str(), &steps[0]["added"]), (Some("room3"), &Value::Null));
    let kept: Vec<f64> = steps.iter().filter(|step| step["kept"] == true).map(|step| number(&step["validation_rmse"])).collect();
    assert!(kept.len() >= 2 && kept.windows(2).all(|pair| pair[1] < pair[0]), "{ladder}");
}

#[test]
fn a_record_that_is_too_short_is_told_so_and_deletions_take_diagnoses_along() {
    let app = TestApp::start();
    app.room("1", 1);
    let body = json!({"kind": "diagnose", "system": "room/1", "window": {"last": "P2D"}, "method": {"name": "lm_multistart"}});
    let job = app.ended(&app.post_job(&body));
    let diagnosis = app.get(job["links"]["diagnosis"].as_str().unwrap()).expect(200).json();
    assert_eq!(diagnosis["verdict"], "not_enough_data", "{diagnosis}");
    app.send("DELETE", "/systems/room/1?force=true", &[], None).unwrap().expect(204);
    app.get(job["links"]["diagnosis"].as_str().unwrap()).problem(404, "diagnosis-not-found");
}
