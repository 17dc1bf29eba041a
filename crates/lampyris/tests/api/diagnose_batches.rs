//! Diagnoses of several systems: asked for at once, by a schedule, and reported together.

use crate::support::TestApp;
use crate::support::rooms::room_csv;
use jiff::SignedDuration;
use lampyris::service::queue::schedules;
use lampyris::store::tokens::Scope;
use serde_json::{Value, json};

/// A diagnosis that is done at once: of two days nothing can be said.
fn short() -> Value {
    json!({"window": {"last": "P2D"}, "method": {"name": "lm_multistart", "seed": 1}})
}

#[test]
fn a_report_groups_what_the_diagnoses_of_several_systems_came_to() {
    let app = TestApp::at("2026-02-10T00:00:00Z", |settings| settings.diagnose.accusation_rate = 0.02);
    app.room("1", 1);
    // Nothing that is served changes, so one that is only observed is looked at as well.
    app.json("PUT", "/systems/room/2", &json!({"model": "rc2", "policy": {"mode": "observe"}})).expect(201);
    app.csv("/systems/room/2/windows", &room_csv(2, 36)).expect(201);
    app.room("3", 3);
    let failed = app.failing("room/3", json!({}));
    assert_eq!(app.ended(&failed)["state"], "failed");
    app.json("PUT", "/systems/room/4", &json!({"model": "rc2"})).expect(201);
    app.json("PUT", "/systems/room/5", &json!({"model": "rc2"})).expect(201);
    app.csv("/systems/room/5/windows", &room_csv(5, 2)).expect(201);

    let body =
        json!({"kind": "diagnose", "systems": ["room/*"], "method": {"name": "lm_multistart", "seed": 1}});
    let answer = app.json("POST", "/jobs", &body).expect(202);
    let report = app.until(answer.header("location"), |batch| batch["finished"] == true);
    assert_eq!((report["kind"].as_str(), &report["improved"]), (Some("diagnose"), &json!([])), "{report}");
    let jobs = report["jobs"].as_array().unwrap();
    let systems: Vec<&str> = jobs.iter().map(|job| job["system"].as_str().unwrap()).collect();
    assert_eq!(systems, ["room/1", "room/2", "room/3", "room/5"]);
    assert_eq!(report["skipped"][0]["system"], "room/4");

    // Each row is what its diagnosis says, and stands in the group of its verdict.
    for row in [&jobs[0], &jobs[1], &jobs[3]] {
        let job = app.get(&format!("/jobs/{}", row["job"].as_str().unwrap())).expect(200).json();
        assert_eq!(
            (job["kind"].as_str(), &job["experiment"], &job["request"]["accusation_rate"]),
            (Some("diagnose"), &json!(true), &json!(0.02))
        );
        assert_eq!(
            job["request"]["split"]["test"], "P7D",
            "a part that no decision sees: {}",
            job["request"]
        );
        let diagnosis =
            app.get(&format!("/diagnoses/{}", row["diagnosis"].as_str().unwrap())).expect(200).json();
        assert_eq!((&row["verdict"], &row["why"]), (&diagnosis["verdict"], &diagnosis["summary"]));
        for finding in diagnosis["findings"].as_array().unwrap() {
            let named = report["diagnosed"]["named"]
                .as_array()
                .unwrap()
                .iter()
                .find(|one| one["effect"] == finding["effect"])
                .unwrap();
            assert!(named["systems"].as_array().unwrap().contains(&row["system"]), "{report}");
        }
        if row["verdict"] != "named" {
            let group = report["diagnosed"][row["verdict"].as_str().unwrap()].as_array().unwrap();
            assert!(group.contains(&row["system"]), "{report}");
        }
    }
    assert_eq!(
        (&report["diagnosed"]["not_enough_data"], &report["rejected"][0]["system"]),
        (&json!(["room/5"]), &json!("room/3")),
        "{report}"
    );
    let counts: u64 =
        report["counts"].as_object().unwrap().values().map(|count| count.as_u64().unwrap()).sum();
    assert_eq!((counts, &report["counts"]["failed"]), (4, &json!(1)), "{report}");
    let summary = report["summary"].as_str().unwrap();
    let ending = "1 have too few data to tell, 1 got no diagnosis; 1 left out";
    assert!(summary.starts_with("of 4 systems ") && summary.ends_with(ending), "{summary}");
    for named in report["diagnosed"]["named"].as_array().unwrap() {
        let words =
            format!("{} {}", named["effect"].as_str().unwrap(), named["systems"].as_array().unwrap().len());
        assert!(summary.contains(&words), "{summary}");
    }
    assert_eq!(app.get("/batches").json()["items"][0]["kind"], "diagnose");
    app.get("/params/room/2").problem(404, "no-validated-parameters");
}

#[test]
fn what_makes_no_sense_of_several_systems_is_refused() {
    let app = TestApp::start();
    app.room("1", 1);
    let faults = |body: Value| -> Vec<String> {
        let problem = app.json("POST", "/jobs", &body).problem(422, "invalid-request");
        problem["errors"]
            .as_array()
            .unwrap()
            .iter()
            .map(|fault| fault["pointer"].as_str().unwrap().to_owned())
            .collect()
    };
    assert_eq!(
        faults(json!({"kind": "recalibrate", "systems": ["room/*"], "accusation_rate": 0.05})),
        ["/accusation_rate"]
    );
    assert_eq!(
        faults(
            json!({"kind": "diagnose", "systems": ["room/*"], "accusation_rate": 0.5, "criterion": "lrt"})
        )
        .len(),
        2
    );
    assert_eq!(faults(json!({"kind": "diagnose", "systems": ["room/*"], "system": "room/1"})), ["/systems"]);
    assert_eq!(faults(json!({"kind": "diagnose", "systems": []})), ["/systems"]);
    let stranger = app.token("stranger", Scope::Operate, &["room/2"]);
    stranger
        .json("POST", "/jobs", &json!({"kind": "diagnose", "systems": ["room/*"]}))
        .problem(403, "out-of-reach");
}

#[test]
fn a_schedule_diagnoses_week_by_week_where_something_new_was_measured() {
    let app = TestApp::start();
    app.room("1", 1);
    let body = json!({"cron": "0 5 * * 1", "kind": "diagnose", "systems": ["room/*"], "request": short()});
    let made = app.json("PUT", "/schedules/weekly", &body).expect(201).json();
    assert_eq!(
        (made["kind"].as_str(), &made["request"], &made["systems"]),
        (Some("diagnose"), &short(), &json!(["room/*"]))
    );
    assert_eq!(app.get("/schedules/nightly").json()["kind"], "recalibrate");
    let wrong = |change: Value| {
        let mut body = body.clone();
        body.as_object_mut().unwrap().extend(change.as_object().unwrap().clone());
        let problem = app.json("POST", "/schedules/weekly/preview", &body).problem(422, "invalid-request");
        problem["errors"][0]["pointer"].as_str().unwrap().to_owned()
    };
    assert_eq!(wrong(json!({"kind": "ladder"})), "/kind");
    assert_eq!(wrong(json!({"request": {"kind": "diagnose"}})), "/request/kind");
    assert_eq!(
        wrong(json!({"kind": "recalibrate", "request": {"accusation_rate": 0.05}})),
        "/request/accusation_rate"
    );
    let rate = json!({
        "cron": "0 5 * * 1", "kind": "diagnose", "systems": ["room/*"], "request": {"accusation_rate": 0.05}
    });
    app.json("POST", "/schedules/weekly/preview", &rate).expect(200);

    let week = |weeks: i64| {
        app.clock.set(
            "2026-01-19T05:00:30Z".parse::<jiff::Timestamp>().unwrap()
                + SignedDuration::from_hours(168 * weeks),
        )
    };
    let weekly = |result: &str| {
        app.within(async |service| schedules::due(service, service.now()).await.unwrap());
        app.until("/schedules/weekly", |schedule| schedule["last_result"] == result)
    };
    app.json(
        "PUT",
        "/schedules/nightly",
        &json!({"cron": "30 2 * * *", "systems": ["room/*"], "enabled": false}),
    )
    .expect(200);
    week(0);
    let batch = format!("/batches/{}", weekly("submitted")["last_run"]["batch"].as_str().unwrap());
    let report = app.until(&batch, |batch| batch["finished"] == true);
    assert_eq!((report["kind"].as_str(), report["schedule"].as_str()), (Some("diagnose"), Some("weekly")));
    assert_eq!(report["diagnosed"]["not_enough_data"], json!(["room/1"]), "{report}");
    week(1);
    weekly("nothing_to_do");
}
