//! A process that goes by milliseconds: windows, jobs, states and forecasts, and rules that do not hold for
//! it.

use crate::support::TestApp;
use lampyris_core::model::document::ModelDocument;
use serde_json::{Value, json};
use std::fmt::Write;

const MOTOR: &str = include_str!("../../../../examples/models/motor.toml");
/// Thirty seconds of samples.
const SAMPLES: usize = 3_000;

/// The voltage of a sample, which changes every half a second and less.
fn voltage(k: usize) -> f64 {
    [6.0, -6.0, 12.0, 0.0, -12.0][(k / 37 + k / 53) % 5]
}

fn stamp(k: usize) -> String {
    format!("2026-01-05T00:00:{:02}.{:03}Z", k / 100, 10 * (k % 100))
}

/// Voltage, current and speed every ten milliseconds, with noise, by small steps of Euler's method.
fn measured() -> String {
    let mut csv = "time,u[V],current[A],speed[rad/s]".to_owned();
    let (mut i, mut w, mut seed) = (0.0, 0.0, 1_u64);
    let mut noise = || {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 33) as f64 / (1_u64 << 31) as f64 - 0.5
    };
    for k in 0..SAMPLES {
        let _ =
            write!(csv, "\n{},{},{:.4},{:.4}", stamp(k), voltage(k), i + 0.17 * noise(), w + 0.7 * noise());
        for _ in 0..1_000 {
            let (di, dw) = ((voltage(k) - 1.2 * i - 0.12 * w) / 0.08, (0.12 * i - 0.002 * w) / 0.01);
            (i, w) = (i + 1e-5 * di, w + 1e-5 * dw);
        }
    }
    csv
}

#[test]
fn a_motor_is_fitted_and_forecast_by_milliseconds() {
    let app = TestApp::start();
    let ModelDocument::Spec(spec) = ModelDocument::from_toml(MOTOR).unwrap() else { panic!("no model") };
    app.json("POST", "/models", &serde_json::to_value(&spec).unwrap()).expect(201);
    let system = json!({"model": "motor", "policy": {"horizon": "PT0.5S", "stale_after": "P3650D"}});
    app.json("PUT", "/systems/motor/1", &system).expect(201);
    let window = app.csv("/systems/motor/1/windows", &measured()).expect(201).json();
    let speed = &window["channels"]["speed"];
    assert_eq!((&speed["median_step_s"], &window["to"]), (&json!(0.01), &json!("2026-01-05T00:00:29.99Z")));

    let job = json!({
        "kind": "estimate", "system": "motor/1", "step": "PT0.01S",
        "split": {"train": "PT12S", "validation": "PT18S"}, "method": {"name": "cfa", "seed": 1}
    });
    let ended = app.ended(&app.post_job(&job));
    assert_eq!(ended["outcome"], "accepted", "{ended}");
    let served = app.get("/params/motor/1").expect(200).json();
    let near = |name: &str, truth: f64| {
        let found = served["parameters"][name].as_f64().unwrap();
        assert!((found / truth - 1.0).abs() < 0.05, "{name}: {found} {truth}");
    };
    for (name, truth) in [("R", 1.2), ("L", 0.08), ("K", 0.12), ("J", 0.01)] {
        near(name, truth);
    }
    let fit = app.get(&format!("/fits/{}", ended["fit"].as_str().unwrap())).json();
    assert_eq!(fit["sample_s"], 0.01);
    let shown =
        app.get("/systems/motor/1/series?channels=speed&from=2026-01-05T00:00:29.5Z").expect(200).json();
    let times = shown["channels"]["speed"]["time"].as_array().unwrap();
    assert_eq!((times.len(), &times[1]), (50, &json!("2026-01-05T00:00:29.51Z")));

    // A live sample goes on where the window ends, and the forecast from there.
    let units = json!({"u": {"unit": "V"}, "current": {"unit": "A"}, "speed": {"unit": "rad/s"}});
    let row = json!({"channels": units, "time": "2026-01-05T00:00:30Z",
        "values": {"u": 6.0, "current": 0.1, "speed": 20.0}});
    let state = app.json("POST", "/systems/motor/1/samples", &row).expect(200).json();
    assert_eq!(state["report"]["rows"], 1, "{state}");
    let asked = json!({"horizon": "PT0.5S", "step": "PT0.01S", "inputs": {
        "channels": {"u": {"unit": "V"}}, "time": ["2026-01-05T00:00:30Z", "2026-01-05T00:00:31Z"],
        "values": {"u": [6.0, 6.0]}
    }});
    let forecast = app.json("POST", "/systems/motor/1/forecast", &asked).expect(200).json();
    assert_eq!(forecast["time"].as_array().unwrap().len(), 51, "{forecast}");
    assert_eq!(forecast["time"][50], "2026-01-05T00:00:30.5Z");
    let said = forecast["outputs"]["speed"]["values"].as_array().unwrap();
    assert!(said[50].as_f64() > said[0].as_f64(), "{forecast}");
}

#[test]
fn a_rule_is_waived_with_a_reason() {
    let app = TestApp::start();
    let put = |checks: Value| {
        app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "policy": {"checks": checks}}))
    };
    let refused = put(json!({"G1 finite": "who cares", "G8 excitd": "one speed", "G9": ""}))
        .problem(422, "invalid-request");
    let places: Vec<&str> = refused["errors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|fault| fault["pointer"].as_str().unwrap())
        .collect();
    assert_eq!(places, ["/policy/checks/G1 finite", "/policy/checks/G8 excitd", "/policy/checks/G9"]);
    app.room("1", 1);
    // The weather stood still, so nothing can be said of it.
    let mut csv = String::from("time,T_room,T_out\n");
    for k in 0..28 * 48 {
        let time: jiff::Timestamp = "2025-12-18T00:00:00Z".parse().unwrap();
        let room = 15.0 + 5.0 * (-0.002 * f64::from(k)).exp() + 0.05 * f64::from(k % 7) / 7.0;
        let _ = writeln!(csv, "{},{room:.3},4", time + jiff::SignedDuration::from_mins(30 * i64::from(k)));
    }
    app.json("PUT", "/systems/room/2", &json!({"model": "rc2"})).expect(201);
    app.csv("/systems/room/2/windows", &csv).expect(201);
    let check = |name: &str| {
        let ended = app.ended(&app.estimate("room/2", json!({})));
        let fit = app.get(&format!("/fits/{}", ended["fit"].as_str().unwrap())).json();
        let checks = fit["checks"].as_array().unwrap();
        (checks.iter().find(|check| check["name"] == name).unwrap().clone(), fit["flags"].clone())
    };
    let (excited, _) = check("G8 excited");
    assert_eq!((&excited["pass"], &excited["severity"]), (&json!(false), &json!("reject")));
    let waived = json!({"model": "rc2", "policy": {"checks": {"G8 excited": "a cellar has no weather"}}});
    app.json("PUT", "/systems/room/2", &waived).expect(200);
    let (excited, flags) = check("G8 excited");
    assert_eq!((&excited["pass"], &excited["severity"]), (&json!(false), &json!("flag")), "{flags}");
    assert!(excited["comment"].as_str().unwrap().ends_with("(waived: a cellar has no weather)"), "{excited}");
    let deeds = app.get("/audit?page_size=1").expect(200).json();
    assert_eq!(deeds["items"][0]["reason"], "G8 excited waived: a cellar has no weather", "{deeds}");
}
