//! A layout is proposed, and nothing follows from it.

use crate::support::TestApp;
use crate::support::rooms::room;
use serde_json::{Value, json};

#[test]
fn a_layout_is_proposed_and_nothing_is_stored() {
    let app = TestApp::start();
    let mut text = "time;Lounge [degF];lounge_2_degC;T_cellar;P_lamp_W;T_outside\n".to_owned();
    let (first, other) = (room(1, 14), room(2, 14));
    for (k, ((time, lounge, out), (_, cellar, _))) in first.iter().zip(&other).enumerate() {
        let twin = if k % 7 == 0 { String::new() } else { format!("{:.1}", lounge + 0.4) };
        text += &format!("{time};{:.3};{twin};{cellar:.2};{};{out:.1}\n", lounge * 1.8 + 32.0, k % 50);
    }
    text += "yesterday;1;1;1;1;1\n";
    let found = app.csv("/systems/layout", &text).expect(200).json();
    let rooms: Vec<(&str, usize)> = found["rooms"]
        .as_array()
        .unwrap()
        .iter()
        .map(|room| (room["id"].as_str().unwrap(), room["sensors"].as_array().unwrap().len()))
        .collect();
    assert_eq!(rooms, [("Lounge", 2), ("cellar", 1)], "{}", found["summary"]);
    assert!(found["summary"].as_str().unwrap().contains("Nothing is stored"));
    assert_eq!(
        (found["thresholds"].clone(), &found["step_s"]),
        (json!({"same_room": 0.96, "neighbour": 0.5}), &json!(1800))
    );
    assert_eq!(found["correlation"][0][0], json!(1.0));
    assert_eq!(found["correlation"][0][1], found["correlation"][1][0]);
    let left_out: Vec<&str> =
        found["left_out"].as_array().unwrap().iter().map(|one| one["channel"].as_str().unwrap()).collect();
    assert_eq!(left_out, ["P_lamp", "T_outside"]);
    assert!(found["warnings"].to_string().contains("the time cannot be read"), "{}", found["warnings"]);
    assert_eq!(app.get("/systems").json()["items"], json!([]));

    let body = json!({
        "time": first.iter().map(|row| row.0.clone()).collect::<Vec<_>>(),
        "values": {
            "a": first.iter().map(|row| row.1).collect::<Vec<_>>(),
            "b": other.iter().map(|row| row.1).collect::<Vec<_>>()
        },
    });
    let plain = app.json("POST", "/systems/layout", &body).expect(200).json();
    assert_eq!(plain["sensors"], json!([{"channel": "a", "samples": 672}, {"channel": "b", "samples": 672}]));

    let short: Vec<&str> = text.lines().take(150).collect();
    let problem = app.csv("/systems/layout", &short.join("\n")).problem(422, "invalid-request");
    assert_eq!(
        (problem["errors"][0]["code"].as_str(), problem["errors"][0]["suggestion"].as_str()),
        (Some("window-too-short"), Some("send two weeks or more"))
    );
    let problem = app.csv("/systems/layout", "time,T_a[x],T_b[y]\n").problem(422, "invalid-request");
    assert_eq!(
        problem["errors"].as_array().unwrap().iter().filter(|fault| fault["code"] == "unknown-unit").count(),
        2
    );
    app.send("POST", "/systems/layout", &[("content-type", "text/plain")], Some(b"x"))
        .unwrap()
        .problem(415, "unsupported-media-type");
    assert_eq!(app.get("/systems/layout/windows").json()["type"], Value::from("system-not-found"));
}
