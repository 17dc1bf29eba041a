//! Database files, asked without the service.

use crate::support::PATIENCE;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Asks the database itself, with the service down.
#[track_caller]
pub fn check_database(path: &Path) {
    assert_eq!(rows(path, "PRAGMA integrity_check"), ["ok"]);
    let orphans = rows(path, "SELECT \"table\" FROM pragma_foreign_key_check");
    assert!(orphans.is_empty(), "{orphans:?}");
}

/// Runs a statement on a database and gives the first column as texts. Where no service has the database
/// open, this also folds the write-ahead log into it.
#[track_caller]
pub fn rows(path: &Path, sql: &'static str) -> Vec<String> {
    use sqlx::{Connection, SqliteConnection};
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let mut connection =
            SqliteConnection::connect(&format!("sqlite://{}?mode=rwc", path.display())).await.unwrap();
        let rows = sqlx::query_scalar(sql).fetch_all(&mut connection).await.unwrap();
        connection.close().await.unwrap();
        rows
    })
}

/// Folds the log of a database that a service has open into it, all of it: it waits for whoever reads.
pub fn fold(path: &Path) {
    use sqlx::{Connection, SqliteConnection};
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let mut connection =
            SqliteConnection::connect(&format!("sqlite://{}", path.display())).await.unwrap();
        let begun = Instant::now();
        loop {
            let (_, log, folded): (i64, i64, i64) =
                sqlx::query_as("PRAGMA wal_checkpoint(PASSIVE)").fetch_one(&mut connection).await.unwrap();
            if log == folded {
                break;
            }
            assert!(begun.elapsed() < PATIENCE, "{folded} of {log} frames are folded");
            std::thread::sleep(Duration::from_millis(10));
        }
        connection.close().await.unwrap();
    });
}

/// Copies what a dead service has left, log and all, so that a look at the copy leaves the recovery to the
/// next start.
pub fn copied(path: &Path) -> PathBuf {
    let copy = path.with_extension("copy.db");
    std::fs::copy(path, &copy).unwrap();
    let (log, copied) = (beside(path, "-wal"), beside(&copy, "-wal"));
    match log.exists() {
        true => drop(std::fs::copy(log, copied).unwrap()),
        false => drop(std::fs::remove_file(copied)),
    }
    let _ = std::fs::remove_file(beside(&copy, "-shm"));
    copy
}

/// The path of a file beside a database.
pub fn beside(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    name.into()
}

/// A small generator, so that a failure can be repeated.
pub fn random(state: &mut u64) -> u64 {
    *state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
    *state >> 33
}
