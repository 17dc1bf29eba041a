//! The list of systems: where they belong, how they fare, what to do about it, and how their errors went.

use crate::support::TestApp;
use serde_json::{Value, json};

/// The first row, without its age, which goes on.
fn row(app: &TestApp) -> Value {
    let mut row = app.get("/systems?with=trend").expect(200).json()["items"][0].clone();
    row["age_s"].take();
    row
}

#[test]
fn a_system_belongs_to_a_group() {
    let app = TestApp::start();
    let put = |group: Value| app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "group": group}));
    put(json!("North house/Floor 2")).expect(201);
    assert_eq!(app.get("/systems/room/1").json()["group"], "North house/Floor 2");
    assert_eq!(row(&app)["group"], "North house/Floor 2");
    for (group, code) in [
        ("a".repeat(201), "too-long"),
        ("North house//Room".to_owned(), "invalid-name"),
        ("/North house".to_owned(), "invalid-name"),
        ("North house / Floor 2".to_owned(), "invalid-name"),
        ("North\nhouse".to_owned(), "invalid-name"),
    ] {
        let problem = put(json!(group)).problem(422, "invalid-request");
        let fault = &problem["errors"][0];
        assert_eq!(
            (fault["pointer"].as_str(), fault["code"].as_str()),
            (Some("/group"), Some(code)),
            "{fault}"
        );
    }
    assert_eq!(row(&app)["group"], "North house/Floor 2", "what was refused has changed nothing");
    put(json!("é".repeat(200))).expect(200);
    put(json!("")).expect(200);
    assert_eq!(row(&app)["group"], "");
    assert_eq!(app.get("/systems/room/1").json().get("group"), None);
}

#[test]
fn a_row_says_what_to_do_next() {
    let mut app = TestApp::start();
    let next = |app: &TestApp| {
        let row = row(app);
        let next = row["next"].as_object().unwrap().clone();
        (next["code"].as_str().unwrap().to_owned(), next["href"].as_str().unwrap().to_owned(), row)
    };
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    let (code, href, _) = next(&app);
    assert_eq!((code.as_str(), href.as_str()), ("upload", "/ui/systems/room/1/data"));
    app.lasting_room("2", 1);
    app.send("DELETE", "/systems/room/1", &[], None).unwrap().expect(204);
    assert_eq!(next(&app).0, "refit");
    let job = app.ended(&app.estimate("room/2", json!({})));
    let (code, _, good) = next(&app);
    assert_eq!((code.as_str(), good["health"].as_str()), ("none", Some("ok")), "{good}");
    let fit = app.get(&format!("/fits/{}", job["fit"].as_str().unwrap())).json();
    let (quality, metrics) = (&good["quality"], &fit["metrics"]["T_room"]);
    assert_eq!(
        (&quality["ahead"], &quality["persistence"], &quality["rho"]),
        (&metrics["ahead"]["PT6H"]["rmse"], &metrics["ahead"]["PT6H"]["persistence"], &metrics["rho"])
    );
    // The newest diagnosis of the model that it has counts, and no other.
    let named = |id: &str, sequence: i64, job: &str, missing: &str| {
        let sql = format!(
            "INSERT INTO diagnoses (id, sequence, job, system, fit, verdict, document, created_at, missing) VALUES \
            ('{id}', {sequence}, '{job}', 'room/2', '{}', 'named', '{{}}', 0, '{missing}')",
            fit["id"].as_str().unwrap()
        );
        app.behind(&sql).unwrap();
    };
    let wind = r#"{"effect": "wind_infiltration", "title": "Wind infiltration", "size": null}"#;
    named("dia_1", 1_000_000, job["id"].as_str().unwrap(), wind);
    let (code, href, lacking) = next(&app);
    assert_eq!((code.as_str(), href.as_str()), ("add_effect", "/ui/systems/room/2/missing"), "{lacking}");
    assert_eq!(
        (lacking["health"].as_str(), lacking["why"].as_str(), lacking["next"]["text"].as_str()),
        (Some("attention"), Some("Wind infiltration is missing."), Some("Add wind infiltration"))
    );
    app.restart();
    assert_eq!(next(&app).0, "add_effect");
    let policy = crate::support::lasting();
    app.json("PUT", "/systems/room/2", &json!({"model": "tite", "policy": policy})).expect(200);
    assert_eq!(next(&app).0, "none", "another model may have it");
}

#[test]
fn a_trend_is_of_fits_that_count() {
    let mut app = TestApp::start();
    app.lasting_room("1", 1);
    let error = |app: &TestApp, more: Value| {
        let job = app.ended(&app.estimate("room/1", more));
        let fit = app.get(&format!("/fits/{}", job["fit"].as_str().unwrap())).json();
        fit["metrics"]["T_room"]["validation_rmse"].clone()
    };
    let first = error(&app, json!({}));
    error(&app, json!({"experiment": true, "method": {"name": "cfa", "seed": 2}}));
    error(&app, json!({"split": {"train": "P9D", "validation": "P3D", "test": "P2D"}}));
    let second = error(&app, json!({"method": {"name": "cfa", "seed": 3}}));
    let told = row(&app);
    assert_eq!(told["trend"], json!([first, second]), "{told}");
    assert_eq!(app.get("/systems").json()["items"][0].get("trend"), None, "it was not asked for");
    // What an earlier program has kept is brought into the list by the next start, and read from the
    // documents until then.
    app.behind("UPDATE fits SET listed = NULL, validation_rmse = NULL").unwrap();
    let before = row(&app);
    assert_eq!((&before["quality"], &before["trend"]), (&told["quality"], &json!([])));
    let listed = app.get("/fits").expect(200).json();
    assert_eq!(listed["items"].as_array().unwrap().len(), 4);
    app.restart();
    app.until("/systems?with=trend", |page| page["items"][0]["trend"] != json!([]));
    assert_eq!(row(&app), told);
    assert_eq!(app.get("/fits").json(), listed);
}

#[test]
fn single_rows_can_be_asked_for() {
    let app = TestApp::start();
    for id in ["1", "2", "10"] {
        app.json("PUT", &format!("/systems/room/{id}"), &json!({"model": "rc2"})).expect(201);
    }
    let names = |path: &str| -> Vec<String> {
        let page = app.get(path).expect(200).json();
        let items = page["items"].as_array().unwrap();
        items.iter().map(|row| row["system"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(names("/systems?systems=room/2,room/10,room/3"), ["room/10", "room/2"]);
    let many: Vec<String> = (0..101).map(|id| format!("room/{id}")).collect();
    app.get(&format!("/systems?systems={}", many.join(","))).problem(422, "invalid-request");
    app.get("/systems?systems=room").problem(422, "invalid-request");
    app.get("/systems?with=everything").problem(422, "invalid-request");
    let some = app.token("one", lampyris::store::tokens::Scope::Read, &["room/1"]);
    assert_eq!(
        some.get("/systems?systems=room/1,room/2").expect(200).json()["items"].as_array().unwrap().len(),
        1
    );
}
