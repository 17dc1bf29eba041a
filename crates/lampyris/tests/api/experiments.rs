//! Plans of experiments: over HTTP, as JSON and as CSV.

use crate::lines::csv;
use crate::support::TestApp;
use crate::support::rooms::{csv_of, room};
use crate::support::schema::disagreements;
use serde_json::{Value, json};

const PATH: &str = "/systems/room/1/experiments";

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

#[test]
fn plans_promise_what_they_teach_and_are_told_to_the_automation() {
    let app = TestApp::start();
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    app.csv("/systems/room/1/windows", &csv_of(&room(1, 15))).expect(201);
    let body = json!({"days": 2, "inputs": {"T_out": [-5, 15]}, "slew": {"T_out": 8}, "to": "separate",
        "comfort": {"T_room": [-30, 60]}, "about": ["alpha_a", "direct_outdoor_loss"]});
    app.json("POST", PATH, &body).problem(404, "no-validated-parameters");
    assert_eq!(app.ended(&app.estimate("room/1", json!({})))["outcome"], "accepted");
    let told = app.json("POST", PATH, &body).expect(200).json();
    let schemas = lampyris::http::described_documents();
    assert_eq!(disagreements(&told, &schemas["SystemExperiment"], &schemas, ""), [""; 0]);
    assert_eq!(
        [&told["model"], &told["about"], &told["tried"], &told["uncomfortable"], &told["learnt"]],
        [
            &json!("rc2+direct_outdoor_loss"),
            &json!(["alpha_a", "c_outdoor"]),
            &json!(36),
            &json!(0),
            &json!([])
        ]
    );
    let plans = told["plans"].as_array().unwrap();
    assert_eq!(plans.len(), 3, "the best of each family");
    for plan in plans {
        for lesson in plan["lessons"].as_array().unwrap() {
            assert!(
                number(&lesson["width_before"]) > 0.0 && number(&lesson["width_after"]) > 0.0,
                "{lesson}"
            );
        }
        let values: Vec<f64> =
            plan["inputs"]["T_out"]["values"].as_array().unwrap().iter().map(number).collect();
        assert_eq!(values.len(), told["time"].as_array().unwrap().len());
        assert!(values.iter().all(|value| (-5.0..=15.0).contains(value)), "{values:?}");
        assert!(values.windows(2).all(|pair| (pair[1] - pair[0]).abs() <= 4.0 + 1e-9), "{values:?}");
    }
    assert_eq!(told["time"].as_array().unwrap().len(), 97);
    assert!(
        told["sentences"][2].as_str().unwrap().starts_with("The weather is taken to be that of"),
        "{told}"
    );

    // The same plan as a table for whoever drives it.
    let table = app.json_with("POST", PATH, &[("accept", "text/csv")], &body).expect(200);
    let (columns, rows) = csv(&table.text);
    assert_eq!(columns, ["time", "T_out[degC]"].map(str::to_owned));
    assert_eq!((rows.len(), rows[0][0].as_str()), (97, told["time"][0].as_str().unwrap()));

    // What was promised, beside what is known now: no experiment has come, and so it is not kept.
    let lesson = &plans[0]["lessons"][1];
    let promised = json!([{"parameter": lesson["parameter"], "width_unit": lesson["width_unit"],
        "width": 0.1 * number(&lesson["width_before"])}]);
    let mut with = body.clone();
    with["promised"] = promised;
    let learnt = app.json("POST", PATH, &with).expect(200).json()["learnt"].clone();
    assert_eq!(
        (&learnt[0]["parameter"], &learnt[0]["kept"]),
        (&json!("c_outdoor"), &json!(false)),
        "{learnt}"
    );

    // Every fault by name.
    let wrong = json!({"days": 0, "inputs": {"T_forward": [28, 45]}, "comfort": {"T_rooms": [19, 23]},
        "to": "determine", "about": ["alpha_a"]});
    let faults = app.json("POST", PATH, &wrong).problem(422, "invalid-request");
    let pointers: Vec<&str> =
        faults["errors"].as_array().unwrap().iter().map(|fault| fault["pointer"].as_str().unwrap()).collect();
    assert_eq!(pointers, ["/days", "/inputs/T_forward", "/comfort/T_rooms"]);
    let mut wrong = body.clone();
    wrong["about"] = json!(["alpha_a", "ghost"]);
    let faults = app.json("POST", PATH, &wrong).problem(422, "invalid-request");
    assert_eq!(faults["errors"][0]["code"], "unknown-name", "{faults}");
    wrong["aboot"] = json!([]);
    app.json("POST", PATH, &wrong).problem(422, "invalid-request");
    // A plan that nobody could live with.
    let mut cold = body.clone();
    cold["comfort"] = json!({"T_room": [40, 41]});
    let none = app.json("POST", PATH, &cold).expect(200).json();
    assert_eq!((&none["plans"], &none["uncomfortable"]), (&json!([]), &json!(36)), "{none}");
    app.json_with("POST", PATH, &[("accept", "text/csv")], &cold).problem(422, "invalid-request");
}
