//! What flows that the model does not know of: over HTTP, as JSON and as CSV.

use crate::lines::{csv, fitted};
use crate::support::TestApp;
use crate::support::rooms::{csv_of, room};
use crate::support::schema::disagreements;
use serde_json::{Value, json};

/// Two weeks of the small room, which is warmed by an oven from 18 to 20 h: so many kelvins per hour.
const OVEN: f64 = 2.0;

/// The room forgets the air's part of it within hours, as the first-order part of its model does.
fn heated() -> String {
    let mut extra = 0.0;
    let samples: Vec<_> = room(1, 14)
        .into_iter()
        .enumerate()
        .map(|(at, (time, room, out))| {
            let shown = (time, room + extra, out);
            let is_on = (36..40).contains(&(at % 48));
            extra += 0.5 * (if is_on { OVEN } else { 0.0 } - 0.8 * extra);
            shown
        })
        .collect();
    csv_of(&samples)
}

#[test]
fn an_oven_that_nobody_logged_shows_at_its_hours() {
    let app = TestApp::start();
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    app.csv("/systems/room/1/windows", &heated()).expect(201);
    let id = fitted(&app, "1", json!({}));
    let path = format!("/fits/{id}/missing-heat");
    let told = app.get(&path).expect(200).json();
    let schemas = lampyris::http::described_documents();
    assert_eq!(disagreements(&told, &schemas["MissingHeat"], &schemas, ""), [""; 0]);
    assert_eq!(
        [&told["fit"], &told["system"], &told["output"], &told["unit"], &told["per_kilowatt"]],
        [&json!(id), &json!("room/1"), &json!("T_room"), &json!("K/h"), &Value::Null]
    );
    let hours = told["hours"].as_array().unwrap();
    assert!((330..=336).contains(&hours.len()), "{}", hours.len());
    let habits = told["habits"].as_array().unwrap();
    let warm = habits.iter().find(|habit| habit["rate"].as_f64() > Some(0.0)).unwrap();
    assert!(warm["events"].as_u64() >= Some(10), "{habits:?}");
    assert!([17, 18].contains(&warm["begins"].as_u64().unwrap()), "{habits:?}");
    assert!((0.4 * OVEN..1.3 * OVEN).contains(&warm["rate"].as_f64().unwrap()), "{habits:?}");
    assert!(told["sentences"].to_string().contains("events, mostly 18 to 20 h"), "{}", told["sentences"]);
    assert_eq!(told["week"].as_array().unwrap().len(), 168);

    // The same numbers as a table that a window takes.
    let table = app.get_with(&path, &[("accept", "text/csv")]).expect(200);
    let (columns, rows) = csv(&table.text);
    assert_eq!(columns[..2], ["time", "missing_T_r[K/h]"].map(str::to_owned));
    let known: Vec<&Value> = hours.iter().filter(|hour| !hour["rate"].is_null()).collect();
    assert_eq!(rows.len(), known.len());
    for (row, hour) in rows.iter().zip(known) {
        let numbers = [&hour["rate"], &hour["band_95"][0], &hour["band_50"][0], &hour["band_50"][1]];
        let read = |cell: &String| json!(cell.parse::<f64>().unwrap());
        assert_eq!(row[0], hour["from"].as_str().unwrap());
        assert!(row[1..5].iter().zip(numbers).all(|(cell, number)| read(cell) == *number), "{row:?} {hour}");
    }
    app.json("PUT", "/systems/room/2", &json!({"model": "rc2"})).expect(201);
    app.csv("/systems/room/2/windows", &table.text).expect(201);

    let problem = app.get(&format!("{path}?output=T_rooms")).problem(422, "invalid-request");
    assert_eq!(problem["errors"][0]["code"], "unknown-output");
    app.get(&format!("{path}?outptu=T_room")).problem(422, "invalid-request");
    app.get_with(&path, &[("accept", "image/png")]).expect(406);
    app.get("/fits/fit_none/missing-heat").problem(404, "fit-not-found");
    app.get("/diagnoses/dia_none/missing-heat").problem(404, "diagnosis-not-found");
}
