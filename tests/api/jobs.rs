//! The queue as a client sees it.

use crate::support::{TestApp, endless, quick};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Write};
use std::time::{Duration, Instant};

/// Reads server-sent events until the stream ends: (event, id, data).
fn events(app: &TestApp, job: &str, last: Option<&str>) -> Vec<(String, String, Value)> {
    let mut stream = std::net::TcpStream::connect(app.addr()).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    let last = last.map(|id| format!("last-event-id: {id}\r\n")).unwrap_or_default();
    write!(stream, "GET /jobs/{job}/events HTTP/1.1\r\nhost: x\r\nconnection: close\r\n{last}\r\n").unwrap();
    let (mut events, mut event, mut id) = (Vec::new(), String::new(), String::new());
    for line in BufReader::new(stream).lines() {
        let line = line.unwrap();
        if let Some(name) = line.strip_prefix("event: ") {
            name.clone_into(&mut event);
        } else if let Some(text) = line.strip_prefix("id: ") {
            text.clone_into(&mut id);
        } else if let Some(data) = line.strip_prefix("data: ") {
            events.push((event.clone(), id.clone(), serde_json::from_str(data).unwrap_or(Value::Null)));
        } else if line == "0" {
            break;
        }
    }
    events
}

#[test]
fn equal_jobs_wait_once() {
    let app = TestApp::with(|settings| settings.workers = 1);
    app.room("1", 1);
    app.room("2", 2);
    let blocker = app.json("POST", "/jobs", &endless("room/1")).expect(202).json()["id"].as_str().unwrap().to_owned();
    app.until(&format!("/jobs/{blocker}"), |job| job["state"] == "running");
    let first = app.json("POST", "/jobs", &quick("room/2")).expect(202).json();
    let second = app.json("POST", "/jobs", &quick("room/2")).expect(200).json();
    assert_eq!(first["id"], second["id"]);
    let mut other = quick("room/2");
    other["method"]["seed"] = json!(2);
    assert_ne!(app.json("POST", "/jobs", &other).expect(202).json()["id"], first["id"]);
    // The running one is no longer waiting: an equal job may be posted beside it.
    let beside = app.json("POST", "/jobs", &endless("room/1")).expect(202).json();
    assert_ne!(beside["id"], blocker.as_str());

    let list = |query: &str| app.get(&format!("/jobs?{query}")).expect(200).json()["items"].as_array().unwrap().len();
    assert_eq!((list("state=queued"), list("state=running"), list("system=room/2"), list("kind=estimate")), (3, 1, 2, 4));
    let page = app.get("/jobs?page_size=3").json();
    let rest = app.get(&format!("/jobs?page_size=3&page_token={}", page["next_page_token"].as_str().unwrap())).json();
    assert_eq!((page["items"].as_array().unwrap().len(), rest["items"].as_array().unwrap().len()), (3, 1));
    assert!(rest["next_page_token"].is_null());

    for job in [&blocker, beside["id"].as_str().unwrap()] {
        app.post(&format!("/jobs/{job}/cancel")).expect(200);
    }
    assert_eq!(app.ended(first["id"].as_str().unwrap())["state"], "succeeded");
}

#[test]
fn a_key_makes_one_job_of_two_requests() {
    let app = TestApp::start();
    app.room("1", 1);
    let post = |key: &str, body: &Value| app.json_with("POST", "/jobs", &[("idempotency-key", key)], body);
    let first = post("a", &quick("room/1")).expect(202);
    let id = first.json()["id"].as_str().unwrap().to_owned();
    app.ended(&id);
    // The job has ended, so without the key this would be another one.
    let again = post("a", &quick("room/1")).expect(202);
    assert_eq!((again.json()["id"].as_str(), again.header("idempotency-replayed")), (Some(id.as_str()), "true"));
    let mut other = quick("room/1");
    other["method"]["seed"] = json!(7);
    post("a", &other).problem(422, "idempotency-key-reused");
    assert_ne!(post("b", &quick("room/1")).expect(202).json()["id"], id.as_str());

    let batch = json!({"kind": "recalibrate", "systems": ["room/*"]});
    let made = post("c", &batch).expect(202).json();
    assert_eq!(post("c", &batch).expect(202).json()["id"], made["id"]);
    let model = json!({"effect": "constant_gain"});
    let effect = |key: &str| app.json_with("POST", "/models/rc2/effects", &[("idempotency-key", key)], &model);
    effect("d").expect(201);
    effect("d").expect(200);
    effect("a").problem(422, "idempotency-key-reused");
}

#[test]
fn a_cancelled_job_stops_within_half_a_second() {
    let app = TestApp::start();
    app.room("1", 1);
    let job = app.json("POST", "/jobs", &endless("room/1")).expect(202).json()["id"].as_str().unwrap().to_owned();
    app.until(&format!("/jobs/{job}"), |job| job["progress"]["evaluations"].as_u64().unwrap_or(0) > 0);
    let start = Instant::now();
    app.post(&format!("/jobs/{job}/cancel")).expect(200);
    let ended = app.ended(&job);
    assert!(start.elapsed() < Duration::from_millis(500), "{:?}", start.elapsed());
    assert_eq!((ended["state"].as_str(), ended["fit"].is_null()), (Some("cancelled"), true));
    assert_eq!(app.post(&format!("/jobs/{job}/cancel")).expect(200).json()["state"], "cancelled", "twice is harmless");
    app.post("/jobs/job_none/cancel").problem(404, "job-not-found");
    // The worker is free again.
    assert_eq!(app.ended(&app.estimate("room/1", json!({})))["state"], "succeeded");
}

#[test]
fn a_deadline_ends_a_search_with_what_it_has() {
    let app = TestApp::start();
    app.room("1", 1);
    let mut body = endless("room/1");
    body["budget"]["wall"] = json!("PT1S");
    let job = app.json("POST", "/jobs", &body).expect(202).json()["id"].as_str().unwrap().to_owned();
    let ended = app.ended(&job);
    assert_eq!((ended["state"].as_str(), ended["stopped_by"].as_str()), (Some("succeeded"), Some("deadline")), "{ended}");
    assert!(ended["wall_s"].as_f64().unwrap() < 3.0, "{ended}");
}

#[test]
fn events_tell_a_job_from_queue_to_end() {
    let app = TestApp::start();
    app.room("1", 1);
    let mut body = endless("room/1");
    body["budget"]["wall"] = json!("PT2S");
    let job = app.json("POST", "/jobs", &body).expect(202).json()["id"].as_str().unwrap().to_owned();
    let start = Instant::now();
    let told = events(&app, &job, None);
    let seconds = start.elapsed().as_secs_f64();
    let names: Vec<&str> = told.iter().map(|(name, _, _)| name.as_str()).collect();
    assert_eq!((names.first(), names.get(1), names.last()), (Some(&"queued"), Some(&"started"), Some(&"finished")), "{names:?}");
    let progress: Vec<&Value> = told.iter().filter(|(name, _, _)| name == "progress").map(|(_, _, data)| data).collect();
    assert!(progress.len() >= 2 && (progress.len() as f64) <= 4.0 * seconds + 2.0, "{} in {seconds} s", progress.len());
    assert!(progress.windows(2).all(|pair| pair[0]["evaluations"].as_u64() < pair[1]["evaluations"].as_u64()));
    assert!(progress.iter().all(|progress| progress["best_train"].is_f64() && progress["eta_s"].is_f64()), "{progress:?}");
    assert_eq!(told.last().unwrap().2["state"], "succeeded");

    // Who comes back is told only what is new, and who has seen the end is told to stay away.
    let rest = events(&app, &job, Some("started-1"));
    assert_eq!(rest.iter().map(|(name, _, _)| name.as_str()).collect::<Vec<_>>(), ["finished"]);
    app.get_with(&format!("/jobs/{job}/events"), &[("last-event-id", "finished")]).expect(204);
}

#[test]
fn a_full_queue_says_so() {
    let app = TestApp::with(|settings| {
        settings.workers = 1;
        settings.limits.queue = 2;
    });
    app.room("1", 1);
    let post = |seed: u64| {
        let mut body = endless("room/1");
        body["method"]["seed"] = json!(seed);
        app.json("POST", "/jobs", &body)
    };
    let first = post(0).expect(202).json()["id"].as_str().unwrap().to_owned();
    app.until(&format!("/jobs/{first}"), |job| job["state"] == "running");
    post(1).expect(202);
    post(2).expect(202);
    let refused = post(3);
    assert!(!refused.header("retry-after").is_empty());
    refused.problem(429, "queue-full");
}

#[test]
fn one_job_of_a_system_waits_for_no_crowd_of_another() {
    let app = TestApp::with(|settings| settings.workers = 1);
    app.room("1", 1);
    app.room("2", 2);
    let blocker = app.json("POST", "/jobs", &endless("room/1")).expect(202).json()["id"].as_str().unwrap().to_owned();
    app.until(&format!("/jobs/{blocker}"), |job| job["state"] == "running");
    let crowd: Vec<String> = (0..6)
        .map(|seed| app.estimate("room/1", json!({"method": {"name": "lm_multistart", "seed": seed}, "budget": {"evaluations": 50}})))
        .collect();
    let single = app.estimate("room/2", json!({"budget": {"evaluations": 50}}));
    app.post(&format!("/jobs/{blocker}/cancel")).expect(200);
    let started = |job: &str| app.ended(job)["started_at"].as_str().unwrap().parse::<jiff::Timestamp>().unwrap();
    let single = started(&single);
    let before = crowd.iter().filter(|job| started(job) < single).count();
    assert!(before <= 1, "{before} jobs of the other system went first");
}

#[test]
fn early_stopping_is_asked_for_in_the_request() {
    let app = TestApp::start();
    app.room("1", 1);
    let method = json!({"name": "cfa_thesis", "seed": 1, "n": 12, "n_min": 6, "generations": 1000});
    let more = json!({"method": method, "budget": {"evaluations": 50_000}, "early_stopping": {"patience": 8, "min_delta": 0.05}});
    let job = app.ended(&app.estimate("room/1", more));
    assert_eq!((job["state"].as_str(), job["stopped_by"].as_str()), (Some("succeeded"), Some("stalled")), "{job}");
    assert!(job["evaluations"].as_u64().unwrap() < 20_000, "{job}");
    assert_eq!(job["request"]["early_stopping"], json!({"patience": 8, "min_delta": 0.05, "validation": false}));

    let mut bad = quick("room/1");
    bad["early_stopping"] = json!({"patience": 0, "min_delta": 2});
    let problem = app.json("POST", "/jobs", &bad).problem(422, "invalid-request");
    let pointers: Vec<&str> = problem["errors"].as_array().unwrap().iter().map(|fault| fault["pointer"].as_str().unwrap()).collect();
    assert_eq!(pointers, ["/early_stopping/patience", "/early_stopping/min_delta"]);
    bad["early_stopping"] = json!({"patients": 3});
    let problem = app.json("POST", "/jobs", &bad).problem(422, "invalid-request");
    assert_eq!(problem["errors"][0]["suggestion"], "did you mean `patience`?");
}
