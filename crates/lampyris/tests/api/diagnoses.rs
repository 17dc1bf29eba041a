//! Compare, see which effect is missing, add it, watch the error fall: over HTTP, on a room with a hidden
//! effect.

use crate::support::TestApp;
use crate::support::events::Told;
use lampyris_core::twin::{Level, WorldRequest, world};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde_json::{Value, json};

/// A room of the model room3 with these hidden effects and four weeks of measurements.
fn twin(app: &TestApp, id: &str, seed: u64, effects: &[&str]) {
    let world = world(&WorldRequest::new(seed, effects, Level::Matched)).unwrap();
    let neighbours: Vec<String> = world.neighbours.iter().map(|name| format!("room/{name}")).collect();
    let document =
        json!({"model": "room3", "location": {"lat": 56.5, "lon": 10.0}, "neighbours": neighbours});
    app.json("PUT", &format!("/systems/room/{id}"), &document).expect(201);
    app.csv(&format!("/systems/room/{id}/windows"), &world.csv).expect(201);
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or_else(|| panic!("{value} is no number"))
}

#[test]
fn the_hidden_effect_is_named_added_and_the_error_falls() {
    let app = TestApp::at("2026-12-01T00:00:00Z", |_| {});
    twin(&app, "windy", 7, &["wind_infiltration"]);
    let job = app.post_job(&json!({"kind": "diagnose", "system": "room/windy", "method": {"seed": 3}}));
    let told: Vec<Told> = app.listen(&format!("/jobs/{job}/events"), "").collect();
    let job = app.ended(&job);
    assert_eq!(
        (job["state"].as_str(), &job["outcome"], job["kind"].as_str()),
        (Some("succeeded"), &Value::Null, Some("diagnose")),
        "{job}"
    );
    app.get("/params/room/windy").problem(404, "no-validated-parameters");

    // On the way it says how many effects have been tried, who leads, and how long it will take, once its
    // model is fitted.
    let progress: Vec<&Value> =
        told.iter().filter(|told| told.event == "progress").map(|told| &told.data).collect();
    let (searching, trying): (Vec<&Value>, Vec<&Value>) =
        progress.iter().partition(|one| one["trials"].is_null());
    assert!(
        searching.iter().all(|one| one["eta_s"].is_null()),
        "the budget of its fit is not its end: {searching:?}"
    );
    let counted = |one: &&Value| one["trials"]["tried"].as_u64() <= one["trials"]["of"].as_u64();
    assert!(!trying.is_empty() && trying.iter().all(counted), "{progress:?}");
    assert!(
        trying.iter().any(|one| one["eta_s"].is_f64() && one["trials"]["of"].as_u64() > Some(10)),
        "{trying:?}"
    );
    assert!(
        progress.windows(2).all(|pair| pair[0]["evaluations"].as_u64() <= pair[1]["evaluations"].as_u64()),
        "{progress:?}"
    );

    let diagnosis = app.get(job["links"]["diagnosis"].as_str().unwrap()).expect(200).json();
    // What flows that nobody knows of is that of the fit which it starts from.
    let heat = |path: String| app.get(&format!("{path}/missing-heat")).expect(200).json();
    let flows = heat(format!("/diagnoses/{}", diagnosis["id"].as_str().unwrap()));
    assert_eq!(flows, heat(format!("/fits/{}", diagnosis["fit"].as_str().unwrap())));
    assert!(flows["hours"].as_array().unwrap().len() > 600, "{}", flows["sentences"]);
    assert_eq!((diagnosis["id"].as_str(), &diagnosis["fit"]), (job["diagnosis"].as_str(), &job["fit"]));
    assert_eq!(
        (diagnosis["verdict"].as_str(), diagnosis["system"].as_str()),
        (Some("named"), Some("room/windy")),
        "{diagnosis}"
    );
    let finding = &diagnosis["findings"][0];
    assert_eq!(finding["effect"], "wind_infiltration", "{diagnosis}");
    let [before, after] = [0, 1].map(|side| number(&finding["rmse"]["test"][side]));
    assert!(after < 0.9 * before, "{finding}");
    let shape = &finding["shape"];
    let [points, unexplained, effect] =
        ["time", "unexplained", "effect"].map(|name| shape[name].as_array().unwrap());
    assert!(
        points.len() <= 400 && points.len() == unexplained.len() && points.len() == effect.len(),
        "{} points",
        points.len()
    );
    assert!(
        shape["validation_from"].as_str() < shape["test_from"].as_str()
            && number(&shape["added"]["slope"]) > 0.5,
        "{shape}"
    );
    assert_eq!(app.get("/diagnoses?system=room/windy").json()["items"][0]["id"], diagnosis["id"]);

    // What its window shows stands in the ledger, of what was named and of what was not.
    let ledger = app.get("/systems/room/windy/evidence").expect(200).json();
    let items = ledger["effects"].as_array().unwrap();
    let t = |item: &Value| number(&item["pooled"]["t"]);
    assert!(items.len() > 5 && items.is_sorted_by(|a, b| t(a).abs() >= t(b).abs()), "{ledger}");
    let of_wind = items.iter().find(|item| item["effect"] == "wind_infiltration").unwrap();
    assert!(t(of_wind) > 5.0 && of_wind["windows"].as_array().unwrap().len() == 1, "{ledger}");
    assert_eq!(finding["pooled"]["windows"], 1, "{finding}");

    // One request adds it; the rest is an ordinary job.
    let model =
        app.json("POST", "/models/room3/effects", &json!({"effect": finding["effect"]})).expect(201).json();
    assert_eq!(model["id"], "room3+wind_infiltration");
    let split = json!({"train": "P14D", "validation": "P7D", "test": "P7D"});
    let errors = |model: &str| {
        let body = json!({
            "kind": "estimate", "system": "room/windy", "model": model, "split": split, "experiment": true
        });
        let job = app.ended(&app.post_job(&body));
        let fit = app.get(&format!("/fits/{}", job["fit"].as_str().unwrap())).json();
        ["train_rmse", "validation_rmse", "test_rmse"].map(|part| number(&fit["metrics"]["T_room"][part]))
    };
    let (old, new) = (errors("room3"), errors("room3+wind_infiltration"));
    assert!(old.iter().zip(&new).all(|(old, new)| *new < 0.9 * old), "{old:?} -> {new:?}");
}

/// Four weeks of a room whose attic fan pulls outdoor air through it whenever it runs: no catalogue knows a
/// fan.
fn fan_csv() -> String {
    let mut rows = "time,T_room[degC],T_out[degC],fan[-]\n".to_owned();
    let mut random = Xoshiro256PlusPlus::seed_from_u64(20_261);
    let (mut t_r, mut t_e, mut front, mut speed) = (14.0, 13.0, 0.0, 0.0);
    for step in 0..28 * 96 {
        let hour = f64::from(step) / 4.0;
        front += random.random_range(-0.3..0.3) - 0.005 * front;
        let t_out = 8.0 + 6.0 * (hour * std::f64::consts::TAU / 24.0).sin() + front;
        if step % 8 == 0 {
            speed = if random.random_bool(0.3) { random.random_range(0.3..1.0) } else { 0.0 };
        }
        let noise = random.random_range(-0.05..0.05);
        let time: jiff::Timestamp = "2026-02-01T00:00:00Z".parse().unwrap();
        let time = time + jiff::SignedDuration::from_mins(15 * i64::from(step));
        rows.push_str(&format!("{time},{:.3},{t_out:.3},{speed:.3}\n", t_r + noise));
        for _ in 0..15 {
            let (to_r, to_e) =
                (0.8 * (t_e - t_r) + 0.4 * speed * (t_out - t_r), 0.2 * (t_r - t_e) + 0.15 * (t_out - t_e));
            (t_r, t_e) = (t_r + to_r / 60.0, t_e + to_e / 60.0);
        }
    }
    rows
}

#[test]
fn an_effect_of_a_user_is_ranked_beside_the_others() {
    let app = TestApp::at("2026-12-01T00:00:00Z", |_| {});
    app.json("PUT", "/systems/room/attic", &json!({"model": "rc2"})).expect(201);
    app.csv("/systems/room/attic/windows", &fan_csv()).expect(201);
    let effect = json!({
        "id": "attic_fan", "title": "Attic fan", "explain": "The fan pulls outdoor air through the room.",
        "signature": "The room follows the outdoors while the fan runs.", "measure": "the speed of the fan",
        "sign": "positive",
        "inputs": {"fan": {"unit": "-", "hold": "zero_order", "min": 0}, "T_out": {"unit": "degC"}},
        "parameters": {"c_fan": {"unit": "1/h", "lower": 0, "upper": 5, "scale": "linear", "nominal": 0.1}},
        "terms": {"T_r": "c_fan * fan * (T_out - T_r)"},
    });
    let mut wrong = effect.clone();
    wrong["terms"] = json!({"T_attic": "c_fan * fan * (T_out - T_r)", "T_r": "c_fan * (T_out - T_r) + fan"});
    wrong["outputs"] = json!({"humidity": "c_fan"});
    wrong["way_of"] = json!("metered_gain");
    let problem = app.json("POST", "/effects", &wrong).problem(422, "invalid-request");
    let faults = problem["errors"].as_array().unwrap();
    assert!(
        faults.len() >= 3
            && faults.iter().any(|fault| fault["pointer"].as_str().unwrap().contains("T_attic")),
        "{problem}"
    );
    // A meter's gain has a channel for its argument, a fan has none.
    assert!(
        faults.iter().any(|fault| fault["pointer"] == "/way_of" && fault["code"] == "unknown-effect"),
        "{problem}"
    );
    app.json("POST", "/effects", &effect).expect(201);

    let job =
        app.ended(&app.post_job(&json!({"kind": "diagnose", "system": "room/attic", "method": {"seed": 5}})));
    let diagnosis = app.get(job["links"]["diagnosis"].as_str().unwrap()).expect(200).json();
    let finding = &diagnosis["findings"][0];
    assert_eq!(
        (diagnosis["verdict"].as_str(), finding["effect"].as_str()),
        (Some("named"), Some("attic_fan")),
        "{diagnosis}"
    );
    let [before, after] = [0, 1].map(|side| number(&finding["rmse"]["test"][side]));
    assert!(after < 0.5 * before, "{finding}");
    let c_fan = &finding["parameters"]["c_fan"];
    assert!((number(&c_fan["value"]) - 0.4).abs() < 0.05, "{c_fan}");
    let added = app.json("POST", "/models/rc2/effects", &json!({"effect": "attic_fan"})).expect(201).json();
    assert_eq!(added["id"], "rc2+attic_fan");
}

#[test]
fn a_ladder_keeps_what_helps_on_unseen_data() {
    let app = TestApp::at("2026-12-01T00:00:00Z", |_| {});
    twin(&app, "sunny", 11, &["wind_infiltration"]);
    app.get("/systems/room/sunny/ladder").problem(404, "ladder-not-found");
    let job = app.ended(&app.post_job(&json!({"kind": "ladder", "system": "room/sunny"})));
    assert_eq!(job["state"], "succeeded", "{job}");
    let ladder = app.get(job["links"]["ladder"].as_str().unwrap()).expect(200).json();
    assert_eq!((&ladder["job"], ladder["system"].as_str()), (&job["id"], Some("room/sunny")));
    let steps = ladder["steps"].as_array().unwrap();
    assert_eq!((steps[0]["model"].as_str(), &steps[0]["added"]), (Some("room3"), &Value::Null));
    let kept: Vec<f64> = steps
        .iter()
        .filter(|step| step["kept"] == true)
        .map(|step| number(&step["validation_rmse"]))
        .collect();
    assert!(kept.len() >= 2 && kept.windows(2).all(|pair| pair[1] < pair[0]), "{ladder}");
}

#[test]
fn a_record_that_is_too_short_is_told_so_and_deletions_take_diagnoses_along() {
    let app = TestApp::start();
    app.room("1", 1);
    let body = json!({
        "kind": "diagnose", "system": "room/1", "window": {"last": "P2D"}, "method": {"name": "lm_multistart"}
    });
    let job = app.ended(&app.post_job(&body));
    let diagnosis = app.get(job["links"]["diagnosis"].as_str().unwrap()).expect(200).json();
    assert_eq!(diagnosis["verdict"], "not_enough_data", "{diagnosis}");
    app.send("DELETE", "/systems/room/1?force=true", &[], None).unwrap().expect(204);
    app.get(job["links"]["diagnosis"].as_str().unwrap()).problem(404, "diagnosis-not-found");
}

#[test]
fn how_often_a_diagnosis_may_accuse_is_a_setting_that_a_request_overrides() {
    let app = TestApp::with(|settings| settings.diagnose.accusation_rate = 0.05);
    app.room("1", 1);
    let body = json!({
        "kind": "diagnose", "system": "room/1", "window": {"last": "P2D"}, "method": {"name": "lm_multistart"}
    });
    let rate = |own: Option<f64>| {
        let mut body = body.clone();
        if let Some(own) = own {
            body["accusation_rate"] = json!(own);
        }
        app.ended(&app.post_job(&body))["request"]["accusation_rate"].clone()
    };
    assert_eq!(rate(None), 0.05);
    assert_eq!(rate(Some(0.002)), 0.002);
    // One in a hundred is what a request says that names no rate.
    assert_eq!(rate(Some(0.01)), Value::Null);
    assert_eq!(app.ended(&app.estimate("room/1", json!({})))["request"]["accusation_rate"], Value::Null);
}
