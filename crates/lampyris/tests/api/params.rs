//! What the controller sees: tags, long polls, statuses.

use crate::support::rooms::{room_csv, stuck_csv};
use crate::support::{TestApp, quick};
use serde_json::json;
use std::time::{Duration, Instant};

#[test]
fn an_unknown_system_and_one_without_a_fit_are_different_things() {
    let app = TestApp::start();
    app.get("/params/room/9").problem(404, "system-not-found");
    app.room("1", 1);
    let problem = app.get("/params/room/1").problem(404, "no-validated-parameters");
    assert!(problem["latest_job"].is_null());
    let nominal = app.get("/params/room/1?accept=nominal").expect(200);
    assert_eq!(
        (nominal.header("params-status"), nominal.json()["parameters"]["alpha_e"].as_f64()),
        ("nominal", Some(0.2))
    );
    assert!(nominal.json()["parameters"]["T_e0"].is_null() && nominal.json()["revision"].is_null());
    let job = app.json("POST", "/jobs", &crate::support::endless("room/1")).expect(202).json()["id"]
        .as_str()
        .unwrap()
        .to_owned();
    let waiting = app.get("/params/room/1");
    assert!(!waiting.header("retry-after").is_empty());
    assert_eq!(waiting.problem(404, "no-validated-parameters")["latest_job"], job.as_str());
    app.post(&format!("/jobs/{job}/cancel")).expect(200);
    app.ended(&job);
    assert!(app.get("/params/room/1").header("retry-after").is_empty());
    app.get("/params/room/1?accept=anything").problem(422, "invalid-request");
    app.get("/systems/room/1/state").problem(404, "no-state");
}

#[test]
fn a_tag_saves_the_body_and_a_long_poll_waits_for_news() {
    let app = TestApp::start();
    app.room("1", 1);
    // Whoever waits for the first set gets it as soon as it is there.
    let poll = {
        let client = app.client.clone();
        std::thread::spawn(move || client.get_with("/params/room/1", &[("prefer", "wait=60")]))
    };
    std::thread::sleep(Duration::from_millis(100));
    app.ended(&app.estimate("room/1", json!({})));
    let first = poll.join().unwrap().expect(200);
    let etag = first.header("etag").to_owned();
    assert!(etag.starts_with('"'));
    let kept = app.get_with("/params/room/1", &[("if-none-match", &etag)]).expect(304);
    assert_eq!((kept.text.as_str(), kept.header("etag")), ("", etag.as_str()));
    assert_eq!(app.get("/params/room/1").text, first.text, "nothing changes because time passes");

    let start = Instant::now();
    app.get_with("/params/room/1", &[("if-none-match", &etag), ("prefer", "wait=1")]).expect(304);
    assert!(start.elapsed() >= Duration::from_millis(950), "{:?}", start.elapsed());

    let (client, tag) = (app.client.clone(), etag.clone());
    let poll = std::thread::spawn(move || {
        client.get_with("/params/room/1", &[("if-none-match", &tag), ("prefer", "wait=60")])
    });
    std::thread::sleep(Duration::from_millis(100));
    app.csv("/systems/room/1/windows", &stuck_csv()).expect(201);
    app.ended(&app.estimate("room/1", json!({})));
    let news = poll.join().unwrap().expect(200);
    assert_eq!(news.json()["status"], "fallback");
}

#[test]
fn a_rejected_fit_leaves_the_previous_set_in_service() {
    let app = TestApp::start();
    app.room("1", 1);
    app.ended(&app.estimate("room/1", json!({})));
    let good = app.get("/params/room/1").expect(200).json();
    app.csv("/systems/room/1/windows", &stuck_csv()).expect(201);

    // An experiment, or another model than the system's, may fail without anybody noticing.
    let experiment = app.ended(&app.estimate("room/1", json!({"experiment": true})));
    assert_eq!(experiment["outcome"], "rejected", "{experiment}");
    app.ended(&app.estimate("room/1", json!({"model": "rc2+constant_gain"})));
    assert_eq!(app.get("/params/room/1").json(), good);

    let rejected = app.ended(&app.estimate("room/1", json!({})));
    assert_eq!(
        (rejected["state"].as_str(), rejected["outcome"].as_str()),
        (Some("succeeded"), Some("rejected")),
        "{rejected}"
    );
    let answer = app.get("/params/room/1").expect(200);
    assert_eq!(answer.header("params-status"), "fallback");
    let fallen = answer.json();
    assert_eq!(
        (&fallen["parameters"], &fallen["revision"], &fallen["fit"]),
        (&good["parameters"], &good["revision"], &good["fit"])
    );
    assert_eq!(
        (fallen["fallback"]["reason"].as_str(), &fallen["fallback"]["fit"]),
        (Some("validation_failed"), &rejected["fit"])
    );
    assert!(!fallen["fallback"]["failed_checks"].as_array().unwrap().is_empty());

    // A good fit on the measurements from before the sensor hung ends the fallback. They are a week older.
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "policy": {"stale_after": "P30D"}}))
        .expect(200);
    let job = app.estimate(
        "room/1",
        json!({"window": {"to": "2026-01-07T00:00:00Z"}, "split": {"train": "P4D", "validation": "P2D"}}),
    );
    let ended = app.ended(&job);
    assert!(["accepted", "unchanged"].contains(&ended["outcome"].as_str().unwrap()), "{ended}");
    let params = app.get("/params/room/1").json();
    assert_eq!((params["status"].as_str(), params["fallback"].is_null()), (Some("fresh"), true));
}

#[test]
fn a_job_that_fails_says_so_beside_the_previous_set() {
    let app = TestApp::start();
    app.room("1", 1);
    app.ended(&app.estimate("room/1", json!({})));
    let good = app.get("/params/room/1").json();
    let failed = app.ended(&app.failing("room/1", json!({})));
    assert_eq!(
        (failed["state"].as_str(), failed["error"]["code"].as_str()),
        (Some("failed"), Some("diverged")),
        "{failed}"
    );
    let params = app.get("/params/room/1").json();
    assert_eq!(
        (params["status"].as_str(), params["fallback"]["reason"].as_str()),
        (Some("fallback"), Some("job_failed"))
    );
    assert_eq!((&params["fallback"]["job"], &params["parameters"]), (&failed["id"], &good["parameters"]));
}

#[test]
fn a_set_turns_stale_when_its_time_has_come() {
    // Before the newest of the measurements, so that the age of the validation decides.
    let app = TestApp::at("2026-01-14T12:00:00Z", |_| {});
    app.room("1", 1);
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "policy": {"stale_after": "PT4S"}}))
        .expect(200);
    app.ended(&app.estimate("room/1", json!({})));
    let fresh = app.get("/params/room/1").expect(200);
    assert_eq!(fresh.json()["status"], "fresh");
    let stale = app
        .get_with("/params/room/1", &[("if-none-match", fresh.header("etag")), ("prefer", "wait=20")])
        .expect(200);
    assert_eq!(
        (stale.header("params-status"), &stale.json()["parameters"]),
        ("stale", &fresh.json()["parameters"])
    );
    app.get("/params/room/1?accept=fresh").problem(404, "no-fresh-parameters");
}

#[test]
fn old_measurements_are_not_fresh_however_lately_they_were_looked_at() {
    let app = TestApp::at("2026-01-20T00:00:00Z", |_| {});
    app.room("1", 1);
    assert_eq!(app.ended(&app.estimate("room/1", json!({})))["outcome"], "accepted");
    let old = app.get("/params/room/1").expect(200).json();
    assert_eq!(
        (&old["status"], &old["stale_after"]),
        (&json!("stale"), &json!("2026-01-17T23:30:00Z")),
        "{old}"
    );
    app.get("/params/room/1?accept=fresh").problem(404, "no-fresh-parameters");
    let row = app.get("/systems").json()["items"][0].clone();
    assert_eq!(row["health"], "attention", "{row}");
    // A week later something worse is tried on newer measurements, and what is served holds its ground there.
    app.clock.set("2026-01-22T00:00:00Z".parse().unwrap());
    app.csv("/systems/room/1/windows", &room_csv(1, 21)).expect(201);
    let tried = |factor: f64| {
        let mut fixed = old["parameters"].clone();
        fixed.as_object_mut().unwrap().shift_remove("T_e0");
        fixed["alpha_a"] = json!(factor * fixed["alpha_a"].as_f64().unwrap());
        let split = json!({"train": "P14D", "validation": "P7D"});
        app.ended(&app.estimate("room/1", json!({"split": split, "fixed": fixed})))
    };
    let unchanged = (1..60)
        .map(|step| tried(1.0 + 0.005 * f64::from(step)))
        .find(|job| job["outcome"] != "suggested")
        .unwrap();
    assert_eq!(unchanged["outcome"], "unchanged", "{unchanged}");
    let held_its_ground = app.get("/params/room/1?accept=fresh").expect(200).json();
    assert_eq!(
        (&held_its_ground["stale_after"], &held_its_ground["window"]),
        (&json!("2026-01-24T23:30:00Z"), &old["window"])
    );
}

#[test]
fn a_clock_that_was_set_back_makes_nothing_fresh_for_years() {
    let app = TestApp::start();
    for room in ["1", "2"] {
        app.room(room, 1);
        app.ended(&app.estimate(&format!("room/{room}"), json!({})));
    }
    let status = |room: &str| app.get(&format!("/params/room/{room}")).expect(200).json()["status"].clone();
    assert_eq!((status("1"), status("2")), (json!("fresh"), json!("fresh")));
    app.clock.set("2019-01-01T00:00:00Z".parse().unwrap());
    // Any event wakes the timer; what is served elsewhere is looked at as well.
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "label": "attic"})).expect(200);
    assert_eq!(status("1"), "stale");
    app.until("/params/room/2", |params| params["status"] == "stale");
    app.clock.set("2026-01-16T00:10:00Z".parse().unwrap());
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(200);
    app.until("/params/room/2", |params| params["status"] == "fresh");
    assert_eq!(status("1"), "fresh");
}

#[test]
fn whoever_waits_for_a_system_that_is_deleted_hears_of_it() {
    let app = TestApp::start();
    app.room("1", 1);
    let poll = {
        let client = app.client.clone();
        std::thread::spawn(move || {
            let begun = Instant::now();
            (client.get_with("/params/room/1", &[("prefer", "respond-async, Wait=\"60\"")]), begun.elapsed())
        })
    };
    std::thread::sleep(Duration::from_millis(300));
    app.send("DELETE", "/systems/room/1", &[], None).unwrap().expect(204);
    let (answer, took) = poll.join().unwrap();
    answer.problem(404, "system-not-found");
    assert!((Duration::from_millis(250)..Duration::from_secs(30)).contains(&took), "{took:?}");
}

#[test]
fn a_policy_that_suggests_publishes_nothing() {
    let app = TestApp::start();
    app.room("1", 1);
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "policy": {"mode": "suggest"}})).expect(200);
    let ended = app.ended(&app.estimate("room/1", json!({})));
    assert_eq!(
        (ended["outcome"].as_str(), ended["revision"].is_null()),
        (Some("suggested"), true),
        "{ended}"
    );
    app.get("/params/room/1").problem(404, "no-validated-parameters");
    let body = quick("room/1");
    assert_eq!(body["kind"], "estimate");
}
