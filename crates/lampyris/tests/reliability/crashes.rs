//! The built service is killed again and again on one database, at random moments and at chosen points of its
//! code.

use crate::backups::{about, served};
use crate::database::{check_database, copied, random, rows};
use crate::support::process::{Process, program};
use crate::support::{Client, PATIENCE, endless, full};
use crate::traffic::{Oracle, Traffic, prepare};
use serde_json::json;
use std::path::Path;
use std::process::Stdio;
use std::sync::Mutex;
use std::thread;
use std::time::{Duration, Instant};

/// Where the service dies by itself (`store::failpoint`).
const POINTS: [&str; 5] = ["before_commit", "in_recovery", "after_commit", "in_backup", "before_swap"];

/// Starts the service and gives it when it is ready, with the time that this took.
fn ready(database: &Path) -> (Process, Duration) {
    let begun = Instant::now();
    let service = Process::start(database);
    service.client.get("/readyz").expect(200);
    (service, begun.elapsed())
}

#[test]
fn killed_at_random_moments_nothing_acknowledged_is_lost() {
    let dir = tempfile::tempdir().unwrap();
    let database = dir.path().join("reliability.db");
    let (kills, aimed, longest_ms) = if full() { (150, 50, 3000) } else { (10, 6, 700) };
    let service = Process::start(&database);
    prepare(&service.client);
    service.kill();
    let oracle = Mutex::new(Oracle::default());
    let (mut boots, mut seed) = (Vec::new(), 7);
    let mut points = (1..).flat_map(|pass| POINTS.map(|point| (point, pass)));
    for round in 0..kills + aimed {
        // Evenly among the others.
        let is_aimed = (round + 1) * aimed / (kills + aimed) > round * aimed / (kills + aimed);
        let (point, pass) = if is_aimed { points.next().unwrap() } else { ("random", 1) };
        match point {
            "before_commit" | "after_commit" | "before_swap" => {
                let armed = format!("{point}:{pass}");
                // A job of an earlier start may have ended before there was anybody to talk to.
                if let Some(mut service) = Process::start_to_die_at(&armed, &database) {
                    Traffic::run(&service.client.clone(), &oracle, round, || {
                        until_it_dies(&mut service, &armed)
                    });
                }
            }
            _ => {
                let (service, took) = ready(&database);
                boots.push(took);
                oracle.lock().unwrap().check_service(&service.client, &database);
                let moment = Duration::from_millis(5 + random(&mut seed) % longest_ms);
                Traffic::run(&service.client.clone(), &oracle, round, || {
                    thread::sleep(moment);
                    if point == "in_backup" {
                        dies_in_a_backup(&database, &dir.path().join(format!("{round}.backup")));
                    }
                    service.kill();
                });
            }
        }
        if point == "in_recovery" {
            assert!(
                Process::start_to_die_at(point, &database).is_none(),
                "it started although it was to die before"
            );
        }
        oracle.lock().unwrap().check_database(&copied(&database));
    }
    let (service, took) = ready(&database);
    boots.push(took);
    let mut oracle = oracle.into_inner().unwrap();
    oracle.check_service(&service.client, &database);
    all_jobs_end(&service.client, &database);
    assert_eq!(service.terminate().0, Some(0));
    oracle.check_database(&database);
    let again: i64 =
        rows(&database, "SELECT CAST(COUNT(*) AS TEXT) FROM jobs WHERE attempt > 1")[0].parse().unwrap();
    assert!(again > 0, "no kill met a running job");
    boots.sort();
    println!(
        "CRASH-1: {kills} kills and {aimed} at chosen points, nothing lost of {}; {again} jobs were \
        interrupted; ready after {:?} (median), {:?} (longest); {} MB",
        oracle.told(),
        boots[boots.len() / 2],
        boots[boots.len() - 1],
        database.metadata().unwrap().len() >> 20
    );
}

/// Waits until the service has died at its point.
fn until_it_dies(service: &mut Process, point: &str) {
    let begun = Instant::now();
    while !service.has_ended() {
        assert!(begun.elapsed() < PATIENCE, "{point} was never passed");
        thread::sleep(Duration::from_millis(5));
    }
}

/// A backup that is killed leaves nothing under its name, and does not stand in the way of the next one.
fn dies_in_a_backup(database: &Path, file: &Path) {
    let mut command = program();
    command
        .args(["backup", file.to_str().unwrap(), "--database", database.to_str().unwrap()])
        .env("LAMPYRIS_ABORT_AT", "in_backup");
    let output = command.stderr(Stdio::null()).output().unwrap();
    assert_eq!((output.status.code(), file.exists()), (None, false));
    about(database, &["backup", file.to_str().unwrap()]).expect(0);
    check_database(file);
    std::fs::remove_file(file).unwrap();
}

/// Waits until nothing waits or runs; a job may have failed of the kills alone.
fn all_jobs_end(client: &Client, database: &Path) {
    for state in ["queued", "running"] {
        client.until(&format!("/jobs?state={state}"), |page| page["items"].as_array().unwrap().is_empty());
    }
    let failed = "SELECT DISTINCT json_extract(error, '$.code') FROM jobs WHERE state = 'failed'";
    assert!(rows(database, failed).iter().all(|code| code == "interrupted"), "{:?}", rows(database, failed));
}

#[test]
fn a_job_that_takes_the_process_down_three_times_fails_for_good() {
    let dir = tempfile::tempdir().unwrap();
    let database = dir.path().join("poison.db");
    let service = Process::start(&database);
    service.client.lasting_room("1", 1);
    service.client.ended(&service.client.estimate("room/1", json!({})));
    let job = service.client.post_job(&endless("room/1"));
    let mut service = service;
    for attempt in 1..=3 {
        let running = service.client.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
        assert_eq!(running["attempt"], attempt);
        service.kill();
        service = Process::start(&database);
    }
    let failed = service.client.get(&format!("/jobs/{job}")).json();
    assert_eq!(
        (failed["state"].as_str(), failed["error"]["code"].as_str()),
        (Some("failed"), Some("interrupted")),
        "{failed}"
    );
    let params = service.client.get("/params/room/1").expect(200).json();
    assert_eq!(
        (params["status"].as_str(), params["fallback"]["reason"].as_str()),
        (Some("fallback"), Some("job_failed"))
    );
    let next = service.client.estimate("room/1", json!({"method": {"name": "lm_multistart", "seed": 5}}));
    assert_eq!(service.client.ended(&next)["state"], "succeeded");
}

/// How long a start takes after a kill, by the size of the database.
#[test]
fn a_killed_service_with_many_windows_starts_again() {
    let dir = tempfile::tempdir().unwrap();
    let database = dir.path().join("large.db");
    let body = served(&database);
    // Blocks that do not compress, in copies of the one window that is there.
    let windows = "INSERT INTO windows (id, system, sequence, from_ms, to_ms, report, uploaded_at) \
        SELECT 'win_' || n, system, n, from_ms, to_ms, report, uploaded_at FROM windows, \
        (WITH RECURSIVE counted (n) AS (SELECT 1000 UNION ALL SELECT n + 1 FROM counted \
        WHERE n < (SELECT value FROM counters WHERE name = 'sequence')) SELECT n FROM counted)";
    let blocks = "INSERT INTO shares (window_id, day, channels, block) \
        SELECT id, 0, '[]', randomblob(10000) FROM windows WHERE sequence >= 1000";
    let (count, sequence) = match full() {
        true => (100_000, "UPDATE counters SET value = 100999 WHERE name = 'sequence'"),
        false => (3_000, "UPDATE counters SET value = 3999 WHERE name = 'sequence'"),
    };
    for sql in [sequence, windows, blocks] {
        rows(&database, sql);
    }
    let mut boots = Vec::new();
    for _ in 0..5 {
        let (service, took) = ready(&database);
        boots.push(took);
        assert_eq!(service.client.get("/params/room/1").expect(200).text, body);
        let put = service.client.json(
            "PUT",
            &format!("/systems/room/{}", 1 + boots.len()),
            &json!({"model": "rc2"}),
        );
        put.expect(201);
        service.kill();
    }
    let kept =
        "SELECT CAST(COUNT(*) AS TEXT) FROM windows UNION ALL SELECT CAST(COUNT(*) AS TEXT) FROM systems";
    assert_eq!(rows(&database, kept), [(count + 1).to_string(), "6".to_owned()]);
    let megabytes = database.metadata().unwrap().len() >> 20;
    println!(
        "CRASH-1: with {count} windows in {megabytes} MB ready after {:?} at most (target 2 s)",
        boots.iter().max().unwrap()
    );
}
