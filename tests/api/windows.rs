//! Uploaded windows: what a fit cites, and what can be deleted.

use crate::support::{TestApp, endless, room, room_csv};
use serde_json::{Value, json};
use sqlx::{Connection, SqliteConnection};

fn id(document: &Value) -> String {
    document["id"].as_str().unwrap().to_owned()
}

fn delete(app: &TestApp, path: &str) -> crate::support::Answer {
    app.send("DELETE", path, &[], None).unwrap()
}

/// Runs a quick estimate and gives what it found.
fn fit(app: &TestApp, system: &str, more: Value) -> Value {
    let ended = app.ended(&app.estimate(system, more));
    app.get(&format!("/fits/{}", ended["fit"].as_str().unwrap_or_else(|| panic!("{ended}")))).expect(200).json()
}

#[test]
fn a_fit_cites_what_it_has_seen_and_nothing_else_is_kept_by_force() {
    let app = TestApp::start();
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    let upload = |text: &str| id(&app.csv("/systems/room/1/windows", text).expect(201).json());
    // Wholly covered by the record; part of the record; a correction of some samples; beyond what the fit asks for.
    let covered = upload("time,T_room,T_out\n2026-01-03T00:00:00Z,1,1\n2026-01-03T00:30:00Z,1,1\n");
    let record = upload(&room_csv(1, 14));
    let rows = room(1, 14);
    let correction: String = rows[100..110].iter().map(|(time, room, _)| format!("{time},{:.3}\n", room + 0.01)).collect();
    let correction = upload(&format!("time,T_room\n{correction}"));
    let later = upload("time,T_room,T_out\n2026-03-01T00:00:00Z,20,1\n2026-03-01T00:30:00Z,20,1\n");
    let fit = fit(&app, "room/1", json!({"window": {"to": "2026-01-15T00:00:00Z"}}));
    assert_eq!(fit["windows"], json!([record, correction]));

    for cited in [&record, &correction] {
        let problem = delete(&app, &format!("/windows/{cited}")).problem(409, "window-cited");
        assert_eq!(problem["fits"], json!([fit["id"]]));
        app.get(&format!("/windows/{cited}")).expect(200);
    }
    for free in [&covered, &later] {
        assert_eq!(delete(&app, &format!("/windows/{free}")).expect(204).text, "");
        app.get(&format!("/windows/{free}")).problem(404, "window-not-found");
        delete(&app, &format!("/windows/{free}")).problem(404, "window-not-found");
    }
    assert_eq!(app.get("/systems/room/1/windows").json()["items"].as_array().unwrap().len(), 2);
    assert_eq!(app.get("/systems/room/1/series").json()["to"], "2026-01-14T23:30:00Z");
}

#[test]
fn what_a_window_covered_shows_again_when_it_is_gone() {
    let app = TestApp::start();
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    app.csv("/systems/room/1/windows", "time,T_room\n2026-01-03T00:00:00Z,20\n2026-01-03T00:30:00Z,21\n").expect(201);
    let wrong = "time,T_room\n2026-01-03T00:00:00Z,30\n2026-01-03T00:30:00Z,31\n";
    let first = id(&app.csv("/systems/room/1/windows", wrong).expect(201).json());
    let values = || app.get("/systems/room/1/series").json()["channels"]["T_room"]["values"].clone();
    assert_eq!(values(), json!([30.0, 31.0]));
    delete(&app, &format!("/windows/{first}")).expect(204);
    assert_eq!(values(), json!([20.0, 21.0]));
    // What is gone is new again when it comes again.
    assert_eq!(id(&app.csv("/systems/room/1/windows", wrong).expect(201).json()), first);
    assert_eq!(values(), json!([30.0, 31.0]));
}

#[test]
fn a_running_job_keeps_its_windows_and_those_of_its_neighbours() {
    let app = TestApp::start();
    app.room("1", 1);
    app.room("2", 2);
    app.room("3", 3);
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "neighbours": ["room/2"]})).expect(200);
    let window = |room: &str| format!("/windows/{}", id(&app.get(&format!("/systems/room/{room}/windows")).json()["items"][0]));
    let job = id(&app.json("POST", "/jobs", &endless("room/1")).expect(202).json());
    app.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
    for room in ["1", "2"] {
        assert_eq!(delete(&app, &window(room)).problem(409, "window-in-use")["jobs"], json!([job]));
    }
    delete(&app, &window("3")).expect(204);
    app.post(&format!("/jobs/{job}/cancel")).expect(200);
    app.ended(&job);
    delete(&app, &window("2")).expect(204);
    delete(&app, &window("1")).expect(204);
}

#[test]
fn fits_of_an_earlier_schema_cite_all_that_they_may_have_seen() {
    let mut app = TestApp::start();
    app.room("1", 1);
    app.room("2", 2);
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "neighbours": ["room/2"]})).expect(200);
    let later = "time,T_room,T_out\n2026-03-01T00:00:00Z,20,1\n2026-03-01T00:30:00Z,20,1\n";
    let later = id(&app.csv("/systems/room/1/windows", later).expect(201).json());
    let before = fit(&app, "room/1", json!({"window": {"to": "2026-01-15T00:00:00Z"}}));
    let own = id(&app.get("/systems/room/1/windows").json()["items"][1]);
    let neighbour = id(&app.get("/systems/room/2/windows").json()["items"][0]);
    assert_eq!(before["windows"], json!([own, neighbour]), "both are in the stitched input");
    app.stop();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let mut db = SqliteConnection::connect(&format!("sqlite://{}", app.database().display())).await.unwrap();
        for sql in ["DROP TABLE fit_windows", "DELETE FROM _sqlx_migrations WHERE version = 3"] {
            sqlx::query(sql).execute(&mut db).await.unwrap();
        }
        db.close().await.unwrap();
    });
    app.restart();
    let after = app.get(&format!("/fits/{}", id(&before))).expect(200).json();
    assert_eq!(after, before);
    delete(&app, &format!("/windows/{own}")).problem(409, "window-cited");
    delete(&app, &format!("/windows/{neighbour}")).problem(409, "window-cited");
    delete(&app, &format!("/windows/{later}")).expect(204);
}
