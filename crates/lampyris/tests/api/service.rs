//! The service about itself: health, figures, description.

use crate::support::rooms::stuck_csv;
use crate::support::{TestApp, endless, quick};
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// The samples of the figures: a name with its labels, and the value.
fn figures(app: &TestApp) -> BTreeMap<String, f64> {
    let answer = app.get("/metrics").expect(200);
    assert!(answer.header("content-type").starts_with("text/plain; version=0.0.4"));
    let mut typed = Vec::new();
    let mut samples = BTreeMap::new();
    for line in answer.text.lines() {
        if let Some(family) = line.strip_prefix("# TYPE ") {
            typed.push(family.split(' ').next().unwrap());
        } else if !line.starts_with('#') {
            let (name, value) = line.rsplit_once(' ').unwrap();
            let plain = name.split('{').next().unwrap();
            let family =
                ["_bucket", "_sum", "_count"].iter().find_map(|end| plain.strip_suffix(end)).unwrap_or(plain);
            assert!(
                typed.contains(&plain) || typed.last() == Some(&family),
                "{name} stands outside of its family"
            );
            assert!(samples.insert(name.to_owned(), value.parse().unwrap()).is_none(), "{name} twice");
        }
    }
    samples
}

#[test]
fn the_figures_follow_what_happens() {
    let app = TestApp::with(|settings| settings.workers = 1);
    let before = figures(&app);
    assert_eq!(
        (before["lampyris_workers"], before["lampyris_database_writable"], before["lampyris_boot"]),
        (1.0, 1.0, 1.0)
    );
    assert_eq!(before[&format!("lampyris_build_info{{version=\"{}\"}}", env!("CARGO_PKG_VERSION"))], 1.0);
    assert_eq!(
        (before["lampyris_jobs{state=\"queued\"}"], before["lampyris_job_duration_seconds_count"]),
        (0.0, 0.0)
    );

    app.room("1", 1);
    app.room("2", 1);
    let done = app.ended(&app.estimate("room/1", json!({})));
    assert_eq!(done["outcome"], "accepted");
    let failed = app.ended(&app.failing("room/2", json!({})));
    assert_eq!(failed["state"], "failed");
    let etag = app.get("/params/room/1").expect(200).header("etag").to_owned();
    app.get_with("/params/room/1", &[("if-none-match", &etag)]).expect(304);
    app.get("/params/room/9").expect(404);
    app.get("/nothing").expect(404);
    let running = app.post_job(&endless("room/1"));
    app.until(&format!("/jobs/{running}"), |job| job["state"] == "running");
    app.post_job(&quick("room/2"));
    let stream = app.listen("/events", "");

    // The last start and the last end are counted when listeners are told, which may be a moment after the
    // jobs say so.
    let ended = |figures: &BTreeMap<String, f64>| {
        figures.get("lampyris_jobs_ended_total{kind=\"estimate\",outcome=\"failed\"}").copied()
    };
    let mut now = figures(&app);
    while ended(&now).is_none()
        || now["lampyris_event_listeners"] < 1.0
        || now["lampyris_queue_wait_seconds_count"] < 3.0
    {
        now = figures(&app);
    }
    drop(stream);
    let expected = [
        ("lampyris_jobs{state=\"queued\"}", 1.0),
        ("lampyris_jobs{state=\"running\"}", 1.0),
        ("lampyris_jobs_ended_total{kind=\"estimate\",outcome=\"accepted\"}", 1.0),
        ("lampyris_jobs_ended_total{kind=\"estimate\",outcome=\"failed\"}", 1.0),
        ("lampyris_jobs_failed_total{code=\"diverged\"}", 1.0),
        ("lampyris_job_duration_seconds_count", 2.0),
        ("lampyris_job_duration_seconds_bucket{le=\"+Inf\"}", 2.0),
        ("lampyris_queue_wait_seconds_count", 3.0),
        ("lampyris_evaluations_total", done["evaluations"].as_f64().unwrap()),
        ("lampyris_systems{status=\"fresh\"}", 1.0),
        ("lampyris_systems{status=\"none\"}", 1.0),
        ("lampyris_params_status{system=\"room/1\",status=\"fresh\"}", 1.0),
        ("lampyris_params_status{system=\"room/1\",status=\"fallback\"}", 0.0),
        ("lampyris_fallbacks_total", 0.0),
        ("http_requests_total{method=\"GET\",route=\"/params/{kind}/{id}\",code=\"200\"}", 1.0),
        ("http_requests_total{method=\"GET\",route=\"/params/{kind}/{id}\",code=\"304\"}", 1.0),
        ("http_requests_total{method=\"GET\",route=\"/params/{kind}/{id}\",code=\"404\"}", 1.0),
        ("http_requests_total{method=\"POST\",route=\"/jobs\",code=\"202\"}", 4.0),
        ("http_request_duration_seconds_count{route=\"/jobs\",code=\"202\"}", 4.0),
        ("http_request_duration_seconds_bucket{route=\"/jobs\",code=\"202\",le=\"+Inf\"}", 4.0),
    ];
    for (name, value) in expected {
        assert_eq!(now.get(name), Some(&value), "{name} in {now:#?}");
    }
    assert!(now.contains_key("lampyris_database_busy_total"), "{now:#?}");
    let params = app.get("/params/room/1").json();
    assert_eq!(
        Some(now["lampyris_fit_rmse{system=\"room/1\",output=\"T_room\",split=\"train\"}"]),
        params["error"]["T_room"]["train_rmse"].as_f64()
    );
    assert!(now["lampyris_params_age_seconds{system=\"room/1\"}"] < 120.0);
    assert!(
        !now.keys().any(|name| name.contains("room/9") || name.contains("nothing")),
        "paths as they come are no labels"
    );
    app.post(&format!("/jobs/{running}/cancel")).expect(200);
}

#[test]
fn a_refused_fit_counts_the_checks_that_it_failed() {
    let app = TestApp::start();
    app.room("1", 1);
    app.csv("/systems/room/1/windows", &stuck_csv()).expect(201);
    let ended = app.ended(&app.estimate("room/1", json!({})));
    assert_eq!(ended["outcome"], "rejected", "{ended}");
    let fit = app.get(&format!("/fits/{}", ended["fit"].as_str().unwrap())).json();
    let failed = |check: &&Value| check["pass"] == false && check["severity"] != "flag";
    let names: Vec<&str> = fit["checks"]
        .as_array()
        .unwrap()
        .iter()
        .filter(failed)
        .map(|check| check["name"].as_str().unwrap())
        .collect();
    assert!(!names.is_empty());
    let now = figures(&app);
    for name in names {
        assert_eq!(
            now.get(&format!("lampyris_gate_failed_total{{check=\"{name}\"}}")),
            Some(&1.0),
            "{name} in {now:#?}"
        );
    }
}

#[test]
fn readiness_names_what_it_rests_on() {
    let app = TestApp::start();
    let ready = app.get("/readyz").expect(200).json();
    assert_eq!(
        ready,
        json!({
            "ready": true, "database": "writable", "why": null, "queue": "alive", "workers": 2,
            "parameters": "loaded",
        })
    );
    // Another hand takes a table away: the database can no longer be written as this service writes it.
    app.behind("ALTER TABLE counters RENAME TO gone").unwrap();
    let ready = app.get("/readyz").expect(503).json();
    assert_eq!(
        (&ready["ready"], &ready["database"], &ready["queue"]),
        (&json!(false), &json!("unavailable"), &json!("alive"))
    );
    assert_eq!(app.get("/healthz").expect(200).text, "ok\n", "the process lives");
    assert_eq!(figures(&app)["lampyris_database_writable"], 0.0);
}

#[test]
fn the_description_is_a_page_that_asks_nobody_else() {
    let app = TestApp::start();
    let page = app.get("/docs").expect(200);
    assert!(page.header("content-type").starts_with("text/html"));
    let policy = page.header("content-security-policy");
    assert!(
        policy.contains("default-src 'none'") && !policy.contains("unsafe") && !policy.contains("http"),
        "{policy}"
    );
    let mut bytes = page.text.len();
    for (name, kind) in [("docs.js", "text/javascript"), ("docs.css", "text/css")] {
        assert!(page.text.contains(&format!("docs/{name}")));
        let part = app.get(&format!("/docs/{name}")).expect(200);
        assert!(part.header("content-type").starts_with(kind));
        assert!(!part.text.contains("://"), "{name} names another place");
        bytes += part.text.len();
    }
    assert!(!page.text.contains("://") && bytes < 30_000, "{bytes} bytes");
    app.get("/docs/other.js").problem(404, "file-not-found");
    app.get("/docs/..%2Fdocs%2Fdocs.js").problem(404, "file-not-found");
    // The page reads this form; it says what the other one says.
    let json = app.get("/openapi.json").expect(200).json();
    let paths: Vec<String> = lampyris::http::described_paths().into_iter().map(|(path, _)| path).collect();
    assert_eq!(json["paths"].as_object().unwrap().keys().cloned().collect::<Vec<_>>(), paths);
}
