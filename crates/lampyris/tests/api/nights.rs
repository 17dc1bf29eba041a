//! What each night has come to, as a document and as a mail, and which rooms lack what.

use crate::support::TestApp;
use lampyris::service::queue::schedules;
use lampyris::store::tokens::Scope;
use serde_json::{Value, json};

/// Lets the nightly schedule run at half past two, and gives its batch when it has ended.
fn night(app: &TestApp, at: &str) -> Value {
    app.clock.set(at.parse().unwrap());
    app.within(async |service| schedules::due(service, service.now()).await.unwrap());
    let batch = app.get("/batches").json()["items"][0]["id"].as_str().unwrap().to_owned();
    app.until(&format!("/batches/{batch}"), |batch| batch["finished"] == true)
}

#[test]
fn a_morning_says_what_changed_and_what_to_do() {
    let app = TestApp::start();
    app.get("/nights/2026-01-16").problem(404, "night-not-found");
    app.get("/nights/bat_none").problem(404, "night-not-found");
    app.room("1", 1);
    // Its sensor hangs: no fit of it may be served, and its name is no markup.
    app.json("PUT", "/systems/room/2", &json!({"model": "rc2", "label": "<b>"})).expect(201);
    app.csv("/systems/room/2/windows", &crate::support::rooms::stuck_csv()).expect(201);
    let batch = night(&app, "2026-01-17T02:30:30Z");
    let listed = app.get("/nights").json();
    assert_eq!(
        (&listed["items"][0]["night"], &listed["items"][0]["id"]),
        (&json!("2026-01-17"), &batch["id"])
    );
    let report = app.get("/nights/2026-01-17").expect(200).json();
    assert_eq!(report["finished"], true, "{report}");
    let changed = &report["changed"][0];
    assert_eq!((&changed["system"], &changed["revision"]), (&json!("room/1"), &json!(1)), "{report}");
    assert!(changed["before"].is_null() && changed["after"].as_f64().unwrap() > 0.0, "{report}");
    assert_eq!(changed["unit"], "K");
    let refused = report["refused"].as_array().unwrap();
    assert_eq!((refused.len(), &refused[0]["systems"]), (1, &json!(["room/2"])), "{report}");
    assert!(report["summary"].as_str().unwrap().starts_with("2 jobs: 1 new parameters, 1 "), "{report}");
    // The same batch by its own name, and as a mail.
    let by_batch = app.get(&format!("/nights/{}", batch["id"].as_str().unwrap())).expect(200).json();
    assert_eq!(by_batch["changed"], report["changed"]);
    let mail = app.get_with("/nights/2026-01-17", &[("accept", "text/html,*/*;q=0.1")]).expect(200);
    assert!(mail.header("content-type").starts_with("text/html"), "{}", mail.header("content-type"));
    assert!(mail.header("content-security-policy").starts_with("default-src 'none'"));
    assert!(mail.text.contains("/ui/systems/room/1/parameters") && !mail.text.contains("<script"));
    app.get_with("/nights/2026-01-17", &[("accept", "image/png")]).expect(406);

    // A week later nothing came: what is served is stale, and the first thing to do is to look why.
    app.clock.set("2026-01-24T06:00:00Z".parse().unwrap());
    app.until("/params/room/1", |served| served["status"] == "stale");
    let report = app.get("/nights/2026-01-17").json();
    let doubtful = &report["doubtful"][0];
    assert_eq!((&doubtful["system"], &doubtful["lost"]), (&json!("room/1"), &json!(true)), "{report}");
    assert_eq!(report["next"][0]["link"], "/ui/systems/room/1/data", "{report}");

    // Whoever may see one room only has no night of all.
    let other = app.token("other", Scope::Read, &["room/9"]);
    other.get("/nights/2026-01-17").problem(404, "night-not-found");
    assert_eq!(other.get("/nights").json()["items"], json!([]));
    assert_eq!(other.get("/evidence/matrix").json()["items"], json!([]));
}

#[test]
fn the_matrix_lays_every_effect_beside_every_room() {
    let app = TestApp::start();
    for (id, seed) in [("1", 1), ("2", 2), ("3", 3)] {
        app.room(id, seed);
    }
    app.json("PUT", "/systems/site/home", &json!({"label": "the weather"})).expect(201);
    let none = app.get("/evidence/matrix").expect(200).json();
    assert_eq!((none["effects"].as_array().unwrap().len(), none["items"].as_array().unwrap().len()), (0, 3));
    let body =
        json!({"kind": "diagnose", "systems": ["room/1", "room/2"], "method": {"name": "lm_multistart"}});
    let answer = app.json("POST", "/jobs", &body).expect(202);
    app.until(answer.header("location"), |batch| batch["finished"] == true);

    let matrix = app.get("/evidence/matrix?systems=room/*").expect(200).json();
    let rows = matrix["items"].as_array().unwrap();
    assert_eq!(rows.iter().map(|row| &row["system"]).collect::<Vec<_>>(), ["room/1", "room/2", "room/3"]);
    assert!(rows[2]["diagnosis"].is_null() && rows[2]["cells"] == json!([]), "{matrix}");
    let diagnosis = app.get(&format!("/diagnoses/{}", rows[0]["diagnosis"].as_str().unwrap())).json();
    let state = |row: &Value, effect: &str| {
        let cells = row["cells"].as_array().unwrap();
        cells.iter().find(|cell| cell["effect"] == effect).map(|cell| cell["state"].clone())
    };
    for untestable in diagnosis["not_testable"].as_array().unwrap() {
        let family = untestable["effect"].as_str().unwrap().split(':').next().unwrap();
        assert!(state(&rows[0], family).is_some(), "{family}: {matrix}");
    }
    assert_eq!(state(&rows[0], "solar_gain"), Some(json!("not_testable")), "nobody has logged the sun");
    let effects = matrix["effects"].as_array().unwrap();
    let sun = effects.iter().find(|effect| effect["effect"] == "solar_gain").unwrap();
    assert_eq!(
        (&sun["diagnosed"], &sun["not_testable"], &sun["sentence"]),
        (&json!(2), &json!(2), &json!("none of 2 rooms lacks solar gain"))
    );
    // By pages, of which the first carries the sums.
    let first = app.get("/evidence/matrix?systems=room/1,room/3&page_size=1").json();
    assert_eq!(first["items"][0]["system"], "room/1");
    let token = first["next_page_token"].as_str().unwrap();
    let second = app.get(&format!("/evidence/matrix?systems=room/1,room/3&page_token={token}")).json();
    assert_eq!((&second["items"][0]["system"], &second["effects"]), (&json!("room/3"), &Value::Null));
    app.get("/evidence/matrix?systems=rooms").problem(422, "invalid-request");
    // What a model has already is no longer lacking.
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2+constant_gain"})).expect(200);
    let grown = app.get("/evidence/matrix?systems=room/1").json();
    assert_eq!(state(&grown["items"][0], "constant_gain"), Some(json!("in_model")), "{grown}");
}
