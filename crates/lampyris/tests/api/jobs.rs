//! The queue as a client sees it.

use crate::support::{TestApp, endless, quick, seeded};
use serde_json::{Value, json};
use std::time::Instant;

#[test]
fn equal_jobs_wait_once() {
    let app = TestApp::with(|settings| settings.workers = 1);
    app.room("1", 1);
    app.room("2", 2);
    let blocker =
        app.json("POST", "/jobs", &endless("room/1")).expect(202).json()["id"].as_str().unwrap().to_owned();
    app.until(&format!("/jobs/{blocker}"), |job| job["state"] == "running");
    let first = app.json("POST", "/jobs", &quick("room/2")).expect(202).json();
    let second = app.json("POST", "/jobs", &quick("room/2")).expect(200).json();
    assert_eq!(first["id"], second["id"]);
    let other = seeded(quick("room/2"), 2);
    assert_ne!(app.json("POST", "/jobs", &other).expect(202).json()["id"], first["id"]);
    // The running one is no longer waiting: an equal job may be posted beside it.
    let beside = app.json("POST", "/jobs", &endless("room/1")).expect(202).json();
    assert_ne!(beside["id"], blocker.as_str());

    let list = |query: &str| {
        app.get(&format!("/jobs?{query}")).expect(200).json()["items"].as_array().unwrap().len()
    };
    assert_eq!(
        (list("state=queued"), list("state=running"), list("system=room/2"), list("kind=estimate")),
        (3, 1, 2, 4)
    );
    let both = [
        "state=queued&system=room/2",
        "state=queued&kind=estimate",
        "system=room/2&kind=estimate",
        "state=running&system=room/2",
    ];
    assert_eq!(both.map(list), [2, 3, 2, 0]);
    assert_eq!(list("state=queued&system=room/2&kind=diagnose"), 0);
    let page = app.get("/jobs?page_size=3").json();
    let rest = app
        .get(&format!("/jobs?page_size=3&page_token={}", page["next_page_token"].as_str().unwrap()))
        .json();
    assert_eq!((page["items"].as_array().unwrap().len(), rest["items"].as_array().unwrap().len()), (3, 1));
    assert!(rest["next_page_token"].is_null());

    // Those that wait, by their turn, a page at a time; what has not ended is no part of the ends.
    let turns = app.get("/jobs?order=turn").json();
    let ids = |page: &Value| -> Vec<String> {
        page["items"].as_array().unwrap().iter().map(|job| job["id"].as_str().unwrap().to_owned()).collect()
    };
    let one = app.get("/jobs?order=turn&page_size=2").json();
    let other = app
        .get(&format!("/jobs?order=turn&page_size=2&page_token={}", one["next_page_token"].as_str().unwrap()))
        .json();
    assert_eq!(ids(&turns).len(), 3);
    assert_eq!([ids(&one), ids(&other)].concat(), ids(&turns));
    assert_eq!((list("order=ended"), list("order=turn&state=queued&system=room/2")), (0, 2));
    app.get("/jobs?order=ended&state=running").problem(422, "invalid-request");
    assert_eq!(
        app.get("/jobs/counts").json(),
        json!({"queued": 3, "running": 1, "succeeded": 0, "failed": 0, "cancelled": 0})
    );

    for job in [&blocker, beside["id"].as_str().unwrap()] {
        app.post(&format!("/jobs/{job}/cancel")).expect(200);
    }
    assert_eq!(app.ended(first["id"].as_str().unwrap())["state"], "succeeded");
    let ends = app.get("/jobs?order=ended").json();
    // As instants: texts have as many digits as they need.
    let ended_at = |job: &Value| job["ended_at"].as_str().unwrap().parse::<jiff::Timestamp>().unwrap();
    let times: Vec<jiff::Timestamp> = ends["items"].as_array().unwrap().iter().map(ended_at).collect();
    assert!(times.len() > 2 && times.windows(2).all(|pair| pair[0] >= pair[1]), "{times:?}");
}

#[test]
fn a_hundred_equal_posts_make_one_job() {
    let (app, blocker) = blocked(&["1", "2"]);
    let body = quick("room/2");
    let post = || app.json("POST", "/jobs", &body);
    let ten_posts = || (0..10).map(|_| post()).collect::<Vec<_>>();
    let answers: Vec<(u16, String)> = std::thread::scope(|scope| {
        let clients: Vec<_> = (0..10).map(|_| scope.spawn(ten_posts)).collect();
        let answers = clients.into_iter().flat_map(|client| client.join().unwrap());
        answers.map(|answer| (answer.status, answer.json()["id"].as_str().unwrap().to_owned())).collect()
    });
    assert_eq!(answers.len(), 100);
    assert_eq!(answers.iter().filter(|(status, _)| *status == 202).count(), 1, "one post made it");
    assert!(
        answers.iter().all(|(status, id)| (*status == 202 || *status == 200) && *id == answers[0].1),
        "{answers:?}"
    );
    let jobs = app.get("/jobs?system=room/2").expect(200).json();
    assert_eq!(jobs["items"].as_array().unwrap().len(), 1, "{jobs}");
    app.post(&format!("/jobs/{blocker}/cancel")).expect(200);
    let ended = app.ended(&answers[0].1);
    assert_eq!((&ended["state"], &ended["attempt"]), (&json!("succeeded"), &json!(1)), "{ended}");
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
    assert_eq!(
        (again.json()["id"].as_str(), again.header("idempotency-replayed")),
        (Some(id.as_str()), "true")
    );
    let other = seeded(quick("room/1"), 7);
    post("a", &other).problem(422, "idempotency-key-reused");
    assert_ne!(post("b", &quick("room/1")).expect(202).json()["id"], id.as_str());

    let batch = json!({"kind": "recalibrate", "systems": ["room/*"]});
    let made = post("c", &batch).expect(202).json();
    assert_eq!(post("c", &batch).expect(202).json()["id"], made["id"]);
    let model = json!({"effect": "constant_gain"});
    let effect =
        |key: &str| app.json_with("POST", "/models/rc2/effects", &[("idempotency-key", key)], &model);
    effect("d").expect(201);
    effect("d").expect(200);
    effect("a").problem(422, "idempotency-key-reused");
}

#[test]
fn a_cancelled_job_stops() {
    let app = TestApp::start();
    app.room("1", 1);
    let job =
        app.json("POST", "/jobs", &endless("room/1")).expect(202).json()["id"].as_str().unwrap().to_owned();
    app.until(&format!("/jobs/{job}"), |job| job["progress"]["evaluations"].as_u64().unwrap_or(0) > 0);
    let start = Instant::now();
    app.post(&format!("/jobs/{job}/cancel")).expect(200);
    let ended = app.ended(&job);
    println!("cancelled within {:?} (target 0.5 s)", start.elapsed());
    assert_eq!((ended["state"].as_str(), ended["fit"].is_null()), (Some("cancelled"), true));
    assert_eq!(
        app.post(&format!("/jobs/{job}/cancel")).expect(200).json()["state"],
        "cancelled",
        "twice is harmless"
    );
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
    assert_eq!(
        (ended["state"].as_str(), ended["stopped_by"].as_str()),
        (Some("succeeded"), Some("deadline")),
        "{ended}"
    );
    assert!(ended["wall_s"].as_f64().unwrap() < 3.0, "{ended}");
    // What it has may be good, and nobody knows it.
    assert!(["held", "rejected"].contains(&ended["outcome"].as_str().unwrap()), "{ended}");
    let fit = app.get(&format!("/fits/{}", ended["fit"].as_str().unwrap())).json();
    let repeat =
        fit["checks"].as_array().unwrap().iter().find(|check| check["name"] == "G7 repeat").cloned().unwrap();
    assert_eq!((&repeat["pass"], &repeat["severity"]), (&json!(false), &json!("hold")), "{repeat}");
    app.get("/params/room/1").problem(404, "no-validated-parameters");
}

#[test]
fn a_full_queue_says_so() {
    let app = TestApp::with(|settings| {
        settings.workers = 1;
        settings.limits.queue = 2;
    });
    app.room("1", 1);
    let post = |seed: u64| {
        let body = seeded(endless("room/1"), seed);
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
    let blocker =
        app.json("POST", "/jobs", &endless("room/1")).expect(202).json()["id"].as_str().unwrap().to_owned();
    app.until(&format!("/jobs/{blocker}"), |job| job["state"] == "running");
    let crowd: Vec<String> = (0..6)
        .map(|seed| {
            app.estimate(
                "room/1",
                json!({"method": {"name": "lm_multistart", "seed": seed}, "budget": {"evaluations": 50}}),
            )
        })
        .collect();
    let single = app.estimate("room/2", json!({"budget": {"evaluations": 50}}));
    app.post(&format!("/jobs/{blocker}/cancel")).expect(200);
    let started =
        |job: &str| app.ended(job)["started_at"].as_str().unwrap().parse::<jiff::Timestamp>().unwrap();
    let single = started(&single);
    let before = crowd.iter().filter(|job| started(job) < single).count();
    assert!(before <= 1, "{before} jobs of the other system went first");
}

/// Holds the only worker until it is called off.
fn blocked(rooms: &[&str]) -> (TestApp, String) {
    let app = TestApp::with(|settings| settings.workers = 1);
    rooms.iter().for_each(|room| app.room(room, 1));
    let blocker = app.post_job(&endless(&format!("room/{}", rooms[0])));
    app.until(&format!("/jobs/{blocker}"), |job| job["state"] == "running");
    (app, blocker)
}

/// A small job, with more fields.
fn small(system: &str, more: &Value) -> Value {
    let mut body = quick(system);
    body["budget"]["evaluations"] = json!(50);
    body.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
    body
}

/// The jobs in the order in which they were started.
fn order<'a>(app: &TestApp, mut jobs: Vec<&'a str>) -> Vec<&'a str> {
    jobs.sort_by_key(|job| {
        app.ended(job)["started_at"].as_str().unwrap().parse::<jiff::Timestamp>().unwrap()
    });
    jobs
}

#[test]
fn a_page_goes_before_an_operator_and_an_operator_before_the_night() {
    let (app, blocker) = blocked(&["1", "2", "3", "4", "5", "6"]);
    let post = |system: &str, priority: &str| app.post_job(&small(system, &json!({"priority": priority})));
    let batch = json!({"kind": "recalibrate", "systems": ["room/2", "room/3"], "priority": "nightly", "budget": {"evaluations": 50},
                       "split": {"train": "P9D", "validation": "P5D"}});
    let night = app.json("POST", "/jobs", &batch).expect(202).json()["jobs"].clone();
    let night: Vec<&str> = night.as_array().unwrap().iter().map(|job| job["job"].as_str().unwrap()).collect();
    let operator = app.post_job(&small("room/4", &json!({})));
    let page = post("room/5", "interactive");
    let crowd = app.post_job(&small(
        "room/5",
        &json!({"priority": "interactive", "method": {"name": "lm_multistart", "seed": 2}}),
    ));
    let other = post("room/6", "interactive");
    let shown = |job: &str| app.get(&format!("/jobs/{job}")).json()["priority"].clone();
    assert_eq!(
        (shown(&page), shown(&operator), shown(night[0])),
        (json!("interactive"), json!("operator"), json!("nightly"))
    );
    app.post(&format!("/jobs/{blocker}/cancel")).expect(200);
    let all: Vec<&str> = night.iter().copied().chain([operator.as_str(), &crowd, &other, &page]).collect();
    // Pages of two systems take turns: the second job of one waits for the first of the other.
    assert_eq!(order(&app, all), [&page, &other, &crowd, &operator, night[0], night[1]]);
}

#[test]
fn an_equal_job_that_waits_is_moved_up_and_never_down() {
    let (app, blocker) = blocked(&["1", "2", "3"]);
    let night = app.post_job(&small("room/2", &json!({"priority": "nightly"})));
    let operator = app.post_job(&small("room/3", &json!({})));
    let again =
        app.json("POST", "/jobs", &small("room/2", &json!({"priority": "interactive"}))).expect(200).json();
    assert_eq!(
        (again["id"].as_str(), again["priority"].as_str()),
        (Some(night.as_str()), Some("interactive"))
    );
    let again =
        app.json("POST", "/jobs", &small("room/2", &json!({"priority": "nightly"}))).expect(200).json();
    assert_eq!(
        (again["id"].as_str(), again["priority"].as_str()),
        (Some(night.as_str()), Some("interactive"))
    );
    app.post(&format!("/jobs/{blocker}/cancel")).expect(200);
    assert_eq!(order(&app, vec![&operator, &night]), [&night, &operator]);
    let problem = app
        .json("POST", "/jobs", &small("room/2", &json!({"priority": "nightli", "experiment": 1})))
        .problem(422, "invalid-request");
    let faults: Vec<&str> = problem["errors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|fault| fault["pointer"].as_str().unwrap())
        .collect();
    assert_eq!(faults, ["/experiment", "/priority"], "{problem}");
    let schedule =
        json!({"cron": "0 4 * * *", "systems": ["room/*"], "request": {"priority": "interactive"}});
    app.json("PUT", "/schedules/odd", &schedule).problem(422, "invalid-request");
}

#[test]
fn a_job_that_has_ended_can_be_done_again() {
    let (app, blocker) = blocked(&["1", "2"]);
    let waiting = app.post_job(&small("room/2", &json!({"experiment": true, "priority": "nightly"})));
    for job in [&blocker, &waiting] {
        app.post(&format!("/jobs/{job}/retry")).problem(409, "job-not-finished");
    }
    app.post("/jobs/job_none/retry").problem(404, "job-not-found");
    app.post(&format!("/jobs/{waiting}/cancel")).expect(200);
    let answer = app.post(&format!("/jobs/{waiting}/retry")).expect(202);
    let again = answer.json();
    assert_eq!(answer.header("location"), format!("/jobs/{}", again["id"].as_str().unwrap()));
    let old = app.get(&format!("/jobs/{waiting}")).json();
    for field in ["kind", "system", "model", "request", "experiment"] {
        assert_eq!(again[field], old[field], "{field}");
    }
    assert_eq!(
        (&again["retry_of"], &again["priority"], &old["retry_of"]),
        (&json!(waiting), &json!("operator"), &Value::Null)
    );
    assert_ne!(again["id"], old["id"]);
    assert_eq!(
        app.post(&format!("/jobs/{waiting}/retry")).expect(200).json()["id"],
        again["id"],
        "equal jobs wait once"
    );

    app.post(&format!("/jobs/{blocker}/cancel")).expect(200);
    let first = app.ended(again["id"].as_str().unwrap());
    assert_eq!(first["state"], "succeeded", "{first}");
    // A key makes one job of two requests; the retry of a retry names what it repeats.
    let retry = || {
        app.send(
            "POST",
            &format!("/jobs/{}/retry", first["id"].as_str().unwrap()),
            &[("idempotency-key", "r")],
            Some(b""),
        )
        .unwrap()
    };
    let second = retry().expect(202).json();
    assert_eq!(second["retry_of"], first["id"]);
    let ended = app.ended(second["id"].as_str().unwrap());
    assert_eq!(ended["evaluations"], first["evaluations"], "the same request and seed, the same search");
    let replayed = retry().expect(202);
    assert_eq!((&replayed.json()["id"], replayed.header("idempotency-replayed")), (&second["id"], "true"));
    app.send("POST", &format!("/jobs/{waiting}/retry"), &[("idempotency-key", "r")], Some(b""))
        .unwrap()
        .problem(422, "idempotency-key-reused");
}

#[test]
fn early_stopping_is_asked_for_in_the_request() {
    let app = TestApp::start();
    app.room("1", 1);
    let method = json!({"name": "cfa_thesis", "seed": 1, "n": 12, "n_min": 6, "generations": 1000});
    let more = json!({
        "method": method, "budget": {"evaluations": 50_000},
        "early_stopping": {"patience": 8, "min_delta": 0.05}
    });
    let job = app.ended(&app.estimate("room/1", more));
    assert_eq!(
        (job["state"].as_str(), job["stopped_by"].as_str()),
        (Some("succeeded"), Some("stalled")),
        "{job}"
    );
    assert!(job["evaluations"].as_u64().unwrap() < 20_000, "{job}");
    assert_eq!(
        job["request"]["early_stopping"],
        json!({"patience": 8, "min_delta": 0.05, "validation": false})
    );

    let mut bad = quick("room/1");
    bad["early_stopping"] = json!({"patience": 0, "min_delta": 2});
    let problem = app.json("POST", "/jobs", &bad).problem(422, "invalid-request");
    let pointers: Vec<&str> = problem["errors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|fault| fault["pointer"].as_str().unwrap())
        .collect();
    assert_eq!(pointers, ["/early_stopping/patience", "/early_stopping/min_delta"]);
    bad["early_stopping"] = json!({"patients": 3});
    let problem = app.json("POST", "/jobs", &bad).problem(422, "invalid-request");
    assert_eq!(problem["errors"][0]["suggestion"], "did you mean `patience`?");
}
