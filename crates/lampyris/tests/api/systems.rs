//! Rooms and plants: their documents, their rows in the list, and their end.

use crate::support::cluster;
use crate::support::rooms::room;
use crate::support::{Answer, TestApp, endless};
use serde_json::{Value, json};

fn delete(app: &TestApp, path: &str) -> Answer {
    app.send("DELETE", path, &[], None).unwrap()
}

/// What the database still knows of a system: tables with rows that name it, and broken references. That it
/// was made and deleted, by whom, and how far its revisions came, is kept for good.
fn remains(app: &TestApp, system: &str) -> Vec<String> {
    let tables = if cluster::is_on() {
        "SELECT table_name::TEXT FROM information_schema.columns WHERE column_name = 'system' AND \
        table_name NOT IN ('audit', 'retired', 'changes')"
    } else {
        "SELECT m.name FROM sqlite_master m JOIN pragma_table_info(m.name) c WHERE m.type = 'table' AND \
        m.name NOT IN ('audit', 'retired') AND c.name = 'system'"
    };
    let tables = app.behind(tables).unwrap();
    assert!(tables.len() >= 6, "{tables:?}");
    // PostgreSQL lets no reference break.
    let broken = "SELECT \"table\" FROM pragma_foreign_key_check";
    let mut remains = if cluster::is_on() { Vec::new() } else { app.behind(broken).unwrap() };
    for table in tables {
        let rows =
            app.behind(&format!("SELECT CAST(COUNT(*) AS TEXT) FROM {table} WHERE system = '{system}'"));
        if rows.unwrap() != ["0"] {
            remains.push(table);
        }
    }
    remains
}

#[test]
fn a_system_without_history_goes_when_no_job_needs_it() {
    let app = TestApp::start();
    app.room("1", 1);
    let job =
        app.json("POST", "/jobs", &endless("room/1")).expect(202).json()["id"].as_str().unwrap().to_owned();
    app.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
    for path in ["/systems/room/1", "/systems/room/1?force=true"] {
        assert_eq!(delete(&app, path).problem(409, "system-busy")["jobs"], json!([job]));
    }
    app.post(&format!("/jobs/{job}/cancel")).expect(200);
    app.ended(&job);
    assert_eq!(app.get("/params/room/1?accept=nominal").expect(200).header("params-status"), "nominal");
    delete(&app, "/systems/room/1").expect(204);
    for path in [
        "/systems/room/1",
        "/params/room/1",
        "/params/room/1?accept=nominal",
        "/systems/room/1/series",
        "/systems/room/1/state",
    ] {
        app.get(path).problem(404, "system-not-found");
    }
    app.get(&format!("/jobs/{job}")).problem(404, "job-not-found");
    assert_eq!(
        (app.get("/systems").json()["items"].clone(), app.get("/jobs").json()["items"].clone()),
        (json!([]), json!([]))
    );
    delete(&app, "/systems/room/1").problem(404, "system-not-found");
    delete(&app, "/systems/room/1?forced=true").problem(422, "invalid-request");
    assert_eq!(remains(&app, "room/1"), [""; 0]);
}

#[test]
fn history_goes_only_by_force_and_then_completely() {
    let mut app = TestApp::start();
    app.room("1", 1);
    // Next door there is the same weather.
    app.room("2", 1);
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "neighbours": ["room/2"]})).expect(200);
    let batch = json!({"kind": "recalibrate", "systems": ["room/*"], "method": {"name": "lm_multistart"}, "budget": {"evaluations": 2000},
        "split": {"train": "P9D", "validation": "P5D"}});
    let answer = app.json_with("POST", "/jobs", &[("idempotency-key", "one")], &batch).expect(202);
    let report = app.until(answer.header("location"), |batch| batch["finished"] == true);
    assert_eq!(report["counts"], json!({"accepted": 2}), "{report}");
    let kept = app.get("/params/room/1").expect(200);

    let problem = delete(&app, "/systems/room/2").problem(409, "system-needed");
    assert_eq!(problem["dependents"], json!(["room/1"]));
    assert!(problem["detail"].as_str().unwrap().contains("1 fits, 1 revisions"), "{problem}");
    assert_eq!(app.get("/params/room/2").expect(200).json()["revision"], 1);

    delete(&app, "/systems/room/2?force=true").expect(204);
    assert_eq!(remains(&app, "room/2"), [""; 0]);
    app.get("/params/room/2").problem(404, "system-not-found");
    assert_eq!(app.get("/params").json()["items"].as_array().unwrap().len(), 1);
    let report = app.get(answer.header("location")).expect(200).json();
    assert_eq!(report["jobs"].as_array().unwrap().len(), 1, "the batch tells of what is left");
    // The other room keeps what it has; its fit no longer cites what is gone.
    assert_eq!(app.get("/params/room/1").text, kept.text);
    let fit = app.get(&format!("/fits/{}", kept.json()["fit"].as_str().unwrap())).json();
    assert_eq!(fit["windows"].as_array().unwrap().len(), 1, "{fit}");

    app.restart();
    app.get("/params/room/2").problem(404, "system-not-found");
    app.room("2", 2);
    app.get("/params/room/2").problem(404, "no-validated-parameters");
    app.ended(&app.estimate("room/2", json!({})));
    assert_eq!(app.get("/params/room/2").expect(200).json()["revision"], 2, "revisions never go back");
}

#[test]
fn a_zone_stands_alone_and_half_a_place_is_named() {
    let app = TestApp::start();
    let put =
        |location: Value| app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "location": location}));
    let kept = put(json!({"zone": "Asia/Tokyo"})).expect(201).json();
    assert_eq!(kept["location"], json!({"zone": "Asia/Tokyo"}));
    for (location, pointer, code, says) in [
        (
            json!({"lat": 35.0, "zone": "Asia/Tokyo"}),
            "/location/lon",
            "half-a-place",
            "the longitude is missing",
        ),
        (json!({"lon": 130.0}), "/location/lat", "half-a-place", "the latitude is missing"),
        (json!({"lat": "", "lon": 130.0}), "/location/lat", "wrong-type", "expected a number"),
        (json!({"lat": 35.0, "lon": 181.0}), "/location/lon", "out-of-range", "between -180 and 180"),
    ] {
        let fault = put(location).problem(422, "invalid-request")["errors"][0].clone();
        assert_eq!(
            (fault["pointer"].as_str(), fault["code"].as_str()),
            (Some(pointer), Some(code)),
            "{fault}"
        );
        assert!(fault["detail"].as_str().unwrap().contains(says), "{fault}");
    }
    assert_eq!(app.get("/systems/room/1").json()["location"], json!({"zone": "Asia/Tokyo"}));
}

#[test]
fn every_field_of_a_document_is_kept_and_counts() {
    let app = TestApp::start();
    // The warmest hour of these measurements is 6 h UTC, a little after noon in Japan.
    let document = json!({
        "label": "Corner office", "location": {"lat": 35.0, "lon": 130.0, "zone": "Asia/Tokyo"},
        "model": "rc2",
        "channels": {"T_room": "T_indoor"}, "neighbours": ["room/2"],
        "policy": {"mode": "suggest", "stale_after": "P2D", "horizon": "PT12H", "refit_when_degraded": false,
            "forget_before_change": true},
        "prior": "log_normal",
        "tenant": "north-estate",
        "exclude": [{
            "from": "2026-01-05T00:00:00Z", "to": "2026-01-07T00:00:00+01:00",
            "reason": "windows were cleaned"
        }],
    });
    let mut kept = app.json("PUT", "/systems/room/1", &document).expect(201).json();
    assert_eq!(kept["system"], "room/1");
    kept.as_object_mut().unwrap().shift_remove("system");
    assert_eq!(kept, document);
    app.csv(
        "/systems/room/1/windows",
        &crate::support::rooms::room_csv(1, 14).replace("T_room[degC]", "T_indoor[degC]"),
    )
    .expect(201);
    let job = app.ended(&app.estimate("room/1", json!({})));
    assert_eq!(
        (job["request"]["prior"].as_str(), job["outcome"].as_str()),
        (Some("log_normal"), Some("suggested")),
        "{job}"
    );

    let bad = json!({"model": "rc2", "label": "x".repeat(201), "channels": {"T_room": " ", "": "x"}, "prior": "normal", "policy": {"mode": "manual", "horizon": "P0D"},
        "exclude": [{"from": "2026-01-05", "to": "later"}], "owner": "me", "tenant": "a b"});
    let problem = app.json("PUT", "/systems/room/1", &bad).problem(422, "invalid-request");
    let mut pointers: Vec<&str> = problem["errors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|fault| fault["pointer"].as_str().unwrap())
        .collect();
    pointers.sort_unstable();
    let expected = [
        "/channels/",
        "/channels/T_room",
        "/exclude/0/from",
        "/exclude/0/to",
        "/label",
        "/owner",
        "/policy/horizon",
        "/policy/mode",
        "/prior",
        "/tenant",
    ];
    assert_eq!(pointers, expected, "{problem}");
}

#[test]
fn what_is_excluded_does_not_count() {
    let app = TestApp::start();
    // A sensor that hangs over the newest three days: no verdict can be given on it.
    let hanging: String = room(1, 14)
        .iter()
        .enumerate()
        .map(|(k, (time, room, out))| {
            format!(
                "{time},{},{out:.3}\n",
                if k >= 11 * 48 { 19.0 } else { (room * 1_000.0).round() / 1_000.0 }
            )
        })
        .collect();
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    app.csv("/systems/room/1/windows", &format!("time,T_room,T_out\n{hanging}")).expect(201);
    let rejected = app.ended(&app.estimate("room/1", json!({})));
    assert_eq!(rejected["outcome"], "rejected", "{rejected}");
    let exclude = json!([{"from": "2026-01-12T00:00:00Z", "to": "2026-01-15T00:00:00Z"}]);
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "exclude": exclude})).expect(200);
    let accepted =
        app.ended(&app.estimate("room/1", json!({"split": {"train": "P7D", "validation": "P3D"}})));
    assert_eq!(accepted["outcome"], "accepted", "{accepted}");
    let before = app.get(&format!("/fits/{}", rejected["fit"].as_str().unwrap())).json();
    let after = app.get(&format!("/fits/{}", accepted["fit"].as_str().unwrap())).json();
    assert_ne!(before["input_hash"], after["input_hash"]);
    assert_eq!(after["windows"], before["windows"], "the inputs of those days still come from there");
}

#[test]
fn a_row_tells_how_a_system_fares() {
    let app = TestApp::start();
    app.room("1", 1);
    app.json(
        "PUT",
        "/systems/room/1",
        &json!({"label": "Attic", "model": "rc2", "policy": {"horizon": "PT12H"}}),
    )
    .expect(200);
    let row = || app.get("/systems").expect(200).json()["items"][0].clone();
    let empty = row();
    assert_eq!(
        (empty["health"].as_str(), &empty["status"], &empty["latest_job"], &empty["error"]),
        (Some("unknown"), &Value::Null, &Value::Null, &json!({}))
    );
    let job = app.estimate("room/1", json!({}));
    app.ended(&job);
    let params = app.get("/params/room/1").json();
    let good = row();
    assert_eq!(
        (good["health"].as_str(), good["status"].as_str(), good["label"].as_str()),
        (Some("ok"), Some("fresh"), Some("Attic")),
        "{good}"
    );
    // A few days in which nothing but the weather moves tell no single rate, and say so.
    let flags: Vec<&str> =
        good["flags"].as_array().unwrap().iter().map(|flag| flag.as_str().unwrap()).collect();
    let open = params["ci95"].as_object().unwrap().iter().filter(|(_, interval)| interval.is_null());
    let open: Vec<String> = open.map(|(name, _)| format!("undetermined:{name}")).collect();
    assert_eq!(
        (flags, good["why"].as_str()),
        (open.iter().map(String::as_str).collect(), Some("The parameters are fresh."))
    );
    assert_eq!(
        (&good["latest_job"], good["latest_state"].as_str(), good["latest_outcome"].as_str()),
        (&json!(job), Some("succeeded"), Some("accepted"))
    );
    let error = &params["error"]["T_room"];
    let expected = json!({
        "unit": error["unit"], "validation_rmse": error["validation_rmse"], "horizon": "PT6H",
        "ahead": error["ahead"]["PT6H"]
    });
    assert_eq!(good["error"]["T_room"], expected);
    for field in ["flags", "fitted_at", "validated_at", "stale_after", "revision"] {
        assert_eq!(good[field], params[field], "{field}");
    }
    assert!((0..120).contains(&good["age_s"].as_i64().unwrap()));
    assert_eq!(
        good["worst_regime"],
        app.get(&format!("/fits/{}", params["fit"].as_str().unwrap())).json()["worst_regime"]
    );

    // An experiment is the newest job, and changes nothing in how the system fares.
    let experiment = app.failing("room/1", json!({"experiment": true}));
    app.ended(&experiment);
    let same = row();
    assert_eq!(
        (&same["latest_job"], same["latest_state"].as_str(), same["health"].as_str()),
        (&json!(experiment), Some("failed"), good["health"].as_str())
    );
    app.ended(&app.failing("room/1", json!({})));
    let fallen = row();
    assert_eq!((fallen["status"].as_str(), fallen["health"].as_str()), (Some("fallback"), Some("attention")));
    assert!(fallen["why"].as_str().unwrap().contains("the newest job failed"), "{fallen}");
}

#[test]
fn a_document_is_overwritten_only_by_those_who_have_seen_it() {
    let app = TestApp::start();
    let put = |headers: &[(&str, &str)], label: &str| {
        app.json_with("PUT", "/systems/room/1", headers, &json!({"model": "rc2", "label": label}))
    };
    let (only_new, any) = ([("if-none-match", "*")], [("if-match", "*")]);
    put(&any, "nothing to replace").problem(412, "not-as-expected");
    let made = put(&only_new, "first").expect(201);
    put(&only_new, "by accident").problem(412, "not-as-expected");
    let read = app.get("/systems/room/1").expect(200);
    assert_eq!((read.json()["label"].as_str(), read.header("etag")), (Some("first"), made.header("etag")));
    let first = read.header("etag").to_owned();
    app.get_with("/systems/room/1", &[("if-none-match", &first)]).expect(304);

    let second = put(&[("if-match", &first)], "second").expect(200).header("etag").to_owned();
    assert_ne!(first, second);
    put(&[("if-match", &first)], "late").problem(412, "not-as-expected");
    put(&[("if-match", &format!("{first}, {second}"))], "third").expect(200);
    put(&any, "fourth").expect(200);
    put(&[], "unconditional").expect(200);
    assert_eq!(app.get("/systems/room/1").json()["label"], "unconditional");
    // A document with faults is told them, whatever its conditions.
    app.json_with("PUT", "/systems/room/1", &only_new, &json!({"model": "none"}))
        .problem(422, "invalid-request");
}
