//! Models that are written for other programs.

use crate::support::TestApp;
use serde_json::{Value, json};

#[test]
fn the_model_in_force_is_written_with_its_revision() {
    let app = TestApp::start();
    app.room("1", 1);
    app.get("/systems/room/1/model").problem(404, "no-validated-parameters");
    app.get("/systems/room/9/model").problem(404, "system-not-found");
    app.get("/fits/fit_none/model").problem(404, "fit-not-found");
    let job = app.ended(&app.estimate("room/1", json!({})));
    assert_eq!(job["outcome"], "accepted");
    let served = app.get("/params/room/1").expect(200).json();
    let answer = app.get("/systems/room/1/model").expect(200);
    let model = answer.json();
    assert_eq!((&model["revision"], &model["fit"], &model["model"]), (&json!(1), &job["fit"], &json!("rc2")));
    for parameter in model["parameters"].as_array().unwrap() {
        let name = parameter["name"].as_str().unwrap();
        assert_eq!(
            (&parameter["value"], &parameter["unit"]),
            (&served["parameters"][name], &served["units"][name])
        );
    }
    let rates: Vec<&str> =
        model["states"].as_array().unwrap().iter().map(|state| state["rate"].as_str().unwrap()).collect();
    assert!(rates[0].contains("T_e - T_r") && rates[1].contains("T_out - T_e"), "{rates:?}");
    let tag = answer.header("etag").to_owned();
    assert_eq!(app.get_with("/systems/room/1/model", &[("if-none-match", &tag)]).status, 304);
    // The same of any fit, which has no revision of its own.
    let of_fit = app.get(&format!("/fits/{}/model", job["fit"].as_str().unwrap())).expect(200).json();
    assert_eq!((&of_fit["revision"], &of_fit["states"]), (&Value::Null, &model["states"]));
    for (format, word) in [
        ("python", "def simulate("),
        ("casadi", "ca.Function("),
        ("modelica", "der(T_e)"),
        ("latex", "\\alpha"),
        ("mathml", "<mi>α</mi>"),
    ] {
        let answer = app.get(&format!("/systems/room/1/model?format={format}")).expect(200);
        assert_eq!(answer.header("content-type"), "text/plain; charset=utf-8");
        assert!(answer.text.contains(word), "{}", answer.text);
        assert!(
            ["latex", "mathml"].contains(&format) || answer.text.contains("room/1 as Lampyris fitted it"),
            "{}",
            answer.text
        );
    }
    app.get("/systems/room/1/model?format=fortran").problem(422, "invalid-request");
    // A model has equations before anything was fitted to it.
    let latex = app.get("/models/rc2/equations").expect(200);
    assert_eq!(latex.text, app.get("/systems/room/1/model?format=latex").text);
    assert_eq!(app.get_with("/models/rc2/equations", &[("if-none-match", latex.header("etag"))]).status, 304);
    assert!(app.get("/models/rc2/equations?format=mathml").expect(200).text.starts_with("<math "));
    app.get("/models/rc2/equations?format=python").problem(422, "invalid-request");
    app.get("/models/nothing/equations").problem(404, "model-not-found");
}
