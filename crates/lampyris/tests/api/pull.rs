//! Measurements that are fetched from a Prometheus: one that is played by a thread, which answers as the real
//! one does.

use crate::support::TestApp;
use jiff::{SignedDuration, Timestamp};
use lampyris::store::tokens::Scope;
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::sync::mpsc::{Receiver, channel};

/// Answers every question with one value a minute for two series, and tells the questions.
fn prometheus() -> (String, Receiver<String>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    let (asked, questions) = channel();
    std::thread::spawn(move || {
        for stream in listener.incoming() {
            let mut stream = stream.unwrap();
            let mut lines = BufReader::new(stream.try_clone().unwrap()).lines().map_while(Result::ok);
            let line = lines.next().unwrap_or_default();
            let _ = lines.by_ref().take_while(|line| !line.is_empty()).count();
            let field = |name: &str| -> f64 {
                let from = line.split(&format!("{name}=")).nth(1).unwrap_or_default();
                from.split(['&', ' ']).next().unwrap_or_default().parse().unwrap_or(f64::NAN)
            };
            let (start, end, step) = (field("start"), field("end"), field("step"));
            let values: Vec<Value> = (0..=((end - start) / step) as usize)
                .map(|k| json!([start + step * k as f64, format!("{}", 20.0 + 0.1 * (k % 7) as f64)]))
                .collect();
            let series =
                |room: &str| json!({"metric": {"__name__": "room_celsius", "room": room}, "values": values});
            let body = match line.contains("broken") {
                true => json!({"status": "error", "errorType": "bad_data", "error": "no such thing"}),
                false => json!({"status": "success",
                    "data": {"resultType": "matrix", "result": [series("1"), series("attic")]}}),
            }
            .to_string();
            let _ = write!(
                stream,
                "HTTP/1.1 200 OK\r\ncontent-type: application/json\r\ncontent-length: {}\r\nconnection: \
                close\r\n\r\n{body}",
                body.len()
            );
            if asked.send(line).is_err() {
                return;
            }
        }
    });
    (address, questions)
}

fn source(url: &str, query: &str) -> Value {
    json!({"url": url, "queries": [query], "lookback": "PT2H", "rules": [
        {"measurement": "room_celsius", "tags": {"room": "{room}"}, "system": "room/{room}",
         "channel": "T_room"}
    ]})
}

#[test]
fn series_become_live_samples_and_only_what_is_new_is_asked() {
    let app = TestApp::by_the_clock();
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    let (url, questions) = prometheus();
    let shown =
        app.json("PUT", "/sources/prometheus", &source(&url, "room_celsius{floor=\"1\"}")).expect(200).json();
    assert_eq!(shown["source"]["every"], "PT1M", "{shown}");
    let first = questions.recv().unwrap();
    assert!(first.contains("/api/v1/query_range?query=room_celsius%7Bfloor%3D%221%22%7D&"), "{first}");
    let state =
        app.until("/sources/prometheus", |state| state["latest"]["error"].is_null() && state["taken"] != 0);
    // Two hours of minutes of the room that is there; the attic is not.
    assert!([120, 121].map(Value::from).contains(&state["taken"]), "{state}");
    assert_eq!(state["latest_untaken"][0]["tags"]["room"], "attic", "{state}");
    let series = app.get("/systems/room/1/series?channels=T_room").expect(200).json();
    let samples = series["channels"]["T_room"]["samples"].as_u64().unwrap();
    assert_eq!(Value::from(samples), state["taken"]);
    let newest: Timestamp = series["to"].as_str().unwrap().parse().unwrap();
    assert!(Timestamp::now().duration_since(newest) < SignedDuration::from_mins(3), "{newest}");

    // A change asks at once, and a failure is told.
    app.json("PUT", "/sources/prometheus", &source(&url, "broken")).expect(200);
    let state = app.until("/sources/prometheus", |state| state["latest"]["error"].is_string());
    assert!(state["latest"]["error"].as_str().unwrap().contains("no such thing"), "{state}");
    app.json("PUT", "/sources/prometheus", &source("http://127.0.0.1:9", "x")).expect(200);
    app.until("/sources/prometheus", |state| {
        state["latest"]["error"].as_str().is_some_and(|said| !said.contains("no such thing"))
    });
    let faults =
        app.json("PUT", "/sources/prometheus", &source("ftp://x", "")).problem(422, "invalid-request");
    assert_eq!(faults["errors"].as_array().unwrap().len(), 2, "{faults}");
    // Whom the service asks is for an administrator to say.
    let operator = app.token("operator", Scope::Operate, &[]);
    operator.json("PUT", "/sources/prometheus", &source(&url, "x")).problem(403, "insufficient-scope");
}
