//! What the database itself refuses, whoever asks: the constraints behind the invariants.

use crate::support::TestApp;
use serde_json::json;
use sqlx::{Connection, SqliteConnection};

/// Runs one statement and gives the complaint.
async fn complaint(connection: &mut SqliteConnection, sql: &'static str) -> String {
    match sqlx::query(sql).execute(connection).await {
        Ok(done) => format!("nothing: {} rows were changed", done.rows_affected()),
        Err(error) => error.to_string(),
    }
}

#[test]
fn an_unvalidated_set_cannot_be_served() {
    let mut app = TestApp::start();
    app.room("1", 1);
    app.ended(&app.estimate("room/1", json!({})));
    let stuck: String = crate::support::rooms::room_csv(1, 14)
        .lines()
        .map(|line| {
            let mut cells: Vec<&str> = line.split(',').collect();
            if cells[0] > "2026-01-07" && cells[0] != "time" {
                cells[1] = "19.0";
            }
            cells.join(",") + "\n"
        })
        .collect();
    app.csv("/systems/room/1/windows", &stuck).expect(201);
    let rejected = app.ended(&app.estimate("room/1", json!({})));
    assert_eq!(rejected["outcome"], "rejected");
    app.stop();
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let mut db =
            SqliteConnection::connect(&format!("sqlite://{}", app.database().display())).await.unwrap();
        let insert = "INSERT INTO revisions (system, revision, fit, job, served, served_hash, model_hash, \
            window_from, window_to, current, fitted_at, validated_at)
                      SELECT system, 2, id, job, '{}', '', '', '', '', FALSE, 0, 0 FROM fits WHERE verdict = \
            'rejected'";
        assert!(complaint(&mut db, insert).await.contains("needs an accepted fit"));
        let second = "INSERT INTO revisions (system, revision, fit, job, served, served_hash, model_hash, \
            window_from, window_to, current, fitted_at, validated_at)
                      SELECT system, 2, fit, job, served, '', '', '', '', TRUE, 0, 0 FROM revisions";
        assert!(complaint(&mut db, second).await.contains("UNIQUE"), "two current revisions");
        let back = "INSERT INTO revisions (system, revision, fit, job, served, served_hash, model_hash, \
            window_from, window_to, current, fitted_at, validated_at)
                    SELECT system, 7, fit, job, served, '', '', '', '', FALSE, 0, 0 FROM revisions";
        assert!(complaint(&mut db, back).await.contains("count up by one"));
        assert!(
            complaint(&mut db, "UPDATE fits SET verdict = 'accepted' WHERE verdict = 'rejected'")
                .await
                .contains("do not change")
        );
        assert!(complaint(&mut db, "UPDATE revisions SET served = '{}'").await.contains("does not change"));
        assert!(
            complaint(&mut db, "UPDATE jobs SET state = 'queued'").await.contains("CHECK"),
            "a job that has an outcome has ended"
        );
        assert!(complaint(&mut db, "UPDATE jobs SET state = 'lost'").await.contains("CHECK"));
        db.close().await.unwrap();
    });
}

#[test]
fn a_database_of_a_newer_program_is_refused() {
    let mut app = TestApp::start();
    app.stop();
    let runtime = tokio::runtime::Runtime::new().unwrap();
    let address = format!("sqlite://{}", app.database().display());
    let error = runtime.block_on(async {
        let mut db = SqliteConnection::connect(&address).await.unwrap();
        let newer =
            "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time) VALUES \
            (9999, 'newer', TRUE, x'00', 0)";
        sqlx::query(newer).execute(&mut db).await.unwrap();
        db.close().await.unwrap();
        let settings =
            lampyris::settings::Settings {
                bind: "127.0.0.1:0".parse().unwrap(), database: app.database(), ..Default::default()
            };
        lampyris::app::App::start(settings).await.err().unwrap()
    });
    assert!(error.to_string().contains("9999"), "{error}");
}
