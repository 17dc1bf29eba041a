//! Models and effects as documents.

use crate::support::TestApp;
use serde_json::json;

fn leaky() -> serde_json::Value {
    json!({
        "id": "leaky", "title": "Leaky room",
        "states": {"T_r": {"unit": "degC", "initial": "T_room"}},
        "inputs": {"T_out": {"unit": "degC"}},
        "parameters": {"a": {"unit": "1/h", "lower": 0.001, "upper": 10, "scale": "log", "nominal": 0.1}},
        "equations": {"T_r": "a*(T_out - T_r)"},
        "outputs": {"T_room": {"expr": "T_r", "unit": "degC", "noise_sd": 0.05}},
    })
}

#[test]
fn an_effect_makes_a_new_model() {
    let app = TestApp::start();
    let base = app.get("/models/rc2").expect(200).json();
    assert_eq!(base["parameters"].as_array().unwrap().len(), 4);
    let made = app.json("POST", "/models/rc2/effects", &json!({"effect": "wind_infiltration"})).expect(201);
    assert_eq!(made.header("location"), "/models/rc2+wind_infiltration");
    let made = made.json();
    assert_eq!((made["id"].as_str(), made["parent"].as_str()), (Some("rc2+wind_infiltration"), Some("rc2")));
    assert_eq!(made["diff"]["terms"]["T_r"], "c_wind * wind_speed * (T_out - T_r)");
    assert_ne!(made["hash"], base["hash"]);
    assert_eq!(app.json("POST", "/models/rc2/effects", &json!({"effect": "wind_infiltration"})).expect(200).json(), made);
    let model = app.get("/models/rc2+wind_infiltration").expect(200).json();
    assert_eq!((&model["hash"], &model["parent"], &model["effects"]), (&made["hash"], &made["parent"], &json!(["wind_infiltration"])));
    let ids = app.get("/models").json()["items"].clone();
    assert!(ids.to_string().contains("rc2+wind_infiltration") && ids.to_string().contains("room3"), "{ids}");

    let slip = app.json("POST", "/models/rc2/effects", &json!({"effect": "wind_infiltratoin"})).problem(422, "invalid-request");
    assert_eq!(
        (slip["errors"][0]["pointer"].as_str(), slip["errors"][0]["suggestion"].as_str()),
        (Some("/effect"), Some("did you mean `wind_infiltration`?"))
    );
    app.json("POST", "/models/rc9/effects", &json!({"effect": "wind_infiltration"})).problem(404, "model-not-found");
    app.json("POST", "/models/rc2+wind_infiltration/effects", &json!({"effect": "wind_infiltration"})).problem(422, "invalid-request");
}

#[test]
fn documents_of_users_are_taken_once_and_never_change() {
    let app = TestApp::start();
    let taken = app.json("POST", "/models", &leaky()).expect(201);
    assert_eq!((taken.header("location"), taken.json()["parameters"][0]["name"].as_str()), ("/models/leaky", Some("a")));
    app.json("POST", "/models", &leaky()).expect(200);
    let mut other = leaky();
    other["title"] = json!("Another room");
    app.json("POST", "/models", &other).problem(409, "already-exists");
    other["id"] = json!("rc2");
    app.json("POST", "/models", &other).problem(409, "already-exists");

    let effect = json!({
        "id": "lamp", "title": "A lamp", "explain": "A lamp that is always on warms the room.",
        "parameters": {"c_lamp": {"unit": "K/h", "lower": 0, "upper": 1, "scale": "linear", "nominal": 0.1}},
        "terms": {"T_r": "c_lamp"},
    });
    let version = app.json("POST", "/models/leaky/effects", &effect).expect(201).json();
    assert_eq!(version["id"], "leaky+lamp");
    assert_eq!(app.get("/effects/lamp").expect(200).json()["title"], "A lamp");
    app.json("POST", "/effects", &effect).expect(200);
    let mut other = effect;
    other["terms"]["T_r"] = json!("2 * c_lamp");
    app.json("POST", "/effects", &other).problem(409, "already-exists");
    app.json("PUT", "/systems/room/1", &json!({"model": "leaky+lamp"})).expect(201);
}

#[test]
fn a_dry_run_lists_every_fault() {
    let app = TestApp::start();
    assert_eq!(app.json("POST", "/models/validate", &leaky()).expect(200).json(), json!({"valid": true, "errors": []}));
    let mut bad = leaky();
    bad["equations"]["T_r"] = json!("aa*(T_out - T_r) + b");
    bad["parameters"]["a"]["upper"] = json!(0.0001);
    let check = app.json("POST", "/models/validate", &bad).expect(200).json();
    assert_eq!(check["valid"], false);
    assert!(check["errors"].as_array().unwrap().len() >= 3, "{check}");
    bad["parameters"]["a"]["scale"] = json!("lgo");
    bad["sttes"] = json!({});
    let check = app.json("POST", "/models/validate", &bad).expect(200).json();
    let pointers: Vec<&str> = check["errors"].as_array().unwrap().iter().map(|fault| fault["pointer"].as_str().unwrap()).collect();
    assert_eq!(pointers, ["/parameters/a/scale", "/sttes"], "{check}");
    app.json("POST", "/models", &bad).problem(422, "invalid-request");
    app.get("/models/leaky").problem(404, "model-not-found");
}
