//! Since when a parameter is another one, by the newest weeks of a record.

use crate::support::TestApp;
use crate::support::events::Told;
use crate::support::rooms::{csv_of, room_that_changes};
use crate::support::schema::disagreements;
use serde_json::{Value, json};

const PATH: &str = "/systems/room/1/changes";

/// Six weeks of a room that loses more to the outdoors from a day on, in 1/h.
fn losing(days: std::ops::Range<usize>, since: usize, then: f64) -> String {
    let room = room_that_changes(1, days.end, |day| if day < since { 0.15 } else { then });
    csv_of(&room[days.start * 48..])
}

/// The temperature of the room alone leaves its three coefficients on a ridge: two of them are known.
fn one_unknown() -> Value {
    json!({"model": "rc2", "fixed": {"alpha_e": 0.8, "beta_e": 4.0}})
}

#[test]
fn a_room_that_loses_more_heat_says_since_when() {
    let app = TestApp::at("2026-02-12T00:00:00Z", |_| {});
    app.json("PUT", "/systems/room/1", &one_unknown()).expect(201);
    app.get(PATH).problem(404, "no-validated-parameters");
    app.csv("/systems/room/1/windows", &losing(0..14, 32, 0.2)).expect(201);
    let job = app.ended(&app.estimate("room/1", json!({})));
    assert_eq!(job["outcome"], "accepted");

    let told = app.get(PATH).expect(200).json();
    let schemas = lampyris::http::described_documents();
    assert_eq!(disagreements(&told, &schemas["SystemChanges"], &schemas, ""), [""; 0]);
    assert_eq!(
        (&told["system"], &told["fit"], &told["change"]),
        (&json!("room/1"), &job["fit"], &Value::Null)
    );

    app.csv("/systems/room/1/windows", &losing(14..42, 32, 0.2)).expect(201);
    let answer = app.get(PATH).expect(200);
    let (told, tag) = (answer.json(), answer.header("etag").to_owned());
    let change = &told["change"];
    assert_eq!(change["parameter"], "alpha_a", "{told}");
    assert_eq!(change["since"], "2026-02-02T00:00:00Z", "{told}");
    let value = |field: &str| change[field].as_f64().unwrap();
    assert!((value("after") / value("before") - 4.0 / 3.0).abs() < 0.1, "{told}");
    assert!(told["sentence"].as_str().unwrap().starts_with("Since 2026-02-02"), "{told}");
    assert_eq!(app.get_with(PATH, &[("if-none-match", &tag)]).status, 304);

    app.get("/systems/room/9/changes").problem(404, "system-not-found");
}

#[test]
fn the_first_scheduled_fit_that_sees_a_change_tells_it_once() {
    let app = TestApp::at("2026-02-12T00:00:00Z", |_| {});
    app.json("PUT", "/systems/room/1", &one_unknown()).expect(201);
    app.csv("/systems/room/1/windows", &losing(0..42, 32, 0.2)).expect(201);
    let mut stream = app.listen("/events", "");
    let night = |seed: u64| {
        // An equal job would be the same one.
        let request = json!({"method": {"name": "lm_multistart", "seed": seed}});
        let schedule = json!({"cron": "30 2 * * *", "systems": ["room/*"], "request": request});
        app.json("PUT", "/schedules/nightly", &schedule).expect(200);
        let batch = app.post("/schedules/nightly/run").expect(202).json();
        app.ended(batch["jobs"][0]["job"].as_str().unwrap())["fit"].clone()
    };
    let fits = [night(1), night(2)];
    for fit in &fits {
        let fit = app.get(&format!("/fits/{}", fit.as_str().unwrap())).expect(200).json();
        assert_eq!(fit["changed"]["parameter"], "alpha_a", "{}", fit["changed"]);
    }
    // Somebody's own job says nothing, and ends behind all that was told.
    let last = app.estimate("room/1", json!({"method": {"name": "lm_multistart", "seed": 3}}));
    let told = stream.until(|told| told.event == "finished" && told.data["id"] == json!(last));
    let changed: Vec<&Told> = told.iter().filter(|told| told.event == "changed").collect();
    assert_eq!(changed.len(), 1, "{changed:?}");
    assert_eq!((&changed[0].data["system"], &changed[0].data["fit"]), (&json!("room/1"), &fits[0]));
    assert!(changed[0].data["sentence"].as_str().unwrap().starts_with("Since 2026-02-0"), "{changed:?}");
}

#[test]
fn what_was_before_a_change_is_forgotten_where_the_policy_wants_it() {
    let app = TestApp::at("2026-02-12T00:00:00Z", |_| {});
    app.json("PUT", "/systems/room/1", &one_unknown()).expect(201);
    app.csv("/systems/room/1/windows", &losing(0..42, 26, 0.25)).expect(201);
    let night = |seed: u64| {
        let request = json!({"method": {"name": "lm_multistart", "seed": seed}});
        let schedule = json!({"cron": "30 2 * * *", "systems": ["room/*"], "request": request});
        app.json("PUT", "/schedules/nightly", &schedule).expect(200);
        let batch = app.post("/schedules/nightly/run").expect(202).json();
        let job = app.ended(batch["jobs"][0]["job"].as_str().unwrap());
        app.get(&format!("/fits/{}", job["fit"].as_str().unwrap())).expect(200).json()
    };
    let loss = |fit: &Value| fit["parameters"]["alpha_a"]["value"].as_f64().unwrap();
    let forgets = |fit: &Value| fit["remarks"].to_string().contains("are forgotten");
    let both = night(1);
    assert_eq!(both["changed"]["parameter"], "alpha_a", "{}", both["changed"]);
    assert!(!forgets(&both) && loss(&both) < 0.24, "{} 1/h", loss(&both));
    let mut system = one_unknown();
    system["policy"] = json!({"forget_before_change": true});
    app.json("PUT", "/systems/room/1", &system).expect(200);
    let mut misses = Vec::new();
    // It sees the change still, and forgets night after night.
    for seed in [2, 3] {
        let newer = night(seed);
        assert!(forgets(&newer), "{}", newer["remarks"]);
        assert_eq!(newer["changed"]["parameter"], "alpha_a", "{}", newer["changed"]);
        misses.push((loss(&newer) - 0.25).abs());
    }
    assert!(misses.iter().all(|miss| *miss < 0.01), "{misses:?} beside {}", (loss(&both) - 0.25).abs());
    // Whoever asks gets what is asked for.
    let job = app.ended(&app.estimate("room/1", json!({"method": {"name": "lm_multistart", "seed": 4}})));
    let posted = app.get(&format!("/fits/{}", job["fit"].as_str().unwrap())).expect(200).json();
    assert!(!forgets(&posted), "{}", posted["remarks"]);
}
