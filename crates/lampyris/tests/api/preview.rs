//! Short simulations for whoever edits a model.

use crate::support::TestApp;
use crate::support::rooms::{room, room_csv};
use serde_json::{Value, json};

fn numbers(value: &Value) -> Vec<Option<f64>> {
    value.as_array().unwrap().iter().map(Value::as_f64).collect()
}

/// The room of the tests with its own parameters: the preview must follow the measurements.
#[test]
fn a_preview_over_a_system_follows_its_measurements() {
    let app = TestApp::start();
    app.room("1", 5);
    let truth = json!({"alpha_e": 0.8, "beta_e": 4.0, "alpha_a": 0.15});
    let ask = json!({"system": "room/1", "parameters": truth});
    let shown = app.json("POST", "/models/preview", &ask).expect(200).json();
    assert_eq!(
        (shown["model"].as_str(), shown["synthetic"].as_bool(), shown["every"].as_u64()),
        (Some("rc2"), Some(false), Some(1))
    );
    let samples = room(5, 14);
    let newest = &samples[samples.len() - 7 * 48 - 1..];
    let (time, measured) =
        (shown["time"].as_array().unwrap(), numbers(&shown["outputs"]["T_room"]["measured"]));
    assert_eq!(
        (time.len(), time[0].as_str().unwrap(), time.last().unwrap().as_str().unwrap()),
        (337, newest[0].0.as_str(), newest[336].0.as_str())
    );
    assert!(
        (measured[100].unwrap() - newest[100].1).abs() < 1e-3,
        "the system's own measurements, cut to the last week"
    );
    let simulated = numbers(&shown["outputs"]["T_room"]["simulated"]);
    // The envelope starts at a guess; after four days the truth is reached.
    let worst = (192..337).map(|k| (simulated[k].unwrap() - newest[k].1).abs()).fold(0.0, f64::max);
    assert!(worst < 0.1, "{worst}");
    let squares: f64 = simulated.iter().zip(&measured).map(|(x, y)| (x.unwrap() - y.unwrap()).powi(2)).sum();
    let rmse = shown["outputs"]["T_room"]["rmse"].as_f64().unwrap();
    assert!((rmse - (squares / 337.0).sqrt()).abs() < 1e-9, "{rmse}");
    assert_eq!(shown["parameters"]["alpha_e"], json!({"value": 0.8, "unit": "1/h"}));
    assert_eq!(numbers(&shown["states"]["T_e"]["values"]).len(), 337);
    assert_eq!(shown["inputs"]["T_out"]["unit"], "degC");

    let thin =
        json!({"system": "room/1", "max_points": 100, "window": {"from": newest[0].0, "to": newest[48].0}});
    let thin = app.json("POST", "/models/preview", &thin).expect(200).json();
    assert_eq!((thin["time"].as_array().unwrap().len(), thin["every"].as_u64()), (49, Some(1)));
    let thin = app
        .json("POST", "/models/preview", &json!({"system": "room/1", "max_points": 100}))
        .expect(200)
        .json();
    assert_eq!((thin["time"].as_array().unwrap().len(), thin["every"].as_u64()), (85, Some(4)));
    assert_eq!(app.get("/jobs").json()["items"], json!([]), "nothing of it is kept");
}

#[test]
fn a_document_and_effects_are_tried_before_they_are_posted() {
    let app = TestApp::start();
    let model = json!({
        "id": "draft", "title": "Draft",
        "states": {"T_r": {"unit": "degC", "initial": "T_room"}},
        "inputs": {"T_out": {"unit": "degC"}},
        "parameters": {"a": {"unit": "1/h", "lower": 0.001, "upper": 10, "scale": "log", "nominal": 0.5}},
        "equations": {"T_r": "a*(T_out - T_r)"},
        "outputs": {"T_room": {"expr": "T_r", "unit": "degC", "noise_sd": 0.05}},
    });
    let lamp = json!({
        "id": "lamp", "title": "A lamp", "explain": "A lamp warms the room.",
        "parameters": {"c_lamp": {"unit": "K/h", "lower": 0, "upper": 5, "scale": "linear", "nominal": 1.0}},
        "terms": {"T_r": "c_lamp"},
    });
    let shown = app.json("POST", "/models/preview", &json!({"model": model})).expect(200).json();
    assert_eq!((shown["model"].as_str(), shown["synthetic"].as_bool()), (Some("draft"), Some(true)));
    let with = json!({
        "model": model, "effects": [lamp, "wind_infiltration"], "parameters": {"c_lamp": 2.0, "c_wind": 0.0}
    });
    let with = app.json("POST", "/models/preview", &with).expect(200).json();
    assert_eq!(with["model"], "draft+lamp+wind_infiltration");
    let last = |shown: &Value| numbers(&shown["outputs"]["T_room"]["simulated"]).last().unwrap().unwrap();
    // The steady effect of 2 K/h against 0.5 1/h is 4 K.
    assert!((last(&with) - last(&shown) - 4.0).abs() < 0.01, "{} {}", last(&with), last(&shown));
    app.get("/models/draft").problem(404, "model-not-found");
    app.get("/effects/lamp").problem(404, "effect-not-found");

    // The same over a system, whose model is another one.
    app.room("1", 2);
    let there =
        app.json("POST", "/models/preview", &json!({"model": model, "system": "room/1"})).expect(200).json();
    assert_eq!((there["model"].as_str(), there["synthetic"].as_bool()), (Some("draft"), Some(false)));
}

#[test]
fn the_faults_of_a_preview_name_their_places() {
    let app = TestApp::start();
    app.csv("/systems/room/1/windows", &room_csv(1, 2)).expect(404);
    app.room("1", 1);
    let of = |body: Value| {
        let problem = app.json("POST", "/models/preview", &body).problem(422, "invalid-request");
        let faults = problem["errors"].as_array().unwrap().clone();
        faults
            .iter()
            .map(|fault| {
                (fault["pointer"].as_str().unwrap().to_owned(), fault["code"].as_str().unwrap().to_owned())
            })
            .collect::<Vec<_>>()
    };
    let one = |pointer: &str, code: &str| vec![(pointer.to_owned(), code.to_owned())];
    assert_eq!(of(json!({})), one("/model", "nothing-to-simulate"));
    assert_eq!(of(json!({"model": "rc9"})), one("/model", "unknown-model"));
    assert_eq!(of(json!({"model": "rc2", "effects": ["wind"]})), one("/effects/0", "unknown-effect"));
    assert_eq!(
        of(json!({"model": "rc2", "parameters": {"alpha_x": 1.0}})),
        one("/parameters/alpha_x", "unknown-parameter")
    );
    assert_eq!(of(json!({"model": "rc2", "parameter": {}})), one("/parameter", "unknown-field"));
    assert_eq!(of(json!({"model": "rc2", "window": {"last": "P1D"}})), one("/window", "contradiction"));
    assert_eq!(of(json!({"system": "room/2"})), one("/system", "system-not-found"));
    assert_eq!(
        of(json!({"system": "room/1", "window": {"last": "P90D"}, "max_points": 1})),
        [
            ("/max_points".to_owned(), "out-of-range".to_owned()),
            ("/window/last".to_owned(), "invalid-range".to_owned())
        ]
    );
    assert_eq!(
        of(json!({
            "system": "room/1", "window": {"from": "2026-01-01T00:00:00Z", "to": "2027-01-01T00:00:00Z"}
        })),
        one("/window", "invalid-range")
    );
    let bad = json!({
        "id": "bad", "title": "Bad",
        "states": {"T_r": {"unit": "degC", "initial": "T_room"}},
        "equations": {"T_r": "alpha*T_r"},
        "outputs": {"T_room": {"expr": "T_r", "unit": "degC", "noise_sd": 0.05}},
    });
    assert_eq!(of(json!({"model": bad})), one("/model/equations/T_r", "unknown-name"));
    let effect = json!({"id": "mist", "title": "Mist", "explain": "Mist.", "terms": {"T_r": "c_mist"}});
    assert_eq!(
        of(json!({"model": "rc2", "effects": ["constant_gain", effect]})),
        one("/effects/1/terms/T_r", "unknown-name")
    );
}
