//! Workers that die, and workers that come back.

use super::cut::Way;
use super::support::process::Process;
use super::support::{endless, full, quick, seeded};
use super::{Fleet, LEASE};
use serde_json::json;
use std::thread::sleep;
use std::time::{Duration, Instant};

/// A job is taken over within a lease and what it takes to look, and ends; a busy machine takes its time.
const TAKEN_OVER: Duration = Duration::from_secs(LEASE + 5);

#[test]
fn a_job_of_a_killed_worker_is_taken_over_and_ends_once() {
    let Some(fleet) = Fleet::new() else { return };
    let api = fleet.node("api,scheduler", &[]);
    api.client.lasting_room("1", 1);
    // It is killed at its work, or dies while its result is written, before that, or behind it.
    let ends = ["", "before_commit", "before_finish", "after_commit"];
    let mut longest = Duration::ZERO;
    for round in 0..if full() { 100 } else { 2 } {
        let dies_at = ends[round % ends.len()];
        let doomed = match dies_at {
            "" => fleet.node("worker", &[("LAMPYRIS_PAUSE_AT", "before_finish:60000")]),
            point => fleet.node("worker", &[("LAMPYRIS_ABORT_AT", point)]),
        };
        let job = api.client.post_job(&seeded(quick("room/1"), round as i64));
        let heir = match dies_at {
            "" => {
                api.client.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
                let heir = fleet.node("worker", &[]);
                doomed.kill();
                heir
            }
            _ => {
                doomed.gone();
                fleet.node("worker", &[])
            }
        };
        let killed = Instant::now();
        let ended = api.client.ended(&job);
        longest = longest.max(killed.elapsed());
        let attempt = if dies_at == "after_commit" { 1 } else { 2 };
        assert_eq!((&ended["state"], &ended["attempt"]), (&json!("succeeded"), &json!(attempt)), "{ended}");
        let fits = fleet.rows(&format!("SELECT COUNT(*)::TEXT FROM fits WHERE job = '{job}'"));
        assert_eq!(fits, ["1"]);
        drop(heir);
    }
    println!("FLEET: taken over within {longest:?} (target {TAKEN_OVER:?})");
    assert!(longest < 6 * TAKEN_OVER, "{longest:?}");
}

/// A job whose worker dies each time that it is run, beside jobs that do their work: four workers, each started
/// again when it is gone, as a supervisor would.
#[test]
fn a_job_that_takes_three_workers_down_fails_and_the_others_keep_their_rate() {
    let Some(fleet) = Fleet::new() else { return };
    let api = fleet.node("api,scheduler", &[]);
    let rooms = if full() { 60 } else { 12 };
    (0..=rooms).for_each(|room| api.client.lasting_room(&room.to_string(), room));
    let mut workers: Vec<Process> = (0..4).map(|_| fleet.node("worker", &[])).collect();
    // Seconds of a round of jobs, one for each room but the last.
    let mut seeds = 0..;
    let mut round = || {
        let seed = seeds.next().unwrap();
        let begun = Instant::now();
        let jobs: Vec<String> = (0..rooms)
            .map(|room| api.client.post_job(&seeded(quick(&format!("room/{room}")), seed)))
            .collect();
        jobs.iter().for_each(|job| assert_eq!(api.client.ended(job)["state"], "succeeded"));
        begun.elapsed().as_secs_f64()
    };
    round();
    let poison = api.client.post_job(&endless(&format!("room/{rooms}")));
    let runs = format!(
        "SELECT w.name FROM jobs j JOIN workers w ON w.worker = j.boot WHERE j.id = '{poison}' AND j.state = 'running'"
    );
    let state = || api.client.get(&format!("/jobs/{poison}")).json()["state"].clone();
    let (beside, deaths) = std::thread::scope(|scope| {
        let killing = scope.spawn(|| {
            let mut deaths = 0;
            loop {
                // Asked seldom, since asking takes its share of a small machine as well.
                sleep(Duration::from_millis(200));
                let by = match state().as_str() {
                    Some("failed") => return deaths,
                    Some("running") => fleet.rows(&runs).pop(),
                    _ => None,
                };
                let is_by = |worker: &Process| {
                    by.as_ref().is_some_and(|by| by.ends_with(&format!("/{}", worker.id())))
                };
                if let Some(at) = workers.iter().position(is_by) {
                    workers.swap_remove(at).kill();
                    workers.push(fleet.node("worker", &[]));
                    deaths += 1;
                }
            }
        });
        let mut beside = Vec::new();
        while !killing.is_finished() {
            beside.push(round());
        }
        (beside, killing.join().unwrap())
    });
    let ended = api.client.ended(&poison);
    assert_eq!((deaths, &ended["error"]["code"]), (3, &json!("interrupted")), "{ended}");
    assert_ne!(api.client.get(&format!("/params/room/{rooms}")).status, 200, "nothing is served of it");
    let alone: f64 = beside.iter().map(|_| round()).sum();
    let kept = alone / beside.iter().sum::<f64>();
    println!(
        "FLEET: beside a job that takes three workers down, {:.0} jobs keep {kept:.2} of their rate (target .9)",
        beside.len() as f64 * rooms as f64
    );
    assert!(kept > 0.5, "{kept}");
}

#[test]
fn a_worker_that_was_stopped_for_two_leases_publishes_nothing_and_goes_on_as_another() {
    let Some(fleet) = Fleet::new() else { return };
    let api = fleet.node("api,scheduler", &[]);
    api.client.lasting_room("1", 1);
    // It has its result, and is stopped before it writes it.
    let frozen = fleet.node("worker", &[("LAMPYRIS_PAUSE_AT", "before_finish:1500")]);
    let job = api.client.post_job(&quick("room/1"));
    api.client.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
    sleep(Duration::from_millis(500));
    frozen.signal("STOP");
    let heir = fleet.node("worker", &[]);
    let ended = api.client.ended(&job);
    assert_eq!((&ended["outcome"], &ended["attempt"]), (&json!("accepted"), &json!(2)), "{ended}");
    let served = api.client.get("/params/room/1").expect(200).text;
    sleep(Duration::from_secs(LEASE));
    frozen.signal("CONT");
    sleep(Duration::from_secs(5));
    assert_eq!(api.client.get("/params/room/1").expect(200).text, served, "the late end was refused");
    assert_eq!(fleet.rows(&format!("SELECT COUNT(*)::TEXT FROM fits WHERE job = '{job}'")), ["1"]);
    assert_eq!(fleet.rows("SELECT COUNT(*)::TEXT FROM revisions"), ["1"]);
    // It has another number by now, and works on.
    drop(heir);
    let again = json!({"experiment": true, "method": {"name": "cfa", "seed": 7}});
    let next = api.client.estimate("room/1", again);
    assert_eq!(api.client.ended(&next)["state"], "succeeded");
}

#[test]
fn a_running_job_is_called_off_by_another_node() {
    let Some(fleet) = Fleet::new() else { return };
    let api = fleet.node("api", &[]);
    let worker = fleet.node("worker,scheduler", &[]);
    api.client.lasting_room("1", 1);
    let mut waits = Vec::new();
    for _ in 0..if full() { 200 } else { 10 } {
        let job = api.client.post_job(&endless("room/1"));
        api.client.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
        let asked = Instant::now();
        api.client.post(&format!("/jobs/{job}/cancel")).expect(200);
        while api.client.get(&format!("/jobs/{job}")).json()["state"] == "running" {
            sleep(Duration::from_millis(5));
        }
        waits.push(asked.elapsed());
        assert_eq!(api.client.get(&format!("/jobs/{job}")).json()["state"], "cancelled");
    }
    drop(worker);
    waits.sort();
    let p99 = waits[(waits.len() * 99).div_ceil(100) - 1];
    println!("FLEET: {} cancels by another node, p99 {p99:?} (target 0.5 s)", waits.len());
    assert!(p99 < Duration::from_secs(10), "{p99:?}");
}

#[test]
fn a_worker_that_is_cut_off_stops_itself_and_publishes_nothing() {
    let Some(fleet) = Fleet::new() else { return };
    let way = Way::to(&fleet.server());
    let api = fleet.node("api,scheduler", &[]);
    api.client.lasting_room("1", 1);
    let cut = fleet.node_by(&way, "worker", &[]);
    let job = api.client.post_job(&endless("room/1"));
    api.client.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
    way.cut(true);
    // Nobody is there to take it over: it stops by itself before its lease has ended.
    sleep(Duration::from_secs(LEASE));
    let before = cut.cpu();
    sleep(Duration::from_secs(2));
    let idle = cut.cpu() - before;
    println!("FLEET: cut off for a lease, a worker computes {idle:.2} s in 2 s (target 0)");
    assert!(idle < 0.5, "it goes on: {idle}");
    let heir = fleet.node("worker", &[]);
    api.client.until(&format!("/jobs/{job}"), |job| job["state"] == "running" && job["attempt"] == 2);
    way.cut(false);
    sleep(Duration::from_secs(3));
    let now = api.client.get(&format!("/jobs/{job}")).json();
    assert_eq!((&now["state"], &now["attempt"]), (&json!("running"), &json!(2)), "{now}");
    api.client.post(&format!("/jobs/{job}/cancel")).expect(200);
    assert_eq!(api.client.ended(&job)["state"], "cancelled");
    drop(heir);
}
