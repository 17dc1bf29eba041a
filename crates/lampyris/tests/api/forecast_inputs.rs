//! Forecasts of inputs: kept apart from measurements, used by forecasts, and compared with what came.

use crate::support::TestApp;
use crate::support::rooms::{csv_of, room};
use jiff::Timestamp;
use serde_json::{Value, json};

const WINDOWS: &str = "/systems/room/1/windows";
const FORECAST: &str = "/systems/room/1/forecast";

/// A room with a fortnight of measurements to the end of the fifteenth, and parameters in service.
fn served() -> TestApp {
    let app = TestApp::at("2026-01-16T00:00:00Z", |_| {});
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    app.csv(WINDOWS, &csv_of(&room(1, 17)[..720])).expect(201);
    assert_eq!(app.ended(&app.estimate("room/1", json!({})))["outcome"], "accepted");
    app
}

/// The outdoor temperature from one half hour of the record to another, as an upload of a forecast or as the
/// inputs of a request.
fn weather(from: usize, to: usize, role: Option<&str>) -> Value {
    let samples = &room(1, 17)[from..to];
    let (time, out): (Vec<&String>, Vec<f64>) = samples.iter().map(|(time, _, out)| (time, *out)).unzip();
    let body = json!({"channels": {"T_out": {"unit": "degC"}}, "time": time, "values": {"T_out": out}});
    let roles = role.map(|role| json!({"roles": {"T_out": role}})).unwrap_or(json!({}));
    let mut body = body.as_object().unwrap().clone();
    body.extend(roles.as_object().unwrap().clone());
    Value::Object(body)
}

fn numbers(series: &Value) -> Vec<f64> {
    series.as_array().unwrap().iter().map(|value| value.as_f64().unwrap()).collect()
}

#[test]
fn what_is_forecast_of_an_input_drives_a_forecast_and_no_fit() {
    let app = served();
    let path = format!("{FORECAST}?horizon=PT23H&step=PT30M");
    let faults = app.get(&path).problem(422, "invalid-request");
    assert_eq!(
        (&faults["errors"][0]["pointer"], &faults["errors"][0]["code"]),
        (&json!("/inputs/values/T_out"), &json!("input-ends"))
    );
    let before = app.get("/fits?system=room/1").expect(200).json()["items"][0]["id"].clone();
    let hash = |fit: &Value| -> Value {
        let fit = app.get(&format!("/fits/{}", fit.as_str().unwrap())).expect(200).json();
        json!([fit["input_hash"], fit["basis"]])
    };
    let answer = app.json("POST", WINDOWS, &weather(719, 768, Some("forecast"))).expect(201);
    assert_eq!(answer.header("location"), "/systems/room/1/forecast/inputs");
    let issue = answer.json();
    assert_eq!((&issue["rows"], &issue["channels"]["T_out"]["samples"]), (&json!(49), &json!(49)), "{issue}");
    let kept = app.get(answer.header("location")).expect(200).json();
    assert_eq!(
        kept,
        json!([{"channel": "T_out", "issued_at": issue["issued_at"], "from": "2026-01-15T23:30:00Z",
            "to": "2026-01-16T23:30:00Z"}])
    );

    // It is the forecast with the same weather given, and what counts is what was measured where it was.
    let answer = app.get(&path).expect(200);
    let found = answer.json();
    let given = json!({"horizon": "PT23H", "step": "PT30M", "inputs": weather(720, 768, None)});
    assert_eq!(found, app.json("POST", FORECAST, &given).expect(200).json());
    let asked = json!({"horizon": "PT23H", "step": "PT30M"});
    assert_eq!(found, app.json("POST", FORECAST, &asked).expect(200).json());
    let tag = answer.header("etag").to_owned();
    let again = app.get_with(&path, &[("if-none-match", &tag)]);
    assert_eq!((again.status, again.header("etag")), (304, tag.as_str()));
    let matrices = app.json("POST", "/systems/room/1/linearisation", &asked).expect(200).json();
    assert_eq!(matrices["steps"].as_array().unwrap().len(), 46);
    let wrong = app.get(&format!("{FORECAST}?horizon=P11D&step=P12D")).problem(422, "invalid-request");
    let places: Vec<&Value> =
        wrong["errors"].as_array().unwrap().iter().map(|fault| &fault["pointer"]).collect();
    assert_eq!(places, ["query horizon", "query step"]);
    let longer = app.get(&format!("{FORECAST}?horizon=PT48H")).problem(422, "invalid-request");
    assert_eq!(longer["errors"][0]["code"], "input-ends");

    // No reader of measurements sees it, and a fit has the inputs that it had.
    assert_eq!(app.get(WINDOWS).expect(200).json()["items"].as_array().unwrap().len(), 1);
    assert_eq!(app.get("/systems/room/1/series").expect(200).json()["to"], "2026-01-15T23:30:00Z");
    let job = app.ended(&app.estimate("room/1", json!({"experiment": true})));
    assert_eq!(hash(&job["fit"]), hash(&before));
}

#[test]
fn the_newest_issue_wins_and_a_body_may_have_both() {
    let app = served();
    let issue = |from: usize, to: usize, value: f64| -> String {
        let rows = (from..=to).map(|hour| format!("2026-01-16T{hour:02}:00:00Z,{value}\n"));
        format!("time,T_out[degC](forecast)\n{}", rows.collect::<String>())
    };
    let ahead = || -> Vec<f64> {
        let found = app.get(&format!("{FORECAST}?horizon=PT8H30M&step=PT30M")).expect(200).json();
        numbers(&found["inputs"]["T_out"]["values"])
    };
    app.csv(WINDOWS, &issue(0, 12, 0.0)).expect(201);
    app.csv(WINDOWS, &issue(3, 6, 10.0)).expect(201);
    // From 23:30 on, by half hours; between two issues it goes in a straight line.
    let hour = |values: &[f64], hour: usize| values[1 + 2 * hour];
    let values = ahead();
    let by_hour: Vec<f64> = (0..=8).map(|at| hour(&values, at)).collect();
    assert_eq!(by_hour, [0.0, 0.0, 0.0, 10.0, 10.0, 10.0, 10.0, 0.0, 0.0]);
    assert_eq!(values[6], 5.0);
    // The same request again changes nothing, although something newer has come.
    let (first, key) = (issue(4, 5, 20.0), [("content-type", "text/csv"), ("idempotency-key", "a")]);
    let sent = |body: &str| app.send("POST", WINDOWS, &key, Some(body.as_bytes())).unwrap();
    let issue_of =
        || -> Timestamp { sent(&first).expect(201).json()["issued_at"].as_str().unwrap().parse().unwrap() };
    let issued = issue_of();
    app.csv(&format!("{WINDOWS}?role=forecast"), &issue(5, 6, 30.0).replace("(forecast)", "")).expect(201);
    assert!(issue_of() >= issued);
    assert_eq!((hour(&ahead(), 4), hour(&ahead(), 5)), (20.0, 30.0));
    sent(&issue(4, 5, 40.0)).problem(422, "idempotency-key-reused");

    // Measurements and forecasts in one body; what was measured counts, and the rest of the issue behind it.
    let both = "time,T_room[degC],T_out[degC],T_out[degC](forecast)\n\
        2026-01-16T00:00:00Z,17.0,1.0,\n2026-01-16T00:30:00Z,17.0,2.0,\n2026-01-16T01:00:00Z,,,7.0\n\
        2026-01-16T09:00:00Z,,,7.0\n";
    let taken = app.csv(WINDOWS, both).expect(201).json();
    assert_eq!(
        (&taken["to"], &taken["rows"], &taken["forecast"]["rows"]),
        (&json!("2026-01-16T00:30:00Z"), &json!(2), &json!(2)),
        "{taken}"
    );
    assert_eq!(taken["forecast"]["to"], "2026-01-16T09:00:00Z");
    let found = app.get(&format!("{FORECAST}?horizon=PT8H&step=PT30M")).expect(200).json();
    assert_eq!(found["at"], "2026-01-16T00:30:00Z");
    let values = numbers(&found["inputs"]["T_out"]["values"]);
    assert_eq!((values[0], values[1], values[16]), (2.0, 7.0, 7.0));
}

#[test]
fn every_fault_of_a_forecast_is_named() {
    let app = TestApp::at("2026-01-16T00:00:00Z", |_| {});
    app.room("1", 1);
    let faults = |answer: crate::support::Answer| -> Vec<(String, String)> {
        let problem = answer.problem(422, "invalid-request");
        let word = |fault: &Value, field: &str| fault[field].as_str().unwrap().to_owned();
        let errors = problem["errors"].as_array().unwrap();
        errors.iter().map(|fault| (word(fault, "pointer"), word(fault, "code"))).collect()
    };
    let fault = |pointer: &str, code: &str| (pointer.to_owned(), code.to_owned());
    let body = |time: [&str; 2], values: Value, roles: Value| -> Value {
        json!({"time": time, "values": values, "roles": roles})
    };
    // Ten days are the most, and a measurement of next week is none.
    let late = body(
        ["2026-01-25T00:00:00Z", "2026-01-27T00:00:00Z"],
        json!({"T_out": [1, 2], "T_room": [20, 21], "T_room_2": [3, null]}),
        json!({"T_out": "forecast", "T_room_2": "forecast"}),
    );
    assert_eq!(
        faults(app.json("POST", WINDOWS, &late)),
        [fault("rows", "future-time"), fault("/values/T_out", "future-time")]
    );
    let old = body(
        ["2025-12-01T00:00:00Z", "2025-12-02T00:00:00Z"],
        json!({"T_out": [1, 2]}),
        json!({"T_out": "forecast"}),
    );
    assert_eq!(faults(app.json("POST", WINDOWS, &old)), [fault("/values/T_out", "past-time")]);
    let day = ["2026-01-16T00:00:00Z", "2026-01-17T00:00:00Z"];
    let wrong = body(day, json!({"T_out": [1, 2]}), json!({"T_out": "guess"}));
    assert_eq!(faults(app.json("POST", WINDOWS, &wrong))[0].0, "/roles/T_out");
    let absent = body(day, json!({"T_out": [1, 2]}), json!({"T_in": "forecast"}));
    assert_eq!(faults(app.json("POST", WINDOWS, &absent)), [fault("/roles/T_in", "no-values")]);
    let csv = "time,T_out[degC](forcast)\n2026-01-16T00:00:00Z,1\n2026-01-16T01:00:00Z,1\n";
    assert_eq!(faults(app.csv(WINDOWS, csv)), [fault("column T_out[degC](forcast)", "unknown-role")]);
    app.get("/systems/room/9/forecast").problem(404, "system-not-found");
    app.get("/systems/room/9/forecast/inputs").problem(404, "system-not-found");
    app.get("/systems/room/9/forecast/scores").problem(404, "system-not-found");
}

#[test]
fn what_was_said_is_compared_with_what_came() {
    let app = served();
    let scores = "/systems/room/1/forecast/scores";
    assert_eq!(app.get(scores).expect(200).json()["outputs"], json!({}));
    app.json("POST", WINDOWS, &weather(719, 768, Some("forecast"))).expect(201);
    let truth = room(1, 17);
    let ask = |horizon: &str| app.get(&format!("{FORECAST}?horizon={horizon}&step=PT30M")).expect(200).json();
    let mut said = vec![ask("PT18H")];
    let kept = app.until(scores, |scores| scores["forecasts"] == 1);
    assert_eq!((&kept["revisions"], &kept["outputs"]["T_room"]["leads"][0]["n"]), (&json!([1]), &json!(0)));
    assert_eq!(kept["outputs"]["T_room"]["leads"][0]["rmse"], Value::Null);
    // One is kept in a quarter of an hour, another one six hours later.
    ask("PT17H");
    app.csv(WINDOWS, &csv_of(&truth[720..732])).expect(201);
    app.clock.set("2026-01-16T06:00:00Z".parse().unwrap());
    said.push(ask("PT17H"));
    app.until(scores, |scores| scores["forecasts"] == 2);
    app.csv(WINDOWS, &csv_of(&truth[732..760])).expect(201);
    app.clock.set("2026-01-16T20:00:00Z".parse().unwrap());

    let answer = app.get(scores).expect(200);
    let found = answer.json();
    let leads = found["outputs"]["T_room"]["leads"].as_array().unwrap();
    let names: Vec<&Value> = leads.iter().map(|row| &row["lead"]).collect();
    assert_eq!(names, ["PT1H", "PT3H", "PT6H", "PT12H"]);
    let measured = |instant: &Value| -> f64 {
        let (_, room, _) = truth.iter().find(|(time, _, _)| *time == instant.as_str().unwrap()).unwrap();
        format!("{room:.3}").parse().unwrap()
    };
    for (row, hours) in leads.iter().zip([1, 3, 6, 12]) {
        let (mut squares, mut sum, mut within, mut held) = (0.0, 0.0, 0, 0.0);
        for forecast in &said {
            let output = &forecast["outputs"]["T_room"];
            let came = measured(&forecast["time"][2 * hours]);
            let error = output["values"][2 * hours].as_f64().unwrap() - came;
            squares += error * error / 2.0;
            sum += error / 2.0;
            within += usize::from(error.abs() <= 1.96 * output["sd"][2 * hours].as_f64().unwrap());
            held += (measured(&forecast["at"]) - came).powi(2) / 2.0;
        }
        let close = |field: &str, value: f64| {
            assert!((row[field].as_f64().unwrap() - value).abs() < 1e-5, "{hours} {field} {value}: {row}");
        };
        assert_eq!(row["n"], 2, "{row}");
        close("rmse", squares.sqrt());
        close("bias", sum);
        close("within95", within as f64 / 2.0);
        close("persistence", held.sqrt());
    }
    let tag = answer.header("etag").to_owned();
    assert_eq!(app.get_with(scores, &[("if-none-match", &tag)]).status, 304);
    // They go with their system.
    app.send("DELETE", "/systems/room/1?force=true", &[], None).unwrap().expect(204);
    app.get(scores).problem(404, "system-not-found");
}
