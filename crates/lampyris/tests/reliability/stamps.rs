//! Times as they come: clocks that change twice a year, run backwards, count in milliseconds, or jump.

use crate::support::process::Process;
use crate::support::rooms::room;
use crate::support::{TestApp, endless, quick};
use serde_json::{Value, json};
use std::fmt::Write;
use std::process::Command;
use std::time::Duration;

/// What a window of these times, a sample each, is answered.
fn post(app: &TestApp, times: &[&str]) -> crate::support::Answer {
    let mut csv = "time,T_room[degC]\n".to_owned();
    times.iter().enumerate().for_each(|(row, time)| writeln!(csv, "{time},{}", 20 + row % 3).unwrap());
    app.csv("/systems/room/1/windows", &csv)
}

#[test]
fn every_kind_of_time_is_kept_in_utc_or_refused_by_name() {
    let app = TestApp::at("2026-12-01T00:00:00Z", |_| {});
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    let kept = |from: &str, to: &str| {
        app.get(&format!("/systems/room/1/series?from={from}&to={to}")).expect(200).json()["channels"]["T_room"]["time"].clone()
    };
    // Offsets of all kinds are instants; the hour that comes twice is two hours.
    let mixed = [
        "2026-01-01T00:00:00Z",
        "2026-01-01T01:10:00+01:00",
        "2026-01-01T06:05:00+05:45",
        "2025-12-31T16:30:00-08:00",
    ];
    post(&app, &mixed).expect(201);
    assert_eq!(
        kept("2026-01-01T00:00:00Z", "2026-01-01T00:30:00Z"),
        json!([
            "2026-01-01T00:00:00Z",
            "2026-01-01T00:10:00Z",
            "2026-01-01T00:20:00Z",
            "2026-01-01T00:30:00Z"
        ])
    );
    let autumn = [
        "2026-10-25T02:00:00+02:00",
        "2026-10-25T02:30:00+02:00",
        "2026-10-25T02:00:00+01:00",
        "2026-10-25T02:30:00+01:00",
    ];
    assert_eq!(post(&app, &autumn).expect(201).json()["rows"], 4);
    assert_eq!(kept("2026-10-25T00:00:00Z", "2026-10-25T01:30:00Z").as_array().unwrap().len(), 4);
    let spring = ["2026-03-29T01:30:00+01:00", "2026-03-29T03:00:00+02:00", "2026-03-29T03:30:00+02:00"];
    assert_eq!(post(&app, &spring).expect(201).json()["longest_gap_s"], Value::Null);
    assert_eq!(kept("2026-03-29T00:30:00Z", "2026-03-29T01:30:00Z")[1], "2026-03-29T01:00:00Z");
    // A leap second is the second before it.
    assert_eq!(
        post(&app, &["2016-12-31T23:59:58Z", "2016-12-31T23:59:60Z", "2017-01-01T00:00:01Z"])
            .expect(201)
            .json()["rows"],
        3
    );
    assert_eq!(post(&app, &["2026-12-01T23:50:00Z", "2026-12-02T00:00:00Z"]).expect(201).json()["rows"], 2);
    // Gaps from a second to a month stay what they are.
    let gaps =
        ["2026-05-01T00:00:00Z", "2026-05-01T00:00:01Z", "2026-05-01T00:10:00Z", "2026-05-31T00:10:00Z"];
    let report = post(&app, &gaps).expect(201).json();
    assert_eq!(
        (&report["rows"], &report["channels"]["T_room"]["longest_gap_s"]),
        (&json!(4), &json!(30 * 86_400)),
        "{report}"
    );
    // Seconds and milliseconds since 1970 are no other times.
    for (times, from) in [
        (["1780444800", "1780445400"], "2026-06-03T00:00:00Z"),
        (["1780531200000", "1780531800000"], "2026-06-04T00:00:00Z"),
    ] {
        assert_eq!(post(&app, &times).expect(201).json()["from"], from);
    }
    let refused = [
        (["2026-06-01T00:00:00", "2026-06-01T00:10:00"], "naive-time"),
        (["2026-03-29T02:30:00", "2026-03-29T03:00:00"], "naive-time"),
        (["17802.5", "17802.6"], "numeric-time"),
        (["0001-01-01T00:00:00Z", "0001-01-01T00:10:00Z"], "rejected-rows"),
        (["9999-01-01T00:00:00Z", "9999-01-01T00:10:00Z"], "rejected-rows"),
        (["2026-13-01T00:00:00Z", "2026-02-30T00:10:00Z"], "rejected-rows"),
        (["2026-06-02T00:10:00Z", "2026-06-02T00:00:00Z"], "rejected-rows"),
        (["2026-06-03T00:00:00Z", "2026-06-03T00:00:00Z"], "rejected-rows"),
        // A day ahead may be a clock that is a little off, more is none of today's measurements.
        (["2026-12-01T23:50:00Z", "2026-12-02T00:05:00Z"], "future-time"),
        (["2026-12-01T23:50:00Z", "2036-12-01T23:50:00Z"], "future-time"),
    ];
    for (times, code) in &refused {
        let problem = post(&app, times).problem(422, "invalid-request");
        assert_eq!(problem["errors"][0]["code"], *code, "{times:?}: {problem}");
    }
    println!(
        "TIME-1: offsets, both changes of the clock, a leap second and gaps are kept in UTC; {} kinds \
        refused by name",
        refused.len()
    );
}

/// The same measurements, told by the clock of Copenhagen over its change, and in UTC.
#[test]
fn a_fit_over_the_change_of_the_clock_is_that_of_the_same_data_in_utc() {
    let app = TestApp::at("2026-12-01T00:00:00Z", |_| {});
    let zone = jiff::tz::TimeZone::get("Europe/Copenhagen").unwrap();
    for (system, start) in [("spring", "2026-03-22T00:00:00Z"), ("autumn", "2026-10-18T00:00:00Z")] {
        let shift =
            start.parse::<jiff::Timestamp>().unwrap().duration_since("2026-01-01T00:00:00Z".parse().unwrap());
        let header = "time,T_room[degC],T_out[degC]\n";
        let (mut utc, mut local) = (header.to_owned(), header.to_owned());
        let mut offsets = std::collections::BTreeSet::new();
        for (time, inside, outside) in room(11, 14) {
            let instant = time.parse::<jiff::Timestamp>().unwrap() + shift;
            let zoned = instant.to_zoned(zone.clone());
            offsets.insert(zoned.offset().to_string());
            writeln!(utc, "{instant},{inside:.3},{outside:.3}").unwrap();
            writeln!(local, "{},{inside:.3},{outside:.3}", zoned.strftime("%Y-%m-%dT%H:%M:%S%:z")).unwrap();
        }
        assert_eq!(offsets.len(), 2, "the record crosses the change: {offsets:?}");
        let fits = [("utc", utc), ("local", local)].map(|(name, csv)| {
            let id = format!("room/{system}_{name}");
            app.json("PUT", &format!("/systems/{id}"), &json!({"model": "rc2"})).expect(201);
            app.csv(&format!("/systems/{id}/windows"), &csv).expect(201);
            let ended = app.ended(&app.post_job(&quick(&id)));
            let fit = app.get(&format!("/fits/{}", ended["fit"].as_str().unwrap())).expect(200).json();
            ["parameters", "metrics", "cost", "trace", "parts", "checks", "input_hash"]
                .map(|field| fit[field].clone())
        });
        assert!(!fits[0][0].is_null() && fits[0][6].is_string());
        assert_eq!(fits[0], fits[1], "{system}");
    }
    println!("TIME-1: fits over both changes of the clock have the bits of those in UTC");
}

/// The wall clock of the service jumps while a job runs, to and fro, by hours and years.
#[test]
fn jumps_of_the_clock_neither_end_jobs_nor_double_them() {
    let wrapped = Command::new("faketime").args(["-m", "-f", "+0", "printenv", "LD_PRELOAD"]).output();
    let Ok(library) = wrapped.map(|output| String::from_utf8(output.stdout).unwrap().trim().to_owned())
    else {
        println!("SKIPPED: TIME-2 needs faketime");
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let clock = dir.path().join("clock");
    let set = |text: &str| {
        // Written beside and moved, so that nobody reads half of it.
        std::fs::write(dir.path().join("next"), format!("{text}\n")).unwrap();
        std::fs::rename(dir.path().join("next"), &clock).unwrap();
    };
    set("+0");
    let mut service = Process::start_by_clock(&library, &clock, &dir.path().join("clock.db"));
    let year = |service: &Process| -> i64 {
        let listed = service.client.get("/jobs?page_size=1").json();
        listed["items"][0]["created_at"].as_str().unwrap()[..4].parse().unwrap()
    };
    service.client.room("1", 1);
    service.client.room("2", 2);
    let mut posted = vec![service.client.estimate("room/2", json!({}))];
    assert_eq!(service.client.ended(&posted[0])["outcome"], "accepted");
    let now = year(&service);
    let mut body = endless("room/1");
    body["method"]["generations"] = json!(10_000);
    let running = service.client.post_job(&body);
    service.client.until(&format!("/jobs/{running}"), |job| job["state"] == "running");
    let (mut revision, mut years) = (1, Vec::new());
    let jumps = ["+1h", "-1h", "+1y", "-1y", "@1970-01-02 00:00:00", "@2037-01-01 00:00:00", "+0"];
    for (index, jump) in jumps.iter().enumerate() {
        set(jump);
        std::thread::sleep(Duration::from_millis(200));
        service.client.get("/readyz").expect(200);
        let job = service
            .client
            .estimate("room/2", json!({"method": {"name": "lm_multistart", "seed": 100 + index}}));
        let ended = service.client.ended(&job);
        assert_eq!((&ended["state"], &ended["attempt"]), (&json!("succeeded"), &json!(1)), "{jump}: {ended}");
        posted.push(job);
        years.push(year(&service));
        let job = service.client.get(&format!("/jobs/{running}")).expect(200).json();
        assert_eq!((&job["state"], &job["attempt"]), (&json!("running"), &json!(1)), "{jump}: {job}");
        let params = service.client.get("/params/room/2").expect(200).json();
        assert!(params["revision"].as_i64().unwrap() >= revision, "{jump}: {params}");
        revision = params["revision"].as_i64().unwrap();
    }
    assert_eq!(years, [now, now, now + 1, now - 1, 1970, 2037, now], "the clock of the service did jump");
    // A start under a clock that went back years finds the running job and goes on with it.
    set("-1y");
    service.kill();
    service = Process::start_by_clock(&library, &clock, &dir.path().join("clock.db"));
    let again = service.client.until(&format!("/jobs/{running}"), |job| job["state"] == "running");
    assert_eq!(again["attempt"], 2, "{again}");
    assert_eq!(service.client.get("/params/room/2").expect(200).json()["revision"], revision);
    service.client.post(&format!("/jobs/{running}/cancel")).expect(200);
    assert_eq!(service.client.ended(&running)["state"], "cancelled");
    let listed = service.client.get("/jobs?page_size=100").json();
    let ids: std::collections::BTreeSet<&str> =
        listed["items"].as_array().unwrap().iter().map(|job| job["id"].as_str().unwrap()).collect();
    assert!(
        ids.len() == posted.len() + 1 && posted.iter().all(|job| ids.contains(job.as_str())),
        "{ids:?} {posted:?}"
    );
    println!(
        "TIME-2: {} jumps and a start by another clock: {} jobs, none lost, none doubled",
        jumps.len(),
        ids.len()
    );
}
