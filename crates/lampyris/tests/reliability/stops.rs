//! Ends that are asked for: of jobs, and of the service.

use crate::database::{beside, check_database, rows};
use crate::support::process::Process;
use crate::support::rooms::room_csv;
use crate::support::{endless, full};
use serde_json::json;
use std::thread;
use std::time::{Duration, Instant};

#[test]
fn fifty_running_fits_are_called_off_while_they_run() {
    let dir = tempfile::tempdir().unwrap();
    let service = Process::start(&dir.path().join("cancel.db"));
    let client = &service.client;
    client.room("1", 1);
    client.json("PUT", "/systems/room/2", &json!({"model": "rc2"})).expect(201);
    client.csv("/systems/room/2/windows", &room_csv(2, 100)).expect(201);
    let mut took: Vec<Duration> = (0..50)
        .map(|round| {
            // A fortnight and a hundred days: a generation of the second takes seven times as long.
            let mut body = endless(if round % 2 == 0 { "room/1" } else { "room/2" });
            body["method"]["seed"] = json!(round);
            let job = client.post_job(&body);
            client.until(&format!("/jobs/{job}"), |job| {
                job["progress"]["evaluations"].as_u64().unwrap_or(0) > 0
            });
            let begun = Instant::now();
            client.post(&format!("/jobs/{job}/cancel")).expect(200);
            assert_eq!(client.ended(&job)["state"], "cancelled");
            begun.elapsed()
        })
        .collect();
    took.sort();
    // The nearest rank: of fifty, the 99th percentile is the slowest one.
    let (median, p99) = (took[24], took[49]);
    println!("Q-6: 50 cancellations, median {median:?}, 99th percentile {p99:?} (target 0.5 s)");
}

#[test]
fn a_stop_gives_running_jobs_back_and_leaves_nothing_in_the_log() {
    let dir = tempfile::tempdir().unwrap();
    let database = dir.path().join("stop.db");
    let queued: u64 = if full() { 1000 } else { 100 };
    let service = Process::start(&database);
    let client = &service.client;
    let running: Vec<String> = ["1", "2"]
        .iter()
        .map(|room| {
            client.room(room, 1);
            let job = client.post_job(&endless(&format!("room/{room}")));
            client.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
            job
        })
        .collect();
    for seed in 0..queued {
        let mut body = endless("room/1");
        body["method"]["seed"] = json!(1000 + seed);
        client.post_job(&body);
    }
    let poll = {
        let client = client.clone();
        thread::spawn(move || client.get_with("/params/room/1", &[("prefer", "wait=60")]))
    };
    thread::sleep(Duration::from_millis(100));
    let (code, took) = service.terminate();
    assert_eq!(code, Some(0));
    poll.join().unwrap().expect(404);
    assert!(!beside(&database, "-wal").exists(), "the log is folded into the database");
    check_database(&database);
    let states = rows(
        &database,
        "SELECT state || ' ' || attempt || ' ' || COUNT(*) FROM jobs GROUP BY state, attempt",
    );
    assert_eq!(states, [format!("queued 0 {}", queued + 2)], "the stop was charged to no job");
    let service = Process::start(&database);
    for job in &running {
        let again = service.client.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
        assert_eq!(again["attempt"], 1);
    }
    println!("STOP-1: 2 running and {queued} queued jobs, stopped within {took:?} (target 5 s)");
}
