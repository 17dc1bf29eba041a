//! What is old goes, and what anybody may still ask for stays.

use crate::support::rooms::{csv_of, room, stuck_csv};
use crate::support::{TestApp, cluster};
use jiff::SignedDuration;
use lampyris::service::queue::retention::{self, Forgotten};
use serde_json::{Value, json};

/// Lets days pass, and forgets what is old by then. No night comes between and forgets it first.
fn later(app: &TestApp, days: i64) -> Forgotten {
    let paused = json!({"cron": "0 3 * * *", "systems": ["room/*"], "enabled": false});
    app.json("PUT", "/schedules/nightly", &paused).expect(200);
    app.clock.set(app.clock.now() + SignedDuration::from_hours(24 * days));
    app.within(async |service| retention::forget(service, service.now()).await.unwrap())
}

fn statuses(app: &TestApp, jobs: &[&str]) -> Vec<u16> {
    jobs.iter().map(|job| app.get(&format!("/jobs/{job}")).status).collect()
}

#[test]
fn what_is_old_and_named_by_nothing_goes_and_the_rest_stays() {
    let app = TestApp::with(|settings| settings.retention.jobs_days = 30);
    app.room("1", 1);
    let experiment = |seed: u64| {
        app.ended(&app.estimate(
            "room/1",
            json!({"experiment": true, "method": {"name": "lm_multistart", "seed": seed}}),
        ))
    };
    let id = |job: &Value| job["id"].as_str().unwrap().to_owned();
    let served = id(&app.ended(&app.estimate("room/1", json!({}))));
    let idle = experiment(2);
    let repeated = experiment(3);
    let again = id(&app.ended(
        app.post(&format!("/jobs/{}/retry", id(&repeated))).expect(202).json()["id"].as_str().unwrap(),
    ));
    // Refused: the fallback names it.
    app.csv("/systems/room/1/windows", &stuck_csv()).expect(201);
    let refused = app.ended(&app.estimate("room/1", json!({})));
    assert_eq!(refused["outcome"], "rejected");
    let newest = id(&experiment(4));
    // Suggested: the newest waits for an operator, who would not go back to an older one.
    app.room("2", 2);
    app.json("PUT", "/systems/room/2", &json!({"model": "rc2", "policy": {"mode": "suggest"}})).expect(200);
    let suggest = |seed: u64| {
        let method = json!({"name": "lm_multistart", "seed": seed});
        let ended = app.ended(&app.estimate("room/2", json!({"method": method})));
        assert_eq!(ended["outcome"], "suggested");
        ended
    };
    let (earlier, suggested) = (suggest(5), suggest(6));
    let after = id(&app.ended(&app.estimate("room/2", json!({"experiment": true}))));
    let params = app.get("/params/room/1").expect(200).text;

    let jobs = [
        served.as_str(),
        &id(&idle),
        &id(&repeated),
        &again,
        &id(&refused),
        &newest,
        &id(&earlier),
        &id(&suggested),
        &after,
    ];
    assert_eq!(later(&app, 29), Forgotten::default(), "nothing is old yet");
    assert_eq!(statuses(&app, &jobs), [200; 9]);
    assert_eq!(later(&app, 2).jobs, 3);
    assert_eq!(
        statuses(&app, &jobs),
        [200, 404, 200, 404, 200, 200, 404, 200, 200],
        "the one that was repeated waits for its repetition"
    );
    app.get(&format!("/fits/{}", idle["fit"].as_str().unwrap())).problem(404, "fit-not-found");
    assert_eq!(later(&app, 1).jobs, 1);
    assert_eq!(later(&app, 1), Forgotten::default());
    assert_eq!(statuses(&app, &jobs), [200, 404, 404, 404, 200, 200, 404, 200, 200]);

    // What is served is served, explained and decided as before.
    let now = app.get("/params/room/1").expect(200).json();
    let before: Value = serde_json::from_str(&params).unwrap();
    assert_eq!((&now["parameters"], &now["fallback"]["fit"]), (&before["parameters"], &refused["fit"]));
    app.get(&format!("/fits/{}/comparison?max_points=10", now["fit"].as_str().unwrap())).expect(200);
    let promote = json!({"reason": "it waited long enough"});
    app.json("POST", &format!("/fits/{}/promote", suggested["fit"].as_str().unwrap()), &promote).expect(200);
    assert_eq!(app.get("/params/room/2").expect(200).json()["fit"], suggested["fit"]);
    assert_eq!(later(&app, 400), Forgotten::default(), "the refused one is still what the fallback names");
}

#[test]
fn windows_go_only_where_that_is_asked_for_and_no_fit_has_read_them() {
    let days = |from: usize, to: usize| csv_of(&room(1, 120)[from * 48..to * 48]);
    let upload = |app: &TestApp| -> Vec<String> {
        app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
        let parts = [(0, 14), (14, 28), (28, 42), (42, 120)];
        let sent =
            parts.map(|(from, to)| app.csv("/systems/room/1/windows", &days(from, to)).expect(201).json());
        // The fit reads the second fortnight alone.
        let window = json!({"from": "2026-01-15T00:00:00Z", "to": "2026-01-28T23:30:00Z"});
        assert_eq!(app.ended(&app.estimate("room/1", json!({"window": window})))["outcome"], "accepted");
        sent.iter().map(|window| window["id"].as_str().unwrap().to_owned()).collect()
    };
    let there = |app: &TestApp, windows: &[String]| {
        windows.iter().map(|id| app.get(&format!("/windows/{id}")).status).collect::<Vec<_>>()
    };

    let app = TestApp::at("2026-12-01T00:00:00Z", |_| {});
    let windows = upload(&app);
    assert_eq!(later(&app, 4000).windows, 0);
    assert_eq!(there(&app, &windows), [200; 4], "measurements are kept for ever by default");

    let app = TestApp::at("2026-12-01T00:00:00Z", |settings| settings.retention.windows_days = 80);
    let windows = upload(&app);
    assert_eq!(later(&app, 79).windows, 0, "they came less than eighty days ago");
    assert_eq!(later(&app, 4000).windows, 1);
    assert_eq!(
        there(&app, &windows),
        [404, 200, 200, 200],
        "the second is read by a fit, the third ends less than eighty days before the newest"
    );
    let deeds = app.get("/audit").expect(200).json();
    let deed = &deeds["items"][0];
    assert_eq!(
        (&deed["action"], &deed["who"], &deed["subject"]),
        (&json!("delete_window"), &json!("service"), &json!(windows[0])),
        "{deeds}"
    );
    assert!(deed["reason"].as_str().unwrap().contains("80 days"), "{deed}");
}

#[test]
fn windows_that_newer_ones_cover_go_when_they_are_old() {
    let app = TestApp::at("2026-12-01T00:00:00Z", |settings| settings.retention.windows_days = 80);
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    let upload = |text: &str| app.csv("/systems/room/1/windows", text).expect(201).json()["id"].clone();
    let row = |day: u32, value: u32| format!("2026-11-{day:02}T00:00:00Z,{value}\n");
    let windows = [
        upload(&format!("time,T_room\n{}{}", row(1, 20), row(2, 20))),
        upload(&format!("time,T_room\n{}{}", row(1, 21), row(2, 21))),
        upload(&format!("time,T_room\n{}{}", row(2, 22), row(3, 22))),
    ];
    let values = || app.get("/systems/room/1/series").json()["channels"]["T_room"]["values"].clone();
    assert_eq!(later(&app, 79).windows, 0);
    let before = values();
    assert_eq!(later(&app, 2).windows, 1, "nothing of the first counts any more");
    let there = windows.map(|id| app.get(&format!("/windows/{}", id.as_str().unwrap())).status);
    assert_eq!((there, values()), ([404, 200, 200], before));
}

#[test]
fn batches_go_with_their_jobs_and_the_newest_one_of_a_schedule_stays() {
    let app = TestApp::at("2026-12-01T00:00:00Z", |settings| settings.retention.jobs_days = 30);
    app.room("1", 1);
    let request = json!({
        "method": {"name": "lm_multistart", "seed": 1}, "budget": {"evaluations": 2000},
        "split": {"train": "P9D", "validation": "P5D"}
    });
    app.json(
        "PUT",
        "/schedules/nightly",
        &json!({"cron": "0 4 29 2 *", "systems": ["room/*"], "request": request}),
    )
    .expect(200);
    let run = || -> Value {
        let answer = app.post("/schedules/nightly/run").expect(202);
        app.until(answer.header("location"), |batch| batch["finished"] == true)
    };
    let good = run();
    // What is refused leaves the first one in service, and only the newest refusal is named by the fallback.
    app.csv("/systems/room/1/windows", &stuck_csv()).expect(201);
    let batches = [good, run(), run()];
    let outcomes: Vec<&str> =
        batches.iter().map(|batch| batch["jobs"][0]["outcome"].as_str().unwrap()).collect();
    assert_eq!(outcomes, ["accepted", "rejected", "rejected"], "{batches:?}");
    assert_eq!(later(&app, 31), Forgotten { jobs: 1, batches: 1, ..Forgotten::default() });
    let statuses: Vec<u16> = batches
        .iter()
        .map(|batch| app.get(&format!("/batches/{}", batch["id"].as_str().unwrap())).status)
        .collect();
    assert_eq!(statuses, [200, 404, 200]);
}

#[test]
fn samples_go_by_whole_months_whatever_has_read_them() {
    let app = TestApp::at("2026-04-20T00:00:00Z", |settings| settings.retention.samples_days = 60);
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    // January to March, in pieces.
    let all = room(1, 90);
    let parts = [(0, 20), (20, 45), (45, 90)];
    let windows = parts.map(|(from, to)| {
        let sent = app.csv("/systems/room/1/windows", &csv_of(&all[from * 48..to * 48])).expect(201).json();
        sent["id"].as_str().unwrap().to_owned()
    });
    let window = json!({"from": "2026-01-15T00:00:00Z", "to": "2026-01-28T23:30:00Z"});
    let fit = app.ended(&app.estimate("room/1", json!({"window": window})));
    assert_eq!(fit["outcome"], "accepted");
    let fit = format!("/fits/{}", fit["fit"].as_str().unwrap());
    let (served, found) = (app.get("/params/room/1").text, app.get(&fit).json());
    let from =
        |app: &TestApp| app.get("/systems/room/1/series?max_points=10").expect(200).json()["from"].clone();
    assert_eq!(from(&app), "2026-01-01T00:00:00Z");

    // On 30 April, sixty days ago is 1 March: January and February lie before.
    assert_eq!(later(&app, 10), Forgotten { windows: 2, samples: first(2, 59), ..Forgotten::default() });
    assert_eq!(from(&app), "2026-03-01T00:00:00Z");
    let there = windows.map(|id| app.get(&format!("/windows/{id}")).status);
    assert_eq!(there, [404, 404, 200]);
    assert_eq!(later(&app, 0), Forgotten::default(), "nothing is left to forget");
    // What was found, and what is served, is what it was.
    assert_eq!(app.get("/params/room/1").text, served);
    let after = app.get(&fit).expect(200).json();
    assert_eq!((&after["parameters"], &after["verdict"]), (&found["parameters"], &found["verdict"]));
    app.get(&format!("{fit}/comparison")).expect(422);
    // What comes again is taken again, and lasts until the next night.
    app.csv("/systems/room/1/windows", &csv_of(&all[..48])).expect(201);
    assert_eq!(from(&app), "2026-01-01T00:00:00Z");
    assert_eq!(later(&app, 1).windows, 1);
    assert_eq!(from(&app), "2026-03-01T00:00:00Z");
}

/// On a server samples go by months, in a file by days of systems.
fn first(months: u64, days: u64) -> u64 {
    if cluster::is_on() { months } else { days }
}

#[test]
fn fits_that_were_never_served_are_shortened_to_what_decides() {
    let app = TestApp::at("2026-12-01T00:00:00Z", |settings| settings.retention.traces_days = 30);
    app.room("1", 1);
    let ended =
        |request: Value| app.ended(&app.estimate("room/1", request))["fit"].as_str().unwrap().to_owned();
    let served = ended(json!({}));
    app.csv("/systems/room/1/windows", &stuck_csv()).expect(201);
    let refused = ended(json!({}));
    let fits = || [&served, &refused].map(|id| app.get(&format!("/fits/{id}")).expect(200).json());
    let before = fits();
    assert_eq!(before.each_ref().map(|fit| fit["verdict"].clone()), ["accepted", "rejected"]);
    assert_eq!(later(&app, 29).traces, 0);
    assert_eq!(later(&app, 2), Forgotten { traces: 1, ..Forgotten::default() });
    assert_eq!(later(&app, 2).traces, 0);
    let after = fits();
    assert_eq!(after[0], before[0]);
    assert_eq!((&after[1]["trace"], &after[1]["covariance"]), (&json!([]), &Value::Null));
    for (what, value) in before[1].as_object().unwrap() {
        assert!(["trace", "covariance"].contains(&what.as_str()) || after[1][what] == *value, "{what}");
    }
}
