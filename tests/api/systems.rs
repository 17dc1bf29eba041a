//! Rooms and plants: their documents, their rows in the list, and their end.

use crate::support::{Answer, TestApp, endless};
use serde_json::json;
use sqlx::{AssertSqlSafe, Connection, SqliteConnection};

fn delete(app: &TestApp, path: &str) -> Answer {
    app.send("DELETE", path, &[], None).unwrap()
}

/// What the database still knows of a system: tables with rows that name it, and broken references.
fn remains(app: &TestApp, system: &str) -> Vec<String> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let mut db = SqliteConnection::connect(&format!("sqlite://{}", app.database().display())).await.unwrap();
        let sql = "SELECT m.name FROM sqlite_master m JOIN pragma_table_info(m.name) c WHERE m.type = 'table' AND c.name = 'system'";
        let tables: Vec<String> = sqlx::query_scalar(sql).fetch_all(&mut db).await.unwrap();
        assert!(tables.len() >= 6, "{tables:?}");
        let mut remains: Vec<String> =
            sqlx::query_scalar("SELECT \"table\" FROM pragma_foreign_key_check").fetch_all(&mut db).await.unwrap();
        for table in tables {
            let sql = format!("SELECT COUNT(*) FROM {table} WHERE system = $1");
            let rows: i64 = sqlx::query_scalar(AssertSqlSafe(sql)).bind(system).fetch_one(&mut db).await.unwrap();
            if rows > 0 {
                remains.push(table);
            }
        }
        db.close().await.unwrap();
        remains
    })
}

#[test]
fn a_system_without_history_goes_when_no_job_needs_it() {
    let app = TestApp::start();
    app.room("1", 1);
    let job = app.json("POST", "/jobs", &endless("room/1")).expect(202).json()["id"].as_str().unwrap().to_owned();
    app.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
    for path in ["/systems/room/1", "/systems/room/1?force=true"] {
        assert_eq!(delete(&app, path).problem(409, "system-busy")["jobs"], json!([job]));
    }
    app.post(&format!("/jobs/{job}/cancel")).expect(200);
    app.ended(&job);
    assert_eq!(app.get("/params/room/1?accept=nominal").expect(200).header("params-status"), "nominal");
    delete(&app, "/systems/room/1").expect(204);
    for path in ["/systems/room/1", "/params/room/1", "/params/room/1?accept=nominal", "/systems/room/1/series", "/systems/room/1/state"] {
        app.get(path).problem(404, "system-not-found");
    }
    app.get(&format!("/jobs/{job}")).problem(404, "job-not-found");
    assert_eq!((app.get("/systems").json()["items"].clone(), app.get("/jobs").json()["items"].clone()), (json!([]), json!([])));
    delete(&app, "/systems/room/1").problem(404, "system-not-found");
    delete(&app, "/systems/room/1?forced=true").problem(422, "invalid-request");
    assert_eq!(remains(&app, "room/1"), [""; 0]);
}

#[test]
fn history_goes_only_by_force_and_then_completely() {
    let mut app = TestApp::start();
    app.room("1", 1);
    app.room("2", 2);
    app.json("PUT", "/systems/room/1", &json!({"model": "rc2", "neighbours": ["room/2"]})).expect(200);
    let batch = json!({"kind": "recalibrate", "systems": ["room/*"], "method": {"name": "lm_multistart"}, "budget": {"evaluations": 600},
        "split": {"train": "P9D", "validation": "P5D"}});
    let answer = app.json_with("POST", "/jobs", &[("idempotency-key", "one")], &batch).expect(202);
    let report = app.until(answer.header("location"), |batch| batch["finished"] == true);
    assert_eq!(report["counts"], json!({"accepted": 2}), "{report}");
    let kept = app.get("/params/room/1").expect(200);

    let problem = delete(&app, "/systems/room/2").problem(409, "system-needed");
    assert_eq!(problem["dependents"], json!(["room/1"]));
    assert!(problem["detail"].as_str().unwrap().contains("1 fits, 1 revisions"), "{problem}");
    assert_eq!(app.get("/params/room/2").expect(200).json()["revision"], 1);

    delete(&app, "/systems/room/2?force=true").expect(204);
    assert_eq!(remains(&app, "room/2"), [""; 0]);
    app.get("/params/room/2").problem(404, "system-not-found");
    assert_eq!(app.get("/params").json()["items"].as_array().unwrap().len(), 1);
    let report = app.get(answer.header("location")).expect(200).json();
    assert_eq!(report["jobs"].as_array().unwrap().len(), 1, "the batch tells of what is left");
    // The other room keeps what it has; its fit no longer cites what is gone.
    assert_eq!(app.get("/params/room/1").text, kept.text);
    let fit = app.get(&format!("/fits/{}", kept.json()["fit"].as_str().unwrap())).json();
    assert_eq!(fit["windows"].as_array().unwrap().len(), 1, "{fit}");

    app.restart();
    app.get("/params/room/2").problem(404, "system-not-found");
    app.room("2", 2);
    app.get("/params/room/2").problem(404, "no-validated-parameters");
    app.ended(&app.estimate("room/2", json!({})));
    assert_eq!(app.get("/params/room/2").expect(200).json()["revision"], 1, "a new system counts from one");
}
