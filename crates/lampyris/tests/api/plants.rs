//! A treatment plant from its record to the parameters that its controller reads.

use crate::support::TestApp;
use lampyris_core::model::Catalogue;
use lampyris_core::twin::{PlantRequest, plant};
use serde_json::json;

const EFFLUENTS: [&str; 4] = ["S_S_e", "X_S_e", "S_NH_e", "S_NO_e"];
/// Rows of five minutes in a day.
const PER_DAY: usize = 288;

/// The record of a plant whose nitrifiers grow this fast; the weather and the noise are the same always.
fn record(mu_a: f64) -> Vec<String> {
    let values = [("mu_A", mu_a), ("Y_H", 0.62)];
    let request =
        PlantRequest { seed: 11, model: "asm1_h", values: &values, days: 6, noise: 1.0, warm_up: false };
    plant(&Catalogue::builtin().unwrap(), &request).unwrap().csv.lines().map(str::to_owned).collect()
}

/// Some days of a record as an upload.
fn days(lines: &[String], from: usize, to: usize) -> String {
    [&lines[..1], &lines[1 + from * PER_DAY..1 + to * PER_DAY]].concat().join("\n")
}

/// The same with an analyser of ammonium that hangs for the last 30 hours.
fn hanging(csv: &str) -> String {
    let lines: Vec<&str> = csv.lines().collect();
    let place = lines[0].split(',').position(|name| name == "S_NH_e").unwrap();
    let from = lines.len() - 30 * 12;
    let one = |(row, line): (usize, &&str)| {
        let mut cells: Vec<&str> = line.split(',').collect();
        if row >= from && !cells[place].is_empty() {
            cells[place] = "2.5";
        }
        cells.join(",")
    };
    lines.iter().enumerate().map(one).collect::<Vec<_>>().join("\n")
}

#[test]
fn a_plant_is_estimated_judged_and_served_as_a_room_is() {
    let app = TestApp::at("2026-01-18T00:00:00Z", |_| {});
    let policy = json!({"refit_when_degraded": false});
    let fixed = json!({"b_H": 0.62, "mu_H": 6.0, "K_OA": 0.5, "K_NH": 1.0, "K_S": 20.0});
    app.json(
        "PUT",
        "/systems/plant/north",
        &json!({"label": "North", "model": "asm1_h", "policy": policy, "fixed": fixed}),
    )
    .expect(201);
    let (plant, weak) = (record(0.55), record(0.36));
    let windows = "/systems/plant/north/windows";
    app.csv(windows, &days(&plant, 0, 4)).expect(201);
    let body = json!({
        "kind": "estimate", "system": "plant/north",
        "split": {"train": "P3D", "validation": "P1D"}, "method": {"name": "lm_multistart", "seed": 1},
    });
    let ended = app.ended(&app.post_job(&body));
    assert_eq!((&ended["state"], &ended["outcome"]), (&json!("succeeded"), &json!("accepted")), "{ended}");

    let params = app.get("/params/plant/north").expect(200).json();
    assert_eq!(
        (&params["status"], &params["revision"], &params["model"]),
        (&json!("fresh"), &json!(1), &json!("asm1_h")),
        "{params}"
    );
    let value = |name: &str| params["parameters"][name].as_f64().unwrap();
    assert!(
        (value("mu_A") / 0.55 - 1.0).abs() < 0.03 && (value("Y_H") / 0.62 - 1.0).abs() < 0.03,
        "{params}"
    );
    assert_eq!((value("b_H"), &params["units"]["mu_A"]), (0.62, &json!("1/d")));
    assert_eq!((&params["job"], &params["window"]["from"]), (&ended["id"], &json!("2026-01-12T00:00:00Z")));
    let noise = [0.03, 0.004, 0.1, 0.07];
    for (channel, noise) in EFFLUENTS.iter().zip(noise) {
        let error = &params["error"][channel];
        assert_eq!((&error["unit"], &error["ahead"]), (&json!("g/m3"), &json!({})), "{channel}: {error}");
        for part in ["train_rmse", "validation_rmse"] {
            let rmse = error[part].as_f64().unwrap();
            assert!((0.7 * noise..1.3 * noise).contains(&rmse), "{channel} {part}: {rmse}");
        }
    }
    let fit = app.get(&format!("/fits/{}", params["fit"].as_str().unwrap())).expect(200).json();
    let persistence = fit["checks"]
        .as_array()
        .unwrap()
        .iter()
        .find(|check| check["name"] == "G4 beats persistence")
        .unwrap()
        .clone();
    assert!(persistence["comment"].as_str().unwrap().starts_with("the free run errs by"), "{persistence}");
    let heat = app.get(&format!("/fits/{}/missing-heat", params["fit"].as_str().unwrap()));
    assert_eq!(heat.problem(422, "invalid-request")["errors"][0]["code"], "no-missing-heat");
    // The states are those of a free run, and say so.
    let state = app.get("/systems/plant/north/state").expect(200).json();
    assert_eq!(
        (&state["free_run"], &state["sd"], &state["revision"]),
        (&json!(true), &json!({}), &json!(1)),
        "{state}"
    );
    assert!(state["states"]["S_NH[aerobic]"].as_f64().unwrap() > 0.0);

    // An analyser that hangs: the parameters stay, and it is said why.
    app.csv(windows, &hanging(&days(&plant, 0, 4))).expect(201);
    assert_eq!(app.ended(&app.post_job(&body))["outcome"], "rejected");
    let fallen = app.get("/params/plant/north").expect(200).json();
    assert_eq!((&fallen["status"], &fallen["parameters"]), (&json!("fallback"), &params["parameters"]));
    assert!(
        fallen["fallback"]["failed_checks"].as_array().unwrap().contains(&json!("G8 not stuck")),
        "{fallen}"
    );

    // The next two days as the plant goes on: the states move with them, and nothing is contradicted.
    app.csv(windows, &days(&plant, 0, 6)).expect(201);
    let moved = app
        .until("/systems/plant/north/state", |state| state["at"].as_str().unwrap() > "2026-01-17T23:00:00Z");
    assert_eq!((&moved["free_run"], &moved["revision"]), (&json!(true), &json!(1)));
    assert!(app.get("/params/plant/north").expect(200).json()["degraded"].is_null());
    // The same two days of a plant whose nitrifiers have become weak.
    app.csv(windows, &days(&weak, 4, 6)).expect(201);
    let degraded = app.until("/params/plant/north", |params| params["status"] == "degraded");
    let what = &degraded["degraded"];
    assert_eq!(
        (&what["horizon"], &what["unit"]),
        (&json!("free_run"), &json!("times the noise of the sensors")),
        "{what}"
    );
    assert!(
        what["error"].as_f64().unwrap() > what["limit"].as_f64().unwrap()
            && degraded["parameters"] == params["parameters"],
        "{what}"
    );
}
