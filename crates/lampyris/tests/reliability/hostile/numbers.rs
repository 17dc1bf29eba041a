//! Numbers that are none, and numbers in the wrong unit: a refusal with its place, or a gap, and never a
//! parameter.

use crate::support::rooms::{csv_of, room, room_csv};
use crate::support::{TestApp, quick};
use serde_json::{Value, json};

/// What becomes of the room's and the other column's value.
type Change = dyn Fn(f64, f64) -> (f64, f64);

/// Every number of a document is one; `null` stands where there is none.
fn numbers_are_finite(text: &str) -> bool {
    !["NaN", "Infinity", "inf,", "-inf", "nan"].iter().any(|word| text.contains(word))
        && serde_json::from_str::<Value>(text).is_ok()
}

#[test]
fn texts_at_the_edge_of_json_are_refused_with_their_place() {
    let app = TestApp::with(|settings| settings.limits.window_bytes = 32 << 20);
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    let window = |value: &str| {
        format!("{{\"channels\":{{}},\"time\":[\"2026-01-01T00:00:00Z\",\"2026-01-01T01:00:00Z\"],\"values\":{{\"x\":[1,{value}]}}}}")
            .into_bytes()
    };
    let nested =
        |open: &str, close: &str| format!("{}1{}", open.repeat(100_000), close.repeat(100_000)).into_bytes();
    let repeated = format!("{{{}\"b\":1}}", "\"a\":1,".repeat(1_000_000)).into_bytes();
    let cases: Vec<(&str, Vec<u8>, &[u16])> = vec![
        ("arrays in arrays", nested("[", "]"), &[400]),
        ("objects in objects", nested("{\"a\":", "}"), &[400]),
        ("a million equal names", repeated, &[422]),
        ("1e400", window("1e400"), &[400]),
        ("-1e400", window("-1e400"), &[400]),
        ("NaN", window("NaN"), &[400]),
        ("\"NaN\"", window("\"NaN\""), &[201, 422]),
        ("1e308", window("1e308"), &[200, 201, 422]),
        ("1e-400", window("1e-400"), &[200, 201]),
        ("-0", window("-0"), &[200, 201]),
        ("a number of 40,000 digits", window(&"9".repeat(40_000)), &[400, 422]),
        ("a fraction of 40,000 digits", window(&format!("0.{}", "9".repeat(40_000))), &[201, 422]),
        ("a lone surrogate", window("\"\\ud800\""), &[400]),
        ("a zero in a name", window("1],\"\\u0000\":[1,2").to_vec(), &[201, 422]),
        ("a mark of byte order", [b"\xef\xbb\xbf".to_vec(), window("2")].concat(), &[201, 400]),
    ];
    let mut said = Vec::new();
    for (what, body, statuses) in &cases {
        let answer = app
            .send("POST", "/systems/room/1/windows", &[("content-type", "application/json")], Some(body))
            .unwrap();
        assert!(
            statuses.contains(&answer.status),
            "{what}: {} {}",
            answer.status,
            answer.text.chars().take(300).collect::<String>()
        );
        assert!(
            answer.text.len() < 64 << 10 && numbers_are_finite(&answer.text.replace("NaN", "")),
            "{what}: {}",
            answer.text
        );
        if answer.status >= 400 {
            let errors = answer.json()["errors"].clone();
            assert!(errors[0]["pointer"].is_string() && errors[0]["detail"].is_string(), "{what}: {errors}");
        }
        said.push(format!("{what} {}", answer.status));
    }
    println!("DOS-3: {}", said.join(", "));
    // What was taken is a number, or is not there.
    assert!(numbers_are_finite(&app.get("/systems/room/1/series").text));
}

#[test]
fn storms_of_numbers_that_are_none_never_reach_the_parameters() {
    let app = TestApp::start();
    app.room("1", 1);
    assert_eq!(app.ended(&app.estimate("room/1", json!({})))["outcome"], "accepted");
    let rows = room(7, 14);
    let (mut taken, mut refused, mut accepted) = (0, 0, 0);
    let mut count = 0;
    for (column, tokens) in [(0, ["NaN", "", "inf"]), (1, ["NaN", "", "-inf"]), (2, ["inf", "", "1e999"])] {
        for token in tokens {
            for share in [0.001, 0.01, 0.1, 0.5, 1.0] {
                let every = (1.0 / share) as usize;
                let system = format!("n{count}");
                count += 1;
                let mut csv = "time,T_room[degC],T_out[degC]\n".to_owned();
                for (row, (time, inside, outside)) in rows.iter().enumerate() {
                    let mut cells = [time.clone(), format!("{inside:.3}"), format!("{outside:.3}")];
                    // The first and the last sample are among them.
                    if row % every == 0 || (row + 1 == rows.len() && share < 1.0) {
                        cells[column] = token.to_owned();
                    }
                    csv += &(cells.join(",") + "\n");
                }
                app.json("PUT", &format!("/systems/room/{system}"), &json!({"model": "rc2"})).expect(201);
                let answer = app.csv(&format!("/systems/room/{system}/windows"), &csv);
                assert!(
                    [201, 422].contains(&answer.status),
                    "{column} {token:?} {share}: {} {}",
                    answer.status,
                    answer.text
                );
                // An empty cell is a gap; a text that is no number costs its row, and the window where a
                // tenth of it is lost.
                if share <= 0.01 {
                    assert_eq!(answer.status, 201, "{column} {token:?} {share}: {}", answer.text);
                }
                if answer.status == 422 {
                    refused += 1;
                    continue;
                }
                taken += 1;
                assert!(numbers_are_finite(&app.get(&format!("/systems/room/{system}/series")).text));
                let posted = app.json("POST", "/jobs", &quick(&format!("room/{system}")));
                if posted.status == 202 {
                    let ended = app.ended(posted.json()["id"].as_str().unwrap());
                    accepted += usize::from(ended["outcome"] == "accepted");
                    // Where every other sample is there, the sensor is one that measures half as often.
                    assert!(
                        ended["outcome"] != "accepted" || share <= 0.5,
                        "{column} {token:?} {share}: {ended}"
                    );
                } else {
                    posted.problem(422, "invalid-request");
                }
            }
        }
    }
    let all = app.get("/params").expect(200);
    assert!(numbers_are_finite(&all.text));
    for set in all.json()["items"].as_array().unwrap() {
        assert!(set["parameters"].as_object().unwrap().values().all(Value::is_f64), "{set}");
    }
    // The same as documents: `null` is a gap, and there is no other way to say that there is no number.
    let nulls: Vec<Value> = rows
        .iter()
        .enumerate()
        .map(|(row, sample)| if row % 3 == 0 { json!(null) } else { json!(sample.1) })
        .collect();
    let times: Vec<&String> = rows.iter().map(|row| &row.0).collect();
    let out: Vec<f64> = rows.iter().map(|row| row.2).collect();
    let body = json!({"time": times, "values": {"T_room": nulls, "T_out": out}});
    app.json("PUT", "/systems/room/nulls", &json!({"model": "rc2"})).expect(201);
    app.json("POST", "/systems/room/nulls/windows", &body).expect(201);
    println!(
        "NAN-1: {count} storms, {taken} windows taken, {refused} refused, {accepted} fits accepted, every \
        served number is one"
    );
    assert!(taken >= 18 && refused >= 6 && accepted >= 9, "{taken} {refused} {accepted}");
}

/// Whole records in another unit than the channel's, with no word about it.
#[test]
fn records_in_the_wrong_unit_are_refused_or_converted() {
    let app = TestApp::start();
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    let rows: Vec<_> =
        room(3, 3).into_iter().map(|(time, inside, outside)| (time, inside + 6.0, outside)).collect();
    let csv = |header: &str, change: &Change| {
        let mut text = format!("time,{header}\n");
        for (time, inside, outside) in &rows {
            let (one, other) = change(*inside, *outside);
            text += &format!("{time},{one:.4},{other:.4}\n");
        }
        text
    };
    let wrong: [(&str, &Change); 7] = [
        ("T_room,T_out", &|inside, outside| (inside * 1.8 + 32.0, outside)),
        ("T_room,T_out", &|inside, outside| (inside + 273.15, outside)),
        ("T_room,T_out", &|inside, outside| (inside, outside + 273.15)),
        ("T_room,P_heater", &|inside, outside| (inside, 1500.0 + outside)),
        ("T_room,cloud_cover", &|inside, outside| (inside, 50.0 + outside)),
        ("T_room,flow", &|inside, outside| (inside, 40.0 + outside)),
        ("T_room,irradiance", &|inside, _| (inside, 40_000.0)),
    ];
    for (header, change) in wrong {
        let problem =
            app.csv("/systems/room/1/windows", &csv(header, change)).problem(422, "invalid-request");
        let codes: Vec<&str> = problem["errors"]
            .as_array()
            .unwrap()
            .iter()
            .map(|fault| fault["code"].as_str().unwrap())
            .collect();
        assert_eq!(codes, ["implausible-values"], "{header}: {problem}");
    }
    // The same with the unit said: what is kept is the channel's own.
    let said: [(&str, &Change); 4] = [
        ("T_room[degF],T_out[degC]", &|inside, outside| (inside * 1.8 + 32.0, outside)),
        ("T_room[K],T_out[degC]", &|inside, outside| (inside + 273.15, outside)),
        ("T_room_degC,T_out[K]", &|inside, outside| (inside, outside + 273.15)),
        ("T_room[degC],P_heater[W]", &|inside, outside| (inside, 1000.0 * (2.0 + outside / 100.0))),
    ];
    for (header, change) in said {
        app.csv("/systems/room/1/windows", &csv(header, change)).expect(201);
        let series = app.get("/systems/room/1/series?channels=T_room").expect(200).json();
        let values = series["channels"]["T_room"]["values"].as_array().unwrap();
        let worst = values
            .iter()
            .zip(&rows)
            .map(|(value, row)| (value.as_f64().unwrap() - row.1).abs())
            .fold(0.0, f64::max);
        assert!(worst < 1e-3, "{header}: {worst}");
    }
    let heater = app.get("/systems/room/1/series?channels=P_heater").expect(200).json();
    assert!(
        (heater["channels"]["P_heater"]["values"][0].as_f64().unwrap() - (2.0 + rows[0].2 / 100.0)).abs()
            < 1e-6,
        "{heater}"
    );
    // Rates per second and per hour: the units of an equation are checked, and a scale is never guessed.
    let model = |unit: &str| {
        json!({
            "id": "rates", "title": "A rate", "states": {"T_room": {"unit": "degC", "initial": "T_room"}},
            "inputs": {"T_out": {"unit": "degC"}},
            "parameters": {"k": {
                "unit": unit, "lower": 1e-6, "upper": 1.0, "nominal": 0.001, "scale": "log"
            }},
            "equations": {"T_room": "k*(T_out - T_room)"},
            "outputs": {"T_room": {"expr": "T_room", "unit": "degC", "noise_sd": 0.05}},
        })
    };
    let faults =
        |unit: &str| app.json("POST", "/models/validate", &model(unit)).expect(200).json()["errors"].clone();
    assert_eq!(faults("1/h"), json!([]));
    for unit in ["1/s", "1/d", "1", "K/h"] {
        assert_eq!(faults(unit)[0]["code"], "unit", "{unit}: {}", faults(unit));
    }
    println!(
        "UNIT-1: {} wrong units refused, {} stated ones converted, 4 rates refused",
        wrong.len(),
        said.len()
    );
    // The good record is good.
    app.json("PUT", "/systems/room/2", &json!({"model": "rc2"})).expect(201);
    assert_eq!(app.csv("/systems/room/2/windows", &csv_of(&rows)).expect(201).json()["warnings"], json!([]));
    app.csv("/systems/room/2/windows", &room_csv(3, 3)).expect(201);
}

/// A number whose square is none would reach what is said of a room, and no document can hold that.
#[test]
fn numbers_without_a_square_are_left_out_and_what_was_written_of_them_is_read() {
    let mut app = TestApp::at("2026-01-16T00:00:00Z", |_| {});
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    let csv = room_csv(1, 15);
    let with = |cell: &str| {
        let end = |row: usize| match row {
            0 => "meter_raw",
            600 => cell,
            _ => "1",
        };
        csv.lines().enumerate().map(|(row, line)| format!("{line},{}\n", end(row))).collect::<String>()
    };
    for cell in ["1e308", "-1e200", "1e16"] {
        // What is left of them is one window.
        let report = app.csv("/systems/room/1/windows", &with(cell)).json();
        assert!(report["warnings"].to_string().contains("outside"), "{cell}: {report}");
    }
    app.csv("/systems/room/1/windows", &with("1e15")).expect(201);
    let ended = app.ended(&app.estimate("room/1", json!({})));
    app.get(&format!("/fits/{}", ended["fit"].as_str().unwrap())).expect(200);
    // An earlier version has written such an error as `null`.
    app.stop();
    app.block_on(async {
        use sqlx::Connection;
        let path = format!("sqlite://{}", app.database().display());
        let mut db = sqlx::SqliteConnection::connect(&path).await.unwrap();
        let sql = r#"INSERT INTO degradations (system, revision, description, since_at)
            SELECT system, revision, '{"error":null,"limit":1.0,"unit":"K","horizon":"PT6H","from":"2026-01-15T00:00:00Z",
            "to":"2026-01-16T00:00:00Z"}', 0 FROM revisions WHERE current"#;
        assert_eq!(sqlx::query(sql).execute(&mut db).await.unwrap().rows_affected(), 1);
        db.close().await.unwrap();
    });
    app.restart();
    let served = app.get("/params/room/1").expect(200).json();
    assert_eq!(served["status"], "degraded", "{served}");
}
