//! The stitched view: what a chart draws, and what a file holds.

use crate::support::TestApp;
use crate::support::rooms::{room, room_csv};
use serde_json::{Value, json};

/// A room of the model `rc2` without measurements.
fn empty(app: &TestApp, id: &str) {
    app.json("PUT", &format!("/systems/room/{id}"), &json!({"model": "rc2"})).expect(201);
}

fn numbers(list: &Value) -> Vec<Option<f64>> {
    list.as_array().unwrap().iter().map(Value::as_f64).collect()
}

/// The content of a channel as the client that knows both windows expects it: time and value.
fn points(series: &Value, channel: &str) -> Vec<(String, Option<f64>)> {
    let channel = &series["channels"][channel];
    let times = channel["time"].as_array().unwrap().iter().map(|time| time.as_str().unwrap().to_owned());
    times.zip(numbers(&channel["values"])).collect()
}

#[test]
fn the_newest_upload_wins_and_gaps_stay_gaps() {
    let app = TestApp::start();
    empty(&app, "1");
    let series = app.get("/systems/room/1/series").expect(200).json();
    assert_eq!((&series["from"], &series["channels"]), (&Value::Null, &json!({})));
    app.get("/systems/room/9/series").problem(404, "system-not-found");

    let older = "time,T_room,T_out[degF]\n2026-01-01T00:00:00Z,20,32\n2026-01-01T00:10:00Z,21,50\n2026-01-01T00:20:00Z,22,\n2026-01-01T00:30:00Z,23,68\n";
    let newer = "time,T_room\n2026-01-01T01:10:00+01:00,31\n2026-01-01T01:15:00+01:00,\n2026-01-01T02:01:00+01:00,34\n";
    app.csv("/systems/room/1/windows", older).expect(201);
    app.csv("/systems/room/1/windows", newer).expect(201);
    let series = app.get("/systems/room/1/series").expect(200).json();
    assert_eq!(
        (series["system"].as_str(), series["thinned"].as_bool(), &series["thinning"]),
        (Some("room/1"), Some(false), &Value::Null)
    );
    assert_eq!(
        (series["from"].as_str(), series["to"].as_str()),
        (Some("2026-01-01T00:00:00Z"), Some("2026-01-01T01:01:00Z"))
    );
    // From 00:30 to 01:01 are more than three steps of ten minutes; a missing cell is no sample.
    let expected = [
        ("00:00", Some(20.0)),
        ("00:10", Some(31.0)),
        ("00:20", Some(22.0)),
        ("00:30", Some(23.0)),
        ("00:40", None),
        ("01:01", Some(34.0)),
    ];
    let expected: Vec<(String, Option<f64>)> =
        expected.map(|(time, value)| (format!("2026-01-01T{time}:00Z"), value)).into();
    assert_eq!(points(&series, "T_room"), expected);
    let room = &series["channels"]["T_room"];
    assert_eq!(
        (room["unit"].as_str(), room["hold"].as_str(), &room["samples"], &room["gaps"]),
        (Some("degC"), Some("linear"), &json!(5), &json!(1))
    );
    assert_eq!(numbers(&series["channels"]["T_out"]["values"]), [Some(0.0), Some(10.0), Some(20.0)]);
    assert!(series["gaps"].as_str().unwrap().contains("three median steps"));

    let part = app
        .get(
            "/systems/room/1/series?from=2026-01-01T00:10:00Z&to=2026-01-01T01:20:00%2B01:00&channels=T_room",
        )
        .expect(200)
        .json();
    assert_eq!(part["channels"].as_object().unwrap().keys().collect::<Vec<_>>(), ["T_room"]);
    assert_eq!(numbers(&part["channels"]["T_room"]["values"]), [Some(31.0), Some(22.0)]);
    let before = app.get("/systems/room/1/series?to=2025-01-01T00:00:00Z").expect(200).json();
    assert_eq!(before["channels"], json!({}), "no sample there");

    // What is asked for decides on the order; naming a channel twice does not show it twice.
    let both = app.get("/systems/room/1/series?channels=T_room,T_out,T_room").json();
    assert_eq!(both["channels"].as_object().unwrap().keys().collect::<Vec<_>>(), ["T_room", "T_out"]);
}

#[test]
fn a_thinned_channel_keeps_its_extremes_and_says_so() {
    let app = TestApp::at("2026-12-01T00:00:00Z", |_| {});
    empty(&app, "1");
    let rows = room(5, 30);
    let mut text = "time,T_room,T_out\n".to_owned();
    for (k, (time, room, out)) in rows.iter().enumerate() {
        // A day is missing, one sample is a spike, and the weather comes every four hours only.
        if (600..648).contains(&k) {
            continue;
        }
        let room = if k == 700 { 45.5 } else { *room };
        text +=
            &format!("{time},{room:.3},{}\n", if k % 8 == 0 { format!("{out:.3}") } else { String::new() });
    }
    app.csv("/systems/room/1/windows", &text).expect(201);
    let series = app.get("/systems/room/1/series?max_points=200").expect(200).json();
    assert_eq!(series["thinned"], true);
    assert!(series["thinning"].as_str().unwrap().contains("lowest"));
    let (room, out) = (&series["channels"]["T_room"], &series["channels"]["T_out"]);
    assert!(room.get("values").is_none() && room["samples"] == 1392, "{room}");
    let (min, max, mean) = (numbers(&room["min"]), numbers(&room["max"]), numbers(&room["mean"]));
    assert!(
        min.len() <= 200
            && min.len() > 80
            && [max.len(), mean.len(), room["time"].as_array().unwrap().len()] == [min.len(); 3]
    );
    assert_eq!(max.iter().flatten().copied().fold(f64::MIN, f64::max), 45.5, "the spike shows");
    assert_eq!(min.iter().filter(|value| value.is_none()).count(), 1, "the day that is missing shows");
    let ordered = min.iter().zip(&mean).zip(&max).all(|((min, mean), max)| min <= mean && mean <= max);
    assert!(
        ordered && room["count"].as_array().unwrap().iter().filter_map(Value::as_u64).sum::<u64>() == 1392
    );
    // The weather has few samples: it comes as it is.
    assert_eq!((out["samples"].as_u64(), numbers(&out["values"]).iter().flatten().count()), (Some(174), 174));
    assert!(out.get("min").is_none() && out.get("bucket_s").is_none());
    assert_eq!(
        app.get("/systems/room/1/series").json()["thinned"],
        false,
        "two thousand points hold this record"
    );

    let csv =
        app.get_with("/systems/room/1/series?max_points=200", &[("accept", "text/csv")]).expect(200).text;
    assert!(
        csv.starts_with("time,T_out[degC],T_room.min[degC],T_room.mean[degC],T_room.max[degC]\n"),
        "{}",
        &csv[..80]
    );
    let whole = app.get_with("/systems/room/1/series", &[("accept", "text/csv")]).expect(200).text;
    assert_eq!(
        (whole.lines().next(), whole.lines().count()),
        (Some("time,T_out[degC],T_room[degC]"), 1393),
        "no thinning without being asked"
    );
}

#[test]
fn the_csv_is_the_same_window_again() {
    let app = TestApp::start();
    empty(&app, "1");
    empty(&app, "2");
    let first = app.csv("/systems/room/1/windows", &room_csv(1, 14)).expect(201).json();
    let csv = app
        .get_with("/systems/room/1/series", &[("accept", "text/csv;q=0.9, application/json;q=0.1")])
        .expect(200);
    assert!(csv.header("content-type").starts_with("text/csv") && csv.header("vary").contains("accept"));
    assert_eq!(
        app.csv("/systems/room/1/windows", &csv.text).expect(200).json()["id"],
        first["id"],
        "the content is that of the window"
    );

    // Channels whose times have nothing in common, a unit that is converted, values with all their digits.
    let odd = "time,P_heater_W,CO2,x[W/m2]\n2026-01-02T00:00:07Z,1234.5678901234567,,0.1\n2026-01-02T00:00:09Z,,400.30000000000001,\n2026-01-02T00:07:00Z,7,,1e-9\n";
    app.csv("/systems/room/1/windows", odd).expect(201);
    let csv = app.get_with("/systems/room/1/series", &[("accept", "text/*")]).expect(200).text;
    app.csv("/systems/room/2/windows", &csv).expect(201);
    let copied = app.get("/systems/room/2/series").json();
    assert_eq!(copied["channels"], app.get("/systems/room/1/series").json()["channels"]);
    assert_eq!(copied["channels"]["P_heater"]["unit"], "kW");
}

#[test]
fn every_fault_of_the_query_is_named() {
    let app = TestApp::start();
    app.room("1", 1);
    let problem = app
        .get("/systems/room/1/series?from=2026-01-02&to=soon&channels=T_rom,T_out,wind&max_points=9")
        .problem(422, "invalid-request");
    let faults: Vec<(&str, &str, &str)> = problem["errors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|fault| {
            [&fault["pointer"], &fault["code"], &fault["suggestion"]]
                .map(|text| text.as_str().unwrap_or_default())
        })
        .map(|[pointer, code, suggestion]| (pointer, code, suggestion))
        .collect();
    assert_eq!(
        faults,
        [
            ("query from", "bad-time", "append an offset, `Z` for UTC: 2026-01-02T00:00:00Z"),
            ("query to", "bad-time", "write it like 2026-01-31T12:00:00Z"),
            ("query channels", "unknown-channel", "did you mean `T_room`?"),
            ("query channels", "unknown-channel", "there are T_out, T_room"),
            ("query max_points", "out-of-range", ""),
        ]
    );
    for range in [
        "from=2026-01-02T00:00:00Z&to=2026-01-02T00:00:00Z",
        "from=2026-01-03T00:00:00Z&to=2026-01-02T00:00:00Z",
    ] {
        let problem = app.get(&format!("/systems/room/1/series?{range}")).problem(422, "invalid-request");
        assert_eq!(problem["errors"][0]["code"], "out-of-order");
    }
    for points in ["100001", "-1", "many", ""] {
        app.get(&format!("/systems/room/1/series?max_points={points}")).problem(422, "invalid-request");
    }
    app.get("/systems/room/1/series?chanels=T_room").problem(422, "invalid-request");
    let refused = app
        .get_with("/systems/room/1/series", &[("accept", "image/png, text/html")])
        .problem(406, "not-acceptable");
    assert!(refused["detail"].as_str().unwrap().contains("text/csv"));
}
