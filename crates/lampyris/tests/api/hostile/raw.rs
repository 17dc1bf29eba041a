//! Bodies that are no documents at all.

use crate::support::TestApp;
use serde_json::{Value, json};

/// Every path that takes a JSON document.
const JSON_PATHS: [(&str, &str); 8] = [
    ("POST", "/jobs"),
    ("POST", "/models"),
    ("POST", "/models/validate"),
    ("POST", "/models/rc2/effects"),
    ("POST", "/effects"),
    ("PUT", "/systems/room/9"),
    ("PUT", "/schedules/odd"),
    ("POST", "/systems/room/3/windows"),
];

/// Sends every text to every path; gives how many there were.
pub fn check(app: &TestApp) -> usize {
    let deep = |open: &str, close: &str, depth: usize| {
        format!("{}1{}", open.repeat(depth), close.repeat(depth)).into_bytes()
    };
    let malformed: Vec<Vec<u8>> = vec![
        b"".to_vec(),
        b"{".to_vec(),
        b"{\"a\": 1,}".to_vec(),
        b"{\"a\": NaN}".to_vec(),
        b"{\"a\": -Infinity}".to_vec(),
        b"{\"a\": 1e999}".to_vec(),
        b"{'a': 1}".to_vec(),
        b"{\"a\": \"\xff\xfe\"}".to_vec(),
        b"{\"a\": \"\\ud800\"}".to_vec(),
        b"{} {}".to_vec(),
        b"// nothing\n{}".to_vec(),
        deep("[", "]", 5_000),
        deep("{\"a\":", "}", 5_000),
    ];
    let mut count = 0;
    for (method, path) in JSON_PATHS {
        let send = |media_type: &str, body: &[u8]| {
            app.send(method, path, &[("content-type", media_type)], Some(body)).unwrap()
        };
        for body in &malformed {
            let problem = send("application/json", body).problem(400, "malformed-body");
            assert!(
                problem["errors"][0]["detail"].as_str().unwrap().contains("line"),
                "{method} {path}: {problem}"
            );
            count += 1;
        }
        let twice = send(
            "application/json",
            b"{\"model\": \"rc2\", \"time\": [1], \"time\": [2], \"model\": \"rc3\"}",
        )
        .problem(422, "invalid-request");
        let pointers: Vec<&Value> =
            twice["errors"].as_array().unwrap().iter().map(|fault| &fault["pointer"]).collect();
        assert_eq!(pointers, ["/time", "/model"], "{method} {path}");
        for value in [json!([]), json!(null), json!("rc2"), json!(7)] {
            let problem =
                send("application/json", value.to_string().as_bytes()).problem(422, "invalid-request");
            assert_eq!(problem["errors"][0]["pointer"], "", "{method} {path} {value}: {problem}");
            count += 1;
        }
        for media_type in ["text/plain", "application/xml", "application/x-www-form-urlencoded", ""] {
            send(media_type, b"{}").problem(415, "unsupported-media-type");
            count += 1;
        }
        // Windows may be larger than other documents; the test sets their limit to 200,000 bytes.
        let limit = if path.ends_with("/windows") { 200_000 } else { 1 << 20 };
        let mut large = b"{\"label\": \"".to_vec();
        large.resize(limit + 1, b'x');
        assert_eq!(send("application/json", &large).problem(413, "body-too-large")["limit"], limit);
        app.send(method, &format!("{path}?x=1&y=2"), &[("content-type", "application/json")], Some(b"{}"))
            .unwrap()
            .problem(422, "invalid-request");
        let key = "k".repeat(256);
        let headers = [("content-type", "application/json"), ("idempotency-key", key.as_str())];
        app.send(method, path, &headers, Some(b"{}")).unwrap().problem(422, "invalid-request");
        count += 4;
    }
    let csv = |body: &[u8]| {
        app.send("POST", "/systems/room/3/windows", &[("content-type", "text/csv")], Some(body)).unwrap()
    };
    for body in [
        &b"time,T_room\n\xff\xfe"[..],
        b"",
        b"\0\0\0",
        b"time,T_room\n\"2026",
        b"time\n2026-01-01T00:00:00Z\n",
        b",,,\n,,,\n",
    ] {
        csv(body).problem(422, "invalid-request");
        count += 1;
    }
    csv(&vec![b'x'; 200_001]).problem(413, "body-too-large");
    // A pipe at the end of an import, not a body of measurements.
    for path in ["/jobs/job_none/cancel", "/schedules/none/run"] {
        let answer =
            app.send("POST", path, &[("content-type", "application/json")], Some(b"{\"a\": 1}")).unwrap();
        assert_eq!(answer.problem(422, "invalid-request")["errors"][0]["code"], "unexpected-body");
        count += 1;
    }
    count + 1
}
