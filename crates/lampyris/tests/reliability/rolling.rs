//! Loggers that send the last fortnight every quarter of an hour: what is kept, and what an answer costs,
//! goes by what was measured and not by how often it was sent.

use crate::database::{check_database, rows};
use crate::support::rooms::{room_csv, stuck_csv};
use crate::support::{Answer, TestApp, endless, full, seeded};
use crate::upgrades::golden;
use jiff::{SignedDuration, Timestamp};
use lampyris_core::data::{ColumnBindings, SystemId, Window};
use serde_json::{Value, json};
use sqlx::{Connection, SqliteConnection};
use std::time::{Duration, Instant};

const WINDOWS: &str = "/systems/room/1/windows";
const SERIES: &str = "/systems/room/1/series?max_points=100000";
/// Samples of a fortnight.
const FORTNIGHT: usize = 14 * 96;
const QUARTER: SignedDuration = SignedDuration::from_mins(15);
const MOST_RESIDENT_KB: u64 = 150 << 10;
/// What an answer takes beside that of a service that got every sample once.
const MOST_TIMES_LONGER: f64 = 3.0;
/// The database beside one that got every sample once.
const MOST_TIMES_LARGER: u64 = 3;

fn start() -> Timestamp {
    "2026-01-01T00:00:00Z".parse().unwrap()
}

/// Rows of a quarter of an hour each, as a sensor with a hundredth of a kelvin writes them.
fn csv(rows: std::ops::Range<usize>) -> String {
    let mut text = "time,T_room[degC],T_out[degC],P_heater[kW]\n".to_owned();
    for row in rows {
        let hour = row as f64 / 4.0;
        let noise = (row as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 56;
        let (room, out) = (20.0 + (hour / 5.0).sin(), 4.0 + 6.0 * (hour / 3.8).sin());
        let time = start() + QUARTER * row as i32;
        text += &format!("{time},{:.2},{out:.1},{:.1}\n", room + noise as f64 / 1000.0, noise as f64 / 100.0);
    }
    text
}

fn id(answer: &Value) -> String {
    answer["id"].as_str().unwrap().to_owned()
}

fn upload(app: &TestApp, text: &str) -> Answer {
    app.csv(WINDOWS, text)
}

fn room(app: &TestApp) {
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
}

/// A service that got so many windows, one every quarter of an hour, and the ids that it gave them.
fn rolled(windows: usize) -> (TestApp, Vec<String>) {
    let app = TestApp::at("2026-01-15T00:00:00Z", |_| {});
    room(&app);
    let send = |index: usize| {
        app.clock.set(start() + QUARTER * (FORTNIGHT + index) as i32);
        id(&upload(&app, &csv(index..index + FORTNIGHT)).expect(201).json())
    };
    let ids = (0..windows).map(send).collect();
    (app, ids)
}

fn series(app: &TestApp) -> Value {
    app.get(SERIES).expect(200).json()
}

fn values(app: &TestApp) -> Value {
    series(app)["channels"]["T_room"]["values"].clone()
}

fn count(app: &TestApp, sql: &'static str) -> usize {
    rows(&app.database(), sql)[0].parse().unwrap()
}

/// The size of a database behind its last service.
fn size(mut app: TestApp) -> u64 {
    app.stop();
    check_database(&app.database());
    app.database().metadata().unwrap().len()
}

/// The longest of some requests, and how many times as long as those of another service they usually take,
/// which are asked in between.
fn beside(app: &TestApp, other: &TestApp, request: impl Fn(&TestApp, u64)) -> (Duration, f64) {
    let time = |app, round| {
        let begun = Instant::now();
        request(app, round);
        begun.elapsed()
    };
    let (mut ours, mut theirs): (Vec<Duration>, Vec<Duration>) =
        (0..15).map(|round| (time(app, round), time(other, round))).unzip();
    ours.sort_unstable();
    theirs.sort_unstable();
    (ours[14], ours[7].as_secs_f64() / theirs[7].as_secs_f64())
}

fn resident_kb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmRSS")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

/// Runs this test in a process of its own: what other tests keep in memory is not what is measured.
fn ran_alone(name: &str) -> bool {
    const MARK: &str = "ROLLING_ALONE";
    if std::env::var_os(MARK).is_some() {
        return false;
    }
    let mut command = std::process::Command::new(std::env::current_exe().unwrap());
    let said = command.args(["--exact", name, "--show-output"]).env(MARK, "1").output().unwrap();
    // Indented, so that its result is not counted beside that of this process.
    String::from_utf8_lossy(&said.stdout).lines().for_each(|line| println!("  {line}"));
    assert!(said.status.success(), "{}", said.status);
    true
}

#[test]
fn rolling_uploads_cost_what_is_new() {
    if full() && ran_alone("rolling::rolling_uploads_cost_what_is_new") {
        return;
    }
    let windows = if full() { 10_000 } else { 400 };
    let (app, ids) = rolled(windows);
    let days = windows / 96 + 2;
    let known: std::collections::BTreeSet<&String> = ids.iter().collect();
    let kept = count(&app, "SELECT CAST(COUNT(*) AS TEXT) FROM windows");
    assert!(kept <= days && kept == known.len(), "{windows} uploads are {kept} windows");
    assert_eq!(count(&app, "SELECT CAST(SUM(uploads) AS TEXT) FROM windows"), windows);
    // Every sample that was sent is there, once.
    let distinct = FORTNIGHT + windows - 1;
    let all = TestApp::at("2026-12-01T00:00:00Z", |_| {});
    room(&all);
    upload(&all, &csv(0..distinct)).expect(201);
    assert_eq!(series(&app), series(&all));
    let newest = app.get(&format!("/windows/{}", ids[windows - 1])).expect(200).json();
    let report = (&newest["channels"]["T_room"]["samples"], newest["rows"].as_u64().unwrap() as usize);
    assert_eq!(report.0, report.1, "{newest}");
    // What comes again is known, the oldest of the last days as well as the newest.
    for index in [windows - 1, windows - 2, windows - 200] {
        let again = upload(&app, &csv(index..index + FORTNIGHT)).expect(200).json();
        assert_eq!((id(&again), &again["again"]), (ids[index].clone(), &json!(false)));
    }
    let (job, jobs) = beside(&app, &all, |app, seed| {
        let body = seeded(endless("room/1"), seed);
        app.post_job(&body);
    });
    for app in [&app, &all] {
        for job in app.get("/jobs?page_size=100").expect(200).json()["items"].as_array().unwrap() {
            // One that has come to its result meanwhile needs none.
            app.post(&format!("/jobs/{}/cancel", id(job)));
        }
    }
    let a_day = "/systems/room/1/series?from=2026-01-16T00:00:00Z&to=2026-01-17T00:00:00Z";
    let (shown, views) = beside(&app, &all, |app, _| drop(app.get(a_day).expect(200)));
    let resident = resident_kb();
    app.within(async |service| {
        lampyris::service::queue::retention::forget(service, service.now()).await.unwrap()
    });
    let (rolled, once) = (size(app), size(all));
    println!(
        "ROLLING: {windows} windows of a fortnight: {kept} kept, resident {} MB (target 150), POST /jobs \
        {job:?} (target 50 ms), {jobs:.2} times as long as where every sample came once, the series of a day \
        {shown:?} (target 20 ms), {views:.2} times, database {} KiB, {} KiB (target 3 times)",
        resident >> 10,
        rolled >> 10,
        once >> 10
    );
    assert!(rolled <= MOST_TIMES_LARGER * once, "{rolled} beside {once}");
    if full() {
        assert!(resident <= MOST_RESIDENT_KB, "{resident} KiB");
        assert!(jobs <= MOST_TIMES_LONGER && views <= MOST_TIMES_LONGER, "{jobs} {views}");
    }
}

#[test]
fn what_comes_again_over_something_newer_counts_again() {
    let app = TestApp::start();
    room(&app);
    let window =
        |value: &str| format!("time,T_room\n2026-01-03T00:00:00Z,{value}\n2026-01-03T00:30:00Z,{value}\n");
    let (good, bad) = (window("20"), window("30"));
    let first = id(&upload(&app, &good).expect(201).json());
    let second = id(&upload(&app, &bad).expect(201).json());
    assert_eq!(values(&app), json!([30.0, 30.0]));
    let again = upload(&app, &good).expect(200).json();
    assert_eq!((id(&again), &again["again"]), (first.clone(), &json!(true)));
    assert_eq!(values(&app), json!([20.0, 20.0]));
    // A third time there is nothing to do; with a key that was seen, neither.
    assert_eq!(upload(&app, &good).expect(200).json()["again"], false);
    let keyed = |text: &str| {
        let headers = [("content-type", "text/csv"), ("Idempotency-Key", "one")];
        app.send("POST", WINDOWS, &headers, Some(text.as_bytes())).unwrap()
    };
    assert_eq!(keyed(&bad).expect(200).json()["again"], true);
    assert_eq!(upload(&app, &good).expect(200).json()["again"], true);
    assert_eq!(keyed(&bad).expect(200).json()["again"], false, "a repeated request changes nothing");
    assert_eq!(values(&app), json!([20.0, 20.0]));
    app.send("DELETE", &format!("/windows/{second}"), &[], None).unwrap().expect(204);
    assert_eq!(values(&app), json!([20.0, 20.0]));
    app.send("DELETE", &format!("/windows/{first}"), &[], None).unwrap().expect(204);
    assert_eq!(count(&app, "SELECT CAST(COUNT(*) AS TEXT) FROM days"), 0);
}

#[test]
fn what_comes_again_is_the_newest_also_where_it_changes_nothing_now() {
    let app = TestApp::start();
    room(&app);
    let window = |rows: &[(&str, &str)]| {
        let row = |(minute, value): &(&str, &str)| format!("2026-01-03T00:{minute}:00Z,{value}\n");
        format!("time,T_room\n{}", rows.iter().map(row).collect::<String>())
    };
    let first = window(&[("00", "21"), ("15", "22"), ("30", "24")]);
    upload(&app, &first).expect(201);
    upload(&app, &window(&[("15", "20"), ("30", "24")])).expect(201);
    let agrees = id(&upload(&app, &window(&[("00", "21"), ("15", "22")])).expect(201).json());
    assert_eq!(values(&app), json!([21.0, 22.0, 24.0]));
    assert_eq!(upload(&app, &first).expect(200).json()["again"], true);
    // Without the one that agreed with it, the one that did not is still older.
    app.send("DELETE", &format!("/windows/{agrees}"), &[], None).unwrap().expect(204);
    assert_eq!(values(&app), json!([21.0, 22.0, 24.0]));
}

#[test]
fn one_of_several_uploads_that_are_one_window_counts_again() {
    let (app, ids) = rolled(3);
    assert_eq!(ids[0], ids[2]);
    let whole = series(&app);
    let bad = csv(0..FORTNIGHT + 2).replace(",20.", ",25.");
    let bad = id(&upload(&app, &bad).expect(201).json());
    assert_ne!(series(&app), whole);
    // The one in the middle under its own id, the first, whose id is that of the window, under another one.
    for index in [1, 0] {
        let again = upload(&app, &csv(index..index + FORTNIGHT)).expect(200).json();
        assert_eq!((&again["again"], &again["uploads"]), (&json!(true), &json!(1)), "{again}");
        let again = upload(&app, &csv(index..index + FORTNIGHT)).expect(200).json();
        assert_eq!(again["again"], false);
    }
    app.send("DELETE", &format!("/windows/{bad}"), &[], None).unwrap().expect(204);
    assert_eq!(series(&app), whole);
}

#[test]
fn a_rejected_fit_keeps_no_window_and_others_do() {
    let app = TestApp::at("2026-01-16T00:00:00Z", |_| {});
    app.room("1", 1);
    let served = app.ended(&app.estimate("room/1", json!({})));
    assert_eq!(served["outcome"], "accepted");
    let record = id(&app.get(WINDOWS).json()["items"][0]);
    let before = series(&app);
    let bad = id(&upload(&app, &stuck_csv()).expect(201).json());
    let rejected = app.ended(&app.estimate("room/1", json!({})));
    assert_eq!(rejected["outcome"], "rejected");
    let cited = |job: &Value| {
        let fit = app.get(&format!("/fits/{}", job["fit"].as_str().unwrap())).expect(200).json();
        fit["windows"].clone()
    };
    assert_eq!(cited(&rejected), json!([record, bad]));
    let delete = |id: &str| app.send("DELETE", &format!("/windows/{id}"), &[], None).unwrap();
    delete(&bad).expect(204);
    assert_eq!((series(&app), cited(&rejected)), (before, json!([record])));
    assert_eq!(delete(&record).problem(409, "window-cited")["fits"], json!([served["fit"]]));
}

#[test]
fn uploads_at_the_same_time_lie_one_over_the_other() {
    const SENDERS: usize = 6;
    let app = TestApp::at("2026-12-01T00:00:00Z", |_| {});
    room(&app);
    let client = &app.client;
    // Each sends parts of the record that overlap with those of the others, in an order of its own.
    let part = |number: usize| csv(number * 40..number * 40 + 100);
    let sent: std::collections::BTreeSet<String> = std::thread::scope(|scope| {
        let send = |sender: usize| {
            let parts = (0..12).map(move |step| part((step * 5 + sender * 7) % 12));
            parts.map(|text| id(&client.csv(WINDOWS, &text).json())).collect::<Vec<String>>()
        };
        let senders: Vec<_> = (0..SENDERS).map(|sender| scope.spawn(move || send(sender))).collect();
        senders.into_iter().flat_map(|sender| sender.join().unwrap()).collect()
    });
    let once = TestApp::at("2026-12-01T00:00:00Z", |_| {});
    room(&once);
    upload(&once, &csv(0..11 * 40 + 100)).expect(201);
    assert_eq!(series(&app), series(&once));
    assert_eq!(count(&app, "SELECT CAST(COUNT(*) AS TEXT) FROM windows"), sent.len());
    for id in &sent {
        app.send("DELETE", &format!("/windows/{id}"), &[], None).unwrap().expect(204);
    }
    assert_eq!(count(&app, "SELECT CAST(COUNT(*) AS TEXT) FROM days"), 0);
}

/// Windows over each other: parts of a record, another unit, a correction, a repetition.
fn overlapping() -> Vec<String> {
    let meter = |from: usize, unit: &str| {
        let row = |row: usize| format!("{},{}\n", start() + QUARTER * row as i32, row % 7);
        format!("time,meter[{unit}]\n{}", (from..from + 150).map(row).collect::<String>())
    };
    vec![
        room_csv(1, 3),
        meter(40, "kW"),
        csv(0..200),
        meter(100, "W"),
        csv(50..120).replace(",20.", ",21."),
        csv(30..260),
        meter(20, "kW"),
        room_csv(1, 2),
    ]
}

#[test]
fn windows_of_an_earlier_program_are_taken_in_as_they_are() {
    let dir = tempfile::tempdir().unwrap();
    let (database, _) = golden(dir.path(), 27);
    let read = |text: &String| Window::parse_csv(text, &ColumnBindings::none()).unwrap().0;
    let named = |(place, text): (usize, &String)| (format!("win_of_before_{place}"), read(text));
    let mut windows: Vec<(String, Window)> = overlapping().iter().enumerate().map(named).collect();
    // At first, every block held all that its window had, and there were no days.
    tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap().block_on(async {
        let mut db = SqliteConnection::connect(&format!("sqlite://{}", database.display())).await.unwrap();
        for sql in [
            "DELETE FROM days WHERE system = 'room/2'",
            "DELETE FROM windows WHERE system = 'room/2'",
            "UPDATE counters SET value = 2000 WHERE name = 'sequence'",
        ] {
            sqlx::query(sql).execute(&mut db).await.unwrap();
        }
        for (place, (id, window)) in windows.iter().enumerate() {
            let sql = "INSERT INTO windows (id, system, sequence, from_ms, to_ms, report, uploaded_at) SELECT $1, \
                'room/2', $2, $3, $4, report, uploaded_at FROM windows WHERE system = 'room/1'";
            let query = sqlx::query(sql).bind(id).bind(1000 + place as i64).bind(window.from());
            query.bind(window.to()).execute(&mut db).await.unwrap();
            for series in window.iter() {
                let sql = "INSERT INTO window_blocks (window_id, channel, block) VALUES ($1, $2, $3)";
                let query = sqlx::query(sql).bind(id).bind(series.channel()).bind(series.encode());
                query.execute(&mut db).await.unwrap();
            }
        }
        // A damaged block costs what is in it, and not the start.
        let sql = "INSERT INTO window_blocks (window_id, channel, block) VALUES ($1, 'lost', X'00')";
        sqlx::query(sql).bind(&windows[0].0).execute(&mut db).await.unwrap();
        db.close().await.unwrap();
    });
    let app = TestApp::at("2026-11-26T13:00:00Z", |settings| settings.database = database.into());
    let channels = app.get("/systems/room/2/series").expect(200).json()["channels"].clone();
    assert_eq!(channels.get("lost"), None, "{channels}");
    let system: SystemId = "room/2".parse().unwrap();
    let is_stitched = |app: &TestApp, windows: &[(String, Window)]| {
        let all: Vec<Window> = windows.iter().map(|(_, window)| window.clone()).collect();
        let stitched = Window::stitch(&all).unwrap();
        let days = app.within(async |service| {
            let span = (stitched.from(), stitched.to());
            lampyris::store::measured::read(&service.store, &system, span, None).await.unwrap()
        });
        for series in stitched.iter() {
            assert_eq!(days.series(series.channel()).unwrap().as_ref(), Some(series));
        }
    };
    is_stitched(&app, &windows);
    // And every one of them can be taken out again.
    while windows.len() > 1 {
        let (id, _) = windows.remove(windows.len() / 2);
        app.send("DELETE", &format!("/windows/{id}"), &[], None).unwrap().expect(204);
        is_stitched(&app, &windows);
    }
}
