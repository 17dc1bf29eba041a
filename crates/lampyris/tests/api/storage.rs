//! A database that is full, or whose disk has failed: nothing is acknowledged and lost, and controllers
//! notice nothing.

use crate::support::cluster;
use crate::support::process::Process;
use crate::support::rooms::room_csv;
use crate::support::{Answer, Client, PATIENCE, TestApp, quick};
use serde_json::json;
use std::time::{Duration, Instant};

/// Writes that are tried before a test gives up on the database becoming full.
const MOST_WRITES: u64 = 2000;

/// Sends something that is new every time until it is refused, and gives what was taken, and the refusal.
#[track_caller]
fn until_refused(send: impl Fn(u64) -> Answer) -> (Vec<String>, Answer) {
    let mut taken = Vec::new();
    for number in 0..MOST_WRITES {
        let answer = send(number);
        if answer.status != 201 {
            return (taken, answer);
        }
        taken.push(answer.json()["id"].as_str().unwrap().to_owned());
    }
    panic!("{MOST_WRITES} writes were taken");
}

fn window(client: &Client, number: u64) -> Answer {
    let date = format!("{}-{:02}-{:02}", 1990 + number / 336, 1 + number / 28 % 12, 1 + number % 28);
    client.csv("/systems/room/1/windows", &room_csv(number, 1).replace("2026-01-01", &date))
}

/// A model document of some kilobytes.
fn model(client: &Client, number: u64) -> Answer {
    let document = json!({
        "id": format!("padding_{number}"), "title": "x".repeat(6000),
        "states": {"T_room": {"unit": "degC", "initial": "T_room"}},
        "equations": {"T_room": "k * (T_out - T_room)"},
        "parameters": {"k": {"unit": "1/h", "lower": 0.01, "upper": 2.0, "nominal": 0.1, "scale": "log"}},
        "inputs": {"T_out": {"unit": "degC"}},
        "outputs": {"T_room": {"expr": "T_room", "unit": "degC", "noise_sd": 0.05}},
    });
    client.json("POST", "/models", &document)
}

#[test]
fn windows_are_refused_while_results_still_fit() {
    if cluster::is_on() {
        return;
    }
    let app = TestApp::with(|settings| settings.limits.database_bytes = 1 << 20);
    app.room("1", 1);
    assert_eq!(app.ended(&app.post_job(&quick("room/1")))["outcome"], "accepted");
    let served = app.get("/params/room/1").expect(200);
    let (taken, refused) = until_refused(|number| window(&app, number));
    assert!(taken.len() > 20, "{}", taken.len());
    assert_eq!(refused.header("retry-after"), "10");
    let problem = refused.problem(507, "storage-full");
    assert!(problem["detail"].as_str().unwrap().contains("delete windows"), "{problem}");
    let now = app.get("/params/room/1").expect(200);
    assert_eq!((now.header("etag"), &now.text), (served.header("etag"), &served.text));
    app.get("/readyz").expect(200);
    let mut again = quick("room/1");
    again["experiment"] = json!(true);
    assert_eq!(app.ended(&app.post_job(&again))["state"], "succeeded", "the reserve is for results");
    // Room again: no restart, no wait.
    for id in &taken[..taken.len() / 2] {
        app.send("DELETE", &format!("/windows/{id}"), &[], None).unwrap().expect(204);
    }
    window(&app, MOST_WRITES).expect(201);
}

#[test]
fn a_full_database_serves_refuses_and_goes_on_when_there_is_room() {
    if cluster::is_on() {
        return;
    }
    let app = TestApp::with(|settings| settings.limits.database_bytes = 1 << 20);
    app.room("1", 1);
    assert_eq!(app.ended(&app.post_job(&quick("room/1")))["outcome"], "accepted");
    let served = app.get("/params/room/1").expect(200);
    let spare: Vec<String> = (0..20)
        .map(|number| window(&app, number).expect(201).json()["id"].as_str().unwrap().to_owned())
        .collect();
    // A fit that ends while there is no room for its result.
    let mut long = crate::support::endless("room/1");
    // Longer than the database takes to fill, also on a machine that is busy.
    long["budget"]["wall"] = json!("PT12S");
    long["method"]["generations"] = json!(10_000);
    long["experiment"] = json!(true);
    let job = app.post_job(&long);
    app.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
    let (taken, refused) = until_refused(|number| model(&app, number));
    assert!(taken.len() > 20, "{}", taken.len());
    assert_eq!(refused.header("retry-after"), "10");
    refused.problem(507, "storage-full");
    let ready = app.get("/readyz").expect(503).json();
    assert_eq!((&ready["ready"], &ready["database"]), (&json!(false), &json!("full")));
    let now = app.get("/params/room/1").expect(200);
    assert_eq!((now.header("etag"), &now.text), (served.header("etag"), &served.text));
    app.get("/jobs").expect(200);
    let ended = app.ended(&job);
    assert_eq!(
        (ended["state"].as_str(), ended["error"]["code"].as_str()),
        (Some("failed"), Some("storage")),
        "{ended}"
    );
    assert_eq!(app.get("/params/room/1").text, served.text, "controllers notice nothing");
    // Room again.
    for id in spare {
        app.send("DELETE", &format!("/windows/{id}"), &[], None).unwrap().expect(204);
    }
    let begun = Instant::now();
    while model(&app, MOST_WRITES).status != 201 {
        assert!(begun.elapsed() < PATIENCE, "writes do not go on");
        std::thread::sleep(Duration::from_millis(50));
    }
    app.get("/readyz").expect(200);
    assert_eq!(app.ended(&app.post_job(&quick("room/1")))["state"], "succeeded");
}

#[test]
fn after_a_failed_write_nothing_is_written_until_the_next_start() {
    let dir = tempfile::tempdir().unwrap();
    let database = dir.path().join("broken.db");
    let service = Process::start(&database);
    service.client.room("1", 1);
    assert_eq!(service.client.ended(&service.client.post_job(&quick("room/1")))["outcome"], "accepted");
    let served = service.client.get("/params/room/1").expect(200);
    assert_eq!(service.terminate().0, Some(0));
    // The system lets no file grow beyond a megabyte: to SQLite that is a write that failed.
    let service = Process::start_with_small_files(&database);
    let (taken, refused) = until_refused(|number| window(&service.client, number));
    assert!(taken.len() > 5, "{}", taken.len());
    assert_ne!(refused.header("retry-after"), "");
    refused.problem(503, "storage-read-only");
    for _ in 0..3 {
        window(&service.client, MOST_WRITES).problem(503, "storage-read-only");
        service
            .client
            .json("PUT", "/systems/room/2", &json!({"model": "rc2"}))
            .problem(503, "storage-read-only");
        service.client.get("/readyz").expect(503);
    }
    let now = service.client.get("/params/room/1").expect(200);
    assert_eq!((now.header("etag"), &now.text), (served.header("etag"), &served.text));
    service.kill();
    let service = Process::start(&database);
    for id in &taken {
        service.client.get(&format!("/windows/{id}")).expect(200);
    }
    window(&service.client, MOST_WRITES).expect(201);
    service.client.get("/readyz").expect(200);
    assert_eq!(service.client.get("/params/room/1").expect(200).text, served.text);
}

#[test]
fn a_write_that_is_larger_than_the_memory_of_the_database_fails_as_any_other() {
    let dir = tempfile::tempdir().unwrap();
    let service = Process::start_with_small_files(&dir.path().join("large.db"));
    let client = &service.client;
    client.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    // Digits that do not compress, for the blocks of eight channels.
    let mut csv =
        "time".to_owned() + &(0..8).map(|channel| format!(",P_{channel}[kW]")).collect::<String>() + "\n";
    let start: jiff::Timestamp = "2026-01-01T00:00:00Z".parse().unwrap();
    let mut state = 1u64;
    for minute in 0..30_000 {
        csv += &(start + jiff::SignedDuration::from_mins(minute)).to_string();
        for _ in 0..8 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            csv += &format!(",{}.{}", state >> 62, state >> 32);
        }
        csv.push('\n');
    }
    client.csv("/systems/room/1/windows", &csv).problem(503, "storage-read-only");
    client.json("PUT", "/systems/room/2", &json!({"model": "rc2"})).problem(503, "storage-read-only");
    client.get("/readyz").expect(503);
}
