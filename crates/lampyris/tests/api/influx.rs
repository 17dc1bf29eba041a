//! Measurements as clients of InfluxDB send them: what is taken, what is only counted, what is refused, and
//! how tokens are shown.

use crate::support::{Answer, Client, TODAY, TestApp};
use flate2::Compression;
use flate2::write::GzEncoder;
use lampyris::store::tokens::Scope;
use serde_json::{Value, json};
use std::io::Write;

/// What Home Assistant's own integration has sent.
const HOME_ASSISTANT: &str = include_str!("influx/home_assistant.txt");
/// The rules that the book gives to whoever has Home Assistant.
const RULES: &str = include_str!("../../../../contrib/home-assistant/rules.json");

/// A service with a room whose measurements come by those rules.
fn living_room() -> TestApp {
    let app = TestApp::start();
    app.json("PUT", "/systems/site/home", &json!({"label": "Outdoors"})).expect(201);
    let room = json!({"model": "ti", "channels": {"T_out": "site/home:T_out"}});
    app.json("PUT", "/systems/room/living_room", &room).expect(201);
    app.json("PUT", "/sources/influx", &serde_json::from_str(RULES).unwrap()).expect(200);
    app
}

fn write(client: &Client, path: &str, headers: &[(&str, &str)], body: &[u8]) -> Answer {
    client.send("POST", path, headers, Some(body)).unwrap()
}

/// The error that clients of InfluxDB read.
#[track_caller]
fn refused(answer: Answer, status: u16, code: &str) -> String {
    assert_eq!(answer.header("content-type"), "application/json", "{}", answer.text);
    let error = answer.expect(status).json();
    assert_eq!(error["code"], code, "{error}");
    error["message"].as_str().unwrap().to_owned()
}

/// Times and values of a channel; gaps are left out.
fn samples(app: &TestApp, channel: &str) -> (Vec<String>, Vec<f64>) {
    let system = if channel == "T_out" { "site/home" } else { "room/living_room" };
    let series = app.get(&format!("/systems/{system}/series?channels={channel}")).expect(200).json();
    let line = &series["channels"][channel];
    let values = line["values"].as_array().unwrap().iter().map(Value::as_f64);
    let times = line["time"].as_array().unwrap().iter().map(|time| time.as_str().unwrap().to_owned());
    times.zip(values).filter_map(|(time, value)| Some((time, value?))).unzip()
}

#[test]
fn home_assistant_pushes_without_a_line_of_code() {
    let mut app = living_room();
    // It asks first whether it may write nothing.
    write(&app, "/api/v2/write?org=any&bucket=any&precision=ns", &[], b"").expect(204);
    let headers = [("content-type", "text/plain"), ("authorization", "Token any")];
    let taken =
        write(&app, "/api/v2/write?org=any&bucket=any&precision=ns", &headers, HOME_ASSISTANT.as_bytes());
    assert_eq!(taken.expect(204).text, "");
    let (times, values) = samples(&app, "T_room");
    assert_eq!(times, ["2026-01-05T00:00:00Z", "2026-01-05T00:05:00Z"]);
    assert_eq!(values, [20.53, 20.61]);
    assert_eq!(samples(&app, "T_out").1, [-1.5]);
    assert_eq!(samples(&app, "P_heater").1, [1.5]);

    let source = app.get("/sources/influx").expect(200).json();
    assert_eq!(
        (&source["taken"], &source["untaken"], &source["changed_by"]),
        (&json!(4), &json!(4), &json!("local"))
    );
    let mut left: Vec<(&str, &str, &str)> = Vec::new();
    for line in source["latest_untaken"].as_array().unwrap() {
        assert!(line["last_at"].is_string() && line["count"] == 1, "{line}");
        left.push((
            line["tags"]["entity_id"].as_str().unwrap(),
            line["field"].as_str().unwrap(),
            line["why"].as_str().unwrap(),
        ));
    }
    left.sort_unstable();
    assert_eq!(
        left,
        [
            ("lampyris_attic_temperature", "value", "no_system"),
            ("lampyris_living_room_humidity", "battery", "no_rule"),
            ("lampyris_living_room_humidity", "value", "no_rule"),
            ("lampyris_living_room_temperature", "restored", "no_rule"),
        ]
    );
    let metrics = app.get("/metrics").text;
    for count in ["lampyris_influx_points_total 4", "lampyris_influx_unmapped_total 4"] {
        assert!(metrics.lines().any(|line| line == count), "{metrics}");
    }

    // The rules outlive the service.
    app.restart();
    write(
        &app,
        "/write?precision=s",
        &[],
        b"W,entity_id=lampyris_living_room_heater_power value=500 1767571500",
    )
    .expect(204);
    assert_eq!(samples(&app, "P_heater").1, [1.5, 0.5]);
}

#[test]
fn times_come_in_any_precision_and_bodies_may_be_packed() {
    let app = living_room();
    let line = |value: f64, time: &str| {
        format!("°C,entity_id=lampyris_living_room_temperature value={value} {time}\n")
    };
    for (minute, (precision, digits)) in
        [("", "000000000"), ("?precision=u", "000000"), ("?precision=ms", "000"), ("?precision=s", "")]
            .into_iter()
            .enumerate()
    {
        let body = line(20.0 + minute as f64, &format!("{}{digits}", 1_767_571_200 + 60 * minute));
        write(&app, &format!("/write{precision}"), &[], body.as_bytes()).expect(204);
    }
    let mut packed = GzEncoder::new(Vec::new(), Compression::default());
    packed.write_all(line(24.0, "1767571440").as_bytes()).unwrap();
    let packed = packed.finish().unwrap();
    let headers = [("content-encoding", "gzip"), ("content-type", "text/plain; charset=utf-8")];
    write(&app, "/api/v2/write?precision=s", &headers, &packed).expect(204);
    // Without a time it is of now, which is two weeks later here.
    write(&app, "/write", &[], line(25.0, "").as_bytes()).expect(204);
    let (times, values) = samples(&app, "T_room");
    assert_eq!(values, [20.0, 21.0, 22.0, 23.0, 24.0, 25.0]);
    assert_eq!(times[4], "2026-01-05T00:04:00Z");
    // Between the start of the service and this moment, however busy the machine is.
    let of_now: jiff::Timestamp = times[5].parse().unwrap();
    assert!(of_now >= TODAY.parse().unwrap() && of_now <= app.clock.now(), "{of_now}");

    let message = refused(write(&app, "/write?precision=d", &[], b"a v=1"), 400, "invalid");
    assert!(message.contains("precision"), "{message}");
    refused(write(&app, "/write?precison=s", &[], b"a v=1"), 400, "invalid");
    refused(write(&app, "/write", &[("content-encoding", "gzip")], b"plain"), 400, "invalid");
    refused(write(&app, "/write", &[("content-encoding", "br")], b"plain"), 400, "invalid");
    let ping = app.get("/ping").expect(204);
    assert!(ping.header("x-influxdb-version").starts_with("lampyris-"));
}

#[test]
fn every_line_that_cannot_be_read_is_named_and_the_others_are_taken() {
    let app = living_room();
    let body = "°C,entity_id=lampyris_living_room_temperature value=20 1767571200\n\
        °C,entity_id=lampyris_living_room_temperature value= 1767571260\n\
        no line\n\
        °C,entity_id=lampyris_living_room_temperature value=21 17675712\n\
        °C,entity_id=lampyris_living_room_temperature value=21 4102444800\n\
        °C,entity_id=lampyris_living_room_temperature value=85 1767571320\n\
        °C,entity_id=lampyris_living_room_temperature value=22 1767571380\n";
    let message = refused(write(&app, "/write?precision=s", &[], body.as_bytes()), 400, "invalid");
    for part in ["4 faults", "line 2", "line 3", "line 4: `°C` is of 1970-07-24", "line 5", "2100-01-01"] {
        assert!(message.contains(part), "{part}: {message}");
    }
    assert_eq!(samples(&app, "T_room").1, [20.0, 22.0]);
    let left = &app.get("/sources/influx").json()["latest_untaken"];
    assert_eq!((&left[0]["why"], left.as_array().map(Vec::len)), (&json!("implausible"), Some(1)), "{left}");
    refused(write(&app, "/write", &[], b"a v=\"\xff\""), 400, "invalid");

    let wrong = json!({"rules": [
        {"system": "room", "channel": "T_room"},
        {"system": "room/1", "channel": "T_room", "unit": "kW", "tag": {}},
        {"system": "room/{", "channel": "x"},
    ]});
    let problem = app.json("PUT", "/sources/influx", &wrong).problem(422, "invalid-request");
    let faults: Vec<&str> = problem["errors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|fault| fault["pointer"].as_str().unwrap())
        .collect();
    assert_eq!(faults, ["/rules/1/tag", "/rules/0/system", "/rules/1/unit", "/rules/2/system"]);
    assert_eq!(
        app.get("/sources/influx").json()["rules"].as_array().map(Vec::len),
        Some(3),
        "the rules of before"
    );
}

#[test]
fn a_token_is_shown_as_the_clients_do_and_reaches_no_further_than_elsewhere() {
    let app = living_room();
    app.json("PUT", "/systems/room/attic", &json!({"model": "ti"})).expect(201);
    let limited = app.token("pusher", Scope::Operate, &["room/living_room"]);
    let reader = app.token("reader", Scope::Read, &[]);
    let secret = limited.secret();
    let basic = format!(
        "Basic {}",
        base64::Engine::encode(&base64::prelude::BASE64_STANDARD, format!("any:{secret}"))
    );
    let (token, query) = (format!("Token {secret}"), format!("/write?u=any&p={secret}"));
    let line = |minute: i64| {
        let time = (1_767_571_200 + 60 * minute) * 1_000_000_000;
        format!(
            "°C,entity_id=lampyris_living_room_temperature value=20 {time}\n°C,entity_id=lampyris_attic_temperature value=20 {time}"
        )
    };
    let bare = &app.client;
    write(bare, "/write", &[("authorization", &token)], line(0).as_bytes()).expect(204);
    write(bare, "/write", &[("authorization", &basic)], line(1).as_bytes()).expect(204);
    write(bare, &query, &[], line(2).as_bytes()).expect(204);
    write(&limited, "/api/v2/write", &[], line(3).as_bytes()).expect(204);
    let kept = |room: &str| {
        let answer = reader.get(&format!("/systems/room/{room}/series?channels=T_room"));
        answer.json()["channels"]["T_room"]["values"].as_array().map_or(0, Vec::len)
    };
    assert_eq!((kept("living_room"), kept("attic")), (4, 0));

    let unknown = write(bare, "/write", &[("authorization", "Token nobody")], line(4).as_bytes());
    // Waiting for the tokens to be known has shown them too early, perhaps more often than an address may.
    assert!([401, 429].contains(&unknown.status), "{}", unknown.text);
    refused(write(bare, "/write", &[], line(4).as_bytes()), 401, "unauthorized");
    refused(write(&reader, "/write", &[], line(4).as_bytes()), 403, "forbidden");
    // Elsewhere a token is shown in one way.
    bare.get_with("/systems", &[("authorization", &token)]).problem(401, "unauthorized");
    limited.get("/sources/influx").problem(403, "insufficient-scope");
    bare.get("/ping").expect(204);
    assert_eq!(kept("living_room"), 4);
}
