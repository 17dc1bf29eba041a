//! What holds for every path: pages, compression, keys.

use crate::support::rooms::{room_csv, stuck_csv};
use crate::support::{TestApp, quick, seeded};
use serde_json::{Value, json};

/// All items of a list, in pages of this size.
fn pages(app: &TestApp, path: &str, size: usize) -> Vec<Value> {
    let mut items = Vec::new();
    let mut token = String::new();
    loop {
        let page = app.get(&format!("{path}?page_size={size}{token}")).expect(200).json();
        let part = page["items"].as_array().unwrap();
        assert!(part.len() <= size, "{path}");
        items.extend(part.iter().cloned());
        match page["next_page_token"].as_str() {
            Some(next) => {
                assert_eq!(part.len(), size, "{path}: a page before the last one is full");
                token = format!("&page_token={next}");
            }
            None => return items,
        }
    }
}

#[test]
fn every_list_comes_page_by_page() {
    let app = TestApp::start();
    for room in ["1", "2", "3"] {
        app.room(room, 1);
        app.json(
            "PUT",
            &format!("/schedules/of_{room}"),
            &json!({"cron": "0 5 * * 1", "systems": ["room/*"], "enabled": false}),
        )
        .expect(201);
    }
    app.csv("/systems/room/1/windows", &room_csv(2, 16)).expect(201);
    for part in ["P9D", "P8D", "P7D"] {
        let split = json!({"train": part, "validation": "P5D"});
        assert_eq!(app.ended(&app.estimate("room/1", json!({"split": split})))["state"], "succeeded");
    }
    for days in ["P2D", "P3D"] {
        let short = json!({
            "kind": "diagnose", "system": "room/1", "window": {"last": days},
            "method": {"name": "lm_multistart"}
        });
        app.ended(&app.post_job(&short));
    }
    for evaluations in [100, 200] {
        let batch =
            json!({"kind": "recalibrate", "systems": ["room/2"], "budget": {"evaluations": evaluations}});
        let batch = app.json("POST", "/jobs", &batch).expect(202);
        app.until(batch.header("location"), |batch| batch["finished"] == true);
    }
    let lists = [
        ("/systems", 3),
        ("/systems/room/1/windows", 2),
        ("/models", 10),
        ("/effects", 10),
        ("/jobs", 7),
        ("/batches", 2),
        ("/fits", 7),
        ("/diagnoses", 2),
        ("/schedules", 4),
        ("/params/room/1/history", 1),
    ];
    for (path, least) in lists {
        let whole = app.get(path).expect(200).json();
        let items = whole["items"].as_array().unwrap();
        assert!(items.len() >= least && whole["next_page_token"].is_null(), "{path}: {} items", items.len());
        let ids = |items: &[Value]| -> Vec<Value> {
            let names = ["id", "name", "system", "revision"];
            items
                .iter()
                .map(|item| names.iter().find_map(|name| item.get(name)).unwrap_or(item).clone())
                .collect()
        };
        for size in [1, 2] {
            assert_eq!(ids(&pages(&app, path, size)), ids(items), "{path} by {size}");
        }
        for query in ["page_size=0", "page_size=100000", "page_size=x", "pages=1"] {
            app.get(&format!("{path}?{query}")).problem(422, "invalid-request");
        }
    }
}

#[test]
fn answers_are_compressed_but_not_those_to_the_controller() {
    let app = TestApp::start();
    app.room("1", 1);
    app.ended(&app.estimate("room/1", json!({})));
    let accepting = [("accept-encoding", "gzip")];
    let encoding = |path: &str| {
        let headers = app.headers(path, &accepting);
        headers.get("content-encoding").map(|value| value.to_str().unwrap().to_owned())
    };
    for path in ["/models", "/effects", "/systems/room/1/series", "/openapi.yaml"] {
        assert_eq!(encoding(path).as_deref(), Some("gzip"), "{path}");
    }
    // One body, one tag.
    for path in ["/params/room/1", "/params"] {
        assert_eq!(encoding(path), None, "{path}");
        assert_eq!(app.headers(path, &accepting)["etag"], app.get(path).header("etag"));
    }
}

#[test]
fn a_key_makes_one_thing_of_two_requests_wherever_something_is_made() {
    let app = TestApp::start();
    app.room("1", 1);
    let effect = |id: &str| {
        json!({"id": id, "title": "A", "explain": "B.", "signature": "C", "sign": "any",
               "parameters": {"c": {"unit": "K/h", "lower": -1, "upper": 1, "scale": "linear", "nominal": 0}}, "terms": {"T_r": "c"}})
    };
    let model = |id: &str| {
        json!({"id": id, "title": "A", "states": {"x": {"unit": "degC", "initial": "T_room"}}, "inputs": {"T_out": {"unit": "degC"}},
               "parameters": {"a": {
                   "unit": "1/h", "lower": 0.001, "upper": 1, "scale": "log", "nominal": 0.1
               }},
               "equations": {"x": "a*(T_out - x)"}, "outputs": {"T_room": {"expr": "x", "unit": "degC", "noise_sd": 0.1}}})
    };
    let batch = |evaluations: u64| {
        json!({
            "kind": "recalibrate", "systems": ["room/1"], "budget": {"evaluations": evaluations}
        })
    };
    let other_job = seeded(quick("room/1"), 9);
    let as_csv = |text: String| ("text/csv", text);
    let as_json = |body: Value| ("application/json", body.to_string());
    let cases = [
        ("/systems/room/1/windows", as_csv(room_csv(3, 3)), as_csv(stuck_csv())),
        ("/jobs", as_json(quick("room/1")), as_json(other_job)),
        ("/jobs", as_json(batch(100)), as_json(batch(200))),
        ("/models", as_json(model("one")), as_json(model("two"))),
        ("/effects", as_json(effect("one")), as_json(effect("two"))),
        (
            "/models/rc2/effects",
            as_json(json!({"effect": "constant_gain"})),
            as_json(json!({"effect": "sensor_lag"})),
        ),
    ];
    for (place, (path, (media_type, body), (_, other))) in cases.into_iter().enumerate() {
        let key = format!("key {place}");
        let send = |body: &str| {
            let headers = [("content-type", media_type), ("idempotency-key", key.as_str())];
            app.send("POST", path, &headers, Some(body.as_bytes())).unwrap()
        };
        let first = send(&body);
        assert!([201, 202].contains(&first.status), "{path}: {} {}", first.status, first.text);
        let again = send(&body);
        assert!([200, first.status].contains(&again.status), "{path}: {}", again.text);
        assert_eq!(
            (again.json()["id"].clone(), again.header("location")),
            (first.json()["id"].clone(), first.header("location")),
            "{path}"
        );
        send(&other).problem(422, "idempotency-key-reused");
    }
    let run = || {
        app.send("POST", "/schedules/nightly/run", &[("idempotency-key", "run")], Some(b""))
            .unwrap()
            .expect(202)
    };
    assert_eq!(run().header("location"), run().header("location"));
}
