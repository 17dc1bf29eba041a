//! The built service is killed at random moments, again and again, on one database.
//!
//! Whatever it acknowledged is written down here (`oracle`) and looked for after every start.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

mod backups;
mod nights;
mod poison;
mod queue;
#[path = "../support/mod.rs"]
mod support;
mod upgrades;

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};
use support::process::Process;
use support::{Client, room_csv};

/// How often the service is killed. The full figure is for `LAMPYRIS_KILLS=200`.
const KILLS: u64 = 20;
/// What the service acknowledged.
#[derive(Default)]
struct Oracle {
    windows: Vec<String>,
    jobs: Vec<String>,
    keys: BTreeMap<String, (serde_json::Value, String)>,
    revision: i64,
}

impl Oracle {
    fn check(&mut self, client: &Client) {
        for window in &self.windows {
            client.get(&format!("/windows/{window}")).expect(200);
        }
        for job in &self.jobs {
            client.get(&format!("/jobs/{job}")).expect(200);
        }
        for (key, (body, job)) in &self.keys {
            let again = client.json_with("POST", "/jobs", &[("idempotency-key", key)], body);
            assert_eq!((again.status, again.json()["id"].as_str()), (202, Some(job.as_str())), "a key made a second job");
        }
        let revision = client.get("/params/room/1").expect(200).json()["revision"].as_i64().unwrap();
        assert!(revision >= self.revision, "revisions never go back");
        self.revision = revision;
    }
}

/// Asks the database itself, with the service down.
fn check_database(path: &Path) {
    assert_eq!(rows(path, "PRAGMA integrity_check"), ["ok"]);
    let orphans = rows(path, "SELECT \"table\" FROM pragma_foreign_key_check");
    assert!(orphans.is_empty(), "{orphans:?}");
}

/// Runs a statement on a database that no service may have open, and gives the first column as texts.
fn rows(path: &Path, sql: &'static str) -> Vec<String> {
    use sqlx::{Connection, SqliteConnection};
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let mut connection = SqliteConnection::connect(&format!("sqlite://{}?mode=rwc", path.display())).await.unwrap();
        let rows = sqlx::query_scalar(sql).fetch_all(&mut connection).await.unwrap();
        connection.close().await.unwrap();
        rows
    })
}

/// A small generator, so that a failure can be repeated.
fn random(state: &mut u64) -> u64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    *state >> 33
}

#[test]
fn killed_at_random_moments_nothing_acknowledged_is_lost() {
    let dir = tempfile::tempdir().unwrap();
    let database = dir.path().join("reliability.db");
    let kills = std::env::var("LAMPYRIS_KILLS").ok().and_then(|text| text.parse().ok()).unwrap_or(KILLS);
    let mut oracle = Oracle::default();
    let service = Process::start(&database);
    service.client.room("1", 1);
    service.client.json("PUT", "/systems/room/2", &serde_json::json!({"model": "rc2"})).expect(201);
    let first = service.client.estimate("room/1", serde_json::json!({}));
    assert_eq!(service.client.ended(&first)["outcome"], "accepted");
    let mut served = service.client.get("/params/room/1").expect(200);
    service.kill();
    check_database(&database);
    let (mut seed, mut attempts) = (7, 0);
    for round in 0..kills {
        let service = Process::start(&database);
        let client = &service.client;
        // Nothing that could be published ran since the last look, so the body is the same to the byte.
        let now = client.get("/params/room/1").expect(200);
        assert_eq!((now.header("etag"), &now.text), (served.header("etag"), &served.text), "round {round}");
        oracle.check(client);
        // The job of the round before runs again; an experiment leaves what is served alone.
        if let Some(last) = oracle.jobs.last() {
            let ended = client.ended(last);
            assert_eq!(ended["state"], "succeeded", "{ended}");
            attempts += ended["attempt"].as_i64().unwrap();
        }
        let body = {
            let mut body = support::quick("room/1");
            body["experiment"] = serde_json::json!(true);
            body["method"] = serde_json::json!({"name": "cfa_thesis", "seed": 100 + round});
            body["budget"] = serde_json::json!({"evaluations": 6000});
            body
        };
        let key = format!("round {round}");
        let job =
            client.json_with("POST", "/jobs", &[("idempotency-key", &key)], &body).expect(202).json()["id"].as_str().unwrap().to_owned();
        oracle.keys.insert(key, (body, job.clone()));
        oracle.jobs.push(job);
        let moment = Instant::now() + Duration::from_millis(5 + random(&mut seed) % 400);
        let mut part = 0;
        while Instant::now() < moment {
            // Each window has a day and a course of its own, so each is another one.
            let day = format!("{}-{:02}-{:02}", 2027 + part / 336 % 100, 1 + part / 28 % 12, 1 + part % 28);
            let taken = client.csv("/systems/room/2/windows", &room_csv(1000 + round, 1).replace("2026-01-01", &day)).expect(201);
            oracle.windows.push(taken.json()["id"].as_str().unwrap().to_owned());
            part += 1;
        }
        served = client.get("/params/room/1").expect(200);
        service.kill();
        check_database(&database);
    }
    assert!(attempts > kills as i64, "no kill met a running job: {attempts} attempts in {kills} rounds");
    let service = Process::start(&database);
    oracle.check(&service.client);
    service.client.ended(oracle.jobs.last().unwrap());
    eprintln!("{kills} kills, {} jobs in {attempts} attempts, {} windows", oracle.jobs.len(), oracle.windows.len());
}

#[test]
fn a_job_that_takes_the_process_down_three_times_fails_for_good() {
    let dir = tempfile::tempdir().unwrap();
    let database = dir.path().join("poison.db");
    let service = Process::start(&database);
    service.client.room("1", 1);
    service.client.ended(&service.client.estimate("room/1", serde_json::json!({})));
    let job = service.client.json("POST", "/jobs", &support::endless("room/1")).expect(202).json()["id"].as_str().unwrap().to_owned();
    let mut service = service;
    for attempt in 1..=3 {
        let running = service.client.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
        assert_eq!(running["attempt"], attempt);
        service.kill();
        service = Process::start(&database);
    }
    let failed = service.client.get(&format!("/jobs/{job}")).json();
    assert_eq!((failed["state"].as_str(), failed["error"]["code"].as_str()), (Some("failed"), Some("interrupted")), "{failed}");
    let params = service.client.get("/params/room/1").expect(200).json();
    assert_eq!((params["status"].as_str(), params["fallback"]["reason"].as_str()), (Some("fallback"), Some("job_failed")));
    assert_eq!(
        service.client.ended(&service.client.estimate("room/1", serde_json::json!({"method": {"name": "lm_multistart", "seed": 5}})))["state"],
        "succeeded"
    );
}

/// The requirement is one of time, so time is what is measured.
#[test]
fn fifty_running_fits_are_called_off_within_half_a_second() {
    let dir = tempfile::tempdir().unwrap();
    let service = Process::start(&dir.path().join("cancel.db"));
    let client = &service.client;
    client.room("1", 1);
    client.json("PUT", "/systems/room/2", &serde_json::json!({"model": "rc2"})).expect(201);
    client.csv("/systems/room/2/windows", &room_csv(2, 100)).expect(201);
    let mut took: Vec<Duration> = (0..50)
        .map(|round| {
            // A fortnight and a hundred days: a generation of the second takes seven times as long.
            let mut body = support::endless(if round % 2 == 0 { "room/1" } else { "room/2" });
            body["method"]["seed"] = serde_json::json!(round);
            let job = client.post_job(&body);
            client.until(&format!("/jobs/{job}"), |job| job["progress"]["evaluations"].as_u64().unwrap_or(0) > 0);
            let begun = Instant::now();
            client.post(&format!("/jobs/{job}/cancel")).expect(200);
            assert_eq!(client.ended(&job)["state"], "cancelled");
            begun.elapsed()
        })
        .collect();
    took.sort();
    // The nearest rank: of fifty, the 99th percentile is the slowest one.
    let (median, p99) = (took[24], took[49]);
    eprintln!("cancel: median {median:?}, 99th percentile {p99:?}");
    assert!(p99 <= Duration::from_millis(500), "{took:?}");
}

#[test]
fn a_stop_is_quick_and_gives_the_job_back() {
    let dir = tempfile::tempdir().unwrap();
    let database = dir.path().join("stop.db");
    let service = Process::start(&database);
    service.client.room("1", 1);
    let job = service.client.json("POST", "/jobs", &support::endless("room/1")).expect(202).json()["id"].as_str().unwrap().to_owned();
    service.client.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
    let poll = {
        let client = service.client.clone();
        std::thread::spawn(move || client.get_with("/params/room/1", &[("prefer", "wait=60")]))
    };
    std::thread::sleep(Duration::from_millis(100));
    let (code, took) = service.terminate();
    assert_eq!(code, Some(0));
    assert!(took < Duration::from_secs(5), "{took:?}");
    assert_eq!(poll.join().unwrap().status, 404, "an answer under way is sent");
    check_database(&database);
    let service = Process::start(&database);
    let running = service.client.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
    assert_eq!(running["attempt"], 1, "the stop was not charged to the job");
}
