//! Every refusal is a problem document that lists all faults at once.

use crate::support::TestApp;
use crate::support::cluster;
use serde_json::{Value, json};
use std::io::{Read, Write};

fn pointers(problem: &Value) -> Vec<String> {
    let mut pointers: Vec<String> = problem["errors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|fault| fault["pointer"].as_str().unwrap().to_owned())
        .collect();
    pointers.sort();
    pointers
}

#[test]
fn all_faults_of_a_job_are_listed() {
    let app = TestApp::start();
    app.room("1", 1);
    let body = json!({
        "kind": "estimate", "system": "room 1", "experiment": "no", "modle": "rc2", "method": {"seed": -1},
        "split": {"train": "21 days", "validation": "P7D"}, "objective": "sme",
        "budget": {"evaluations": 10, "walls": "PT1M"},
        "bounds": {"alpha_e": [1.0]}, "window": {"from": "yesterday"},
    });
    let problem = app.json("POST", "/jobs", &body).problem(422, "invalid-request");
    let expected = [
        "/bounds/alpha_e",
        "/budget/walls",
        "/experiment",
        "/method/seed",
        "/modle",
        "/objective",
        "/split/train",
        "/system",
        "/window/from",
    ];
    assert_eq!(pointers(&problem), expected, "{problem}");
    let of = |pointer: &str| {
        problem["errors"]
            .as_array()
            .unwrap()
            .iter()
            .find(|fault| fault["pointer"] == pointer)
            .unwrap()
            .clone()
    };
    assert_eq!(of("/modle")["suggestion"], "did you mean `model`?");
    assert_eq!(of("/objective")["suggestion"], "did you mean `mse`?");

    let problem = app
        .json(
            "POST",
            "/jobs",
            &json!({"kind": "estimate", "system": "room/2", "window": {"from": "yesterday"}}),
        )
        .problem(422, "invalid-request");
    assert_eq!(pointers(&problem), ["/system", "/window/from"]);
    let problem = app
        .json("POST", "/jobs", &json!({"kind": "estimate", "system": "room/2"}))
        .problem(422, "invalid-request");
    assert_eq!(problem["errors"][0]["suggestion"], "did you mean `room/1`?");
    let problem = app
        .json("POST", "/jobs", &json!({"kind": "estimate", "system": "room/1", "model": "room22"}))
        .problem(422, "invalid-request");
    assert_eq!(
        (problem["errors"][0]["pointer"].as_str(), problem["errors"][0]["suggestion"].as_str()),
        (Some("/model"), Some("did you mean `room2`?"))
    );
    // Methods and objectives that there are not: the fault lists those that there are.
    for (field, value, known) in [
        (
            "method",
            json!({"name": "annealing"}),
            "`cfa`, `cfa_thesis`, `cfa_hierarchical`, `lm_multistart`, `ctsm`",
        ),
        ("method", json!({"name": "bfgs", "seed": 3}), "`fa`, `fa_modified`, `grid`, `lshade`, `pso`, `ga`"),
        ("objective", json!("mae"), "`mse`, `swmse`, `nmse`, `likelihood`"),
    ] {
        let problem = app
            .json("POST", "/jobs", &json!({"kind": "estimate", "system": "room/1", field: value}))
            .problem(422, "invalid-request");
        let fault = &problem["errors"][0];
        let pointer = if field == "method" { "/method/name" } else { "/objective" };
        assert_eq!(
            (fault["pointer"].as_str(), fault["code"].as_str()),
            (Some(pointer), Some("unknown-value")),
            "{problem}"
        );
        assert!(fault["detail"].as_str().unwrap().contains(known), "{problem}");
    }
    let problem = app
        .json("POST", "/jobs", &json!({"kind": "estimat", "system": "room/1"}))
        .problem(422, "invalid-request");
    assert_eq!(problem["errors"][0]["suggestion"], "did you mean `estimate`?");
    assert_eq!(app.get("/jobs").json()["items"], json!([]), "nothing of this was taken");
}

#[test]
fn all_faults_of_a_system_and_a_schedule_are_listed() {
    let app = TestApp::start();
    let body = json!({
        "model": "room9", "location": {"lat": 91, "lon": 10, "zone": "Mars/Olympus"},
        "neighbours": ["room/1", "room/1"],
        "policy": {"stale_after": "P0D"},
        "exclude": [{"from": "2026-02-01T00:00:00Z", "to": "2026-01-01T00:00:00Z"}],
    });
    let problem = app.json("PUT", "/systems/room/1", &body).problem(422, "invalid-request");
    let expected = [
        "/exclude/0",
        "/location/lat",
        "/location/zone",
        "/model",
        "/neighbours/0",
        "/neighbours/1",
        "/neighbours/1",
        "/policy/stale_after",
    ];
    assert_eq!(pointers(&problem), expected, "{problem}");
    app.get("/systems/room/1").problem(404, "system-not-found");
    app.json("PUT", "/systems/Room/1", &json!({"model": "rc2"})).problem(422, "invalid-request");

    let body =
        json!({"cron": "61 * * * *", "zone": "Mars/Olympus", "systems": ["room/*"], "request": {"sede": 1}});
    let problem = app.json("PUT", "/schedules/odd", &body).problem(422, "invalid-request");
    assert_eq!(pointers(&problem), ["/cron", "/request/sede", "/zone"], "{problem}");
}

#[test]
fn all_faults_of_a_window_are_listed() {
    let app = TestApp::start();
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    let problem = app
        .csv("/systems/room/1/windows", "when,T_room[furlong],T_out[kW]\nat noon,1,2\n")
        .problem(422, "invalid-request");
    assert!(problem["errors"].as_array().unwrap().len() >= 3, "{problem}");
    app.csv("/systems/room/9/windows", "time,T_room\n").problem(404, "system-not-found");
    assert_eq!(app.get("/systems/room/1/windows").json()["items"], json!([]));
}

#[test]
fn paths_methods_types_and_sizes_are_refused_with_a_problem() {
    let app = TestApp::with(|settings| settings.limits.body_bytes = 2048);
    app.get("/nothing/here").problem(404, "not-found");
    app.get("/systems/room").problem(404, "not-found");
    app.get("/windows/win_x").problem(404, "window-not-found");
    app.get("/jobs/job_x").problem(404, "job-not-found");
    app.get("/jobs/job_x/events").problem(404, "job-not-found");
    app.get("/fits/fit_x").problem(404, "fit-not-found");
    app.get("/batches/bat_x").problem(404, "batch-not-found");
    app.get("/models/nothing").problem(404, "model-not-found");
    app.get("/schedules/none").problem(404, "schedule-not-found");
    app.get("/systems/room/%2e%2e").problem(404, "system-not-found");
    let answer = app.send("DELETE", "/jobs", &[], None).unwrap();
    assert!(answer.header("allow").contains("GET"), "{:?}", answer.headers);
    answer.problem(405, "method-not-allowed");
    app.send("PUT", "/params/room/1", &[], Some(b"")).unwrap().problem(405, "method-not-allowed");
    app.send("POST", "/jobs", &[("content-type", "text/plain")], Some(b"{}"))
        .unwrap()
        .problem(415, "unsupported-media-type");
    app.send("POST", "/jobs", &[("content-type", "application/json")], Some(b"{"))
        .unwrap()
        .problem(400, "malformed-body");
    app.send("POST", "/jobs", &[("content-type", "application/json")], Some(b"[1e999]"))
        .unwrap()
        .problem(400, "malformed-body");
    app.json("POST", "/jobs", &json!([])).problem(422, "invalid-request");
    let large = app.json("POST", "/jobs", &json!({"kind": "x".repeat(4096)})).problem(413, "body-too-large");
    assert_eq!(large["limit"], 2048);
    app.get("/jobs?stat=queued").problem(422, "invalid-request");
    assert_eq!(
        app.get("/jobs?state=queud").problem(422, "invalid-request")["errors"][0]["suggestion"],
        "did you mean `queued`?"
    );
    app.get("/systems?page_size=0").problem(422, "invalid-request");
    app.get("/systems?page_size=many").problem(422, "invalid-request");
    app.json_with("POST", "/jobs", &[("idempotency-key", &"k".repeat(300))], &json!({}))
        .problem(422, "invalid-request");
    let deep = format!("{}1{}", "[".repeat(900), "]".repeat(900));
    app.send("POST", "/jobs", &[("content-type", "application/json")], Some(deep.as_bytes()))
        .unwrap()
        .problem(400, "malformed-body");
}

#[test]
fn an_endless_body_is_cut_off_at_the_limit() {
    let app = TestApp::with(|settings| settings.limits.window_bytes = 10_000);
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    let mut stream = std::net::TcpStream::connect(app.addr()).unwrap();
    stream
        .write_all(
            b"POST /systems/room/1/windows HTTP/1.1\r\nhost: localhost\r\ncontent-type: \
            text/csv\r\ntransfer-encoding: chunked\r\n\r\n",
        )
        .unwrap();
    let chunk = format!("1000\r\n{}\r\n", "x".repeat(0x1000));
    for _ in 0..1000 {
        if stream.write_all(chunk.as_bytes()).is_err() {
            break;
        }
    }
    stream.set_read_timeout(Some(std::time::Duration::from_secs(5))).unwrap();
    let mut answer = vec![0; 4096];
    // The connection may be reset under the flood; if anything was answered, it is the refusal.
    let read = stream.read(&mut answer).unwrap_or(0);
    let text = String::from_utf8_lossy(&answer[..read]);
    assert!(read == 0 || text.starts_with("HTTP/1.1 413"), "{text}");
    assert_eq!(app.get("/systems/room/1/windows").json()["items"], json!([]));
}

#[test]
fn the_service_tells_about_itself() {
    let app = TestApp::start();
    assert_eq!(app.get("/healthz").expect(200).text, "ok\n");
    let ready = app.get("/readyz").expect(200).json();
    assert_eq!((ready["ready"].as_bool(), ready["workers"].as_u64()), (Some(true), Some(2)), "{ready}");
    assert_eq!(app.get("/version").expect(200).json()["name"], "lampyris");
    assert!(app.get("/openapi.yaml").expect(200).text.contains("/params/{kind}/{id}"));
}

#[test]
fn an_address_that_others_can_reach_is_refused() {
    let dir = tempfile::tempdir().unwrap();
    let settings = lampyris::settings::Settings {
        bind: "0.0.0.0:0".parse().unwrap(),
        database: dir.path().join("test.db").into(),
        ..Default::default()
    };
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let error = runtime.block_on(lampyris::app::App::start(settings)).err().unwrap();
    assert!(error.to_string().contains("127.0.0.1"), "{error}");
}

#[test]
fn a_database_serves_one_service() {
    if cluster::is_on() {
        return;
    }
    let app = TestApp::start();
    let settings = lampyris::settings::Settings {
        bind: "127.0.0.1:0".parse().unwrap(),
        database: app.database().into(),
        ..Default::default()
    };
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let error = runtime.block_on(lampyris::app::App::start(settings)).err().unwrap();
    assert!(error.to_string().contains("another service"), "{error}");
}
