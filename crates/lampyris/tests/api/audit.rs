//! What operators did, and who they were.

use crate::support::TestApp;
use crate::support::rooms::room_csv;
use lampyris::store::tokens::Scope;
use serde_json::{Value, json};

#[test]
fn what_is_done_is_noted_with_the_name_of_the_token() {
    let app = TestApp::by_the_clock();
    app.json("PUT", "/systems/room/9", &json!({"model": "rc2"})).expect(201);
    let admin = app.token("ada", Scope::Admin, &[]);
    let night = app.token("night", Scope::Operate, &["room/1"]);
    admin.json("PUT", "/systems/room/1", &json!({"model": "rc2", "policy": {"mode": "suggest"}})).expect(201);
    let window = night.csv("/systems/room/1/windows", &room_csv(1, 14)).expect(201).json();
    let fit = night.ended(&night.estimate("room/1", json!({})))["fit"].as_str().unwrap().to_owned();
    let other = night
        .ended(&night.estimate("room/1", json!({"method": {"name": "lm_multistart", "seed": 2}})))["fit"]
        .clone();
    for _ in 0..2 {
        night.json("POST", &format!("/fits/{fit}/promote"), &json!({"reason": "looks right"})).expect(200);
    }
    if other
        .as_str()
        .is_some_and(|other| night.get(&format!("/fits/{other}")).json()["waits_for_operator"] == true)
    {
        night
            .json(
                "POST",
                &format!("/fits/{}/reject", other.as_str().unwrap()),
                &json!({"reason": "once is enough"}),
            )
            .expect(200);
    }
    night.json("PUT", "/params/room/1/pin", &json!({"reason": "sensor swap"})).expect(200);
    for _ in 0..2 {
        night.send("DELETE", "/params/room/1/pin", &[], None).unwrap().expect(204);
    }
    admin
        .json(
            "PUT",
            "/schedules/weekly",
            &json!({"cron": "0 5 * * 1", "systems": ["room/*"], "enabled": false}),
        )
        .expect(201);
    admin.send("DELETE", "/schedules/weekly", &[], None).unwrap().expect(204);
    for _ in 0..2 {
        let added = admin.json("POST", "/models/rc2/effects", &json!({"effect": "constant_gain"}));
        assert!([200, 201].contains(&added.status), "{}", added.text);
    }
    let cited = format!("/windows/{}", window["id"].as_str().unwrap());
    admin.send("DELETE", &cited, &[], None).unwrap().expect(409);
    admin.send("DELETE", "/systems/room/1?force=true", &[], None).unwrap().expect(204);

    let entries: Vec<Value> = admin.get("/audit").expect(200).json()["items"].as_array().unwrap().clone();
    let short: Vec<[&str; 4]> = entries
        .iter()
        .filter(|entry| entry["action"] != "reject_fit")
        .map(|entry| {
            ["who", "action", "subject", "reason"].map(|field| entry[field].as_str().unwrap_or_default())
        })
        .collect();
    let expected = [
        ["ada", "delete_system", "room/1", ""],
        ["ada", "post_model", "rc2+constant_gain", ""],
        ["ada", "delete_schedule", "weekly", ""],
        ["ada", "put_schedule", "weekly", ""],
        ["night", "unpin", "room/1", ""],
        ["night", "pin", &fit, "sensor swap"],
        ["night", "promote_fit", &fit, "looks right"],
        ["ada", "put_system", "room/1", ""],
        ["local", "create_token", "night", ""],
        ["local", "create_token", "ada", ""],
        ["local", "put_system", "room/9", ""],
        ["service", "put_schedule", "nightly", ""],
    ];
    assert_eq!(short, expected);
    let at = |entry: &Value| entry["at"].as_str().unwrap().parse::<jiff::Timestamp>().unwrap();
    assert!(entries.windows(2).all(|pair| at(&pair[0]) >= at(&pair[1])), "newest first");

    // Page by page, and by system; who may see one room sees what was done to it.
    let page = admin.get("/audit?page_size=3").json();
    let next = admin
        .get(&format!("/audit?page_size=3&page_token={}", page["next_page_token"].as_str().unwrap()))
        .json();
    assert_eq!(
        [page["items"].as_array().unwrap().clone(), next["items"].as_array().unwrap().clone()].concat(),
        entries[..6]
    );
    let of_room = admin.get("/audit?system=room/1").json();
    assert!(of_room["items"].as_array().unwrap().len() >= 5);
    assert_eq!(night.get("/audit").json(), of_room);
    admin.get("/audit?system=room").problem(422, "invalid-request");
}

#[test]
fn what_was_done_cannot_be_rewritten() {
    let app = TestApp::start();
    app.token("ada", Scope::Admin, &[]);
    for sql in [
        "UPDATE audit SET who = 'nobody'",
        "DELETE FROM audit",
        "UPDATE tokens SET scope = 'read'",
        "UPDATE tokens SET expires_at = 0",
        "DELETE FROM tokens",
        "INSERT INTO audit (at, who, action, subject) VALUES (0, 'x', 'nothing', 'y')",
    ] {
        assert!(app.behind(sql).is_err(), "{sql}");
    }
}
