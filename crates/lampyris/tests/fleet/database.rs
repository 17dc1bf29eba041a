//! A database that goes away, and what many workers do to it.

use super::Fleet;
use super::support::process::{Process, verb};
use super::support::{Client, full, quick, seeded, stubs};
use lampyris::store::jobs::Priority;
use lampyris::store::{self, DatabasePlace, Store};
use lampyris_core::data::SystemId;
use serde_json::json;
use std::process::Command;
use std::sync::Arc;
use std::thread::sleep;
use std::time::{Duration, Instant};

#[test]
fn what_is_served_is_served_while_the_database_is_away_and_jobs_go_on_behind() {
    let Some(fleet) = Fleet::new() else { return };
    let api = fleet.node("api", &[]);
    let worker = fleet.node("worker,scheduler", &[]);
    api.client.lasting_room("1", 1);
    api.client.ended(&api.client.post_job(&quick("room/1")));
    while api.client.get("/params/room/1").status != 200 {
        sleep(Duration::from_millis(10));
    }
    let data = std::env::var("LAMPYRIS_TEST_CLUSTER").unwrap();
    let mut slowest = Duration::ZERO;
    for round in 0..if full() { 20 } else { 2 } {
        let pid = std::fs::read_to_string(format!("{data}/postmaster.pid")).unwrap();
        Command::new("kill").args(["-QUIT", pid.lines().next().unwrap()]).status().unwrap();
        let stopped = Instant::now();
        let mut back = None;
        let body = seeded(quick("room/1"), round);
        let job = loop {
            api.client.get("/params/room/1").expect(200);
            if back.is_none()
                && api.client.get("/systems").status == 200
                && stopped.elapsed().as_millis() > 500
            {
                back = Some(Instant::now());
            }
            let posted = api.client.json("POST", "/jobs", &body);
            if matches!(posted.status, 200 | 202) && back.is_some() {
                break posted.json()["id"].as_str().unwrap().to_owned();
            }
            assert!(stopped.elapsed() < Duration::from_secs(120), "{}", posted.text);
            sleep(Duration::from_millis(20));
        };
        api.client.until(&format!("/jobs/{job}"), |job| job["state"] != "queued");
        slowest = slowest.max(back.unwrap().elapsed());
        api.client.ended(&job);
    }
    println!("FLEET: claims go on within {slowest:?} of the database (target 10 s)");
    assert!(slowest < Duration::from_secs(30), "{slowest:?}");
    drop(worker);
}

#[test]
fn many_workers_end_every_job_once() {
    let Some(fleet) = Fleet::new() else { return };
    let api = fleet.node("api,scheduler", &[]);
    let systems = if full() { 100 } else { 20 };
    let mut jobs = Vec::new();
    for system in 0..systems {
        api.client.lasting_room(&system.to_string(), system);
        for seed in 0..3 {
            let body = seeded(quick(&format!("room/{system}")), seed);
            jobs.push(api.client.post_job(&body));
        }
    }
    let begun = Instant::now();
    let workers: Vec<_> = (0..4).map(|_| fleet.node("worker", &[])).collect();
    for job in &jobs {
        assert_eq!(api.client.ended(job)["state"], "succeeded");
    }
    let took = begun.elapsed();
    println!("FLEET: {} fits by 4 workers in {took:?}", jobs.len());
    let fits = fleet.rows("SELECT COUNT(*)::TEXT FROM fits");
    assert_eq!(fits, [jobs.len().to_string()]);
    assert_eq!(fleet.rows("SELECT MAX(attempt)::TEXT FROM jobs"), ["1"]);
    drop(workers);
}

#[test]
fn services_that_start_at_once_make_the_schema_once() {
    let Some(fleet) = Fleet::new() else { return };
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let opened: Vec<_> = (0..6)
        .map(|_| {
            let place = fleet.place.clone();
            runtime.spawn(async move { Store::open(&place, None).await.map(drop) })
        })
        .collect();
    for opening in opened {
        runtime.block_on(opening).unwrap().unwrap();
    }
    let once = "SELECT (COUNT(*) = COUNT(DISTINCT version))::TEXT FROM _sqlx_migrations";
    assert_eq!(fleet.rows(once), ["true"]);
    assert_eq!(fleet.rows("SELECT COUNT(*)::TEXT FROM pg_locks WHERE locktype = 'advisory'"), ["0"]);
}

/// Jobs that are claimed and ended without any work in between, as fast as the database allows.
#[test]
fn the_queue_ends_every_job_once_and_never_runs_two_of_a_system() {
    let Some(fleet) = Fleet::new() else { return };
    let (jobs, systems) = if full() { (20_000, 5_000) } else { (2_000, 500) };
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let rate = runtime.block_on(drained(&fleet.place, jobs, systems));
    println!("FLEET: {jobs} jobs of {systems} systems, {rate:.0} a second (target 500)");
    let ends = fleet.rows("SELECT state || ' ' || COUNT(*) || ' ' || MAX(attempt) FROM jobs GROUP BY state");
    assert_eq!(ends, [format!("failed {jobs} 1")]);
    let numbers = "SELECT COUNT(DISTINCT end_sequence)::TEXT FROM jobs";
    assert_eq!(fleet.rows(numbers), [jobs.to_string()]);
}

/// Submits jobs of systems, and has four processes of four threads each claim and end them; jobs a second.
async fn drained(place: &DatabasePlace, jobs: usize, systems: usize) -> f64 {
    let store = Store::open(place, None).await.unwrap();
    let names: Vec<SystemId> = (0..systems).map(|system| format!("room/{system}").parse().unwrap()).collect();
    for name in &names {
        stubs::put_room(&store, name, "").await;
    }
    let batch = stubs::batch((0..jobs).map(|number| names[number % systems].clone()), Priority::Operator);
    let begun = Instant::now();
    stubs::submit(&store, &batch).await;
    println!("FLEET: {jobs} jobs submitted in {:?} (limit 5 s)", begun.elapsed());
    let begun = Instant::now();
    let mut workers = Vec::new();
    for process in 0..4 {
        let store = Arc::new(Store::open(place, None).await.unwrap());
        let worker = stubs::enlist(&store, &format!("process {process}")).await;
        for _ in 0..4 {
            workers.push(tokio::spawn(ended_all(store.clone(), worker)));
        }
    }
    let mut ended = 0;
    for worker in workers {
        ended += worker.await.unwrap();
    }
    assert_eq!(ended, jobs);
    store.close().await;
    jobs as f64 / begun.elapsed().as_secs_f64()
}

/// Ends jobs until none is left; gives how many.
async fn ended_all(store: Arc<Store>, worker: i64) -> usize {
    let mut ended = 0;
    loop {
        if stubs::claim_and_end(&store, worker).await.is_some() {
            ended += 1;
            continue;
        }
        // The jobs that are left are of systems of which one runs.
        let left = store::metrics::queue(&store).await.unwrap();
        if left.iter().all(|standing| standing.count == 0) {
            return ended;
        }
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
}

#[test]
fn a_house_moves_to_a_server_with_everything_that_it_served() {
    let Some(fleet) = Fleet::new() else { return };
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("house.db");
    let service = Process::start(&file);
    for room in ["1", "2"] {
        service.client.lasting_room(room, room.parse().unwrap());
        service.client.ended(&service.client.estimate(&format!("room/{room}"), json!({})));
    }
    let diagnosis = service.client.post_job(&json!({
        "kind": "diagnose", "system": "room/1", "split": {"train": "P9D", "validation": "P5D"}
    }));
    service.client.ended(&diagnosis);
    let paths = ["/params/room/1", "/params/room/2", "/fits", "/jobs", "/systems/room/1/windows", "/audit"];
    let body = |client: &Client, path: &str| client.get(path).expect(200).text;
    let before = paths.map(|path| body(&service.client, path));
    let tag = service.client.get("/params/room/1").header("etag").to_owned();
    service.terminate();
    let (from, to) = (file.to_str().unwrap(), String::from(fleet.place.clone()));
    let said = verb("", &["migrate", "--from", from, "--to", &to]).expect(0).out;
    assert!(said.contains("2 revisions are what they were"), "{said}");
    assert_ne!(verb("", &["migrate", "--from", from, "--to", &to]).code, Some(0), "into an empty one alone");
    let node = fleet.node("api,worker,scheduler", &[]);
    assert_eq!(paths.map(|path| body(&node.client, path)), before);
    assert_eq!(node.client.get("/params/room/1").header("etag"), tag);
    let health = verb("", &["doctor", "--database", &to]).expect(0).out;
    assert!(health.contains("1 have a lease, 0 are silent") && !health.contains("FAIL"), "{health}");
    // Numbers go on where they were.
    let next = node.client.estimate("room/1", json!({"method": {"name": "cfa", "seed": 5}}));
    assert_eq!(node.client.ended(&next)["state"], "succeeded");
}
