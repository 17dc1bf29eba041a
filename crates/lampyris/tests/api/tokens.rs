//! Who is answered: tokens, their scopes and systems, and those who have none.

use crate::support::cluster;
use crate::support::{Answer, Client, PATIENCE, TestApp, process, quick};
use lampyris::app::{App, AppError};
use lampyris::settings::Settings;
use lampyris::store::DatabasePlace;
use lampyris::store::Store;
use lampyris::store::tokens::Scope;
use serde_json::{Value, json};
use std::time::Instant;

/// An operation of the description.
struct Operation {
    method: String,
    path: String,
    /// The scope that it needs; `None` where everybody may.
    needs: Option<Scope>,
}

fn operations() -> Vec<Operation> {
    let description: Value = serde_json::from_str(&lampyris::http::openapi_json()).unwrap();
    let mut operations = Vec::new();
    for (path, item) in description["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            let security = operation["security"]
                .as_array()
                .unwrap_or_else(|| panic!("{method} {path} declares no scope"));
            let needs = security.first().map(|one| one["token"][0].as_str().unwrap().parse().unwrap());
            for status in ["401", "403", "429"] {
                assert_eq!(
                    operation["responses"][status].is_object(),
                    needs.is_some(),
                    "{method} {path} describes {status}"
                );
            }
            operations.push(Operation { method: method.to_uppercase(), path: path.clone(), needs });
        }
    }
    operations
}

/// A room of which everything is there that an operation can name: by the first part of the path.
fn furnished(app: &TestApp) -> impl Fn(&str) -> String + use<> {
    app.room("1", 1);
    app.room("2", 1);
    let job = app.estimate("room/1", json!({}));
    let fit = app.ended(&job)["fit"].as_str().unwrap().to_owned();
    let window = app.get("/systems/room/1/windows").json()["items"][0]["id"].as_str().unwrap().to_owned();
    let short = json!({
        "kind": "diagnose", "system": "room/1", "window": {"last": "P2D"}, "method": {"name": "lm_multistart"}
    });
    let diagnosis = app.ended(&app.post_job(&short))["diagnosis"].as_str().unwrap().to_owned();
    let batch = json!({"kind": "recalibrate", "systems": ["room/1"], "budget": {"evaluations": 100}});
    let batch = app.json("POST", "/jobs", &batch).expect(202).json()["id"].as_str().unwrap().to_owned();
    app.json(
        "PUT",
        "/schedules/weekly",
        &json!({"cron": "0 5 * * 1", "systems": ["room/1"], "enabled": false}),
    )
    .expect(201);
    move |path: &str| {
        let id = match path.split('/').nth(1).unwrap() {
            "jobs" => &job,
            "fits" => &fit,
            "windows" => &window,
            "diagnoses" => &diagnosis,
            "batches" | "nights" => &batch,
            "models" => "rc2",
            "effects" => "wind_infiltration",
            _ => "1",
        };
        path.replace("{kind}", "room").replace("{id}", id).replace("{name}", "weekly")
    }
}

/// Sends what no operation takes: the guard stands before the body, and nothing is changed.
fn try_out(client: &Client, operation: &Operation, path: &str) -> Answer {
    let body = (operation.method != "GET").then_some(b"[]".as_slice());
    client
        .send(&operation.method, path, &[("content-type", "application/json"), ("connection", "close")], body)
        .unwrap()
}

#[test]
fn every_operation_answers_those_who_may_and_nobody_else() {
    let app = TestApp::start();
    let concrete = furnished(&app);
    let clients = [Scope::Read, Scope::Operate, Scope::Admin]
        .map(|scope| (scope, app.token(scope.as_str(), scope, &[])));
    let stranger = app.token("stranger", Scope::Operate, &["room/2", "plant/*"]);
    let wrong = app.with_token("lampyris_0000");
    let operations = operations();
    assert!(operations.len() > 50);
    for operation in &operations {
        let path = concrete(&operation.path);
        let named = format!("{} {path}", operation.method);
        let without = try_out(&app, operation, &path);
        let Some(needs) = operation.needs else {
            assert!(
                ![401, 403, 404].contains(&without.status) || path == "/docs/weekly",
                "{named}: {}",
                without.text
            );
            continue;
        };
        // Clients of InfluxDB read errors in another form.
        let is_influx = operation.path.ends_with("/write");
        if is_influx {
            assert_eq!((without.status, &without.json()["code"]), (401, &json!("unauthorized")), "{named}");
        } else {
            without.clone().problem(401, "unauthorized");
        }
        assert_eq!(without.header("www-authenticate"), "Bearer realm=\"lampyris\"", "{named}");
        let guessed = try_out(&wrong, operation, &path);
        assert!([401, 429].contains(&guessed.status), "{named}: {}", guessed.text);
        for (scope, client) in &clients {
            let answer = try_out(client, operation, &path);
            if scope.includes(needs) {
                // The room has no ladder, which is another thing than no room.
                let is_there = answer.status != 404 || answer.text.contains("\"ladder-not-found\"");
                assert!(
                    is_there && ![401, 403, 500, 503].contains(&answer.status),
                    "{named} as {}: {}",
                    scope.as_str(),
                    answer.text
                );
            } else {
                assert!(answer.header("www-authenticate").contains("insufficient_scope"), "{named}");
                if is_influx {
                    assert_eq!(
                        (answer.status, &answer.json()["code"]),
                        (403, &json!("forbidden")),
                        "{named}"
                    );
                    continue;
                }
                assert_eq!(
                    answer.problem(403, "insufficient-scope")["scope"],
                    needs.as_str(),
                    "{named} as {}",
                    scope.as_str()
                );
            }
        }
        // Somebody who may operate another room.
        let foreign = try_out(&stranger, operation, &path);
        let is_of_a_system =
            operation.path.contains('{') && !path.starts_with("/models") && !path.starts_with("/effects");
        if needs == Scope::Admin {
            foreign.problem(403, "insufficient-scope");
        } else if is_of_a_system {
            assert_eq!(foreign.status, 404, "{named}: {}", foreign.text);
            let slug = foreign.json()["type"].as_str().unwrap().to_owned();
            assert!(slug.ends_with("-not-found") && slug != "ladder-not-found", "{named}: {}", foreign.text);
        } else {
            assert!(![401, 403, 404, 500].contains(&foreign.status), "{named}: {}", foreign.text);
            for secret in ["room/1", "Room 1", &concrete("/fits/{id}")[6..], &concrete("/jobs/{id}")[6..]] {
                assert!(!foreign.text.contains(secret), "{named} tells of {secret}: {}", foreign.text);
            }
        }
    }
    // What nobody describes is no way around.
    app.send("HEAD", "/jobs", &[], None).unwrap().expect(401);
    app.send("OPTIONS", "/jobs", &[], None).unwrap().expect(405);
    app.get("/systems/room/1/").expect(404);
    app.get("/ui/").expect(200);
}

#[test]
fn what_a_body_names_lies_within_reach_or_is_not_there() {
    let app = TestApp::start();
    let concrete = furnished(&app);
    app.estimate("room/2", json!({}));
    let stranger = app.token("stranger", Scope::Operate, &["room/2"]);
    let detail =
        |body: Value| stranger.json("POST", "/jobs", &body).problem(422, "invalid-request")["errors"].clone();
    assert_eq!(
        detail(quick("room/1")).to_string(),
        detail(quick("room/7")).to_string().replace("room/7", "room/1")
    );
    let preview = |system: &str| stranger.json("POST", "/models/preview", &json!({"system": system}));
    preview("room/1").problem(422, "invalid-request");
    preview("room/2").expect(200);
    let fit = &concrete("/fits/{id}")[6..];
    let compared = stranger.get(&format!("/compare?fits={fit},fit_none")).problem(422, "invalid-request");
    assert_eq!(compared["errors"].as_array().unwrap().len(), 2, "{compared}");
    stranger.get("/events?system=room/1").problem(404, "system-not-found");

    let recalibrate =
        |systems: Value| stranger.json("POST", "/jobs", &json!({"kind": "recalibrate", "systems": systems}));
    for systems in [json!(["room/*"]), json!(["room/2", "room/1"]), json!(["*/2"])] {
        recalibrate(systems.clone()).problem(403, "out-of-reach");
        stranger
            .json("PUT", "/schedules/mine", &json!({"cron": "0 5 * * 1", "systems": systems}))
            .problem(403, "out-of-reach");
    }
    recalibrate(json!(["room/2"])).expect(202);
    let own = json!({"cron": "0 5 * * 1", "systems": ["room/2"], "enabled": false});
    stranger.json("PUT", "/schedules/mine", &own).expect(201);
    stranger.json("PUT", "/schedules/nightly", &own).problem(404, "schedule-not-found");

    let names = |path: &str, field: &str| -> Vec<Value> {
        stranger.get(path).expect(200).json()["items"]
            .as_array()
            .unwrap()
            .iter()
            .map(|item| item[field].clone())
            .collect()
    };
    assert_eq!(names("/systems", "system"), ["room/2"]);
    assert_eq!(names("/schedules", "name"), ["mine"]);
    assert_eq!(names("/batches", "schedule").len(), 1);
    assert!(
        !names("/jobs", "system").is_empty()
            && names("/jobs", "system").iter().all(|system| system == "room/2")
    );
    // A page of a list is as full as it can be, whatever is left out.
    let page = stranger.get("/jobs?page_size=1").expect(200).json();
    assert_eq!((page["items"].as_array().unwrap().len(), page["next_page_token"].is_string()), (1, true));
    assert!(
        names("/audit", "system").is_empty()
            || names("/audit", "system").iter().all(|system| system == "room/2")
    );
}

#[test]
fn a_stream_tells_of_the_systems_of_its_token_and_ends_with_it() {
    let app = TestApp::start();
    app.room("1", 1);
    app.room("2", 1);
    let admin = app.token("admin", Scope::Admin, &[]);
    let stranger = app.token("stranger", Scope::Read, &["room/2"]);
    let mut stream = stranger.listen("/events", "");
    admin.ended(&admin.estimate("room/1", json!({})));
    admin.ended(&admin.estimate("room/2", json!({})));
    let told = stream.until(|told| told.event == "finished");
    assert!(told.iter().all(|told| told.data["system"] == "room/2"), "{told:#?}");

    revoke(&app.place(), "stranger");
    assert!(stream.next().is_none(), "the stream ends");
    let start = Instant::now();
    while stranger.get("/jobs").status == 200 {
        assert!(start.elapsed() < PATIENCE);
    }
    let refused = stranger.get("/params/room/2").problem(401, "unauthorized");
    assert!(refused["detail"].as_str().unwrap().contains("revoked"), "{refused}");
    admin.get("/params/room/2").expect(200);
}

#[test]
fn a_long_poll_ends_with_its_token() {
    let app = TestApp::start();
    app.room("1", 1);
    app.ended(&app.estimate("room/1", json!({})));
    let reader = app.token("reader", Scope::Read, &["room/*"]);
    let tag = reader.get("/params/room/1").expect(200).header("etag").to_owned();
    reader.get_with("/params/room/1", &[("if-none-match", &tag)]).expect(304);
    let waiting = {
        let reader = reader.clone();
        std::thread::spawn(move || {
            reader.get_with("/params/room/1", &[("if-none-match", &tag), ("prefer", "wait=60")])
        })
    };
    revoke(&app.place(), "reader");
    waiting.join().unwrap().problem(401, "unauthorized");
}

fn revoke(database: &DatabasePlace, name: &str) {
    let database = String::from(database.clone());
    process::verb("", &["token", "revoke", name, "--database", &database]).expect(0);
}

#[test]
fn tokens_are_made_and_revoked_beside_a_running_service() {
    let app = TestApp::start();
    let database = String::from(app.place());
    let verb = |arguments: &[&str]| {
        let all: Vec<&str> = [&["token"], arguments, &["--database", &database]].concat();
        process::verb("", &all)
    };
    verb(&["list"]).expect(3);
    app.get("/systems").expect(200);
    let made = verb(&[
        "create",
        "--name",
        "dash",
        "--scope",
        "read",
        "--system",
        "room/4",
        "--expires",
        "PT1S",
        "--json",
    ])
    .expect(0)
    .json();
    let secret = made["token"].as_str().unwrap();
    assert_eq!(
        (secret.len(), &made["scope"], &made["systems"]),
        ("lampyris_".len() + 64, &json!("read"), &json!(["room/4"]))
    );
    // It counts, and then it has expired.
    let dash = app.with_token(secret);
    let start = Instant::now();
    while app.get("/systems").status == 200 {
        assert!(start.elapsed() < PATIENCE);
    }
    loop {
        let answer = dash.get("/systems");
        if answer.status == 401 {
            // A request that is under way when it happens is told that it has ended.
            assert!(["expired", "ended"].iter().any(|word| answer.text.contains(word)), "{}", answer.text);
            break;
        }
        assert!(start.elapsed() < PATIENCE);
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    let plain = verb(&["create", "--name", "ops", "--scope", "admin"]).expect(0);
    let ops = app.with_token(plain.out.lines().next().unwrap());
    while ops.get("/systems").status != 200 {
        assert!(start.elapsed() < PATIENCE);
    }
    let url = format!("http://{}", app.addr());
    let listed = process::verb(&url, &["systems", "list", "--token", plain.out.lines().next().unwrap()]);
    assert_eq!(listed.code, Some(3), "{}", listed.err);
    assert!(process::verb(&url, &["systems", "list"]).expect(1).err.contains("A token is needed"));

    assert!(
        verb(&["create", "--name", "ops", "--scope", "read"])
            .expect(1)
            .err
            .contains("never means another token")
    );
    for wrong in [
        &["--name", "a b", "--scope", "read"][..],
        &["--name", "local", "--scope", "read"],
        &["--name", "x", "--scope", "admin", "--system", "room/4"],
    ] {
        verb(&[&["create"], wrong].concat()).expect(1);
    }
    verb(&["create", "--name", "x", "--scope", "root"]).expect(2);
    verb(&["revoke", "nobody"]).expect(4);
    verb(&["revoke", "ops"]).expect(0);
    verb(&["revoke", "ops"]).expect(0);
    let list = verb(&["list", "--json"]).expect(0);
    let states: Vec<Value> = list.json()["items"]
        .as_array()
        .unwrap()
        .iter()
        .map(|item| json!([item["name"], item["state"]]))
        .collect();
    assert_eq!(states, [json!(["dash", "expired"]), json!(["ops", "revoked"])]);
    assert!(!list.out.contains(&secret[9..]) && !verb(&["list"]).expect(0).out.contains(&secret[9..]));
    // With the last token gone the door stays shut.
    app.get("/systems").problem(401, "unauthorized");
    // The file holds no token, also not in its log.
    for name in ["test.db", "test.db-wal"] {
        let bytes = std::fs::read(std::path::Path::new(&database).with_file_name(name)).unwrap_or_default();
        assert!(!bytes.windows(20).any(|part| part == &secret.as_bytes()[20..40]), "{name}");
    }
}

#[test]
fn guessing_is_slowed_down_and_locks_nobody_out() {
    let app = TestApp::start();
    let reader = app.token("reader", Scope::Read, &[]);
    for attempt in 0..10 {
        app.with_token(&format!("lampyris_{attempt:064}")).get("/systems").problem(401, "unauthorized");
    }
    for path in ["/systems", "/params", "/params/room/1"] {
        let refused = app.with_token("lampyris_x").get(path);
        assert_eq!(refused.header("retry-after"), "60");
        refused.problem(429, "too-many-failures");
    }
    reader.get("/systems").expect(200);
    app.get("/systems").problem(401, "unauthorized");
    let metrics = reader.get("/metrics").expect(200).text;
    let refused = metrics.lines().find_map(|line| line.strip_prefix("lampyris_refused_total ")).unwrap();
    assert!(refused.parse::<f64>().unwrap() >= 14.0, "{refused}");
}

#[test]
fn without_a_token_nobody_listens_for_other_machines() {
    let dir = tempfile::tempdir().unwrap();
    // An address for documents (RFC 5737): no machine has it, so that nothing listens in the end.
    let settings = Settings {
        bind: "192.0.2.1:0".parse().unwrap(),
        database: dir.path().join("test.db").into(),
        ..Settings::default()
    };
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let start = || runtime.block_on(App::start(settings.clone())).unwrap_err();
    let refused = start();
    assert!(
        matches!(refused, AppError::NotLoopback(_)) && refused.to_string().contains("lampyris token create"),
        "{refused}"
    );
    process::verb(
        "",
        &[
            "token",
            "create",
            "--name",
            "a",
            "--scope",
            "read",
            "--database",
            settings.database.file().unwrap().to_str().unwrap(),
        ],
    )
    .expect(0);
    let refused = start();
    assert!(matches!(refused, AppError::Bind(..)), "{refused}");
}

#[test]
fn a_visitor_needs_no_lock_and_a_second_service_of_a_file_does() {
    let app = TestApp::start();
    app.block_on(async {
        let second = Store::open(&app.place(), None).await;
        assert_eq!(cluster::is_on(), second.is_ok());
        assert!(matches!(second, Ok(_) | Err(lampyris::store::StoreError::InUse(_))));
        let visitor = Store::visit(&app.place()).await.unwrap();
        assert!(lampyris::store::tokens::all(&visitor).await.unwrap().is_empty());
        visitor.close().await;
    });
    app.room("1", 1);
}

#[test]
fn nobody_learns_the_keys_of_others() {
    let app = TestApp::start();
    let (one, two) = (app.token("one", Scope::Admin, &[]), app.token("two", Scope::Admin, &[]));
    one.room("1", 1);
    let post = |client: &Client, body: &Value| {
        client.json_with("POST", "/jobs", &[("idempotency-key", "monday")], body)
    };
    let (body, other) = (quick("room/1"), json!({"kind": "recalibrate", "systems": ["room/*"]}));
    let first = post(&one, &body).expect(202).json();
    assert_eq!(post(&one, &body).expect(202).json()["id"], first["id"]);
    post(&one, &other).problem(422, "idempotency-key-reused");
    // To somebody else the key is a new one.
    assert_ne!(post(&two, &other).expect(202).json()["id"], first["id"]);
}
