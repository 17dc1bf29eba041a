//! What is to come, by the parameters that are served.

use crate::support::TestApp;
use crate::support::rooms::{csv_of, room};
use serde_json::{Value, json};

const PATH: &str = "/systems/room/1/forecast";

/// The outdoor temperature of a day behind so many.
fn day(days: usize) -> Value {
    let samples = &room(1, days + 1)[days * 48 - 1..];
    let (time, out): (Vec<&String>, Vec<f64>) = samples.iter().map(|(time, _, out)| (time, *out)).unzip();
    json!({"channels": {"T_out": {"unit": "degC"}}, "time": time, "values": {"T_out": out}})
}

#[test]
fn a_day_is_forecast_with_the_parameters_that_are_served() {
    let app = TestApp::at("2026-01-16T00:00:00Z", |_| {});
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    app.csv("/systems/room/1/windows", &csv_of(&room(1, 15))).expect(201);
    let body = json!({"horizon": "PT23H", "step": "PT30M", "inputs": day(15)});
    let refused = app.json("POST", PATH, &body).problem(404, "no-validated-parameters");
    assert_eq!(refused["latest_job"], Value::Null, "{refused}");
    let job = app.ended(&app.estimate("room/1", json!({})));
    assert_eq!(job["outcome"], "accepted");
    let answer = app.json("POST", PATH, &body).expect(200);
    let found = answer.json();
    assert_eq!((&found["revision"], &found["fit"]), (&json!(1), &job["fit"]), "{found}");
    assert_eq!(found["at"], "2026-01-15T23:30:00Z");
    let numbers = |series: &Value| -> Vec<f64> {
        series.as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).collect()
    };
    let (values, sd) =
        (numbers(&found["outputs"]["T_room"]["values"]), numbers(&found["outputs"]["T_room"]["sd"]));
    assert_eq!((values.len(), sd.len(), found["time"].as_array().unwrap().len()), (47, 47, 47));
    // It starts where the room is, and is less and less sure.
    let truth = room(1, 16);
    assert!((values[0] - truth[15 * 48 - 1].1).abs() < 0.1, "{values:?}");
    assert!(sd.iter().all(|sd| *sd > 0.0) && sd[46] > sd[1], "{sd:?}");
    let held = (0..47).filter(|k| (truth[15 * 48 - 1 + k].1 - values[*k]).abs() <= 1.96 * sd[*k]).count();
    assert!(held >= 40, "{held} of 47 lie within the band");
    assert_eq!(numbers(&found["inputs"]["T_out"]["values"]).len(), 47);

    // Nothing has changed: the same tag.
    let tag = answer.header("etag").to_owned();
    let again = app.json_with("POST", PATH, &[("if-none-match", &tag)], &body);
    assert_eq!((again.status, again.header("etag")), (304, tag.as_str()));
    // A sample more, and it starts there.
    app.csv("/systems/room/1/windows", &csv_of(&truth[15 * 48 - 1..15 * 48 + 1])).expect(201);
    let later = app.json_with("POST", PATH, &[("if-none-match", &tag)], &body).expect(200).json();
    assert_eq!(later["at"], "2026-01-16T00:00:00Z");
    // Beyond what was told of the weather there is nothing to say.
    let longer = json!({"horizon": "PT24H", "step": "PT30M", "inputs": day(15)});
    let faults = app.json("POST", PATH, &longer).problem(422, "invalid-request");
    assert_eq!(faults["errors"][0]["pointer"], "/inputs/values/T_out", "{faults}");
}

/// A matrix of an answer times a vector.
fn times(matrix: &Value, by: &[f64]) -> Vec<f64> {
    let rows = matrix.as_array().unwrap().iter();
    rows.map(|row| row.as_array().unwrap().iter().zip(by).map(|(a, b)| a.as_f64().unwrap() * b).sum())
        .collect()
}

fn vector(values: &Value) -> Vec<f64> {
    values.as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).collect()
}

#[test]
fn the_matrices_of_a_day_are_its_forecast() {
    let app = TestApp::at("2026-01-16T00:00:00Z", |_| {});
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    app.get("/systems/room/1/linearisation").problem(404, "no-validated-parameters");
    app.csv("/systems/room/1/windows", &csv_of(&room(1, 15))).expect(201);
    assert_eq!(app.ended(&app.estimate("room/1", json!({})))["outcome"], "accepted");
    let body = json!({"horizon": "PT23H", "step": "PT30M", "inputs": day(15)});
    let forecast = app.json("POST", PATH, &body).expect(200).json();
    let found = app.json("POST", "/systems/room/1/linearisation", &body).expect(200).json();
    let steps = found["steps"].as_array().unwrap();
    assert_eq!(
        (steps.len(), &found["revision"], &found["constant"]),
        (46, &json!(1), &json!(true)),
        "{found}"
    );
    let names: Vec<&str> =
        found["states"].as_array().unwrap().iter().map(|state| state["name"].as_str().unwrap()).collect();
    let ahead = |k: usize| -> Vec<f64> {
        names.iter().map(|name| forecast["states"][name]["values"][k].as_f64().unwrap()).collect()
    };
    // A controller goes by the matrices alone; the stepper of the forecast errs by some thousandths.
    let mut x = vector(&steps[0]["states"]);
    for (k, step) in steps.iter().enumerate() {
        let output = times(&step["c"], &x)[0] + step["output_offset"][0].as_f64().unwrap();
        let then = forecast["outputs"]["T_room"]["values"][k].as_f64().unwrap();
        assert!((output - then).abs() < 3e-3, "{k}: {output} {then}");
        let parts = [
            times(&step["a"], &x),
            times(&step["b"], &vector(&step["held"])),
            times(&step["e"], &vector(&step["moving"])),
            times(&step["e_next"], &vector(&step["moving_next"])),
            vector(&step["offset"]),
        ];
        x = (0..x.len()).map(|i| parts.iter().map(|part| part[i]).sum()).collect();
        let then = ahead(k + 1);
        assert!(x.iter().zip(&then).all(|(x, then)| (x - then).abs() < 3e-3), "{k}: {x:?} {then:?}");
    }
    // Now, for a step: the same matrices, since nothing of this model bends.
    let answer = app.get("/systems/room/1/linearisation?step=PT30M").expect(200);
    let now = answer.json();
    for matrix in ["a", "b", "e", "e_next", "c", "d_held", "d_moving"] {
        assert_eq!(now["steps"][0][matrix], steps[0][matrix], "{matrix}");
    }
    assert_eq!((now["steps"].as_array().unwrap().len(), &now["at"]), (1, &found["at"]));
    assert_eq!(now["steps"][0]["moving"], now["steps"][0]["moving_next"]);
    let tag = answer.header("etag").to_owned();
    let again = app.get_with("/systems/room/1/linearisation?step=PT30M", &[("if-none-match", &tag)]);
    assert_eq!(again.status, 304);
    // As it was a day before.
    let then = "/systems/room/1/linearisation?step=PT30M&at=2026-01-15T00:10:00Z";
    assert_eq!(app.get(then).expect(200).json()["at"], "2026-01-15T00:00:00Z");
    let wrong = app.get("/systems/room/1/linearisation?step=often&at=noon").problem(422, "invalid-request");
    assert_eq!(wrong["errors"].as_array().unwrap().len(), 2, "{wrong}");
    let wrong = app.get("/systems/room/1/linearisation?step=P11D").problem(422, "invalid-request");
    assert_eq!(wrong["errors"][0]["pointer"], "query step", "{wrong}");
}

#[test]
fn what_a_forecast_lacks_is_named() {
    let app = TestApp::at("2026-01-16T00:00:00Z", |_| {});
    app.room("1", 1);
    assert_eq!(app.ended(&app.estimate("room/1", json!({})))["outcome"], "accepted");
    let faults = |body: Value| -> Vec<(String, String)> {
        let problem = app.json("POST", PATH, &body).problem(422, "invalid-request");
        let word = |fault: &Value, field: &str| fault[field].as_str().unwrap().to_owned();
        let errors = problem["errors"].as_array().unwrap();
        errors.iter().map(|fault| (word(fault, "pointer"), word(fault, "code"))).collect()
    };
    let fault = |pointer: &str, code: &str| (pointer.to_owned(), code.to_owned());
    assert_eq!(faults(json!({})), [fault("/inputs/values/T_out", "input-ends")]);
    assert_eq!(
        faults(json!({"horizon": "P11D", "step": "P12D"})),
        [fault("/horizon", "out-of-range"), fault("/step", "out-of-range")]
    );
    assert!(faults(json!({"horizont": "PT1H"}))[0].1.contains("unknown-field"));
    let twisted =
        json!({"inputs": {"channels": {}, "time": ["2026-01-16T00:00:00Z"], "values": {"T_out": []}}});
    assert!(faults(twisted).iter().all(|(pointer, _)| pointer.starts_with("/inputs")));
    app.json("POST", "/systems/room/9/forecast", &json!({})).problem(404, "system-not-found");
}

#[test]
fn a_controller_asks_for_the_covariance_with_its_parameters() {
    let app = TestApp::start();
    app.room("1", 1);
    app.get("/params/room/1?with=covariance").problem(404, "no-validated-parameters");
    assert_eq!(app.ended(&app.estimate("room/1", json!({})))["outcome"], "accepted");
    let plain = app.get("/params/room/1").expect(200).json();
    let answer = app.get("/params/room/1?with=covariance").expect(200);
    let mut found = answer.json();
    let covariance = found.as_object_mut().unwrap().remove("covariance").unwrap();
    assert_eq!(found, plain);
    let of_fit = app.get(&format!("/fits/{}/covariance", plain["fit"].as_str().unwrap())).expect(200).json();
    assert_eq!(covariance["matrix"], of_fit["matrix"]);
    let tag = answer.header("etag").to_owned();
    assert_eq!(app.get_with("/params/room/1?with=covariance", &[("if-none-match", &tag)]).status, 304);
    assert_eq!(app.get_with("/params/room/1", &[("if-none-match", &tag)]).status, 200);
    app.get("/params/room/1?with=everything").problem(422, "invalid-request");
}

#[test]
fn the_covariance_of_a_fit_belongs_to_its_intervals() {
    let app = TestApp::start();
    app.room("1", 1);
    for method in ["lm_multistart", "ctsm"] {
        let asked = json!({"experiment": true, "method": {"name": method, "seed": 1}});
        let fit = app.ended(&app.estimate("room/1", asked))["fit"].as_str().unwrap().to_owned();
        let document = app.get(&format!("/fits/{fit}")).expect(200).json();
        let found = app.get(&format!("/fits/{fit}/covariance")).expect(200).json();
        let names = found["parameters"].as_array().unwrap();
        assert_eq!(names.len(), found["matrix"].as_array().unwrap().len(), "{found}");
        assert!(names.len() >= 2, "{found}");
        for (i, name) in names.iter().enumerate() {
            let name = name.as_str().unwrap();
            let estimate = &document["parameters"][name];
            assert_eq!(found["values"][i], estimate["value"]);
            let deviation = found["matrix"][i][i].as_f64().unwrap().sqrt();
            for (j, _) in names.iter().enumerate() {
                assert_eq!(found["matrix"][i][j], found["matrix"][j][i], "{method}");
            }
            // What the data leave open has a row, and no interval.
            if estimate["ci95"].is_null() {
                continue;
            }
            // On a logarithmic scale the interval is that of the logarithm, which is nearly the same while it
            // is short.
            let (low, high) = (estimate["ci95"][0].as_f64().unwrap(), estimate["ci95"][1].as_f64().unwrap());
            let half = (high - low) / 2.0 / 1.97;
            let value = estimate["value"].as_f64().unwrap();
            if deviation < 0.1 * value.abs() {
                assert!((half / deviation - 1.0).abs() < 0.05, "{method} {name}: {half} {deviation}");
            }
        }
    }
    app.get("/fits/fit_none/covariance").problem(404, "fit-not-found");
}
