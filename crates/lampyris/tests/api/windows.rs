//! Uploaded windows: what a fit cites, and what can be deleted.

use crate::support::rooms::{room, room_csv};
use crate::support::{TestApp, endless};
use serde_json::{Value, json};

fn id(document: &Value) -> String {
    document["id"].as_str().unwrap().to_owned()
}

fn delete(app: &TestApp, path: &str) -> crate::support::Answer {
    app.send("DELETE", path, &[], None).unwrap()
}

/// Runs a quick estimate and gives what it found.
fn fit(app: &TestApp, system: &str, more: Value) -> Value {
    let ended = app.ended(&app.estimate(system, more));
    app.get(&format!("/fits/{}", ended["fit"].as_str().unwrap_or_else(|| panic!("{ended}"))))
        .expect(200)
        .json()
}

#[test]
fn a_fit_cites_what_it_has_seen_and_nothing_else_is_kept_by_force() {
    let app = TestApp::at("2026-12-01T00:00:00Z", |_| {});
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    let upload = |text: &str| id(&app.csv("/systems/room/1/windows", text).expect(201).json());
    // Wholly covered by the record; part of the record; a correction of some samples; beyond what the fit
    // asks for.
    let covered = upload("time,T_room,T_out\n2026-01-03T00:00:00Z,1,1\n2026-01-03T00:30:00Z,1,1\n");
    let record = upload(&room_csv(1, 14));
    let rows = room(1, 14);
    let correction: String =
        rows[100..110].iter().map(|(time, room, _)| format!("{time},{:.3}\n", room + 0.01)).collect();
    let correction = upload(&format!("time,T_room\n{correction}"));
    let later = upload("time,T_room,T_out\n2026-03-01T00:00:00Z,20,1\n2026-03-01T00:30:00Z,20,1\n");
    let fit = fit(&app, "room/1", json!({"window": {"to": "2026-01-15T00:00:00Z"}}));
    assert_eq!(fit["windows"], json!([record, correction]));

    for cited in [&record, &correction] {
        let problem = delete(&app, &format!("/windows/{cited}")).problem(409, "window-cited");
        assert_eq!(problem["fits"], json!([fit["id"]]));
        app.get(&format!("/windows/{cited}")).expect(200);
    }
    for free in [&covered, &later] {
        assert_eq!(delete(&app, &format!("/windows/{free}")).expect(204).text, "");
        app.get(&format!("/windows/{free}")).problem(404, "window-not-found");
        delete(&app, &format!("/windows/{free}")).problem(404, "window-not-found");
    }
    assert_eq!(app.get("/systems/room/1/windows").json()["items"].as_array().unwrap().len(), 2);
    assert_eq!(app.get("/systems/room/1/series").json()["to"], "2026-01-14T23:30:00Z");
}

#[test]
fn what_a_window_covered_shows_again_when_it_is_gone() {
    let app = TestApp::start();
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    app.csv("/systems/room/1/windows", "time,T_room\n2026-01-03T00:00:00Z,20\n2026-01-03T00:30:00Z,21\n")
        .expect(201);
    let wrong = "time,T_room\n2026-01-03T00:00:00Z,30\n2026-01-03T00:30:00Z,31\n";
    let first = id(&app.csv("/systems/room/1/windows", wrong).expect(201).json());
    let values = || app.get("/systems/room/1/series").json()["channels"]["T_room"]["values"].clone();
    assert_eq!(values(), json!([30.0, 31.0]));
    delete(&app, &format!("/windows/{first}")).expect(204);
    assert_eq!(values(), json!([20.0, 21.0]));
    // What is gone is new again when it comes again.
    assert_eq!(id(&app.csv("/systems/room/1/windows", wrong).expect(201).json()), first);
    assert_eq!(values(), json!([30.0, 31.0]));
}

#[test]
fn a_running_job_keeps_its_windows_and_those_of_its_neighbours() {
    let app = TestApp::start();
    app.room("1", 1);
    app.room("2", 2);
    app.room("3", 3);
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "neighbours": ["room/2"]})).expect(200);
    let window = |room: &str| {
        format!("/windows/{}", id(&app.get(&format!("/systems/room/{room}/windows")).json()["items"][0]))
    };
    let job = id(&app.json("POST", "/jobs", &endless("room/1")).expect(202).json());
    app.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
    for room in ["1", "2"] {
        assert_eq!(delete(&app, &window(room)).problem(409, "window-in-use")["jobs"], json!([job]));
    }
    delete(&app, &window("3")).expect(204);
    app.post(&format!("/jobs/{job}/cancel")).expect(200);
    app.ended(&job);
    delete(&app, &window("2")).expect(204);
    delete(&app, &window("1")).expect(204);
}

#[test]
fn every_unit_rule_of_the_surface() {
    let app = TestApp::start();
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    let twice = |header: &str, cells: &str| {
        format!("{header}\n2026-01-01T00:00:00Z,{cells}\n2026-01-01T00:10:00Z,{cells}\n")
    };
    // Header, cell, channel, unit and value as they are kept.
    let cases = [
        ("T_room[degC]", "20.5", "T_room", "degC", 20.5),
        ("T_room[degF]", "68", "T_room", "degC", 20.0),
        ("T_room[K]", "300.15", "T_room", "degC", 27.0),
        ("T_room_degC", "21", "T_room", "degC", 21.0),
        ("T_room", "21.5", "T_room", "degC", 21.5),
        ("P_heater[W]", "1500", "P_heater", "kW", 1.5),
        ("P_heater_W", "250", "P_heater", "kW", 0.25),
        ("P_heater_kW", "2.5", "P_heater", "kW", 2.5),
        ("P_heater", "3.5", "P_heater", "kW", 3.5),
        ("irradiance_W_m2", "420", "irradiance", "W/m2", 420.0),
        ("irradiance[kW/m2]", "0.5", "irradiance", "W/m2", 500.0),
        ("wind_speed_m_s", "4", "wind_speed", "m/s", 4.0),
        ("wind_speed[km/h]", "36", "wind_speed", "m/s", 10.0),
        ("CO2_ppm", "650", "CO2", "ppm", 650.0),
        ("valve_pct", "35", "valve", "-", 0.35),
        ("valve_frac", "0.4", "valve", "-", 0.4),
        ("cloud_cover[%]", "50", "cloud_cover", "-", 0.5),
        ("RH_room_pct", "45", "RH_room", "pct", 45.0),
        ("plug load[W]", "12", "plug load", "W", 12.0),
        ("a_W[degC]", "12", "a_W", "degC", 12.0),
        ("something", "12", "something", "-", 12.0),
    ];
    for (header, cell, channel, unit, value) in cases {
        let report = app.csv("/systems/room/1/windows", &twice(&format!("time,{header}"), cell)).json();
        let found = &report["channels"][channel];
        assert_eq!(found["unit"], unit, "{header}: {report}");
        assert!(
            (found["min"].as_f64().unwrap() - value).abs() < 1e-9 && found["min"] == found["max"],
            "{header}: {report}"
        );
        let numbers = vec![cell.parse::<f64>().unwrap(); 2];
        // The same column in JSON is the same window, whether the name or `channels` says the unit.
        let mut body = json!({
            "time": ["2026-01-01T01:00:00+01:00", "2026-01-01T00:10:00Z"], "values": {header: numbers}
        });
        assert_eq!(
            id(&app.json("POST", "/systems/room/1/windows", &body).expect(200).json()),
            id(&report),
            "{header}"
        );
        if let Some((name, stated)) = header.trim_end_matches(']').split_once('[') {
            body["values"] = json!({name: numbers});
            body["channels"] = json!({name: {"unit": stated}});
            assert_eq!(
                id(&app.json("POST", "/systems/room/1/windows", &body).expect(200).json()),
                id(&report),
                "{header}"
            );
        }
    }
    // What is not stated must be plausible.
    let refused = |header: &str, cell: &str| {
        let problem = app
            .csv("/systems/room/1/windows", &twice(&format!("time,{header}"), cell))
            .problem(422, "invalid-request");
        ["code", "suggestion"]
            .map(|field| problem["errors"][0][field].as_str().unwrap_or_default().to_owned())
    };
    for (header, cell, unit) in [
        ("T_room", "68", "T_room[degF]"),
        ("T_out", "274.1", "T_out[K]"),
        ("P_heater", "1500", "P_heater[W]"),
        ("valve", "80", "valve[pct]"),
    ] {
        let [code, suggestion] = refused(header, cell);
        assert!(code == "implausible-values" && suggestion.contains(unit), "{header}: {code}, {suggestion}");
    }
    assert_eq!(refused("T_room[furlong]", "1")[0], "unknown-unit");
    assert_eq!(refused("T_room_W", "1")[0], "inconvertible-unit");
    let doubted = app.csv("/systems/room/1/windows", &twice("time,P_lamp", "60")).expect(201).json();
    assert!(doubted["warnings"][0].as_str().unwrap().contains("P_lamp[W]"), "{doubted}");
}

#[test]
fn a_unit_that_can_never_be_stitched_is_refused() {
    let app = TestApp::start();
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    let window = |column: &str, day: u32| {
        format!("time,{column}\n2026-01-{day:02}T00:00:00Z,1\n2026-01-{day:02}T00:10:00Z,2\n")
    };
    app.csv("/systems/room/1/windows", &window("meter[kW]", 1)).expect(201);
    app.csv("/systems/room/1/windows", &window("meter[W]", 2)).expect(201);
    let problem =
        app.csv("/systems/room/1/windows", &window("meter[degC]", 3)).problem(422, "invalid-request");
    assert_eq!(
        (problem["errors"][0]["code"].as_str(), problem["errors"][0]["pointer"].as_str()),
        (Some("unit-conflict"), Some("/values/meter"))
    );
    // What converts is shown in the newest unit.
    let meter = app.get("/systems/room/1/series").expect(200).json()["channels"]["meter"].clone();
    assert_eq!(
        (meter["unit"].as_str(), &meter["values"]),
        (Some("W"), &json!([1000.0, 2000.0, null, 1.0, 2.0]))
    );
}

#[test]
fn rows_are_taken_or_named() {
    let app = TestApp::start();
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    // A hundred good rows, with mixed offsets, then every kind of rubbish once.
    let good = |k: i64| {
        let instant = jiff::Timestamp::new(1_767_225_600 + 600 * k, 0).unwrap();
        let zone = jiff::tz::TimeZone::fixed(jiff::tz::offset((k % 3) as i8 - 1));
        instant.to_zoned(zone).strftime("%Y-%m-%dT%H:%M:%S%:z").to_string()
    };
    let mut text = "time,T_room,T_out\n".to_owned();
    for k in 0..100 {
        // One missing cell, one gap of two hours, and a sensor that hangs for an hour.
        let gap = if k >= 50 { 11 } else { 0 };
        let room = if (20..=26).contains(&k) { 20.0 } else { 20.0 + 0.01 * (k + 1) as f64 };
        text += &format!(
            "{},{room},{}\n",
            good(k + gap),
            if k == 7 { "null".to_owned() } else { format!("{}", k % 9) }
        );
    }
    let last = good(110);
    for row in [
        format!("{last},20,5"),
        format!("{},20,5", good(60)),
        "tomorrow,20,5".into(),
        format!("{},NaN,5", good(120)),
        format!("{},20,-inf", good(121)),
        format!("{},warm,5", good(122)),
        format!("{},20", good(123)),
        "1767225600,20,5".into(),
    ] {
        text += &format!("{row}\n");
    }
    let problem = app.csv("/systems/room/1/windows", &text).problem(422, "invalid-request");
    assert_eq!(
        (problem["errors"].as_array().unwrap().len(), problem["errors"][0]["code"].as_str()),
        (1, Some("numeric-time")),
        "{problem}"
    );
    let text = text.replace("1767225600,20,5\n", "");
    let naive = text.replace("tomorrow", "2026-02-01T00:00:00");
    assert_eq!(
        app.csv("/systems/room/1/windows", &naive).problem(422, "invalid-request")["errors"][0]["code"],
        "naive-time"
    );

    let taken = app.csv("/systems/room/1/windows", &text).expect(201).json();
    let rejected: Vec<(u64, &str)> = taken["rejected_rows"]
        .as_array()
        .unwrap()
        .iter()
        .map(|row| (row["line"].as_u64().unwrap(), row["reason"].as_str().unwrap()))
        .collect();
    let expected = [
        (102, "the time is the same as that of the row before"),
        (103, "the time goes backwards"),
        (104, "the time cannot be read"),
        (108, "not the 3 cells of the header"),
    ];
    assert_eq!(rejected, expected);
    assert_eq!(
        (&taken["rows"], taken["from"].as_str(), taken["to"].as_str()),
        (&json!(103), Some("2026-01-01T00:00:00Z"), Some("2026-01-01T20:20:00Z"))
    );
    let room = &taken["channels"]["T_room"];
    let facts =
        ["missing", "median_step_s", "longest_gap_s", "stuck_s"].map(|name| room[name].as_i64().unwrap());
    assert_eq!(facts, [2, 600, 7_200, 3_600], "{room}");
    assert_eq!((room["min"].as_f64(), &taken["channels"]["T_out"]["missing"]), (Some(20.0), &json!(2)));
    let warnings = taken["warnings"].as_array().unwrap();
    assert!(warnings.iter().any(|warning| warning.as_str().unwrap().contains("line 107: `warm`")), "{taken}");
    assert_eq!(app.csv("/systems/room/1/windows", &text).expect(200).json(), taken);
    // More than a tenth of rubbish is a misunderstanding, not a slip.
    let mostly: String =
        text.lines().take(20).chain(text.lines().skip(101)).map(|line| format!("{line}\n")).collect();
    let problem = app.csv("/systems/room/1/windows", &mostly).problem(422, "invalid-request");
    assert!(
        problem["errors"].as_array().unwrap().iter().all(|fault| fault["code"] == "rejected-rows"),
        "{problem}"
    );
    assert_eq!(
        app.get("/systems/room/1/windows").json()["items"].as_array().unwrap().len(),
        1,
        "nothing that was refused is there"
    );
}

/// The measurements of a fortnight with another start, in UTC or on the clocks of a place.
fn fortnight(start: &str, zone: Option<&str>) -> String {
    let start: jiff::Timestamp = start.parse().unwrap();
    let mut text = "time,T_room,T_out\n".to_owned();
    for (k, (_, room, out)) in room(1, 14).into_iter().enumerate() {
        let instant = start + jiff::SignedDuration::from_mins(30 * k as i64);
        let time = zone.map_or(instant.to_string(), |zone| {
            instant.in_tz(zone).unwrap().strftime("%Y-%m-%dT%H:%M:%S%:z").to_string()
        });
        text += &format!("{time},{room:.3},{out:.3}\n");
    }
    text
}

#[test]
fn clock_changes_do_not_touch_a_fit() {
    let app = TestApp::at("2026-12-01T00:00:00Z", |_| {});
    // Over both days of the change: one has no 02:30, the other has it twice.
    for (day, start) in [("spring", "2026-03-22T00:00:00Z"), ("autumn", "2026-10-18T00:00:00Z")] {
        let found: Vec<Value> = [("local", Some("Europe/Copenhagen")), ("utc", None)]
            .into_iter()
            .map(|(clock, zone)| {
                let system = format!("room/{day}-{clock}");
                app.json("PUT", &format!("/systems/{system}"), &json!({"model": "rc2"})).expect(201);
                let text = fortnight(start, zone);
                assert_eq!(text.contains("+02:00") && text.contains("+01:00"), zone.is_some());
                app.csv(&format!("/systems/{system}/windows"), &text).expect(201);
                fit(&app, &system, json!({}))
            })
            .collect();
        assert_eq!(found[0]["input_hash"], found[1]["input_hash"]);
        // Numbers are written so that they read back to the same bits.
        assert_eq!(
            (&found[0]["parameters"], &found[0]["cost"]),
            (&found[1]["parameters"], &found[1]["cost"])
        );
        assert!(found[0]["parameters"]["alpha_e"]["value"].is_f64());
    }
}
