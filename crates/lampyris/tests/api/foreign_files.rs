//! Files as other programs write them.

use crate::support::TestApp;
use lampyris_core::twin::{HouseRequest, house};
use serde_json::json;

const GERMAN: &str = "Datum;Raum 1 Temperatur (°C);Raum 2 Temperatur (°C);Raum 1 Ventil;Außentemperatur\r\n\
    31.01.2026 12:00;21,5;20,1;0,4;-3,25\r\n31.01.2026 12:10;21,25;n/a;0,5;-3\r\n";

/// As a program for Windows writes it.
fn windows_1252(text: &str) -> Vec<u8> {
    text.chars().map(|letter| u8::try_from(u32::from(letter)).unwrap()).collect()
}

#[test]
fn a_file_of_another_program_is_read_by_the_zone_of_the_system() {
    let app = TestApp::at("2026-02-15T00:00:00Z", |_| {});
    let room = |zone: &str, channels: serde_json::Value| {
        let place = json!({"lat": 52.5, "lon": 13.4, "zone": zone});
        let place = if zone.is_empty() { json!(null) } else { place };
        json!({"model": "rc1", "location": place, "channels": channels})
    };
    let channels = json!({"T_room": "Raum 1 Temperatur (°C)", "T_out": "Außentemperatur[degC]"});
    app.json("PUT", "/systems/room/1", &room("Europe/Berlin", channels.clone())).expect(201);
    app.json("PUT", "/systems/room/2", &room("", channels)).expect(201);
    let send = |path: &str| {
        app.send("POST", path, &[("content-type", "text/csv")], Some(&windows_1252(GERMAN))).unwrap()
    };
    let taken = send("/systems/room/1/windows?columns=bound").expect(201).json();
    assert_eq!((&taken["from"], &taken["rows"]), (&json!("2026-01-31T11:00:00Z"), &json!(2)));
    let names: Vec<&String> = taken["channels"].as_object().unwrap().keys().collect();
    assert_eq!(names, ["T_room", "T_out"], "only what the system binds");
    assert_eq!(taken["channels"]["T_out"]["min"], -3.25);
    let said = taken["warnings"][0].as_str().unwrap();
    assert!(said.contains("windows-1252") && said.contains("Europe/Berlin"), "{said}");
    // Nobody has said the zone of the other one.
    let problem = send("/systems/room/2/windows").problem(422, "invalid-request");
    assert_eq!(problem["errors"][0]["code"], "naive-time", "{problem}");
    let taken = send("/systems/room/2/windows?zone=America/New_York").expect(201).json();
    assert_eq!(taken["from"], "2026-01-31T17:00:00Z");
    let wrong = send("/systems/room/2/windows?zone=Middle/Earth").problem(422, "invalid-request");
    assert_eq!(wrong["errors"][0]["pointer"], "/zone");
}

#[test]
fn a_name_with_a_comma_is_not_absent() {
    let app = TestApp::at("2026-02-15T00:00:00Z", |_| {});
    let channels = json!({"T_room": "Temperatur, innen", "T_out": "Außen"});
    app.json("PUT", "/systems/room/1", &json!({"model": "rc1", "channels": channels})).expect(201);
    let body = "time,\"Temperatur, innen\"\n2026-01-31T12:00:00Z,21.5\n2026-01-31T12:10:00Z,21.25\n";
    let path = "/systems/room/1/windows";
    let taken = app
        .send("POST", path, &[("content-type", "text/csv")], Some(body.as_bytes()))
        .unwrap()
        .expect(201)
        .json();
    let names: Vec<&String> = taken["channels"].as_object().unwrap().keys().collect();
    assert_eq!(names, ["T_room"]);
    let warnings = taken["warnings"].as_array().unwrap();
    assert!(warnings.len() == 1 && warnings[0].as_str().unwrap().contains("`T_out`"), "{warnings:?}");
}

#[test]
fn what_commas_mean_is_asked_where_nothing_says_it() {
    let app = TestApp::start();
    let ask = |query: &str| {
        let body = b"time,P_heater[W]\n2026-01-31T12:00:00Z,\"1,250\"\n2026-01-31T12:10:00Z,\"1,350\"\n";
        let path = format!("/windows/recognise{query}");
        app.send("POST", &path, &[("content-type", "text/csv")], Some(body)).unwrap()
    };
    let problem = ask("").problem(422, "invalid-request");
    assert_eq!(problem["errors"][0]["code"], "ambiguous-decimals", "{problem}");
    assert_eq!(ask("?decimal=point").expect(200).json()["columns"][0]["first"], json!([1250.0, 1350.0]));
    assert_eq!(ask("?decimal=comma").expect(200).json()["columns"][0]["first"], json!([1.25, 1.35]));
}

#[test]
fn what_a_file_is_can_be_asked_before_anything_is_kept() {
    let app = TestApp::start();
    let ask = |query: &str, body: &[u8]| {
        let path = format!("/windows/recognise{query}");
        app.send("POST", &path, &[("content-type", "text/csv")], Some(body)).unwrap()
    };
    let open = ask("", &windows_1252(GERMAN)).expect(200).json();
    assert_eq!((&open["asks"], &open["dialect"]["decimal"]), (&json!(["zone"]), &json!("comma")));
    let read = ask("?zone=Europe/Berlin", &windows_1252(GERMAN)).expect(200).json();
    assert_eq!((&read["asks"], &read["from"]), (&json!([]), &json!("2026-01-31T11:00:00Z")));
    let column = |at: usize, field: &str| read["columns"][at][field].clone();
    assert_eq!(
        (column(1, "channel"), column(1, "room"), column(1, "first")),
        (json!("T_room"), json!("raum_2"), json!([20.1, null]))
    );
    assert_eq!(read["rooms"].as_array().unwrap().len(), 2);
    ask("", b"no table at all").problem(422, "invalid-request");
    // A house of many sensors says which rooms are next door.
    let request = HouseRequest { seed: 4, days: 8, step_minutes: 15, lived_in: false };
    let house = house(&request).unwrap();
    let read = ask("", house.csv.as_bytes()).expect(200).json();
    let rooms = read["rooms"].as_array().unwrap();
    let sensors: usize = house.rooms.iter().map(|room| room.sensors.len()).sum();
    assert_eq!(rooms.len(), sensors, "{rooms:?}");
    assert!(read["neighbours"].as_array().unwrap().len() > 3, "{}", read["neighbours"]);
}
