//! Fits as documents and as a list.

use crate::support::TestApp;
use crate::support::schema::disagreements;
use serde_json::{Value, json};

#[test]
fn a_fit_has_all_the_fields_that_are_described_and_no_others() {
    let app = TestApp::start();
    app.room("1", 1);
    let ended = app.ended(&app.estimate(
        "room/1",
        json!({"fixed": {"beta_e": 4.0}, "split": {"train": "P7D", "validation": "P4D", "test": "P3D"}}),
    ));
    let fit = app.get(&format!("/fits/{}", ended["fit"].as_str().unwrap())).expect(200).json();
    let schemas = lampyris::http::described_documents();
    assert_eq!(disagreements(&fit, &schemas["Fit"], &schemas, ""), [""; 0]);

    let parameters = fit["parameters"].as_object().unwrap();
    assert_eq!(
        parameters.keys().collect::<Vec<_>>(),
        ["alpha_e", "beta_e", "alpha_a", "T_e0"],
        "the model's order"
    );
    for (name, estimate) in parameters {
        let (value, bounds) = (estimate["value"].as_f64().unwrap(), &estimate["bounds"]);
        assert!(
            bounds[0].as_f64().unwrap() <= value && value <= bounds[1].as_f64().unwrap(),
            "{name}: {estimate}"
        );
        assert_eq!(estimate["fixed"].as_bool().unwrap(), name == "beta_e");
        if let Some(interval) = estimate["ci95"].as_array() {
            assert!(
                interval[0].as_f64().unwrap() <= value && value <= interval[1].as_f64().unwrap(),
                "{name}: {estimate}"
            );
        }
    }
    assert!(parameters["beta_e"]["ci95"].is_null() && parameters["alpha_e"]["ci95"].is_array());
    assert_eq!(
        (parameters["alpha_e"]["unit"].as_str(), parameters["T_e0"]["unit"].as_str()),
        (Some("1/h"), Some("degC"))
    );
    let trace = fit["trace"].as_array().unwrap();
    assert!(trace.windows(2).all(|pair| pair[0]["best"].as_f64() > pair[1]["best"].as_f64()), "{trace:?}");
    assert!(
        fit["correlated"]
            .as_array()
            .unwrap()
            .iter()
            .all(|pair| pair["correlation"].as_f64().unwrap().abs() > 0.95)
    );
    for check in fit["checks"].as_array().unwrap() {
        let (statistic, threshold) = (check["statistic"].as_f64(), check["threshold"].as_f64());
        if let (Some(statistic), Some(threshold)) = (statistic, threshold) {
            let holds = match check["operator"].as_str().unwrap() {
                "<=" => statistic <= threshold,
                ">=" => statistic >= threshold,
                ">" => statistic > threshold,
                "<" => statistic < threshold,
                other => panic!("{other}"),
            };
            // G6 also asks whether a parameter has changed much.
            assert!(
                check["pass"] == holds || check["name"].as_str().unwrap().starts_with("G6 jump"),
                "{check}"
            );
        }
        assert!(!check["comment"].as_str().unwrap().is_empty());
    }
    assert_eq!(fit["basis"]["channels"], json!(["T_out", "T_room", "hour_of_day", "weekday", "window_drop"]));
    assert_eq!(fit["parts"]["train"]["from"], "2026-01-01T00:00:00Z");
}

#[test]
fn the_list_shows_the_newest_first_page_by_page() {
    let app = TestApp::start();
    app.room("1", 1);
    app.room("2", 2);
    assert_eq!(app.get("/fits").expect(200).json(), json!({"items": [], "next_page_token": null}));
    let fit = |system: &str, more: Value| {
        app.ended(&app.estimate(system, more))["fit"].as_str().unwrap().to_owned()
    };
    let first = fit("room/1", json!({}));
    let other = fit("room/2", json!({}));
    let second = fit("room/1", json!({"model": "rc2+constant_gain"}));
    let ids = |path: &str| -> Vec<String> {
        let page = app.get(path).expect(200).json();
        page["items"].as_array().unwrap().iter().map(|row| row["id"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(ids("/fits"), [second.clone(), other, first.clone()]);
    assert_eq!(ids("/fits?system=room/1"), [second.clone(), first.clone()]);
    assert_eq!(ids("/fits?system=room/9"), [""; 0]);
    let page = app.get("/fits?system=room/1&page_size=1").json();
    assert_eq!(page["items"][0]["id"], second.as_str());
    let token = page["next_page_token"].as_str().unwrap();
    assert_eq!(ids(&format!("/fits?system=room/1&page_size=1&page_token={token}")), [first.as_str()]);
    let rows = app.get("/fits?system=room/1").json()["items"].clone();
    let stored = app.get(&format!("/fits/{first}")).json();
    for field in ["job", "system", "model", "verdict", "summary", "metrics", "parts", "created_at"] {
        assert_eq!(rows[1][field], stored[field], "{field}");
    }
    assert_eq!(
        (rows[1]["served"].as_bool(), rows[0]["served"].as_bool(), rows[0]["model"].as_str()),
        (Some(true), Some(false), Some("rc2+constant_gain"))
    );
    app.get("/fits?system=room").problem(422, "invalid-request");
    app.get("/fits?room=1").problem(422, "invalid-request");
}
