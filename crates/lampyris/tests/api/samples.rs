//! Live samples: they count at once, the states go on with them, and they cost the database what a window of
//! them does.

use crate::support::rooms::{csv_of, room};
use crate::support::{Answer, TODAY, TestApp};
use serde_json::{Value, json};

const STATE: &str = "/systems/room/1/state";

/// A room whose parameters are served, at the end of its fifteen days.
fn served() -> TestApp {
    let app = TestApp::at("2026-01-16T00:00:00Z", |_| {});
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    app.csv("/systems/room/1/windows", &csv_of(&room(1, 15))).expect(201);
    assert_eq!(app.ended(&app.estimate("room/1", json!({})))["outcome"], "accepted");
    app
}

fn post(app: &TestApp, values: &Value, time: &str) -> Value {
    let body = json!({"time": time, "values": values});
    app.json("POST", "/systems/room/1/samples", &body).expect(200).json()
}

fn windows(app: &TestApp, system: &str) -> Vec<Value> {
    let list = app.get(&format!("/systems/{system}/windows")).expect(200).json();
    list["items"].as_array().unwrap().clone()
}

#[test]
fn the_states_go_on_with_every_sample_as_a_filter_over_the_whole_does() {
    let (app, whole) = (served(), served());
    // As the sensor of the record writes them: its resolution says how much a value is believed.
    let written = |value: f64| (1000.0 * value).round() / 1000.0;
    let rows: Vec<(String, f64, f64)> = room(1, 16)
        .into_iter()
        .skip(15 * 48)
        .take(20)
        .map(|(time, room, out)| (time, written(room), written(out)))
        .collect();
    let today = &rows[..];
    // The first has nothing to go on from but the record, which is looked at behind it.
    let (time, temperature, out) = &today[0];
    let first = post(&app, &json!({"T_room": temperature, "T_out": out}), time);
    app.until(STATE, |state| state["at"] == time.as_str());
    for (time, temperature, out) in &today[1..] {
        // The sensor of the room is ahead of the weather: what is hidden waits and is not thrown away.
        let early = post(&app, &json!({"T_room": temperature}), time);
        assert!(early["state"]["at"].as_str().unwrap() < time.as_str(), "{early}");
        let taken = post(&app, &json!({"T_out": out}), time);
        assert_eq!(taken["state"]["at"], time.as_str(), "{taken}");
        assert_eq!((&taken["window"], &taken["state"]["revision"]), (&first["window"], &json!(1)));
    }
    let live = app.get(STATE).expect(200).json();
    let list = |of: &dyn Fn(&(String, f64, f64)) -> Value| today.iter().map(of).collect::<Vec<_>>();
    let window = json!({"time": list(&|row| json!(row.0)),
        "values": {"T_room": list(&|row| json!(row.1)), "T_out": list(&|row| json!(row.2))}});
    whole.json("POST", "/systems/room/1/windows", &window).expect(201);
    let last = &today[19].0;
    let filtered = whole.until(STATE, |state| state["at"] == last.as_str());
    for (name, value) in filtered["states"].as_object().unwrap() {
        let close = |of: &str| {
            let [live, whole] = [&live, &filtered].map(|state| state[of][name].as_f64().unwrap());
            assert!((live - whole).abs() < 1e-9, "{of} {name}: {live} {whole}");
        };
        close("states");
        close("sd");
        assert!(value.is_number());
    }
    assert_eq!(windows(&app, "room/1").len(), 2, "all samples of a day are one window");
    assert_eq!(windows(&app, "room/1")[0]["uploads"], 39);
}

#[test]
fn samples_count_at_once_and_whatever_comes_later_lies_over_them() {
    let mut app = TestApp::at("2026-01-16T00:00:00Z", |_| {});
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    // A sensor that is away is a missing value, whatever it calls that.
    let odd = json!({"time": ["2026-01-15T10:00:00Z", "2026-01-15T10:10:00Z", "2026-01-15T10:20:00Z"],
        "values": {"T_room": [20.0, "unavailable", "20.4"], "T_out": ["-", 4.0, 5.0]}});
    let taken = app.json("POST", "/systems/room/1/samples", &odd).expect(200).json();
    assert_eq!(taken["report"]["channels"]["T_room"]["samples"], 2, "{taken}");
    assert_eq!(taken["report"]["rejected_rows"], json!([]));
    assert_eq!(taken["state"], Value::Null, "nothing is served yet");
    let series = |app: &TestApp| -> Vec<Value> {
        let body = app.get("/systems/room/1/series?channels=T_room").expect(200).json();
        body["channels"]["T_room"]["values"].as_array().unwrap().clone()
    };
    assert_eq!(series(&app), [20.0, 20.4]);
    // The same sample again changes nothing, another value of it counts, and a start in between loses
    // nothing.
    post(&app, &json!({"T_room": 20.4}), "2026-01-15T10:20:00Z");
    post(&app, &json!({"T_room": 21.0}), "2026-01-15T10:20:00Z");
    app.restart();
    assert_eq!(series(&app), [20.0, 21.0]);
    // A window over it is newer, a sample over that is newer still, and what was covered shows again.
    let correction = "time,T_room\n2026-01-15T10:00:00Z,18\n2026-01-15T10:20:00Z,19\n";
    let correction = app.csv("/systems/room/1/windows", correction).expect(201).json();
    assert_eq!(series(&app), [18.0, 19.0]);
    post(&app, &json!({"T_room": 22.0}), "2026-01-15T10:20:00Z");
    assert_eq!(series(&app), [18.0, 22.0]);
    let path = format!("/windows/{}", correction["id"].as_str().unwrap());
    app.send("DELETE", &path, &[], None).unwrap().expect(204);
    assert_eq!(series(&app), [20.0, 22.0]);
    assert_eq!(windows(&app, "room/1").len(), 2);
    // Everything that is wrong is said, and nothing of it is kept.
    let refused = |body: Value| -> Answer { app.json("POST", "/systems/room/1/samples", &body) };
    let bad = json!({"time": "2027-01-15T10:30:00Z", "values": {"T_room[kW]": 20}});
    let faults = refused(bad).problem(422, "invalid-request");
    assert!(faults["errors"].as_array().is_some_and(|errors| !errors.is_empty()), "{faults}");
    let late = json!({"time": "2027-01-15T10:30:00Z", "values": {"T_room": 20}});
    assert_eq!(refused(late).problem(422, "invalid-request")["errors"][0]["code"], "future-time");
    refused(json!({"time": "2026-01-15T10:30:00Z"})).problem(422, "invalid-request");
    assert_eq!(series(&app), [20.0, 22.0]);
}

#[test]
fn samples_of_many_systems_are_taken_whatever_is_wrong_with_one() {
    let app = TestApp::at("2026-01-16T00:00:00Z", |_| {});
    for room in ["/systems/room/1", "/systems/room/2"] {
        app.json("PUT", room, &json!({"model": "rc2"})).expect(201);
    }
    let of = |system: &str, values: Value| json!({"system": system, "samples": {"values": values}});
    let samples = json!([
        of("room/1", json!({"T_room": 20.5})),
        of("room/9", json!({"T_room": 20.5})),
        of("room/2", json!({"T_room": "21.5", "T_out": null}))
    ]);
    let answer = app.json("POST", "/samples", &json!({"samples": samples})).expect(200).json();
    assert_eq!(answer["taken"], 2, "{answer}");
    assert_eq!(answer["refused"][0]["system"], "room/9");
    assert_eq!(answer["refused"][0]["errors"][0]["code"], "system-not-found");
    let newest = app.get("/systems/room/2/series").expect(200).json();
    let newest: jiff::Timestamp = newest["to"].as_str().unwrap().parse().unwrap();
    assert!(newest >= TODAY.parse().unwrap() && newest <= app.clock.now(), "without a time it is now");
}

#[test]
fn a_site_shares_its_weather_with_every_room_that_names_it() {
    let app = TestApp::at("2026-01-16T00:00:00Z", |_| {});
    app.json("PUT", "/systems/site/house", &json!({"label": "Home"})).expect(201);
    let shared = json!({"model": "rc2", "channels": {"T_out": "site/house:T_outside"}});
    app.json("PUT", "/systems/room/1", &shared).expect(201);
    app.json("PUT", "/systems/room/2", &json!({"model": "rc2"})).expect(201);
    let rows = room(1, 15);
    let csv = |of: &dyn Fn(&(String, f64, f64)) -> String, header: &str| {
        rows.iter().fold(header.to_owned(), |text, row| text + &of(row))
    };
    let own = csv(&|(time, room, _)| format!("{time},{room:.3}\n"), "time,T_room\n");
    let weather = csv(&|(time, _, out)| format!("{time},{out:.3}\n"), "time,T_outside[degC]\n");
    app.csv("/systems/room/1/windows", &own).expect(201);
    let site = app.csv("/systems/site/house/windows", &weather).expect(201).json();
    app.csv("/systems/room/2/windows", &csv_of(&rows)).expect(201);
    let fit = |system: &str| {
        let job = app.ended(&app.estimate(system, json!({})));
        assert_eq!(job["outcome"], "accepted", "{job}");
        app.get(&format!("/fits/{}", job["fit"].as_str().unwrap())).expect(200).json()
    };
    let (by_site, by_itself) = (fit("room/1"), fit("room/2"));
    assert_eq!(by_site["parameters"], by_itself["parameters"], "the same measurements, the same fit");
    assert!(by_site["windows"].as_array().unwrap().contains(&site["id"]), "it is cited");
    // A site has nothing to estimate, and goes only by force as long as somebody needs it.
    let job = app.json("POST", "/jobs", &json!({"kind": "estimate", "system": "site/house"}));
    job.problem(422, "invalid-request");
    app.get("/params/site/house").problem(404, "no-validated-parameters");
    app.send("DELETE", "/systems/site/house", &[], None).unwrap().problem(409, "system-needed");
}
