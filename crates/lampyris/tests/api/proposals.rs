//! Terms that no catalogue has: proposed over HTTP, taken as they are, and fitted.

use crate::lines::fitted;
use crate::support::TestApp;
use crate::support::rooms::room;
use crate::support::schema::disagreements;
use serde_json::json;
use std::fmt::Write;

/// Above so many kilowatts the machine is not on stand-by any more, and warms the room.
const STAND_BY: f64 = 0.3;
/// What a kilowatt more does, in K/h.
const WARMS: f64 = 1.5;

/// Three weeks of the small room with the meter of a machine that runs at other hours every day.
fn warmed() -> String {
    warmed_by(WARMS)
}

fn warmed_by(warms: f64) -> String {
    let mut extra = 0.0;
    let mut csv = "time,T_room[degC],T_out[degC],x1[kW]\n".to_owned();
    for (at, (time, room, out)) in room(3, 21).into_iter().enumerate() {
        let (day, half) = (at / 48, at % 48);
        let from = (day * 17 + 5) % 41;
        let power = if (from..from + 7).contains(&half) { 0.5 + 0.25 * (day % 5) as f64 } else { 0.1 };
        let _ = writeln!(csv, "{time},{:.3},{out:.3},{power:.2}", room + extra);
        extra += 0.5 * (warms * (power - STAND_BY).max(0.0) - 0.8 * extra);
    }
    csv
}

#[test]
fn a_meter_that_no_effect_knows_is_proposed_and_its_document_is_taken_as_it_is() {
    let app = TestApp::at("2026-01-22T00:00:00Z", |_| {});
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    app.csv("/systems/room/1/windows", &warmed()).expect(201);
    let id = fitted(&app, "1", json!({}));
    let told = app.get(&format!("/fits/{id}/proposals")).expect(200).json();
    let schemas = lampyris::http::described_documents();
    assert_eq!(disagreements(&told, &schemas["Proposals"], &schemas, ""), [""; 0]);
    assert_eq!([&told["fit"], &told["system"]], [&json!(id), &json!("room/1")]);
    let best = &told["proposals"][0];
    assert!(best["sentence"].as_str().unwrap().contains("x1"), "{told:#}");
    assert!(best["left"].as_f64() < Some(0.5), "{best:#}");
    // Again it is the same, to the bit.
    assert_eq!(app.get(&format!("/fits/{id}/proposals")).expect(200).json(), told);
    // Its document is an effect at once, in TOML as in JSON.
    let toml = best["toml"].as_str().unwrap();
    let toml_of = |text: &str| {
        let kind = [("content-type", "application/toml")];
        app.send("POST", "/effects", &kind, Some(text.as_bytes())).unwrap()
    };
    toml_of(toml).expect(201);
    app.json("POST", "/effects", &best["document"]).expect(200);
    let grown =
        app.json("POST", "/models/rc2/effects", &json!({"effect": best["effect"]})).expect(201).json();
    let with = fitted(&app, "1", json!({"model": grown["id"], "experiment": true}));
    let error = |id: &str| {
        let fit = app.get(&format!("/fits/{id}")).expect(200).json();
        fit["metrics"]["T_room"]["validation_rmse"].as_f64().unwrap()
    };
    assert!(error(&with) < 0.9 * error(&id), "{} with it, {} without", error(&with), error(&id));
    let broken = toml_of("id = ").expect(400).json();
    assert_eq!(broken["errors"][0]["code"], "invalid-toml", "{broken}");
}

#[test]
fn what_three_rooms_have_taken_is_tried_in_all_others() {
    let app = TestApp::at("2026-01-22T00:00:00Z", |_| {});
    let rooms = [("1", 1.5), ("2", 1.1), ("3", 1.9), ("4", 1.4)];
    for (name, warms) in rooms {
        app.json("PUT", &format!("/systems/room/{name}"), &json!({"model": "rc2"})).expect(201);
        app.csv(&format!("/systems/room/{name}/windows"), &warmed_by(warms)).expect(201);
    }
    let best = |name: &str| {
        let fit = fitted(&app, name, json!({}));
        app.get(&format!("/fits/{fit}/proposals")).expect(200).json()["proposals"][0].clone()
    };
    let first = best("1");
    let id = first["effect"].as_str().unwrap();
    assert_eq!(first["known"], false, "{first:#}");
    app.json("POST", "/effects", &first["document"]).expect(201);
    // The term of the next room is the same with other numbers: it goes under the name that is known.
    let second = best("2");
    assert_eq!([&second["effect"], &second["known"]], [&first["effect"], &json!(true)], "{second:#}");
    assert_eq!(second["document"], first["document"]);
    assert_ne!(second["size"], first["size"]);
    let listed = || {
        let all = app.get("/effects?page_size=500").expect(200).json();
        let all = all["items"].as_array().unwrap().clone();
        all.into_iter().find(|effect| effect["id"] == id).unwrap()
    };
    let with = format!("rc2+{id}");
    app.json("POST", "/models/rc2/effects", &json!({ "effect": id })).expect(201);
    let tried = || {
        let job = json!({"kind": "diagnose", "system": "room/4"});
        let done = app.ended(app.json("POST", "/jobs", &job).expect(202).json()["id"].as_str().unwrap());
        let told = app.get(&format!("/diagnoses/{}", done["diagnosis"].as_str().unwrap())).expect(200).json();
        let of = |part: &str| told[part].as_array().unwrap().iter().any(|one| one["effect"] == id);
        of("findings") || of("considered") || of("not_testable")
    };
    for (count, (name, _)) in rooms.iter().take(3).enumerate() {
        assert_eq!([&listed()["systems"], &listed()["tried"]], [&json!(count), &json!(false)]);
        app.json("PUT", &format!("/systems/room/{name}"), &json!({ "model": with })).expect(200);
        assert_eq!(count == 2, tried(), "with {} rooms", count + 1);
    }
    assert_eq!([&listed()["systems"], &listed()["tried"]], [&json!(3), &json!(true)]);
}
