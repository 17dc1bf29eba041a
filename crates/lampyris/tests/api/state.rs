//! What the controller hears of the states: long polls, and events of what is served.

use crate::support::events::Told;
use crate::support::rooms::{csv_of, room};
use crate::support::{Answer, TestApp};
use serde_json::{Value, json};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

const STATE: &str = "/systems/room/1/state";

/// Asks for the states in the background, ready to wait for a minute, and gives the request time to arrive.
fn waiting(app: &TestApp, tag: &str) -> JoinHandle<Answer> {
    let (client, tag) = (app.client.clone(), tag.to_owned());
    let poll = std::thread::spawn(move || {
        client.get_with(STATE, &[("if-none-match", tag.as_str()), ("prefer", "wait=60")])
    });
    std::thread::sleep(Duration::from_millis(150));
    assert!(!poll.is_finished(), "nothing is news yet");
    poll
}

/// A day that goes on as the two weeks before it.
fn another_day(app: &TestApp, day: usize) {
    let rows = &room(1, day + 1)[day * 48..];
    app.csv("/systems/room/1/windows", &csv_of(rows)).expect(201);
}

#[test]
fn states_are_waited_for() {
    let app = TestApp::at("2026-01-16T00:00:00Z", |_| {});
    app.room("1", 1);
    app.get(STATE).problem(404, "no-state");
    let poll = waiting(&app, "\"none\"");
    app.ended(&app.estimate("room/1", json!({})));
    let first = poll.join().unwrap().expect(200);
    assert_eq!(
        (first.json()["at"].as_str(), first.json()["revision"].as_i64()),
        (Some("2026-01-14T23:30:00Z"), Some(1))
    );
    let tag = first.header("etag").to_owned();
    // Whoever waits hears nothing of what changes other things.
    let start = Instant::now();
    let poll = waiting(&app, &tag);
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "policy": {"stale_after": "P4D"}}))
        .expect(200);
    app.get_with(STATE, &[("if-none-match", tag.as_str()), ("prefer", "wait=1")]).expect(304);
    assert!(start.elapsed() >= Duration::from_secs(1) && !poll.is_finished());
    another_day(&app, 14);
    let newer = poll.join().unwrap().expect(200);
    assert_eq!(
        (newer.json()["at"].as_str(), newer.json()["revision"].as_i64()),
        (Some("2026-01-15T23:30:00Z"), Some(1))
    );
    // An old tag is answered at once.
    let start = Instant::now();
    let answer = app.get_with(STATE, &[("if-none-match", tag.as_str()), ("prefer", "wait=60")]).expect(200);
    assert!(start.elapsed() < Duration::from_secs(10));
    assert_eq!(answer.text, newer.text);
    app.get(&format!("{STATE}?wait=1")).problem(422, "invalid-request");
    let poll = waiting(&app, newer.header("etag"));
    app.send("DELETE", "/systems/room/1?force=true", &[], None).unwrap().expect(204);
    poll.join().unwrap().problem(404, "system-not-found");
}

#[test]
fn listeners_hear_of_parameters_and_states() {
    let mut app = TestApp::at("2026-01-16T00:00:00Z", |_| {});
    app.room("1", 1);
    app.room("2", 2);
    let (mut own, other) = (app.listen("/events?system=room/1", ""), app.listen("/events?system=room/2", ""));
    app.ended(&app.estimate("room/1", json!({})));
    let served = |told: &[Told]| -> Vec<(String, Value)> {
        let served = told.iter().filter(|told| ["params", "state"].contains(&told.event.as_str()));
        served.map(|told| (told.event.clone(), told.data.clone())).collect()
    };
    let params = |revision: i64, status: &str| {
        ("params".to_owned(), json!({"system": "room/1", "revision": revision, "status": status}))
    };
    let state = |revision: i64, at: &str| {
        ("state".to_owned(), json!({"system": "room/1", "revision": revision, "at": at}))
    };
    let published = own.until(|told| told.event == "state");
    assert_eq!(served(&published), [params(1, "fresh"), state(1, "2026-01-14T23:30:00Z")]);
    app.json("PUT", "/params/room/1/pin", &json!({"reason": "holidays"})).expect(200);
    assert_eq!(served(&own.until(|told| told.event == "params")), [params(2, "pinned")]);
    another_day(&app, 14);
    let newest = state(2, "2026-01-15T23:30:00Z");
    own.until(|told| told.event == newest.0 && told.data == newest.1);
    // Where the log does not reach back, it is told how things stand.
    let last_id = own.last_id.clone();
    drop(own);
    app.restart();
    let told = app.listen("/events?system=room/1", &last_id).until(|told| told.event == "state");
    assert_eq!(served(&told), [params(2, "pinned"), newest]);
    // A second system hears nothing of it, and its stream has ended with the service.
    assert_eq!(served(&other.collect::<Vec<_>>()), []);
}
