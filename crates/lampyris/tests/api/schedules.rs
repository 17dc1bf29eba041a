//! Schedules submit ordinary jobs.

use crate::support::rooms::{room_csv, stuck_csv};
use crate::support::{TestApp, endless, quick};
use jiff::{SignedDuration, Timestamp};
use lampyris::service::queue::schedules;
use lampyris::store;
use serde_json::{Value, json};
use std::collections::BTreeSet;

#[test]
fn the_nightly_schedule_is_there_and_runs_on_demand() {
    let mut app = TestApp::with(|settings| settings.zone = "Europe/Copenhagen".into());
    let nightly = app.get("/schedules/nightly").expect(200).json();
    assert_eq!(
        (nightly["cron"].as_str(), nightly["zone"].as_str(), &nightly["systems"]),
        (Some("30 2 * * *"), Some("Europe/Copenhagen"), &json!(["room/*"]))
    );
    assert_eq!(
        (nightly["in_words"].as_str(), nightly["next_runs"].as_array().unwrap().len()),
        (Some("At 02:30."), 5)
    );
    app.room("1", 1);
    app.room("2", 2);
    app.json("PUT", "/systems/room/3", &json!({"model": "rc2"})).expect(201);
    app.json("PUT", "/systems/room/4", &json!({"model": "rc2", "policy": {"mode": "observe"}})).expect(201);
    app.json("PUT", "/systems/plant/1", &json!({"model": "rc2"})).expect(201);
    let request = json!({
        "method": {"name": "lm_multistart"}, "budget": {"evaluations": 2000},
        "split": {"train": "P9D", "validation": "P5D"}
    });
    app.json(
        "PUT",
        "/schedules/nightly",
        &json!({"cron": "0 4 * * *", "systems": ["room/*"], "request": request}),
    )
    .expect(200);

    let answer = app.post("/schedules/nightly/run").expect(202);
    let batch = answer.json();
    assert_eq!(answer.header("location"), format!("/batches/{}", batch["id"].as_str().unwrap()));
    let systems: Vec<&str> =
        batch["jobs"].as_array().unwrap().iter().map(|job| job["system"].as_str().unwrap()).collect();
    assert_eq!((systems, batch["schedule"].as_str()), (vec!["room/1", "room/2"], Some("nightly")));
    let skipped: Vec<&str> =
        batch["skipped"].as_array().unwrap().iter().map(|row| row["system"].as_str().unwrap()).collect();
    assert_eq!(skipped, ["room/3", "room/4"]);
    let report = app.until(answer.header("location"), |batch| batch["finished"] == true);
    assert_eq!(report["counts"], json!({"accepted": 2}), "{report}");
    assert!(report["jobs"][0]["why"].is_string() && report["jobs"][0]["error_ratio"].is_null());
    assert_eq!((&report["improved"], &report["rejected"]), (&json!(["room/1", "room/2"]), &json!([])));
    assert_eq!(report["summary"], "of 2 systems 2 have new parameters; 2 left out");
    let job = app.get(&format!("/jobs/{}", report["jobs"][0]["job"].as_str().unwrap())).json();
    assert_eq!((job["origin"].as_str(), job["kind"].as_str()), (Some("scheduled"), Some("estimate")));
    assert_eq!(app.get("/params/room/2").expect(200).json()["status"], "fresh");
    let fits = |report: &Value| -> Vec<Value> {
        let fits = report["jobs"].as_array().unwrap().iter().map(|job| job["fit"].as_str().unwrap());
        fits.map(|fit| app.get(&format!("/fits/{fit}")).expect(200).json()).collect()
    };
    assert!(fits(&report).iter().all(|fit| fit["searched"] == "global"));
    // The next night begins at what is served, but for a system whose turn it is to be searched everywhere.
    let mut again = request.clone();
    again["method"]["seed"] = json!(2);
    let schedule = json!({"cron": "0 4 * * *", "systems": ["room/*"], "request": again});
    app.json("PUT", "/schedules/nightly", &schedule).expect(200);
    let next = app.post("/schedules/nightly/run").expect(202);
    let next = fits(&app.until(next.header("location"), |batch| batch["finished"] == true));
    let is_drawn = |fit: &Value| fit["remarks"].to_string().contains("as on one night in ten");
    assert!(next.iter().all(|fit| is_drawn(fit) != (fit["searched"] == "local")), "{next:?}");
    assert!(next.iter().any(|fit| fit["searched"] == "local"), "{next:?}");

    app.restart();
    let nightly = app.get("/schedules/nightly").json();
    assert_eq!(nightly["cron"], "0 4 * * *");
    assert!(nightly["last_run"]["batch"].is_string() && nightly["last_run"]["batch"] != batch["id"]);
}

#[test]
fn a_tick_submits_one_batch_and_none_while_it_runs() {
    let app = TestApp::start();
    app.room("1", 1);
    let request = json!({"method": {"name": "cfa_thesis"}, "budget": {"evaluations": 100_000_000}});
    // A sixth field in front counts seconds: a tick every second.
    app.json(
        "PUT",
        "/schedules/often",
        &json!({"cron": "* * * * * *", "systems": ["room/1"], "request": request}),
    )
    .expect(201);
    let schedule = app.until("/schedules/often", |schedule| schedule["last_result"] == "skipped_overlap");
    let batch = app.get(&format!("/batches/{}", schedule["last_run"]["batch"].as_str().unwrap())).json();
    assert_eq!(app.get("/jobs").json()["items"].as_array().unwrap().len(), 1, "the first batch still runs");
    app.json(
        "PUT",
        "/schedules/often",
        &json!({"cron": "* * * * * *", "systems": ["room/1"], "enabled": false}),
    )
    .expect(200);
    let job = batch["jobs"][0]["job"].as_str().unwrap();
    assert_eq!(app.get(&format!("/jobs/{job}")).json()["priority"], "nightly");
    app.post(&format!("/jobs/{job}/cancel")).expect(200);
    app.ended(job);
}

#[test]
fn a_report_says_who_improved_by_how_much_and_who_was_refused_and_why() {
    let app = TestApp::start();
    app.room("1", 1);
    app.room("2", 2);
    app.ended(&app.estimate("room/1", json!({})));
    let quick = json!({
        "method": {"name": "lm_multistart"}, "budget": {"evaluations": 2000},
        "split": {"train": "P9D", "validation": "P5D"}
    });
    let mut request = quick.as_object().unwrap().clone();
    request.extend(json!({"fixed": {"alpha_a": 1.2}}).as_object().unwrap().clone());
    // What a schedule says is no experiment of somebody: it is published.
    app.json(
        "PUT",
        "/schedules/trial",
        &json!({"cron": "0 5 * * 1", "systems": ["room/*"], "request": request}),
    )
    .expect(201);
    let first = app.post("/schedules/trial/run").expect(202).json();
    let report =
        app.until(&format!("/batches/{}", first["id"].as_str().unwrap()), |batch| batch["finished"] == true);
    assert_eq!(report["counts"], json!({"accepted": 1, "rejected": 1}), "{report}");
    assert_eq!(
        (&report["improved"], report["rejected"][0]["system"].as_str()),
        (&json!(["room/2"]), Some("room/1"))
    );
    assert!(report["rejected"][0]["why"].as_str().unwrap().starts_with("rejected by "), "{report}");
    // Only the room with an incumbent can say how much worse the new parameters would have been.
    assert!(
        report["jobs"][0]["error_ratio"].as_f64().unwrap() > 1.1
            && report["jobs"][1]["error_ratio"].is_null(),
        "{report}"
    );
    let list = app.get("/batches").expect(200).json();
    assert_eq!(
        (&list["items"][0]["id"], &list["items"][0]["jobs"], &list["items"][0]["finished"]),
        (&first["id"], &json!(2), &json!(true))
    );
}

#[test]
fn the_report_of_twenty_rooms_adds_up() {
    let app = TestApp::start();
    for room in 1..=20 {
        app.room(&room.to_string(), room);
    }
    // Two with a sensor that hangs, one that is only observed; another one was never measured.
    for room in [7, 13] {
        app.csv(&format!("/systems/room/{room}/windows"), &stuck_csv()).expect(201);
    }
    app.json("PUT", "/systems/room/20", &json!({"model": "rc2", "policy": {"mode": "observe"}})).expect(200);
    app.json("PUT", "/systems/room/21", &json!({"model": "rc2"})).expect(201);
    let body = json!({"kind": "recalibrate", "systems": ["room/*"], "method": {"name": "lm_multistart", "seed": 1},
                      "budget": {"evaluations": 2000}, "split": {"train": "P9D", "validation": "P5D"}});
    let answer = app.json("POST", "/jobs", &body).expect(202);
    let report = app.until(answer.header("location"), |batch| batch["finished"] == true);

    let systems = |list: &Value, field: &str| -> BTreeSet<String> {
        let names =
            list.as_array().unwrap().iter().map(|row| if field.is_empty() { row } else { &row[field] });
        names.map(|name| name.as_str().unwrap().to_owned()).collect()
    };
    let jobs = report["jobs"].as_array().unwrap();
    let (asked, skipped) = (systems(&report["jobs"], "system"), systems(&report["skipped"], "system"));
    assert_eq!((jobs.len(), asked.len()), (19, 19), "one job for each room with measurements: {report}");
    assert_eq!(skipped, BTreeSet::from(["room/20".to_owned(), "room/21".to_owned()]));
    let counts: u64 =
        report["counts"].as_object().unwrap().values().map(|count| count.as_u64().unwrap()).sum();
    assert_eq!(counts, 19, "every job is counted once: {}", report["counts"]);

    // The report against the jobs and what is served.
    let jobs: Vec<Value> = jobs
        .iter()
        .map(|row| app.get(&format!("/jobs/{}", row["job"].as_str().unwrap())).expect(200).json())
        .collect();
    let with = |outcome: &str| -> BTreeSet<String> {
        let jobs = jobs.iter().filter(|job| job["outcome"] == outcome);
        jobs.map(|job| job["system"].as_str().unwrap().to_owned()).collect()
    };
    let (improved, rejected) = (systems(&report["improved"], ""), systems(&report["rejected"], "system"));
    assert_eq!((&improved, &rejected), (&with("accepted"), &with("rejected")));
    assert!(
        rejected.is_superset(&BTreeSet::from(["room/13".to_owned(), "room/7".to_owned()])),
        "{rejected:?}"
    );
    assert!(improved.len() >= 15, "{}", report["summary"]);
    let items = app.get("/params").expect(200).json()["items"].clone();
    assert_eq!(systems(&items, "system"), improved);
    let summary = report["summary"].as_str().unwrap();
    assert!(summary.starts_with("of 19 systems ") && summary.ends_with("; 2 left out"), "{summary}");
    assert!(summary.contains(&format!("{} have new parameters", improved.len())), "{summary}");
}

#[test]
fn there_are_several_schedules_and_all_but_the_nightly_one_can_go() {
    let app = TestApp::start();
    app.json(
        "PUT",
        "/schedules/weekly",
        &json!({"cron": "0 5 * * 1", "zone": "Europe/Copenhagen", "systems": ["room/*"]}),
    )
    .expect(201);
    let names = |path: &str| -> Vec<String> {
        let page = app.get(path).expect(200).json();
        page["items"].as_array().unwrap().iter().map(|row| row["name"].as_str().unwrap().to_owned()).collect()
    };
    assert_eq!(names("/schedules"), ["nightly", "weekly"]);
    assert_eq!(names("/schedules?page_size=1&page_token=nightly"), ["weekly"]);
    app.send("DELETE", "/schedules/nightly", &[], None).unwrap().problem(409, "schedule-not-removable");
    app.send("DELETE", "/schedules/weekly", &[], None).unwrap().expect(204);
    app.send("DELETE", "/schedules/weekly", &[], None).unwrap().problem(404, "schedule-not-found");
}

#[test]
fn a_preview_says_when_it_would_run_and_keeps_nothing() {
    let app = TestApp::with(|settings| settings.zone = "Europe/Copenhagen".into());
    let weekly = json!({"cron": "0 5 * * 1", "systems": ["room/*"], "enabled": false});
    let preview = app.json("POST", "/schedules/weekly/preview", &weekly).expect(200).json();
    assert_eq!(preview["zone"], "Europe/Copenhagen");
    let runs: Vec<Timestamp> = preview["next_runs"]
        .as_array()
        .unwrap()
        .iter()
        .map(|run| run.as_str().unwrap().parse().unwrap())
        .collect();
    assert_eq!(runs.len(), 5);
    for run in &runs {
        let local = run.in_tz("Europe/Copenhagen").unwrap();
        assert_eq!((local.hour(), local.minute(), local.weekday()), (5, 0, jiff::civil::Weekday::Monday));
    }
    assert!(
        runs.windows(2)
            .all(|pair| (6 * 24 + 22..=7 * 24 + 2).contains(&pair[1].duration_since(pair[0]).as_hours()))
    );
    app.get("/schedules/weekly").expect(404);
    // Every fault at once, as for the schedule itself.
    let bad = json!({
        "cron": "61 * * * *", "zone": "Mars/Olympus", "systems": ["room"],
        "request": {"budget": {"evaluations": 0}}
    });
    let problem = |method: &str, path: &str| app.json(method, path, &bad).expect(422).json();
    let preview = problem("POST", "/schedules/weekly/preview");
    let pointers: Vec<&str> = preview["errors"]
        .as_array()
        .unwrap()
        .iter()
        .map(|fault| fault["pointer"].as_str().unwrap())
        .collect();
    assert!(
        ["/cron", "/zone", "/systems/0"].iter().all(|pointer| pointers.contains(pointer)),
        "{pointers:?}"
    );
    assert_eq!(preview["errors"], problem("PUT", "/schedules/weekly")["errors"]);
}

#[test]
fn half_past_two_fires_once_on_both_days_of_a_clock_change() {
    let app = TestApp::with(|settings| settings.zone = "Europe/Copenhagen".into());
    // Years ahead of any real clock, so that the service's own timer finds nothing to do meanwhile.
    let cases = [
        ("2040-03-23T12:00:00Z", ["2040-03-24T01:30:00Z", "2040-03-25T01:00:00Z", "2040-03-26T00:30:00Z"]),
        ("2040-10-26T12:00:00Z", ["2040-10-27T00:30:00Z", "2040-10-28T00:30:00Z", "2040-10-29T01:30:00Z"]),
    ];
    for (start, expected) in cases {
        let start: Timestamp = start.parse().unwrap();
        let fired: Vec<String> = app.within(async |service| {
            let tick = async || {
                store::schedules::get(&service.store, schedules::NIGHTLY).await.unwrap().unwrap().last_tick_at
            };
            schedules::due(service, start).await.unwrap();
            let (mut last, mut fired) = (tick().await, Vec::new());
            for minutes in (0..60 * 72).step_by(10) {
                schedules::due(service, start + SignedDuration::from_mins(minutes)).await.unwrap();
                let now = tick().await;
                if now != last {
                    fired.push(now.to_string());
                }
                last = now;
            }
            fired
        });
        assert_eq!(fired, expected);
    }
}

#[test]
fn a_schedule_that_finds_no_room_in_the_queue_holds_up_no_other() {
    let app = TestApp::with(|settings| {
        settings.workers = 1;
        settings.limits.queue = 3;
    });
    for room in 1..=3 {
        app.room(&room.to_string(), room);
    }
    let blocker = app.post_job(&endless("room/1"));
    app.until(&format!("/jobs/{blocker}"), |job| job["state"] == "running");
    let waiting = app.post_job(&quick("room/1"));
    let request = quick("room/1")["method"].clone();
    let schedule = |systems: &str| {
        json!({
            "cron": "0 3 1 1 *", "systems": [systems],
            "request": {"method": request, "budget": {"evaluations": 50}}
        })
    };
    app.json(
        "PUT",
        "/schedules/nightly",
        &json!({"cron": "30 2 * * *", "systems": ["room/*"], "enabled": false}),
    )
    .expect(200);
    app.json("PUT", "/schedules/all", &schedule("room/*")).expect(201);
    app.json("PUT", "/schedules/one", &schedule("room/2")).expect(201);
    let tick = Timestamp::now() + SignedDuration::from_hours(24 * 366);
    let last = |name: &str| app.get(&format!("/schedules/{name}")).expect(200).json()["last_result"].clone();
    app.within(async |service| schedules::due(service, tick).await.unwrap());
    assert_eq!(
        (last("all"), last("one")),
        (Value::Null, json!("submitted")),
        "there is room for one job and not for three"
    );
    for job in [&blocker, &waiting] {
        app.post(&format!("/jobs/{job}/cancel")).expect(200);
    }
    app.until("/batches", |page| page["items"][0]["finished"] == true);
    // The tick was not lost.
    app.within(async |service| schedules::due(service, tick).await.unwrap());
    assert_eq!(last("all"), "submitted");
    app.until("/batches", |page| page["items"][0]["finished"] == true);
}

#[test]
fn a_night_leaves_alone_what_is_frozen() {
    let app = TestApp::start();
    for room in 1..=4 {
        app.room(&room.to_string(), room);
        app.ended(&app.estimate(&format!("room/{room}"), json!({})));
    }
    app.json("PUT", "/params/room/2/pin", &json!({"reason": "the filter is being changed"})).expect(200);
    app.json("PUT", "/systems/room/3", &json!({"model": "rc2", "policy": {"mode": "observe"}})).expect(200);
    app.json("PUT", "/systems/room/4", &json!({"model": "rc2", "policy": {"mode": "suggest"}})).expect(200);
    let served = |room: u32| app.get(&format!("/params/room/{room}")).expect(200).json();
    let before = [served(2), served(3), served(4)];
    // Other parameters than those that are served, so that a fit that passes would be published.
    let request = json!({
        "method": {"name": "lm_multistart"}, "budget": {"evaluations": 2000},
        "split": {"train": "P5D", "validation": "P3D"}
    });
    app.json(
        "PUT",
        "/schedules/nightly",
        &json!({"cron": "30 2 * * *", "systems": ["room/*"], "request": request}),
    )
    .expect(200);
    let report = app.until(app.post("/schedules/nightly/run").expect(202).header("location"), |batch| {
        batch["finished"] == true
    });
    let skipped: Vec<&str> =
        report["skipped"].as_array().unwrap().iter().map(|row| row["system"].as_str().unwrap()).collect();
    assert_eq!((skipped, report["jobs"].as_array().unwrap().len()), (vec!["room/3"], 3), "{report}");
    for (room, before) in [2, 3, 4].into_iter().zip(before) {
        let now = served(room);
        for field in ["parameters", "revision", "fit"] {
            assert_eq!(now[field], before[field], "room/{room}: {field}");
        }
    }
    assert_eq!(served(2)["status"], "pinned");
    assert!(
        report["jobs"].as_array().unwrap()[1..].iter().all(|job| job["outcome"] != "accepted"),
        "{report}"
    );
}

#[test]
fn a_night_asks_nothing_twice_so_that_a_silent_room_turns_stale() {
    let start: Timestamp = "2026-03-01T12:00:00Z".parse().unwrap();
    let app = TestApp::at(&start.to_string(), |_| {});
    for room in 1..=2 {
        app.room(&room.to_string(), room);
    }
    let mut fields = quick("room/1");
    fields.as_object_mut().unwrap().retain(|field, _| !["kind", "system"].contains(&field.as_str()));
    app.json(
        "PUT",
        "/schedules/nightly",
        &json!({"cron": "30 2 * * *", "systems": ["room/*"], "request": fields}),
    )
    .expect(200);
    // The batch of the night before a morning, where there is one.
    let night = |day: i64| -> Option<Value> {
        let now = start + SignedDuration::from_hours(24 * day);
        app.clock.set(now);
        app.within(async |service| schedules::due(service, now).await.unwrap());
        let newest = app.until("/batches?page_size=1", |page| page["items"][0]["finished"] == true)["items"]
            [0]
        .clone();
        let is_new = newest["created_at"].as_str().unwrap().parse::<Timestamp>().unwrap() >= now;
        is_new.then(|| app.get(&format!("/batches/{}", newest["id"].as_str().unwrap())).expect(200).json())
    };
    let asked = |report: &Value| -> Vec<String> {
        report["jobs"]
            .as_array()
            .unwrap()
            .iter()
            .map(|job| job["system"].as_str().unwrap().to_owned())
            .collect()
    };
    // A batch is known to have ended a moment before what it has led to is served.
    let served =
        |room: u32| app.until(&format!("/params/room/{room}"), |params| params["parameters"].is_object());

    assert_eq!(asked(&night(1).unwrap()), ["room/1", "room/2"]);
    let first = served(2);
    assert_eq!(night(2), None, "nothing has come in");
    assert_eq!(app.get("/schedules/nightly").json()["last_result"], "nothing_to_do");
    // One of the rooms goes on measuring.
    app.csv("/systems/room/1/windows", &room_csv(1, 12)).expect(201);
    let third = night(3).unwrap();
    assert_eq!(asked(&third), ["room/1"]);
    let left_out =
        json!([{"system": "room/2", "why": "no measurements have arrived since its last estimate"}]);
    assert_eq!(third["skipped"], left_out, "{third}");
    assert_eq!(
        (&served(2)["validated_at"], &served(2)["revision"]),
        (&first["validated_at"], &first["revision"])
    );
    // Another question about the same measurements is asked, and so is the same one about a system that was
    // changed.
    app.json("PUT", "/systems/room/2", &json!({"model": "rc2", "label": "attic"})).expect(200);
    assert_eq!(asked(&night(4).unwrap()), ["room/2"]);
    let fourth = served(2);
    assert_eq!(night(5), None);
    assert_eq!(
        served(2)["stale_after"],
        fourth["stale_after"],
        "what is served ages although the nights go on"
    );
}
