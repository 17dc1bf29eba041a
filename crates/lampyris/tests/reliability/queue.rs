//! The queue under a crowd: nothing is dropped in silence, nobody waits for another's crowd, and nothing is
//! done twice.

use crate::database::rows;
use crate::support::process::Process;
use crate::support::rooms::room_csv;
use crate::support::{Answer, Client, PATIENCE, endless, full, quick, seeded};
use jiff::Timestamp;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Rooms whose jobs keep both workers from the crowd until it is complete.
const BLOCKERS: [&str; 2] = ["blocker-1", "blocker-2"];

/// A service whose workers are both held up, with these rooms of one parameter each. So many jobs may wait in
/// all and of one system.
fn blocked(database: &Path, (limit, of_system): (u64, u64), rooms: &[String]) -> (Process, Vec<String>) {
    let poison = BLOCKERS.map(|room| format!("room/{room}:stall")).join(",");
    let service = Process::start_with(
        database,
        &[
            ("LAMPYRIS_POISON", &poison),
            ("LAMPYRIS_LIMITS_QUEUE", &limit.to_string()),
            ("LAMPYRIS_LIMITS_QUEUE_PER_SYSTEM", &of_system.to_string()),
        ],
    );
    let client = &service.client;
    BLOCKERS.iter().for_each(|room| client.room(room, 1));
    for room in rooms {
        client.json("PUT", &format!("/systems/room/{room}"), &json!({"model": "rc1"})).expect(201);
        client.csv(&format!("/systems/room/{room}/windows"), &room_csv(1, 4)).expect(201);
    }
    let blockers: Vec<String> =
        BLOCKERS.iter().map(|room| client.post_job(&quick(&format!("room/{room}")))).collect();
    for blocker in &blockers {
        client.until(&format!("/jobs/{blocker}"), |job| job["state"] == "running");
    }
    (service, blockers)
}

/// A job that takes next to no time: nothing is free, the fit is only judged. Each seed makes another one.
fn small(room: &str, seed: u64) -> Value {
    json!({"kind": "estimate", "system": format!("room/{room}"), "split": {"train": "P3D", "validation": "P1D"}, "experiment": true,
           "method": {"name": "lm_multistart", "seed": seed}, "budget": {"evaluations": 1}, "fixed": {"alpha_a": 0.15}})
}

fn release(client: &Client, blockers: &[String]) {
    for blocker in blockers {
        client.post(&format!("/jobs/{blocker}/cancel")).expect(200);
    }
}

/// All jobs of a list, in the order in which they were submitted, and how long the slowest page took.
fn jobs(client: &Client, query: &str) -> (Vec<Value>, Duration) {
    let (mut jobs, mut token, mut slowest) = (Vec::new(), String::new(), Duration::ZERO);
    loop {
        let begun = Instant::now();
        let page = client.get(&format!("/jobs?page_size=100{query}{token}")).expect(200).json();
        slowest = slowest.max(begun.elapsed());
        jobs.extend(page["items"].as_array().unwrap().iter().cloned());
        match page["next_page_token"].as_str() {
            Some(next) => token = format!("&page_token={next}"),
            None => break,
        }
    }
    jobs.reverse();
    (jobs, slowest)
}

fn started(job: &Value) -> Timestamp {
    job["started_at"].as_str().unwrap_or_else(|| panic!("{job}")).parse().unwrap()
}

/// The nearest rank.
fn percentile(times: &mut [Duration], share: f64) -> Duration {
    times.sort();
    times[((times.len() as f64 * share).ceil() as usize).clamp(1, times.len()) - 1]
}

#[test]
fn a_crowd_is_taken_up_to_the_limit_and_every_job_of_it_is_done_once_in_order() {
    const ROOMS: u64 = 20;
    let limit: u64 = if full() { 10_000 } else { 500 };
    let dir = tempfile::tempdir().unwrap();
    let rooms: Vec<String> = (0..ROOMS).map(|room| room.to_string()).collect();
    let (service, blockers) = blocked(&dir.path().join("crowd.db"), (limit, limit), &rooms);
    let client = &service.client;
    let empty = service.status("VmRSS") << 10;

    let next = AtomicU64::new(0);
    let post = || -> Vec<(Answer, Duration)> {
        let mut answers = Vec::new();
        loop {
            let number = next.fetch_add(1, Ordering::Relaxed);
            if number >= limit + 40 {
                return answers;
            }
            let begun = Instant::now();
            let answer =
                client.json("POST", "/jobs", &small(&rooms[(number % ROOMS) as usize], number / ROOMS));
            answers.push((answer, begun.elapsed()));
        }
    };
    let answers: Vec<(Answer, Duration)> = std::thread::scope(|scope| {
        let posters: Vec<_> = (0..4).map(|_| scope.spawn(post)).collect();
        posters.into_iter().flat_map(|poster| poster.join().unwrap()).collect()
    });
    let count = |status: u16| answers.iter().filter(|(answer, _)| answer.status == status).count() as u64;
    assert_eq!(
        (count(202), count(429), answers.len() as u64),
        (limit, 40, limit + 40),
        "every post is taken or told to wait"
    );
    for (answer, _) in answers.iter().filter(|(answer, _)| answer.status == 429) {
        assert!(answer.header("retry-after").parse::<u64>().unwrap() > 0);
        answer.clone().problem(429, "queue-full");
    }
    let accepted: BTreeSet<String> = answers
        .iter()
        .filter(|(answer, _)| answer.status == 202)
        .map(|(answer, _)| answer.json()["id"].as_str().unwrap().to_owned())
        .collect();
    let mut posts: Vec<Duration> = answers.iter().map(|(_, took)| *took).collect();
    let (waiting, slowest_page) = jobs(client, "&state=queued");
    assert_eq!(waiting.len() as u64, limit);
    let crowded = service.status("VmRSS") << 10;

    release(client, &blockers);
    let begun = Instant::now();
    while !client.get("/jobs?state=queued&page_size=1").expect(200).json()["items"]
        .as_array()
        .unwrap()
        .is_empty()
    {
        assert!(begun.elapsed() < PATIENCE, "the queue does not empty");
        std::thread::sleep(Duration::from_millis(100));
    }
    for room in &rooms {
        client.until(&format!("/jobs?state=running&system=room/{room}"), |page| page["items"] == json!([]));
    }
    let took = begun.elapsed();
    let (mut all, _) = jobs(client, "");
    all.retain(|job| !blockers.contains(&job["id"].as_str().unwrap().to_owned()));
    assert_eq!(
        all.iter().map(|job| job["id"].as_str().unwrap().to_owned()).collect::<BTreeSet<_>>(),
        accepted
    );
    let fits: BTreeSet<&str> =
        all.iter().map(|job| job["fit"].as_str().unwrap_or_else(|| panic!("{job}"))).collect();
    assert_eq!(fits.len() as u64, limit, "one result for each job");
    assert!(all.iter().all(|job| job["state"] == "succeeded" && job["attempt"] == 1));
    // In the order of submission: exactly so within a room, and over all rooms as far as two workers and
    // rooms that take turns allow.
    let mut newest: BTreeMap<String, Timestamp> = BTreeMap::new();
    for job in &all {
        let start = started(job);
        let before = newest.insert(job["system"].to_string(), start);
        assert!(before.is_none_or(|before| before < start), "{job} overtook a job of its room");
    }
    let mut order: Vec<usize> = (0..all.len()).collect();
    order.sort_by_key(|index| started(&all[*index]));
    let farthest = order.iter().enumerate().map(|(rank, index)| rank.abs_diff(*index)).max().unwrap();
    assert!(farthest < 2 * ROOMS as usize, "a job started {farthest} places from its turn");
    // The same from the other side: what was counted as ended is what was taken, and the two that were called
    // off.
    let metrics = client.get("/metrics").expect(200).text;
    let ended = metrics
        .lines()
        .filter(|line| line.starts_with("lampyris_jobs_ended_total{"))
        .map(|line| line.rsplit_once(' ').unwrap().1);
    assert_eq!(ended.map(|count| count.parse::<u64>().unwrap()).sum::<u64>(), limit + 2, "{metrics}");
    let megabytes = |bytes: u64| bytes >> 20;
    println!(
        "Q-1: {limit} jobs taken, 40 told to wait; a post 50 % {:?}, 99 % {:?} (target 50 ms); slowest page \
        of {limit} {slowest_page:?} (target 50 ms); \
         done in {took:.1?}; memory {} MB, with the queue {} MB, at the end {} MB; farthest from its turn: \
        {farthest}",
        percentile(&mut posts, 0.5),
        percentile(&mut posts, 0.99),
        megabytes(empty),
        megabytes(crowded),
        megabytes(service.status("VmRSS") << 10)
    );
}

#[test]
fn a_room_with_one_job_waits_for_no_crowd_of_another() {
    let crowd: u64 = if full() { 9_000 } else { 200 };
    let dir = tempfile::tempdir().unwrap();
    let rooms = ["a".to_owned(), "b".to_owned()];
    let (service, blockers) = blocked(&dir.path().join("fair.db"), (10_000, crowd), &rooms);
    let client = &service.client;
    std::thread::scope(|scope| {
        for part in 0..4 {
            scope.spawn(move || {
                (part..crowd)
                    .step_by(4)
                    .for_each(|seed| drop(client.json("POST", "/jobs", &small("a", seed)).expect(202)))
            });
        }
    });
    client.json("POST", "/jobs", &small("a", crowd)).problem(429, "queue-full");
    client.json("POST", "/jobs", &small("a", 0)).expect(200);
    let one = client.post_job(&small("b", 0));
    assert_eq!(
        client.json("POST", "/jobs", &small("b", 0)).expect(200).json()["id"],
        one.as_str(),
        "equal jobs wait once"
    );
    release(client, &blockers);
    let one = started(&client.ended(&one));
    let (running, _) = jobs(client, "&system=room/a&state=running");
    let (done, _) = jobs(client, "&system=room/a&state=succeeded");
    let before = running.iter().chain(&done).filter(|job| started(job) < one).count();
    assert!(before <= 2, "{before} jobs of the crowd went first");
    println!("Q-2: {before} of {crowd} jobs of the other room went first");
}

#[test]
fn a_tenant_of_few_jobs_waits_for_no_crowd_of_another() {
    let crowd: usize = if full() { 2_000 } else { 40 };
    let dir = tempfile::tempdir().unwrap();
    let rooms: Vec<String> = (0..crowd).map(|room| format!("many-{room}")).collect();
    let (service, blockers) = blocked(&dir.path().join("tenants.db"), (10_000, 10), &rooms);
    let client = &service.client;
    let few: Vec<String> = (0..5).map(|room| format!("few-{room}")).collect();
    for room in &few {
        let document = json!({"model": "rc1", "tenant": "few"});
        client.json("PUT", &format!("/systems/room/{room}"), &document).expect(201);
        client.csv(&format!("/systems/room/{room}/windows"), &room_csv(1, 4)).expect(201);
    }
    rooms.iter().for_each(|room| drop(client.json("POST", "/jobs", &small(room, 0)).expect(202)));
    let own: Vec<String> = few.iter().map(|room| client.post_job(&small(room, 0))).collect();
    release(client, &blockers);
    let last = own.iter().map(|job| started(&client.ended(job))).max().unwrap();
    let (done, _) = jobs(client, "&state=succeeded");
    let before = done
        .iter()
        .filter(|job| started(job) < last && job["system"].as_str().unwrap().contains("many"))
        .count();
    // Both workers begin with one of either; then they take turns.
    assert!(before <= few.len() + 2, "{before} jobs of the crowd went before the fifth of the few");
    println!("Q-8: {before} of {crowd} jobs of the other tenant went before the last of {}", few.len());
}

#[test]
fn an_idle_worker_hears_of_a_job_while_another_works() {
    let dir = tempfile::tempdir().unwrap();
    let service = Process::start_with(&dir.path().join("idle.db"), &[("LAMPYRIS_WORKERS", "2")]);
    let client = &service.client;
    ["long", "short"].iter().for_each(|room| client.room(room, 1));
    let mut waited = Vec::new();
    for round in 0..4 {
        let long = seeded(endless("room/long"), round);
        let long = client.post_job(&long);
        client.until(&format!("/jobs/{long}"), |job| job["state"] == "running");
        // Until the other worker, which was told of the first one, has gone to sleep again.
        std::thread::sleep(Duration::from_millis(300));
        let posted = Instant::now();
        let short = seeded(quick("room/short"), round);
        let short = client.post_job(&short);
        client.until(&format!("/jobs/{short}"), |job| job["state"] != "queued");
        waited.push(posted.elapsed());
        client.ended(&short);
        client.post(&format!("/jobs/{long}/cancel")).expect(200);
        client.ended(&long);
    }
    println!("Q-5: the second of two workers began after {waited:?}");
    assert!(waited.iter().all(|waited| *waited < Duration::from_secs(3)), "{waited:?}");
}

/// A fit without what tells one run from another.
fn result(client: &Client, job: &Value) -> Value {
    let mut fit = client.get(&format!("/fits/{}", job["fit"].as_str().unwrap())).expect(200).json();
    for field in ["id", "job", "created_at", "links"] {
        fit.as_object_mut().unwrap().shift_remove(field);
    }
    fit
}

#[test]
fn a_job_that_is_killed_half_way_ends_as_if_it_had_not_been() {
    let evaluations = if full() { 100_000 } else { 12_000 };
    let dir = tempfile::tempdir().unwrap();
    let mut body = seeded(endless("room/1"), 7);
    body["method"]["generations"] = json!(1_000_000);
    body["budget"]["evaluations"] = json!(evaluations);
    let begin = |name: &str, threads: &str| {
        let database = dir.path().join(name);
        let service = Process::start_with(&database, &[("LAMPYRIS_THREADS", threads)]);
        service.client.room("1", 1);
        (database, service)
    };
    let (_, service) = begin("unbroken.db", "1");
    let whole = service.client.ended(&service.client.post_job(&body));
    let unbroken = result(&service.client, &whole);
    drop(service);

    for threads in ["1", "2"] {
        let (database, service) = begin(&format!("{threads}.db"), threads);
        let job = service.client.post_job(&body);
        let half = service.client.until(&format!("/jobs/{job}"), |job| {
            job["progress"]["evaluations"].as_u64() >= Some(evaluations / 2)
        });
        assert_eq!(half["state"], "running", "{half}");
        service.kill();
        let service = Process::start_with(&database, &[("LAMPYRIS_THREADS", threads)]);
        let ended = service.client.ended(&job);
        assert_eq!((&ended["state"], &ended["attempt"]), (&json!("succeeded"), &json!(2)), "{ended}");
        let again = result(&service.client, &ended);
        for (field, value) in unbroken.as_object().unwrap() {
            assert_eq!(&again[field], value, "{field} with {threads} threads");
        }
        assert_eq!(again, unbroken);
        println!(
            "Q-7: killed after {} of {} evaluations ({} s) with {threads} threads: the same fit to the bit",
            half["progress"]["evaluations"], whole["evaluations"], whole["wall_s"]
        );
    }
}

/// A wall of many layers between the room and the weather.
fn wall(layers: usize) -> Value {
    let state = |layer: usize| if layer == 0 { "T_room".to_owned() } else { format!("T_{layer}") };
    let (mut states, mut equations) = (serde_json::Map::new(), serde_json::Map::new());
    for layer in 0..layers {
        states.insert(state(layer), json!({"unit": "degC", "initial": "T_room"}));
        let outer = if layer + 1 == layers { "T_out".to_owned() } else { state(layer + 1) };
        let inner = if layer == 0 {
            String::new()
        } else {
            format!(" + k * ({} - {})", state(layer - 1), state(layer))
        };
        equations.insert(state(layer), json!(format!("k * ({outer} - {}){inner}", state(layer))));
    }
    json!({
        "id": "wall", "title": "A wall of many layers", "states": states,
        "inputs": {"T_out": {"unit": "degC"}}, "equations": equations,
        "parameters": {"k": {"unit": "1/h", "lower": 0.1, "upper": 10.0, "nominal": 1.0, "scale": "log"}},
        "outputs": {"T_room": {"expr": "T_room", "unit": "degC", "noise_sd": 0.05}},
    })
}

#[test]
fn a_large_model_on_a_long_record_is_called_off_in_the_middle_of_a_simulation() {
    let days = if full() { 150 } else { 60 };
    let dir = tempfile::tempdir().unwrap();
    let service = Process::start(&dir.path().join("wall.db"));
    let client = &service.client;
    client.json("POST", "/models", &wall(40)).expect(201);
    client.json("PUT", "/systems/room/1", &json!({"model": "wall"})).expect(201);
    client.csv("/systems/room/1/windows", &room_csv(1, days)).expect(201);
    let mut body = endless("room/1");
    body["split"] = json!({"train": format!("P{}D", days - 10), "validation": "P10D"});
    let mut single = body.clone();
    single["budget"]["evaluations"] = json!(1);
    let single = client.ended(&client.post_job(&single));
    let batch = single["wall_s"].as_f64().unwrap();

    let job = client.post_job(&body);
    client.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
    std::thread::sleep(Duration::from_secs_f64(batch / 8.0));
    let begun = Instant::now();
    client.post(&format!("/jobs/{job}/cancel")).expect(200);
    assert_eq!(client.ended(&job)["state"], "cancelled");
    let cancelled = begun.elapsed().as_secs_f64();
    println!(
        "Q-6: a job of the smallest budget takes {batch:.2} s ({}), one was called off within {cancelled:.3} \
        s (target 0.5 s)",
        single["state"]
    );
    assert!(cancelled < batch / 4.0, "{cancelled} s of {batch} s");
}

#[test]
fn a_batch_of_very_many_jobs_is_gone_on_with_where_the_process_died() {
    let dir = tempfile::tempdir().unwrap();
    let database = dir.path().join("many.db");
    let service = Process::start(&database);
    service.client.json("PUT", "/systems/room/0", &json!({"model": "rc1"})).expect(201);
    service.client.csv("/systems/room/0/windows", &room_csv(1, 4)).expect(201);
    service.terminate();
    const ROOMS: usize = 5_000;
    for sql in [
        "INSERT INTO systems (system, model, document, created_at, updated_at) SELECT 'room/' || n, model, document, \
        created_at, updated_at FROM systems, (WITH RECURSIVE counted (n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM \
        counted WHERE n < 4999) SELECT n FROM counted)",
        "INSERT INTO days SELECT s.system, d.day, d.from_ms, d.to_ms, d.channels, d.block FROM systems s, days d \
        WHERE s.system <> d.system",
    ] {
        rows(&database, sql);
    }
    // Nobody works, so that all of them wait; and it dies with the third of three transactions.
    let environment = [("LAMPYRIS_ROLES", "api,scheduler"), ("LAMPYRIS_LIMITS_QUEUE", "10000")];
    let dying = [&environment[..], &[("LAMPYRIS_ABORT_AT", "in_entering:2")]].concat();
    let service = Process::start_with(&database, &dying);
    let body = json!({"kind": "recalibrate", "systems": ["room/*"]});
    let headers = [("content-type", "application/json")];
    let sent = service.client.send("POST", "/jobs", &headers, Some(body.to_string().as_bytes()));
    assert!(sent.is_err());
    service.gone();
    let waiting = "SELECT CAST(COUNT(*) AS TEXT) FROM jobs WHERE state = 'queued'";
    assert_eq!(rows(&database, waiting), ["4000"]);
    let service = Process::start_with(&database, &environment);
    let begun = Instant::now();
    while rows(&database, waiting) != [ROOMS.to_string()] {
        assert!(begun.elapsed() < PATIENCE);
        std::thread::sleep(Duration::from_millis(20));
    }
    let batches = service.client.get("/batches").expect(200).json();
    assert_eq!(
        (&batches["items"][0]["jobs"], batches["items"].as_array().unwrap().len()),
        (&json!(ROOMS), 1)
    );
    assert_eq!(rows(&database, "SELECT CAST(COUNT(DISTINCT system) AS TEXT) FROM jobs"), [ROOMS.to_string()]);
    let waits = "SELECT CAST(COUNT(*) AS TEXT) FROM batches WHERE waiting IS NOT NULL";
    assert_eq!(rows(&database, waits), ["0"]);
}
