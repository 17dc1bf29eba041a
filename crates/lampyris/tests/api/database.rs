//! What the database itself refuses, whoever asks: the constraints behind the invariants.

use crate::support::TestApp;
use serde_json::json;

/// Runs one statement and gives the complaint.
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
    let complaint = |sql: &str| match app.behind(sql) {
        Ok(_) => format!("nothing: {sql}"),
        Err(error) => error,
    };
    let insert = "INSERT INTO revisions (system, revision, fit, job, served, served_hash, model_hash, \
            window_from, window_to, current, fitted_at, validated_at)
                      SELECT system, 2, id, job, '{}', '', '', '', '', FALSE, 0, 0 FROM fits WHERE verdict = \
            'rejected'";
    assert!(complaint(insert).contains("needs an accepted fit"));
    let second = "INSERT INTO revisions (system, revision, fit, job, served, served_hash, model_hash, \
            window_from, window_to, current, fitted_at, validated_at)
                      SELECT system, 2, fit, job, served, '', '', '', '', TRUE, 0, 0 FROM revisions";
    assert!(complaint(second).to_lowercase().contains("unique"), "two current revisions");
    let back = "INSERT INTO revisions (system, revision, fit, job, served, served_hash, model_hash, \
            window_from, window_to, current, fitted_at, validated_at)
                    SELECT system, 7, fit, job, served, '', '', '', '', FALSE, 0, 0 FROM revisions";
    assert!(complaint(back).contains("count up by one"));
    assert!(
        complaint("UPDATE fits SET verdict = 'accepted' WHERE verdict = 'rejected'")
            .contains("do not change")
    );
    assert!(complaint("UPDATE revisions SET served = '{}'").contains("does not change"));
    assert!(
        complaint("UPDATE jobs SET state = 'queued'").to_lowercase().contains("check"),
        "a job that has an outcome has ended"
    );
    assert!(complaint("UPDATE jobs SET state = 'lost'").to_lowercase().contains("check"));
}

#[test]
fn a_database_of_a_newer_program_is_refused() {
    let mut app = TestApp::start();
    app.stop();
    let newer = "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time) VALUES \
        (9999, 'newer', TRUE, '\\x00', 0)";
    app.behind(newer).unwrap();
    let settings = lampyris::settings::Settings {
        bind: "127.0.0.1:0".parse().unwrap(),
        database: app.place(),
        ..Default::default()
    };
    let error = app.block_on(lampyris::app::App::start(settings)).err().unwrap();
    assert!(error.to_string().contains("9999"), "{error}");
}
