//! Maximum likelihood over HTTP: a job with `ctsm`, what its fit says, and what is refused.

use crate::support::rooms::room_csv;
use crate::support::{TestApp, quick};
use serde_json::json;

#[test]
fn a_job_maximises_the_likelihood_and_is_judged_like_any_other() {
    let app = TestApp::start();
    app.json("PUT", "/systems/room/4", &json!({"model": "rc2"})).expect(201);
    app.csv("/systems/room/4/windows", &room_csv(1, 14)).expect(201);
    let ended =
        app.ended(&app.estimate(
            "room/4",
            json!({"method": {"name": "ctsm", "seed": 1}, "budget": {"evaluations": 4000}}),
        ));
    assert_eq!(
        (ended["state"].as_str(), ended["outcome"].as_str()),
        (Some("succeeded"), Some("accepted")),
        "{ended}"
    );
    let fit = app.get(&format!("/fits/{}", ended["fit"].as_str().unwrap())).expect(200).json();
    assert_eq!((fit["method"].as_str(), fit["objective"].as_str()), (Some("ctsm"), Some("likelihood")));
    let found = &fit["likelihood"];
    let number = |name: &str| found[name].as_f64().unwrap();
    assert_eq!((number("estimated"), found["exact"].as_bool()), (4.0 + 2.0 + 1.0, Some(true)), "{found}");
    assert!((number("aic") - (2.0 * 7.0 - 2.0 * number("log_likelihood"))).abs() < 1e-6);
    assert!(
        (number("bic") - (7.0 * number("innovations").ln() - 2.0 * number("log_likelihood"))).abs() < 1e-6
    );
    assert_eq!(found["diffusion"]["T_r"]["unit"], "K/h^0.5");
    assert!(found["measurement"]["T_room"]["value"].as_f64().unwrap() > 0.0, "{found}");
    assert!(
        found["starts"]
            .as_array()
            .unwrap()
            .iter()
            .any(|start| start["origin"] == "warm" && start["settled"] == true),
        "{found}"
    );
    assert!(
        found["reason"].as_str().unwrap().contains("local runs end at the largest log-likelihood"),
        "{found}"
    );
    // What is served is the fit, and the states are filtered with its noise.
    let params = app.get("/params/room/4").expect(200).json();
    assert_eq!(params["parameters"]["alpha_e"], fit["parameters"]["alpha_e"]["value"]);
    assert!(app.get("/systems/room/4/state").expect(200).json()["sd"]["T_e"].as_f64().unwrap() > 0.0);
    let diagnostics =
        app.get(&format!("/fits/{}/diagnostics", fit["id"].as_str().unwrap())).expect(200).json();
    assert!(diagnostics["by_horizon"].is_object());
}

#[test]
fn objective_and_method_go_together() {
    let app = TestApp::start();
    app.json("PUT", "/systems/room/4", &json!({"model": "rc2"})).expect(201);
    app.csv("/systems/room/4/windows", &room_csv(1, 14)).expect(201);
    let post = |more: serde_json::Value| {
        let mut body = quick("room/4");
        body.as_object_mut().unwrap().shift_remove("method");
        body.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
        app.json("POST", "/jobs", &body)
    };
    let refused = |more: serde_json::Value| {
        let problem = post(more).expect(422).json();
        let error = &problem["errors"][0];
        (error["pointer"].as_str().unwrap().to_owned(), error["code"].as_str().unwrap().to_owned())
    };
    let contradiction = ("/objective".to_owned(), "contradiction".to_owned());
    assert_eq!(refused(json!({"objective": "likelihood", "method": {"name": "cfa"}})), contradiction);
    assert_eq!(refused(json!({"objective": "mse", "method": {"name": "ctsm"}})), contradiction);
    assert_eq!(
        refused(json!({"method": {"name": "ctsm", "scoring": {"radius": 9}}})).0,
        "/method/scoring/radius"
    );
    // The objective alone says which method it is.
    let ended =
        app.ended(post(json!({"objective": "likelihood"})).expect(202).json()["id"].as_str().unwrap());
    let fit = app.get(&format!("/fits/{}", ended["fit"].as_str().unwrap())).expect(200).json();
    assert_eq!(fit["method"], "ctsm");
}

#[test]
fn a_ladder_by_likelihood_adds_what_the_test_speaks_for() {
    let app = TestApp::at("2026-12-01T00:00:00Z", |_| {});
    app.json("PUT", "/systems/room/4", &json!({"model": "tite-solar_gain"})).expect(201);
    app.csv("/systems/room/4/windows", &lampyris_core::twin::noisy(3, 10).csv).expect(201);
    let job = app.ended(&app.post_job(&json!({"kind": "ladder", "system": "room/4", "criterion": "lrt"})));
    assert_eq!(job["state"], "succeeded", "{job}");
    let ladder = app.get(job["links"]["ladder"].as_str().unwrap()).expect(200).json();
    let steps = ladder["steps"].as_array().unwrap();
    let test = &steps[1]["likelihood_ratio"];
    assert_eq!(
        (steps[1]["added"].as_str(), steps[1]["kept"].as_bool()),
        (Some("solar_gain"), Some(true)),
        "{ladder}"
    );
    assert!(test["p"].as_f64().unwrap() < 1e-6 && test["degrees_of_freedom"] == 1, "{test}");
    assert_eq!(steps[1]["why"], test["sentence"]);
    let refused = app
        .json("POST", "/jobs", &json!({"kind": "estimate", "system": "room/4", "criterion": "lrt"}))
        .expect(422)
        .json();
    assert_eq!(refused["errors"][0]["pointer"], "/criterion", "{refused}");
}
