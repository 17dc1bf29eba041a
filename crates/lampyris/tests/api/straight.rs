//! From a file to served parameters, and what stays after a restart.

use crate::support::rooms::{room, room_csv};
use crate::support::{TestApp, quick};
use serde_json::{Value, json};

#[test]
fn a_window_becomes_served_parameters() {
    let app = TestApp::start();
    let made =
        app.json("PUT", "/systems/room/4", &json!({"label": "Living room", "model": "rc2"})).expect(201);
    assert_eq!(
        (made.json()["system"].as_str(), made.json()["policy"]["stale_after"].as_str()),
        (Some("room/4"), Some("P3D"))
    );
    app.json("PUT", "/systems/room/4", &json!({"label": "Room 4", "model": "rc2"})).expect(200);

    let csv = room_csv(1, 14);
    let taken = app.csv("/systems/room/4/windows", &csv).expect(201).json();
    assert_eq!(
        (taken["rows"].as_u64(), taken["channels"]["T_room"]["missing"].as_u64()),
        (Some(672), Some(0))
    );
    let again = app.csv("/systems/room/4/windows", &csv).expect(200).json();
    assert_eq!(taken, again, "the same body twice is one window");
    let id = taken["id"].as_str().unwrap();
    assert!(id.starts_with("win_"));
    assert_eq!(app.get(&format!("/windows/{id}")).expect(200).json(), taken);
    assert_eq!(app.get("/systems/room/4/windows").json()["items"], json!([taken]));

    let job = app.estimate("room/4", json!({}));
    let ended = app.ended(&job);
    assert_eq!(
        (ended["state"].as_str(), ended["outcome"].as_str()),
        (Some("succeeded"), Some("accepted")),
        "{ended}"
    );
    assert_eq!((ended["revision"].as_i64(), ended["attempt"].as_i64()), (Some(1), Some(1)));
    assert!(ended["wall_s"].as_f64().unwrap() > 0.0 && ended["evaluations"].as_i64().unwrap() > 10);

    let fit = app.get(&format!("/fits/{}", ended["fit"].as_str().unwrap())).expect(200).json();
    assert_eq!((fit["verdict"].as_str(), fit["job"].as_str()), (Some("accepted"), Some(job.as_str())));
    assert!(fit["checks"].as_array().unwrap().iter().all(|check| check["name"].is_string()));

    let answer = app.get("/params/room/4").expect(200);
    assert_eq!(answer.header("params-status"), "fresh");
    let params = answer.json();
    // A room that nothing but the weather drives tells two combinations of its three rates.
    let value = |name: &str| params["parameters"][name].as_f64().unwrap();
    let (alpha_e, beta_e, alpha_a) = (value("alpha_e"), value("beta_e"), value("alpha_a"));
    assert!((alpha_e * alpha_a / 0.12 - 1.0).abs() < 0.1, "{params}");
    assert!(((alpha_e * (1.0 + 1.0 / beta_e) + alpha_a) / 1.15 - 1.0).abs() < 0.1, "{params}");
    assert_eq!(fit["parameters"]["alpha_e"]["value"].as_f64().unwrap(), alpha_e);
    assert_eq!(
        (params["revision"].as_i64(), params["job"].as_str(), &params["fallback"]),
        (Some(1), Some(job.as_str()), &Value::Null)
    );
    assert_eq!(params["units"]["alpha_e"], "1/h");
    assert!(params["error"]["T_room"]["ahead"]["PT6H"].as_f64().unwrap() < 0.2, "{params}");

    let state = app.get("/systems/room/4/state").expect(200).json();
    assert!(
        state["states"]["T_r"].is_f64()
            && state["states"]["T_e"].is_f64()
            && state["sd"]["T_r"].is_f64()
            && state["at"].is_string(),
        "{state}"
    );
    assert_eq!(state["revision"], 1);

    let rows = app.get("/systems").json()["items"].clone();
    assert_eq!(
        (rows[0]["system"].as_str(), rows[0]["status"].as_str(), rows[0]["revision"].as_i64()),
        (Some("room/4"), Some("fresh"), Some(1))
    );
    assert_eq!(app.get("/params").json()["items"], json!([params]));
}

#[test]
fn json_and_bindings_lead_to_the_same_measurements() {
    let app = TestApp::at("2026-12-01T00:00:00Z", |_| {});
    let document = json!({
        "model": "rc2", "channels": {"T_room": "T_indoor", "T_out": "weather"},
        "location": {"lat": 56.5, "lon": 10.0, "zone": "Europe/Copenhagen"}
    });
    app.json("PUT", "/systems/room/1", &document).expect(201);
    let rows = room(3, 2);
    let body = json!({
        "channels": {"T_indoor": {"unit": "degF"}, "weather": {"unit": "degC"}},
        "time": rows.iter().map(|row| row.0.clone()).collect::<Vec<_>>(),
        "values": {
            "T_indoor": rows.iter().enumerate().map(|(k, row)| if k == 5 { Value::Null } else { json!(row.1 * 1.8 + 32.0) }).collect::<Vec<_>>(),
            "weather": rows.iter().map(|row| row.2).collect::<Vec<_>>(),
        },
    });
    let report = app.json("POST", "/systems/room/1/windows", &body).expect(201).json();
    assert_eq!(
        (report["channels"]["T_room"]["unit"].as_str(), report["channels"]["T_room"]["missing"].as_u64()),
        (Some("degC"), Some(1)),
        "{report}"
    );
    assert!(
        (report["channels"]["T_room"]["max"].as_f64().unwrap()
            - rows.iter().map(|row| row.1).fold(f64::MIN, f64::max))
        .abs()
            < 1e-6
    );
    // A file without a bound column is taken, and says so: a slip in a binding would look the same.
    let weather = app
        .csv(
            "/systems/room/1/windows",
            "time,weather[degC]\n2026-02-01T00:00:00Z,1\n2026-02-01T01:00:00Z,2\n",
        )
        .expect(201)
        .json();
    assert!(weather["warnings"].to_string().contains("T_indoor"), "{weather}");
}

#[test]
fn a_restart_changes_nothing_that_is_served() {
    let mut app = TestApp::start();
    app.room("1", 1);
    app.ended(&app.estimate("room/1", json!({})));
    let before = app.get("/params/room/1").expect(200);
    let state = app.get("/systems/room/1/state").expect(200).text;
    let effect =
        app.json("POST", "/models/rc2/effects", &json!({"effect": "constant_gain"})).expect(201).json();
    app.restart();
    let after = app.get("/params/room/1").expect(200);
    assert_eq!((after.header("etag"), &after.text), (before.header("etag"), &before.text));
    assert_eq!(app.get("/systems/room/1/state").text, state);
    assert_eq!(app.get("/models/rc2+constant_gain").expect(200).json()["parent"], effect["parent"]);
    app.ended(&app.estimate("room/1", json!({"method": {"name": "lm_multistart", "seed": 2}})));
    let revision = app.get("/params/room/1").json()["revision"].as_i64().unwrap();
    assert!((1..=2).contains(&revision));
}

#[test]
fn a_job_that_a_stop_interrupts_runs_again_without_a_charge() {
    let mut app = TestApp::start();
    app.room("1", 1);
    let job = app.json("POST", "/jobs", &crate::support::endless("room/1")).expect(202).json()["id"]
        .as_str()
        .unwrap()
        .to_owned();
    app.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
    app.restart();
    let running = app.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
    assert_eq!(running["attempt"], 1, "the first attempt was given back");
    app.post(&format!("/jobs/{job}/cancel")).expect(200);
    assert_eq!(app.ended(&job)["state"], "cancelled");
}

#[test]
fn a_neighbour_that_is_a_system_lends_its_measurements() {
    let app = TestApp::start();
    app.room("2", 2);
    app.json("PUT", "/systems/room/1", &json!({"model": "room3", "neighbours": ["room/2"]})).expect(201);
    let mut text = "time,T_room[degC],T_out[degC],T_forward[degC],irradiance[W/m2]\n".to_owned();
    for (k, (time, room, out)) in room(1, 14).into_iter().enumerate() {
        text.push_str(&format!(
            "{time},{room:.3},{out:.3},{:.1},{:.0}\n",
            30.0 + (k % 7) as f64,
            (k % 48) as f64 * 10.0
        ));
    }
    app.csv("/systems/room/1/windows", &text).expect(201);
    let body = {
        let mut body = quick("room/1");
        body["budget"]["evaluations"] = json!(300);
        body
    };
    let job = app.json("POST", "/jobs", &body).expect(202).json()["id"].as_str().unwrap().to_owned();
    let ended = app.ended(&job);
    assert_eq!(ended["state"], "succeeded", "{ended}");
    let fit = app.get(&format!("/fits/{}", ended["fit"].as_str().unwrap())).json();
    assert!(fit["parameters"]["alpha_n[2]"]["value"].is_f64(), "{}", fit["parameters"]);
}
