//! What listeners hear, however often they are cut off.

use crate::support::events::Told;
use crate::support::{TestApp, endless, quick};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::time::Instant;

fn names(told: &[Told]) -> Vec<&str> {
    told.iter().map(|told| told.event.as_str()).collect()
}

/// What was said, without the ids.
fn said(told: &[Told]) -> Vec<(&str, &Value)> {
    told.iter().map(|told| (told.event.as_str(), &told.data)).collect()
}

/// A job of some seconds. It ends by its count, since one that ends by the wall time fails beside busy
/// processes, where its judgement does not fit behind its search.
fn lasting(system: &str) -> Value {
    let mut body = endless(system);
    body["budget"]["evaluations"] = json!(10_000);
    body
}

fn is_end(told: &Told) -> bool {
    told.event == "finished"
}

#[test]
fn a_job_is_told_from_queue_to_end() {
    let app = TestApp::start();
    app.room("1", 1);
    let job = app.post_job(&lasting("room/1"));
    let start = Instant::now();
    let told: Vec<Told> = app.listen(&format!("/jobs/{job}/events"), "").collect();
    let seconds = start.elapsed().as_secs_f64();
    let names = names(&told);
    assert_eq!(
        (names.first(), names.get(1), names.last()),
        (Some(&"queued"), Some(&"started"), Some(&"finished")),
        "{names:?}"
    );
    let of =
        |name: &str| told.iter().filter(|told| told.event == name).map(|told| &told.data).collect::<Vec<_>>();
    let (progress, incumbents) = (of("progress"), of("incumbent"));
    assert!(progress.len() >= 2 && !incumbents.is_empty(), "{names:?}");
    assert!((progress.len() + incumbents.len()) as f64 <= 4.0 * seconds + 1.0, "{names:?} in {seconds} s");
    assert!(
        progress.windows(2).all(|pair| pair[0]["evaluations"].as_u64() < pair[1]["evaluations"].as_u64())
    );
    assert!(
        progress.iter().all(|progress| progress["best_train"].is_f64() && progress["eta_s"].is_f64()),
        "{progress:?}"
    );
    assert!(
        incumbents.windows(2).all(|pair| pair[0]["parameters"] != pair[1]["parameters"]),
        "{incumbents:?}"
    );

    let ended = &told.last().unwrap().data;
    assert_eq!(ended["state"], "succeeded");
    let fit = app.get(&format!("/fits/{}", ended["fit"].as_str().unwrap())).json();
    let keys = |value: &Value| value.as_object().unwrap().keys().cloned().collect::<BTreeSet<_>>();
    assert_eq!(keys(&incumbents[0]["parameters"]), keys(&fit["parameters"]), "every parameter by its name");
    for (name, value) in incumbents[0]["parameters"].as_object().unwrap() {
        let bounds = &fit["parameters"][name]["bounds"];
        assert!(
            (bounds[0].as_f64().unwrap()..=bounds[1].as_f64().unwrap()).contains(&value.as_f64().unwrap()),
            "{name} {value}"
        );
    }

    // Whoever has seen the end is told to stay away, by header or by query.
    let last = &told.last().unwrap().last_id;
    app.get_with(&format!("/jobs/{job}/events"), &[("last-event-id", last)]).expect(204);
    app.get(&format!("/jobs/{job}/events?last_event_id={last}")).expect(204);
    app.get("/jobs/job_none/events").problem(404, "job-not-found");
}

#[test]
fn all_listeners_hear_the_same_and_a_filter_leaves_others_out() {
    let app = TestApp::start();
    app.room("1", 1);
    app.room("2", 2);
    let (mut all, mut one, mut other) = (
        app.listen("/events", ""),
        app.listen("/events?system=room/1", ""),
        app.listen("/events?system=room/2", ""),
    );
    let job = app.post_job(&lasting("room/1"));
    let own = app.listen(&format!("/jobs/{job}/events"), "");
    // This one reads nothing until all is over.
    let slow = app.listen(&format!("/jobs/{job}/events"), "");
    let own: Vec<Told> = own.collect();
    assert!(own.len() > 4, "{:?}", names(&own));
    assert_eq!(said(&own), said(&slow.collect::<Vec<_>>()));
    for stream in [&mut one, &mut all] {
        let mut told = stream.until(is_end);
        // What is served is no event of a job.
        told.retain(|told| !["params", "state"].contains(&told.event.as_str()));
        assert_eq!(said(&own), said(&told));
    }
    let second = app.estimate("room/2", json!({}));
    assert!(other.until(is_end).iter().chain(&all.until(is_end)).all(|told| told.data["system"] == "room/2"));
    assert_eq!(app.ended(&second)["state"], "succeeded");
    app.get("/events?system=room/9").problem(404, "system-not-found");
    app.get("/events?system=Room").problem(422, "invalid-request");
    app.get("/events?sytem=room/1").problem(422, "invalid-request");
}

#[test]
fn who_is_cut_off_misses_nothing_and_hears_nothing_twice() {
    let app = TestApp::start();
    app.room("1", 1);
    let mut whole = app.listen("/events", "");
    let mut pieces = Vec::new();
    let mut last_id = {
        let mut first = app.listen("/events", "");
        let job = app.post_job(&lasting("room/1"));
        pieces.extend(first.until(|told| told.event == "started"));
        let id = first.last_id.clone();
        drop(first);
        assert_eq!(app.ended(&job)["state"], "succeeded");
        id
    };
    // One event per connection from here on.
    while pieces.last().is_none_or(|told| told.event != "finished") {
        let mut stream = app.listen("/events", &last_id);
        pieces.extend(stream.next());
        last_id = stream.last_id;
    }
    assert_eq!(said(&pieces), said(&whole.until(is_end)));
}

#[test]
fn no_end_is_lost_over_a_restart() {
    let mut app = TestApp::with(|settings| settings.workers = 1);
    ["1", "2", "3"].iter().for_each(|room| app.room(room, 1));
    let mut stream = app.listen("/events", "");
    let running = app.post_job(&endless("room/1"));
    stream.until(|told| told.event == "progress");
    let waiting = app.post_job(&quick("room/2"));
    stream.until(|told| told.event == "queued");
    let last_id = stream.last_id.clone();
    drop(stream);
    // While nobody listens, one job comes and goes, another only comes, and the service starts again.
    let gone = app.post_job(&quick("room/3"));
    app.post(&format!("/jobs/{gone}/cancel")).expect(200);
    let late = app.post_job(&endless("room/3"));
    app.restart();
    app.until(&format!("/jobs/{running}"), |job| job["state"] == "running");

    let mut stream = app.listen("/events", &last_id);
    let mut told = stream.until(is_end);
    assert_eq!(told.last().unwrap().data["id"], gone.as_str());
    let heard = |told: &[Told], name: &str, job: &str| {
        told.iter().filter(|told| told.event == name && told.data["id"] == job).count()
    };
    assert_eq!(heard(&told, "queued", &late), 1, "{:?}", said(&told));
    for job in [&running, &late] {
        app.post(&format!("/jobs/{job}/cancel")).expect(200);
    }
    for _ in 0..3 {
        told.extend(stream.until(is_end));
    }
    for job in [&running, &waiting, &gone, &late] {
        assert_eq!(heard(&told, "finished", job), 1, "{job} {:?}", said(&told));
    }
    assert_eq!(heard(&told, "started", &running), 1, "{:?}", said(&told));

    // A listener of one job, too, is told an end that it has not seen, once.
    let own: Vec<Told> = app.listen(&format!("/jobs/{gone}/events"), &last_id).collect();
    assert_eq!(names(&own), ["finished"]);
    app.get_with(&format!("/jobs/{gone}/events"), &[("last-event-id", &own[0].last_id)]).expect(204);
    // An id that makes no sense is that of somebody new.
    assert_eq!(
        names(&app.listen(&format!("/jobs/{gone}/events"), "what?").collect::<Vec<_>>()),
        ["finished"]
    );
}

#[test]
fn a_stop_ends_every_stream_properly() {
    let mut app = TestApp::start();
    app.room("1", 1);
    let job = app.post_job(&endless("room/1"));
    let mut own = app.listen(&format!("/jobs/{job}/events"), "");
    own.until(|told| told.event == "progress");
    let all = app.listen("/events", "");
    // The ends come from a service that still listens to its clients: a cut would make the readers panic.
    let readers = [std::thread::spawn(move || own.count()), std::thread::spawn(move || all.count())];
    app.stop();
    readers.into_iter().for_each(|reader| assert!(reader.join().is_ok()));
}
