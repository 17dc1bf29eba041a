//! Fits beside the measurements: what is shown, what it adds up to, and what it costs.

use crate::lines::{csv, fitted, near, part, root_mean_square, values};
use crate::support::TestApp;
use crate::support::rooms::{room, room_csv};
use crate::support::schema::disagreements;
use lampyris::service::work::interactive::MOST_PENDING;
use serde_json::{Value, json};
use std::sync::mpsc;

#[test]
fn what_is_shown_adds_up_to_the_stored_errors() {
    let app = TestApp::start();
    app.room("1", 1);
    let id = fitted(&app, "1", json!({}));
    let fit = app.get(&format!("/fits/{id}")).json();
    let metrics = &fit["metrics"]["T_room"];
    let shown = app.get(&format!("/fits/{id}/comparison")).expect(200).json();
    let schemas = lampyris::http::described_documents();
    assert_eq!(disagreements(&shown, &schemas["Comparison"], &schemas, ""), [""; 0]);
    assert_eq!(
        (shown["fit"].as_str(), shown["system"].as_str(), shown["model"].as_str()),
        (Some(id.as_str()), Some("room/1"), Some("rc2"))
    );
    assert_eq!(
        (shown["mode"].as_str(), shown["horizon"].is_null(), shown["thinning"].is_null()),
        (Some("free_run"), true, true)
    );
    assert_eq!((shown["samples"].as_u64(), shown["step_s"].as_i64()), (Some(672), Some(1_800)));
    assert_eq!(
        (&shown["from"], &shown["to"]),
        (&fit["parts"]["train"]["from"], &fit["parts"]["validation"]["to"])
    );
    assert_eq!(
        (shown["provenance"]["reproduced"].as_bool(), shown["provenance"]["measurements_changed"].as_bool()),
        (Some(true), Some(false))
    );
    let output = &shown["outputs"]["T_room"];
    assert_eq!((output["unit"].as_str(), output["error_unit"].as_str()), (Some("degC"), Some("K")));
    let line = |name: &str| values(&output[name]["values"]);
    let (measured, simulated, residual) = (line("measured"), line("simulated"), line("residual"));
    assert_eq!((measured.len(), simulated.len(), shown["time"].as_array().unwrap().len()), (672, 672, 672));
    assert!((0..672).all(|k| residual[k] == measured[k] - simulated[k]), "measured minus simulated");
    // What was sent is what is shown, and so is the weather.
    let sent = room(1, 14);
    let rounded = |value: f64| format!("{value:.3}").parse::<f64>().unwrap();
    let outdoors = values(&shown["inputs"]["T_out"]["values"]);
    assert!((0..672).all(|k| measured[k] == rounded(sent[k].1)
        && outdoors[k] == rounded(sent[k].2)
        && shown["time"][k] == sent[k].0.as_str()));
    for (name, stored) in [("train", "train_rmse"), ("validation", "validation_rmse")] {
        let rmse = root_mean_square(&residual[part(&shown, name)]);
        assert!(near(rmse, &metrics[stored]), "{name}: {rmse} {metrics}");
        assert!(near(rmse, &shown["errors"]["T_room"]["parts"][name]["rmse"]));
    }
    assert!(near(root_mean_square(&residual), &shown["errors"]["T_room"]["range"]["rmse"]));

    let ahead = app.get(&format!("/fits/{id}/comparison?mode=ahead&horizon=PT6H")).expect(200).json();
    assert_eq!((ahead["mode"].as_str(), ahead["horizon"].as_str()), (Some("ahead"), Some("PT6H")));
    let residual = values(&ahead["outputs"]["T_room"]["residual"]["values"]);
    // Origin and target in the validation part: its first twelve samples are forecast from before it.
    let validation = part(&ahead, "validation");
    let rmse = root_mean_square(&residual[validation.start + 12..validation.end]);
    assert!(near(rmse, &metrics["ahead"]["PT6H"]["rmse"]), "{rmse} {metrics}");
    assert!(residual[..12].iter().all(|e| e.is_nan()), "nothing can be forecast before the first origin");
    let day = app.get(&format!("/fits/{id}/comparison?mode=ahead")).json();
    assert!(near(
        day["errors"]["T_room"]["parts"]["validation"]["rmse"].as_f64().unwrap(),
        &metrics["ahead"]["PT24H"]["rmse"]
    ));
}

#[test]
fn a_thinned_line_keeps_every_extreme_and_says_so() {
    let app = TestApp::start();
    app.room("1", 1);
    let id = fitted(&app, "1", json!({}));
    let full = app.get(&format!("/fits/{id}/comparison")).json();
    let thin = app.get(&format!("/fits/{id}/comparison?max_points=100")).expect(200).json();
    let schemas = lampyris::http::described_documents();
    assert_eq!(disagreements(&thin, &schemas["Comparison"], &schemas, ""), [""; 0]);
    // 672 samples in at most 100 points are seven to a point.
    assert_eq!(
        (thin["thinning"]["method"].as_str(), thin["thinning"]["samples_per_point"].as_u64()),
        (Some("min_max"), Some(7))
    );
    assert!(thin["thinning"]["comment"].as_str().unwrap().contains('7'));
    assert_eq!((thin["samples"].as_u64(), thin["time"].as_array().unwrap().len()), (Some(672), 96));
    assert_eq!(thin["time"][1], full["time"][7]);
    let pairs = [
        ("measured", "outputs", "T_room"),
        ("simulated", "outputs", "T_room"),
        ("residual", "outputs", "T_room"),
        ("", "inputs", "T_out"),
    ];
    for (name, kind, channel) in pairs {
        let line = |document: &Value| {
            if name.is_empty() {
                document[kind][channel].clone()
            } else {
                document[kind][channel][name].clone()
            }
        };
        let (all, thinned) = (values(&line(&full)["values"]), line(&thin));
        assert!(thinned.get("values").is_none_or(Value::is_null));
        let (min, max) = (values(&thinned["min"]), values(&thinned["max"]));
        for (point, stretch) in all.chunks(7).enumerate() {
            assert_eq!(min[point], stretch.iter().copied().fold(f64::INFINITY, f64::min), "{name} {point}");
            assert_eq!(
                max[point],
                stretch.iter().copied().fold(f64::NEG_INFINITY, f64::max),
                "{name} {point}"
            );
        }
    }
    assert_eq!(thin["errors"], full["errors"], "errors are those of all samples");
    let all = app.get(&format!("/fits/{id}/comparison?max_points=672")).json();
    assert_eq!(all, full);
}

#[test]
pub fn csv_holds_the_same_numbers_as_json() {
    let app = TestApp::start();
    app.room("1", 1);
    let id = fitted(&app, "1", json!({}));
    // Before the first origin nothing is forecast, so there are empty cells.
    let query = "to=2026-01-03T00:00:00Z&mode=ahead&horizon=PT1H";
    for thin in ["", "&max_points=10"] {
        let path = format!("/fits/{id}/comparison?{query}{thin}");
        let document = app.get(&path).expect(200);
        assert_eq!(
            (document.header("content-type"), document.header("vary").contains("accept")),
            ("application/json", true)
        );
        let document = document.json();
        let table = app.get_with(&path, &[("accept", "text/csv")]).expect(200);
        assert_eq!(table.header("content-type"), "text/csv; charset=utf-8");
        let (headers, rows) = csv(&table.text);
        let edges: &[&str] = if thin.is_empty() { &["values"] } else { &["min", "max"] };
        let output = &document["outputs"]["T_room"];
        let lines = [
            ("T_room", "degC", &output["measured"]),
            ("simulated_T_room", "degC", &output["simulated"]),
            ("residual_T_room", "K", &output["residual"]),
            ("T_out", "degC", &document["inputs"]["T_out"]),
        ];
        let expected: Vec<(String, Vec<f64>)> = lines
            .iter()
            .flat_map(|(name, unit, line)| {
                edges.iter().map(move |edge| {
                    let prefix = if *edge == "values" { String::new() } else { format!("{edge}_") };
                    (format!("{prefix}{name}[{unit}]"), values(&line[edge]))
                })
            })
            .collect();
        assert_eq!(headers[0], "time");
        assert_eq!(headers[1..], expected.iter().map(|(name, _)| name.clone()).collect::<Vec<_>>());
        assert_eq!(rows.len(), document["time"].as_array().unwrap().len());
        for (row, cells) in rows.iter().enumerate() {
            assert_eq!(document["time"][row], cells[0].as_str());
            for (column, (name, line)) in expected.iter().enumerate() {
                let cell = cells[column + 1].parse::<f64>().unwrap_or(f64::NAN);
                assert!(
                    cell.to_bits() == line[row].to_bits() || (cell.is_nan() && line[row].is_nan()),
                    "{name} {row}: {cell} {}",
                    line[row]
                );
            }
        }
    }
    // What was exported can be uploaded again.
    app.json("PUT", "/systems/room/2", &json!({"model": "rc2"})).expect(201);
    let table = app.get_with(&format!("/fits/{id}/comparison"), &[("accept", "text/csv")]).text;
    let taken = app.csv("/systems/room/2/windows", &table).expect(201).json();
    assert_eq!(
        taken["channels"]["T_room"]["max"],
        app.get("/systems/room/1/windows").json()["items"][0]["channels"]["T_room"]["max"]
    );
    assert_eq!(taken["channels"]["residual_T_room"]["unit"], "K");
}

#[test]
fn every_fault_of_a_question_is_listed_at_once() {
    let app = TestApp::start();
    app.room("1", 1);
    app.room("2", 2);
    let (one, two) = (fitted(&app, "1", json!({})), fitted(&app, "2", json!({})));
    let pointers = |problem: &Value| -> Vec<(String, String)> {
        let text = |fault: &Value, field: &str| fault[field].as_str().unwrap().to_owned();
        problem["errors"]
            .as_array()
            .unwrap()
            .iter()
            .map(|fault| (text(fault, "pointer"), text(fault, "code")))
            .collect()
    };
    let faults = |path: &str| pointers(&app.get(path).problem(422, "invalid-request"));
    let list = |pairs: &[(&str, &str)]| -> Vec<(String, String)> {
        pairs.iter().map(|(pointer, code)| (format!("query {pointer}"), (*code).to_owned())).collect()
    };
    let all = faults(&format!(
        "/fits/{one}/comparison?mode=fre_run&horizon=6h&from=yesterday&to=2026-01-02&max_points=0"
    ));
    let expected = [
        ("mode", "unknown-value"),
        ("horizon", "invalid-duration"),
        ("from", "bad-time"),
        ("to", "bad-time"),
        ("max_points", "out-of-range"),
    ];
    assert_eq!(all, list(&expected));
    let slip = app.get(&format!("/fits/{one}/comparison?mode=fre_run")).problem(422, "invalid-request");
    assert_eq!(slip["errors"][0]["suggestion"], "did you mean `free_run`?");
    let both = faults(&format!(
        "/fits/{one}/comparison?horizon=P9D&from=2026-01-05T00:00:00Z&to=2026-01-04T00:00:00Z"
    ));
    assert_eq!(
        both,
        list(&[("horizon", "invalid-range"), ("horizon", "contradiction"), ("to", "out-of-order")])
    );
    // What only the fit can say.
    let early = faults(&format!("/fits/{one}/comparison?to=2025-12-01T00:00:00Z&mode=ahead&horizon=PT45M"));
    assert_eq!(early, list(&[("to", "before-the-fit"), ("horizon", "no-multiple")]));
    let late = faults(&format!("/fits/{one}/comparison?from=2026-03-01T00:00:00Z&to=2026-03-02T00:00:00Z"));
    assert_eq!(late, list(&[("from", "no-data-in-range")]));
    app.get(&format!("/fits/{one}/comparison?mod=ahead")).problem(422, "invalid-request");

    app.get("/fits/fit_none/comparison").problem(404, "fit-not-found");
    app.get("/fits/fit_none/diagnostics").problem(404, "fit-not-found");
    app.get_with(&format!("/fits/{one}/comparison"), &[("accept", "text/html")])
        .problem(406, "not-acceptable");
    app.get_with(&format!("/compare?fits={one}"), &[("accept", "image/png, */*;q=0")])
        .problem(406, "not-acceptable");

    assert_eq!(faults("/compare"), list(&[("fits", "missing-field")]));
    assert_eq!(
        faults(&format!("/compare?fits={one},{one}&mode=x")),
        list(&[("fits", "named-twice"), ("mode", "unknown-value")])
    );
    assert_eq!(faults("/compare?fits=a,b,c,d,e,f,g,h,i"), list(&[("fits", "out-of-range")]));
    // Unknown fits and strangers together.
    let strangers = faults(&format!("/compare?fits={one},fit_x,{two},fit_y"));
    assert_eq!(
        strangers,
        list(&[("fits", "fit-not-found"), ("fits", "fit-not-found"), ("fits", "different-systems")])
    );
}

#[test]
fn an_answer_is_computed_once_and_anew_when_measurements_come() {
    let app = TestApp::at("2026-12-01T00:00:00Z", |_| {});
    app.room("1", 1);
    let id = fitted(&app, "1", json!({}));
    let computed = || app.service().interactive.computed();
    let path = format!("/fits/{id}/comparison");
    let first = app.get(&path).expect(200).text;
    assert_eq!(computed(), 1);
    assert_eq!(app.get(&path).expect(200).text, first);
    assert_eq!(computed(), 1, "the second question costs nothing");
    app.get_with(&path, &[("accept", "text/csv")]).expect(200);
    app.get(&format!("{path}?mode=ahead&horizon=PT1H")).expect(200);
    app.get(&format!("{path}?max_points=50")).expect(200);
    assert_eq!(computed(), 4, "another question is another answer");
    // Another system's measurements are none of its business.
    app.room("2", 2);
    app.get(&path).expect(200);
    assert_eq!(computed(), 4);

    // The record goes on for four days; nothing in the window of the fit has changed.
    let longer: String = room_csv(1, 18)
        .lines()
        .enumerate()
        .filter(|(k, _)| *k == 0 || *k > 672)
        .map(|(_, line)| format!("{line}\n"))
        .collect();
    app.csv("/systems/room/1/windows", &longer).expect(201);
    assert_eq!(app.get(&path).expect(200).json(), serde_json::from_str::<Value>(&first).unwrap());
    assert_eq!(computed(), 5);
    let beyond =
        app.get(&format!("{path}?from=2026-01-10T00:00:00Z&to=2026-01-17T00:00:00Z")).expect(200).json();
    let names: Vec<&str> =
        beyond["parts"].as_array().unwrap().iter().map(|span| span["part"].as_str().unwrap()).collect();
    assert_eq!(names, ["validation", "after"]);
    assert_eq!(
        (beyond["samples"].as_u64(), &beyond["provenance"]["measurements_changed"]),
        (Some(337), &json!(false))
    );
    let simulated = values(&beyond["outputs"]["T_room"]["simulated"]["values"]);
    assert!(simulated.iter().all(|value| value.is_finite()));
    // The room follows the model, so the fit holds on days that it has never seen.
    assert!(
        beyond["errors"]["T_room"]["parts"]["after"]["rmse"].as_f64().unwrap() < 0.2,
        "{}",
        beyond["errors"]
    );
    // A range may begin before the fit has: it begins with it.
    let early = app.get(&format!("{path}?from=2025-12-01T00:00:00Z")).json();
    assert_eq!(early["from"], "2026-01-01T00:00:00Z");

    // An upload that corrects a day of the window.
    app.csv(
        "/systems/room/1/windows",
        "time,T_room[degC]\n2026-01-03T00:00:00Z,30\n2026-01-03T00:30:00Z,30\n",
    )
    .expect(201);
    let changed = app.get(&path).expect(200).json();
    assert_eq!(changed["provenance"]["measurements_changed"], true);
    assert_ne!(changed["provenance"]["input_hash"], changed["provenance"]["fit_input_hash"]);
    assert!(changed["provenance"]["comment"].as_str().unwrap().contains("newer uploads"));
    assert_eq!(changed["outputs"]["T_room"]["measured"]["values"][96], 30.0);
    let told = app.get(&format!("/fits/{id}/diagnostics")).json()["summary"].as_str().unwrap().to_owned();
    assert!(told.contains("Mind that newer uploads"), "{told}");
}

/// Two sensors see the room and its wall.
fn two_outputs() -> Value {
    json!({
        "id": "walled", "title": "Room with a sensor in the wall",
        "states": {
            "T_r": {"unit": "degC", "initial": "T_room"}, "T_e": {"unit": "degC", "initial": "T_wall"}
        },
        "inputs": {"T_out": {"unit": "degC"}},
        "parameters": {
            "a": {"unit": "1/h", "lower": 0.001, "upper": 10, "scale": "log", "nominal": 0.5},
            "b": {"unit": "1/h", "lower": 0.001, "upper": 10, "scale": "log", "nominal": 0.2},
            "c": {"unit": "1/h", "lower": 0.001, "upper": 10, "scale": "log", "nominal": 0.2},
        },
        "equations": {"T_r": "a*(T_e - T_r)", "T_e": "b*(T_r - T_e) + c*(T_out - T_e)"},
        "outputs": {
            "T_room": {"expr": "T_r", "unit": "degC", "noise_sd": 0.05},
            "T_wall": {"expr": "T_e", "unit": "degC", "noise_sd": 0.05}
        },
    })
}

#[test]
fn a_users_model_with_two_outputs_is_shown_with_both() {
    let app = TestApp::start();
    app.json("POST", "/models", &two_outputs()).expect(201);
    app.json("PUT", "/systems/room/1", &json!({"model": "walled"})).expect(201);
    let mut text = "time,T_room[degC],T_wall[degC],T_out[degC]\n".to_owned();
    let rows = room(1, 14);
    for (k, (time, inside, out)) in rows.iter().enumerate() {
        // The wall lies between the mean of the last day inside and the weather; its sensor is read every
        // hour only.
        let mean =
            rows[k.saturating_sub(47)..=k].iter().map(|row| row.1).sum::<f64>() / (k.min(47) + 1) as f64;
        let wall = if k % 2 == 0 { format!("{:.3}", 0.8 * mean + 0.2 * out) } else { String::new() };
        text.push_str(&format!("{time},{inside:.3},{wall},{out:.3}\n"));
    }
    app.csv("/systems/room/1/windows", &text).expect(201);
    let id = fitted(&app, "1", json!({}));
    let metrics = app.get(&format!("/fits/{id}")).json()["metrics"].clone();
    let shown = app.get(&format!("/fits/{id}/comparison")).expect(200).json();
    assert_eq!(shown["provenance"]["reproduced"], true);
    for channel in ["T_room", "T_wall"] {
        let output = &shown["outputs"][channel];
        let residual = values(&output["residual"]["values"]);
        let validation = part(&shown, "validation");
        assert!(
            near(root_mean_square(&residual[validation]), &metrics[channel]["validation_rmse"]),
            "{channel}"
        );
        let gaps = residual.iter().filter(|e| e.is_nan()).count();
        assert_eq!(gaps, if channel == "T_wall" { 336 } else { 0 }, "{channel}");
        assert!(values(&output["simulated"]["values"]).iter().all(|value| value.is_finite()));
    }
    // Forecasts of both, each from origins at which it was measured.
    let ahead = app.get(&format!("/fits/{id}/comparison?mode=ahead&horizon=PT1H30M")).json();
    let known = |channel: &str| {
        values(&ahead["outputs"][channel]["simulated"]["values"])
            .iter()
            .filter(|value| value.is_finite())
            .count()
    };
    assert_eq!((known("T_room"), known("T_wall")), (669, 335));
    let told = app.get(&format!("/fits/{id}/diagnostics")).json();
    assert!(near(
        told["skill"]["T_wall"]["validation"]["rmse"].as_f64().unwrap(),
        &metrics["T_wall"]["validation_rmse"]
    ));
    assert!(told["by_horizon"]["T_wall"].as_array().unwrap().iter().any(|skill| skill["horizon"] == "PT6H"));
    // Beside a model that does not know the wall, the room is what both have.
    let plain = fitted(&app, "1", json!({"model": "rc2"}));
    let compared = app.get(&format!("/compare?fits={plain},{id}")).expect(200).json();
    let simulated = |channel: &str| {
        compared["outputs"][channel]["simulated"].as_object().unwrap().keys().cloned().collect::<Vec<_>>()
    };
    assert_eq!((simulated("T_room"), simulated("T_wall")), (vec![plain, id.clone()], vec![id.clone()]));
    let (headers, _) = csv(&app.get_with(&format!("/fits/{id}/comparison"), &[("accept", "text/csv")]).text);
    assert!(headers.contains(&"residual_T_wall[K]".to_owned()), "{headers:?}");
}

#[test]
fn a_fit_is_shown_as_it_was_made_whatever_became_of_the_system() {
    let app = TestApp::start();
    app.room("2", 2);
    let place = json!({"lat": 56.5, "lon": 10.0});
    app.json(
        "PUT",
        "/systems/room/1",
        &json!({"model": "room3", "neighbours": ["room/2"], "location": place}),
    )
    .expect(201);
    let mut text = "time,T_room[degC],T_out[degC],T_forward[degC]\n".to_owned();
    for (k, (time, inside, out)) in room(1, 14).into_iter().enumerate() {
        text.push_str(&format!("{time},{inside:.3},{out:.3},{:.1}\n", 30.0 + (k % 7) as f64));
    }
    app.csv("/systems/room/1/windows", &text).expect(201);
    let id = fitted(&app, "1", json!({}));
    let path = format!("/fits/{id}/comparison");
    let before = app.get(&path).expect(200).json();
    let inputs: Vec<&String> = before["inputs"].as_object().unwrap().keys().collect();
    assert_eq!(inputs, ["T_forward", "T_out", "sun_altitude", "T_room_2"]);
    // The house moves, loses its neighbour, and learns of a sensor that the model would rather use.
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "location": {"lat": 0.0, "lon": 0.0}}))
        .expect(200);
    app.csv(
        "/systems/room/1/windows",
        "time,irradiance[W/m2]\n2026-01-01T00:00:00Z,0\n2026-01-14T23:30:00Z,500\n",
    )
    .expect(201);
    let after = app.get(&path).expect(200).json();
    assert_eq!(after, before);
    // A stretch that is not to be trusted any more is left out of the measurements, and that is said.
    let exclude = json!([{"from": "2026-01-02T00:00:00Z", "to": "2026-01-03T00:00:00Z"}]);
    app.json("PUT", "/systems/room/1", &json!({"model": "room3", "exclude": exclude})).expect(200);
    let excluded = app.get(&path).expect(200).json();
    assert!(excluded["outputs"]["T_room"]["measured"]["values"][60].is_null());
    assert_eq!(excluded["provenance"]["measurements_changed"], true);
}

#[test]
fn what_is_computed_delays_no_controller() {
    let app = TestApp::start();
    app.room("1", 1);
    let id = fitted(&app, "1", json!({}));
    let interactive = &app.service().interactive;
    // All threads for short work are held, and as much waits for them as may.
    let (release, held) = mpsc::channel::<()>();
    let mut held = Some(held);
    std::thread::scope(|scope| {
        for index in 0..MOST_PENDING {
            let mine = held.take();
            let app = &app;
            scope.spawn(move || {
                let work = move |_: &lampyris_core::interrupt::Brake| {
                    mine.iter().for_each(|held| held.recv().unwrap());
                    Ok(Vec::new())
                };
                app.block_on(interactive.answer(&format!("held {index}"), work)).unwrap();
            });
            // The first one must have its thread before the others queue up behind it.
            while interactive.computed() == 0 {
                std::thread::yield_now();
            }
        }
        while interactive.pending() < MOST_PENDING {
            std::thread::yield_now();
        }
        let refused = app.get(&format!("/fits/{id}/comparison"));
        assert_eq!(refused.header("retry-after"), "2");
        refused.problem(503, "busy");
        assert_eq!(app.until("/params/room/1", |params| params["fit"].is_string())["fit"], id.as_str());
        assert_eq!(app.get("/healthz").expect(200).text, "ok\n");
        // A job has threads of its own.
        assert_eq!(app.ended(&app.estimate("room/1", json!({"experiment": true})))["state"], "succeeded");
        release.send(()).unwrap();
    });
    app.get(&format!("/fits/{id}/comparison")).expect(200);
}
