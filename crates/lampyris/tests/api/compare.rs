//! Several fits beside each other, and the numbers behind one.

use crate::lines::{csv, fitted, near, part, root_mean_square, values};
use crate::support::TestApp;
use crate::support::schema::disagreements;
use serde_json::{Value, json};

#[test]
fn fits_are_compared_on_one_window() {
    let app = TestApp::start();
    app.room("1", 1);
    let whole = fitted(&app, "1", json!({}));
    let other = fitted(&app, "1", json!({"model": "rc2+constant_gain"}));
    let early = fitted(
        &app,
        "1",
        json!({"window": {"to": "2026-01-09T00:00:00Z"}, "split": {"train": "P5D", "validation": "P2D"}}),
    );
    let path = format!("/compare?fits={whole},{other},{early}");
    let compared = app.get(&path).expect(200).json();
    let schemas = lampyris::http::described_documents();
    assert_eq!(disagreements(&compared, &schemas["Compare"], &schemas, ""), [""; 0]);
    // From where the last of them begins to where the last of them ends.
    assert_eq!(
        (compared["from"].as_str(), compared["to"].as_str()),
        (Some("2026-01-02T00:30:00Z"), Some("2026-01-14T23:30:00Z"))
    );
    let models: Vec<&str> =
        compared["fits"].as_array().unwrap().iter().map(|fit| fit["model"].as_str().unwrap()).collect();
    assert_eq!(models, ["rc2", "rc2+constant_gain", "rc2"]);
    let last = compared["fits"][2]["parts"].as_array().unwrap().last().unwrap().clone();
    assert_eq!((last["part"].as_str(), &last["to"]), (Some("after"), &compared["to"]));
    let measured = values(&compared["outputs"]["T_room"]["measured"]["values"]);
    let unseen_from = compared["fits"][0]["parts"]
        .as_array()
        .unwrap()
        .iter()
        .find(|span| span["part"] == "validation")
        .unwrap()["from"]
        .clone();
    let unseen = compared["time"].as_array().unwrap().iter().position(|time| *time == unseen_from).unwrap();
    let row = |fit: &str, horizon: &str, over: &str| {
        let rows = compared["errors"].as_array().unwrap();
        rows.iter()
            .find(|row| row["fit"] == fit && row["horizon"] == horizon && row["over"] == over)
            .unwrap()
            .clone()
    };
    for fit in [&whole, &other, &early] {
        let simulated = values(&compared["outputs"]["T_room"]["simulated"][fit]["values"]);
        // The same run as when the fit is looked at alone.
        let alone = app
            .get(&format!("/fits/{fit}/comparison?from=2026-01-02T00:30:00Z&to=2026-01-14T23:30:00Z"))
            .json();
        assert_eq!(simulated, values(&alone["outputs"]["T_room"]["simulated"]["values"]));
        for (over, first) in [("range", 0), ("unseen", unseen)] {
            let errors: Vec<f64> = (first..measured.len()).map(|k| measured[k] - simulated[k]).collect();
            let found = row(fit, "free_run", over);
            assert_eq!(found["n"].as_u64(), Some(errors.len() as u64));
            assert!(near(root_mean_square(&errors), &found["rmse"]), "{found}");
            let bias = errors.iter().sum::<f64>() / errors.len() as f64;
            assert!((bias - found["bias"].as_f64().unwrap()).abs() < 1e-12);
            let mean = measured[first..].iter().sum::<f64>() / errors.len() as f64;
            let spread: f64 = measured[first..].iter().map(|value| (value - mean).powi(2)).sum();
            let r2 = 1.0 - errors.iter().map(|e| e * e).sum::<f64>() / spread;
            assert!((r2 - found["r2"].as_f64().unwrap()).abs() < 1e-12);
        }
        let counts: Vec<u64> = [&whole, &other, &early]
            .iter()
            .map(|fit| row(fit, "PT6H", "range")["n"].as_u64().unwrap())
            .collect();
        assert!(counts.windows(2).all(|pair| pair[0] == pair[1]), "{counts:?}");
    }
    let ahead =
        app.get(&format!("{path}&mode=ahead&horizon=PT2H&from=2026-01-10T00:00:00Z")).expect(200).json();
    assert_eq!(
        (ahead["horizon"].as_str(), ahead["from"].as_str()),
        (Some("PT2H"), Some("2026-01-10T00:00:00Z"))
    );
    let alone =
        app.get(&format!("/fits/{early}/comparison?mode=ahead&horizon=PT2H&from=2026-01-10T00:00:00Z&to=2026-01-14T23:30:00Z")).json();
    assert_eq!(
        ahead["outputs"]["T_room"]["simulated"][&early]["values"],
        alone["outputs"]["T_room"]["simulated"]["values"]
    );

    let (headers, rows) = csv(&app.get_with(&path, &[("accept", "text/csv")]).expect(200).text);
    assert_eq!(
        headers,
        [
            "time".to_owned(),
            "T_room[degC]".to_owned(),
            format!("simulated_T_room_{whole}[degC]"),
            format!("simulated_T_room_{other}[degC]"),
            format!("simulated_T_room_{early}[degC]")
        ]
    );
    assert_eq!(rows.len(), measured.len());
    assert!(rows.iter().zip(&measured).all(|(cells, value)| cells[1].parse::<f64>().unwrap() == *value));
    let before = app.service().interactive.computed();
    app.get(&path).expect(200);
    assert_eq!(app.service().interactive.computed(), before);
}

/// Regimes, hours and episodes against the residuals of the chart, half-hourly and without a gap.
fn where_it_fails(told: &Value, residual: &[f64], outdoors: &[f64], time: &Value) {
    let number = |value: &Value| value.as_f64().unwrap();
    let is = |value: &Value, expected: f64| (number(value) - expected).abs() < 1e-9;
    let starts = time.as_array().unwrap();
    for day in told["hour_by_date"].as_array().unwrap() {
        let first = starts
            .iter()
            .position(|start| start.as_str().unwrap().starts_with(day["date"].as_str().unwrap()))
            .unwrap();
        for (hour, mean) in day["hours"].as_array().unwrap().iter().enumerate() {
            let at = first + 2 * hour;
            assert!(is(mean, (residual[at] + residual[at + 1]) / 2.0), "{} {hour}", day["date"]);
        }
    }
    let total: f64 = residual.iter().map(|error| error * error).sum();
    let squares = |at: usize| residual[at..at + 12].iter().map(|error| error * error).sum::<f64>();
    let worst = (0..residual.len() - 12).max_by(|a, b| squares(*a).total_cmp(&squares(*b))).unwrap();
    let episode = &told["episodes"][0];
    assert_eq!(episode["from"], starts[worst]);
    assert!(
        is(&episode["rmse"], (squares(worst) / 12.0).sqrt()) && is(&episode["share"], squares(worst) / total),
        "{episode}"
    );
    let regimes = told["by_regime"].as_array().unwrap();
    let warm = regimes.iter().find(|regime| regime["regime"] == "T_out high").unwrap();
    let mut sorted = outdoors.to_vec();
    sorted.sort_by(f64::total_cmp);
    let limit = sorted[2 * sorted.len() / 3];
    let errors: Vec<f64> =
        (0..residual.len()).filter(|k| outdoors[*k] > limit).map(|k| residual[k]).collect();
    assert!(is(&warm["time_share"], errors.len() as f64 / residual.len() as f64), "{warm}");
    assert!(is(&warm["bias"], errors.iter().sum::<f64>() / errors.len() as f64), "{warm}");
    assert!(
        is(&warm["error_share"], errors.iter().map(|error| error * error).sum::<f64>() / total),
        "{warm}"
    );
    let [low, high] = [0, 1].map(|side| number(&warm["bias_ci95"][side]));
    assert!((low..high).contains(&number(&warm["bias"])), "{warm}");
    let inputs: Vec<&str> = told["residual_by_input"]
        .as_array()
        .unwrap()
        .iter()
        .map(|input| input["channel"].as_str().unwrap())
        .collect();
    assert!(inputs.contains(&"T_out") && !inputs.contains(&"T_room"), "{inputs:?}");
    let innovations = &told["innovations"];
    assert!(
        innovations["n"].as_u64().unwrap() > 600 && innovations["acf"].as_array().unwrap().len() == 48,
        "{innovations}"
    );
    let step = number(&innovations["step_hours"]);
    let [cycles, cumulated] =
        ["cycles_per_day", "cumulated_periodogram"].map(|name| innovations[name].as_array().unwrap());
    assert_eq!(cycles.len(), cumulated.len());
    assert!(
        number(&cycles[0]) > 0.0 && number(cycles.last().unwrap()) < 12.0 / step,
        "half the sampling rate is left out"
    );
    // Neither a valve nor a heater is among the channels of this room, so that no input is moved by the
    // output.
    assert!(told["residual_by_input"].as_array().unwrap().iter().all(|input| input["feedback"] == false));
}

#[test]
fn diagnostics_are_the_numbers_behind_the_chart() {
    let app = TestApp::start();
    app.room("1", 1);
    let id = fitted(&app, "1", json!({"split": {"train": "P7D", "validation": "P4D", "test": "P3D"}}));
    let told = app.get(&format!("/fits/{id}/diagnostics")).expect(200).json();
    let schemas = lampyris::http::described_documents();
    assert_eq!(disagreements(&told, &schemas["Diagnostics"], &schemas, ""), [""; 0]);
    let metrics = app.get(&format!("/fits/{id}")).json()["metrics"]["T_room"].clone();
    let skill = &told["skill"]["T_room"];
    assert_eq!(skill["unit"], "K");
    let residual =
        values(&app.get(&format!("/fits/{id}/comparison")).json()["outputs"]["T_room"]["residual"]["values"]);
    let shown = app.get(&format!("/fits/{id}/comparison")).json();
    for name in ["train", "validation", "test"] {
        assert!(near(skill[name]["rmse"].as_f64().unwrap(), &metrics[format!("{name}_rmse")]), "{name}");
        let errors = &residual[part(&shown, name)];
        let n = errors.len() as f64;
        let (bias, mae) = (errors.iter().sum::<f64>() / n, errors.iter().map(|e| e.abs()).sum::<f64>() / n);
        let urmse = (errors.iter().map(|e| (e - bias).powi(2)).sum::<f64>() / n).sqrt();
        for (field, expected) in [("n", n), ("bias", bias), ("mae", mae), ("urmse", urmse)] {
            assert!((skill[name][field].as_f64().unwrap() - expected).abs() < 1e-12, "{name} {field}");
        }
    }
    let horizons = told["by_horizon"]["T_room"].as_array().unwrap();
    assert_eq!(
        horizons.iter().map(|skill| skill["horizon"].as_str().unwrap()).collect::<Vec<_>>(),
        ["PT1H", "PT6H", "PT24H", "free_run"]
    );
    assert_eq!(told["judged_on"], "validation");
    for skill in &horizons[..3] {
        let stored = &metrics["ahead"][skill["horizon"].as_str().unwrap()];
        assert!(
            near(skill["rmse"].as_f64().unwrap(), &stored["rmse"])
                && near(skill["persistence_rmse"].as_f64().unwrap(), &stored["persistence"])
        );
        assert_eq!(skill["n"], stored["n"]);
    }
    assert_eq!(horizons[3]["rmse"], skill["validation"]["rmse"]);
    assert_eq!(
        (&told["rho"]["T_room"], &told["noise_floor"]["T_room"]),
        (&metrics["rho"], &metrics["noise_floor"])
    );
    where_it_fails(&told, &residual, &values(&shown["inputs"]["T_out"]["values"]), &shown["time"]);
    let summary = told["summary"].as_str().unwrap();
    assert!(summary.contains("The worst six hours begin at"), "{summary}");
    assert!(
        summary.contains("6 h ahead") && summary.contains("on unseen data") && !summary.contains("Mind"),
        "{summary}"
    );
    let before = app.service().interactive.computed();
    app.get(&format!("/fits/{id}/diagnostics")).expect(200);
    assert_eq!(app.service().interactive.computed(), before);
}

/// Two rooms of a model that measures both: the second follows the first.
fn two_outputs(app: &TestApp) -> String {
    let temperature = json!({"unit": "degC", "initial": "T_a"});
    let rate =
        |nominal: f64| json!({"unit": "1/h", "lower": 0.01, "upper": 5, "scale": "log", "nominal": nominal});
    let model = json!({
        "id": "pair", "title": "Two rooms",
        "states": {"A": temperature, "B": {"unit": "degC", "initial": "T_b"}},
        "inputs": {"T_out": {"unit": "degC"}},
        "parameters": {"a": rate(0.3), "b": rate(0.1)},
        "equations": {"A": "a*(T_out - A)", "B": "b*(A - B)"},
        "outputs": {
            "T_a": {"expr": "A", "unit": "degC", "noise_sd": 0.05},
            "T_b": {"expr": "B", "unit": "degC", "noise_sd": 0.05}
        },
    });
    app.json("POST", "/models", &model).expect(201);
    app.json("PUT", "/systems/room/1", &json!({"model": "pair"})).expect(201);
    let mut csv = String::from("time,T_a,T_b,T_out\n");
    let (mut a, mut b) = (10.0, 10.0);
    for k in 0..12 * 48 {
        let hours = f64::from(k) * 0.5;
        let out = 10.0 + 8.0 * (hours * std::f64::consts::TAU / 24.0).sin();
        // Each errs at hours of its own: the first at noon, the second at midnight.
        let [noon, midnight] = [12, 0].map(|hour| if (k / 2) % 24 == hour { 2.0 } else { 0.0 });
        let wobble = 0.1 * (f64::from(k) * 12.9898).sin();
        let time = jiff::Timestamp::from_second(1_767_225_600 + i64::from(k) * 1800).unwrap();
        csv.push_str(&format!("{time},{:.4},{:.4},{out:.4}\n", a + noon + wobble, b + midnight - wobble));
        (a, b) = (a + 0.5 * 0.3 * (out - a), b + 0.5 * 0.1 * (a - b));
    }
    app.csv("/systems/room/1/windows", &csv).expect(201);
    fitted(app, "1", json!({"split": {"train": "P7D", "validation": "P3D"}}))
}

#[test]
fn each_output_is_looked_at_by_its_name() {
    let app = TestApp::start();
    let id = two_outputs(&app);
    let shown = app.get(&format!("/fits/{id}/comparison")).expect(200).json();
    let [first, second, unnamed] = ["?output=T_a", "?output=T_b", ""]
        .map(|q| app.get(&format!("/fits/{id}/diagnostics{q}")).expect(200).json());
    assert_eq!(first, unnamed);
    assert_eq!((&first["skill"], &first["by_horizon"]), (&second["skill"], &second["by_horizon"]));
    for (told, output, hour) in [(&first, "T_a", 12), (&second, "T_b", 0)] {
        assert_eq!(told["output"], output);
        // The hours are those of this output's own residual.
        let day = &told["hour_by_date"][5];
        let mut sums = [(0.0, 0); 24];
        let residual = values(&shown["outputs"][output]["residual"]["values"]);
        for (time, error) in shown["time"].as_array().unwrap().iter().zip(&residual) {
            let (date, clock) = time.as_str().unwrap().split_once('T').unwrap();
            if day["date"] == date && !error.is_nan() {
                let at = &mut sums[clock[..2].parse::<usize>().unwrap()];
                *at = (at.0 + error, at.1 + 1);
            }
        }
        let hours = day["hours"].as_array().unwrap();
        for (found, (sum, count)) in hours.iter().zip(sums) {
            assert!((found.as_f64().unwrap() - sum / f64::from(count)).abs() < 1e-9, "{day}");
        }
        let worst = (0..24)
            .max_by(|x, y| hours[*x].as_f64().unwrap().abs().total_cmp(&hours[*y].as_f64().unwrap().abs()));
        assert_eq!(worst, Some(hour), "{day}");
        assert_eq!(told["innovations"]["acf"].as_array().map(Vec::len), Some(48));
    }
    assert_ne!(first["innovations"], second["innovations"]);
    assert_ne!(first["summary"], second["summary"]);
    let problem = app.get(&format!("/fits/{id}/diagnostics?output=T_c")).problem(422, "invalid-request");
    assert_eq!(
        (&problem["errors"][0]["pointer"], &problem["errors"][0]["code"]),
        (&json!("query output"), &json!("unknown-output"))
    );
    assert!(
        problem["errors"][0]["suggestion"].as_str().unwrap().starts_with("did you mean `T_"),
        "{problem}"
    );
    app.get(&format!("/fits/{id}/diagnostics?outptu=T_b")).problem(422, "invalid-request");
}
