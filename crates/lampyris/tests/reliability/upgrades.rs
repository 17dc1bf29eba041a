//! Databases of every released schema, brought up to date: all or nothing, and what is served stays what it
//! was.
//!
//! `tests/golden/<schema>.sql` is a dump of such a database, `<schema>.json` the body that its program
//! served. `27-series.json` is what its program told of the measurements of a room whose windows lie over each
//! other, and `27-fit.json` of the fit.

use crate::database::{check_database, copied, random, rows};
use crate::support::full;
use crate::support::process::{Process, program, verb};
use lampyris_core::data::Series;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

/// Released schemas, and what later programs say beyond the body that was served from them.
const RELEASED: [(i64, &str); 3] = [(1, r#","degraded":null,"pin":null"#), (5, ""), (27, "")];

/// When what those databases serve turns stale: a hundred years behind the validation, and behind the newest
/// measurement.
const STALE_AFTER: [&str; 2] = ["2126-10-28T12:39:21.254Z", "2125-12-17T23:00:00Z"];

/// The states that those databases hold, as they are told by now.
const STATES: [&str; 1] = [concat!(
    r#"{"at":"2026-01-10T23:00:00Z","states":{"T_r":9.51753423733371,"T_e":8.045134243154257},"#,
    r#""sd":{"T_r":0.031512115491294866,"T_e":0.02669343293028649}}"#
)];

/// Makes a database of a released schema; gives its path, and the body that was served from it. Its age
/// counts from the measurements by now.
pub fn golden(dir: &Path, schema: i64) -> (PathBuf, String) {
    use sqlx::{Connection, SqliteConnection};
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden");
    let dump = std::fs::read_to_string(folder.join(format!("{schema}.sql"))).unwrap();
    let path = dir.join(format!("golden-{schema}.db"));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
    runtime.block_on(async {
        let mut connection =
            SqliteConnection::connect(&format!("sqlite://{}?mode=rwc", path.display())).await.unwrap();
        sqlx::raw_sql(sqlx::AssertSqlSafe(dump)).execute(&mut connection).await.unwrap();
        connection.close().await.unwrap();
    });
    check_database(&path);
    let body = std::fs::read_to_string(folder.join(format!("{schema}.json"))).unwrap();
    (path, body.replace(STALE_AFTER[0], STALE_AFTER[1]))
}

/// What the database says of its own schema.
fn schema(path: &Path) -> i64 {
    rows(path, "SELECT CAST(MAX(version) AS TEXT) FROM _sqlx_migrations")[0].parse().unwrap()
}

/// What was measured of the one room of a database of an earlier schema.
fn blocks(path: &Path) -> Vec<Series> {
    let sql = "SELECT hex(block) FROM window_blocks WHERE window_id IN (SELECT id FROM windows WHERE system = 'room/1')";
    let earlier = "SELECT hex(block) FROM window_blocks";
    let hex = rows(path, if schema(path) < 27 { earlier } else { sql });
    let byte = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap();
    let block = |hex: &String| hex.as_bytes().chunks(2).map(byte).collect::<Vec<u8>>();
    hex.iter().map(|hex| Series::decode(&block(hex)).unwrap()).collect()
}

fn migrate(path: &Path) -> serde_json::Value {
    verb("http://127.0.0.1:1", &["migrate", "--json", "--database", path.to_str().unwrap()]).expect(0).json()
}

#[test]
fn what_a_released_program_served_is_served_after_the_upgrade() {
    let dir = tempfile::tempdir().unwrap();
    for (released, added) in RELEASED {
        let (database, body) = golden(dir.path(), released);
        let measured = blocks(&database);
        let told = migrate(&database);
        let newest = told["to"].as_i64().unwrap();
        assert_eq!((told["from"].as_i64(), schema(&database)), (Some(released), newest), "{told}");
        check_database(&database);
        let states = rows(&database, "SELECT document FROM states");
        assert!(released != 5 || states == STATES, "{states:?}");
        // Later programs say more of what they serve, and change nothing of what was said.
        let expected = format!("{}{added}}}", body.strip_suffix('}').unwrap());
        let service = Process::start(&database);
        assert_eq!(service.client.get("/params/room/1").expect(200).text, expected);
        let history = service.client.get("/systems/room/1/windows").expect(200).json();
        assert_eq!(history["items"][0]["rows"], 240, "the measurements can be read");
        let series = service.client.get("/systems/room/1/series?max_points=100000").expect(200).json();
        assert_eq!(series["channels"].as_object().unwrap().len(), measured.len());
        for one in measured {
            let shown = serde_json::json!(one.values());
            assert_eq!(series["channels"][one.channel()]["values"], shown, "{}", one.channel());
        }
        // What a fit has read is known, also where its program did not note it.
        let window = format!("/windows/{}", history["items"][0]["id"].as_str().unwrap());
        service.client.send("DELETE", &window, &[], None).unwrap().problem(409, "window-cited");
        assert_eq!(service.terminate().0, Some(0));
        // A second time there is nothing to do, and nothing to back up.
        assert_eq!(migrate(&database)["from"], newest);
        let backup = dir.path().join(format!("golden-{released}.db.schema-{released}.backup"));
        assert_eq!(backup.exists(), released < newest);
        if released < newest {
            assert_eq!(schema(&backup), released, "the backup is the database as it was");
            check_database(&backup);
        }
    }
}

#[test]
fn windows_over_each_other_and_fits_are_what_they_were() {
    let dir = tempfile::tempdir().unwrap();
    let (database, _) = golden(dir.path(), 27);
    let told = |name: &str| {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name);
        serde_json::from_str::<serde_json::Value>(&std::fs::read_to_string(path).unwrap()).unwrap()
    };
    let fit = told("27-fit.json");
    let service = Process::start(&database);
    let series =
        |service: &Process| service.client.get("/systems/room/2/series?max_points=100000").expect(200).json();
    assert_eq!(series(&service), told("27-series.json"));
    let path = format!("/fits/{}", fit["id"].as_str().unwrap());
    assert_eq!(service.client.get(&path).expect(200).json(), fit);
    // What was begun with it may still read its windows.
    let is_idle = |jobs: &serde_json::Value| jobs["items"].as_array().is_some_and(Vec::is_empty);
    for state in ["queued", "running"] {
        service.client.until(&format!("/jobs?state={state}"), is_idle);
    }
    // The newest hides something of those below, which counts again when it goes.
    let windows = service.client.get("/systems/room/2/windows").expect(200).json();
    let newest = windows["items"][0]["id"].as_str().unwrap();
    service.client.send("DELETE", &format!("/windows/{newest}"), &[], None).unwrap().expect(204);
    let (before, after) = (told("27-series.json"), series(&service));
    let at = |told: &serde_json::Value, place: usize| {
        told["channels"]["T_room"]["values"][place].as_f64().unwrap()
    };
    let changed: Vec<usize> = (0..100).filter(|place| at(&before, *place) != at(&after, *place)).collect();
    assert_eq!(changed, (30..50).collect::<Vec<_>>());
    assert!(changed.iter().all(|place| (at(&before, *place) - at(&after, *place)).abs() > 0.05));
    for table in ["channel_days", "window_blocks"] {
        let sql = "SELECT name FROM sqlite_schema";
        assert!(!rows(&database, sql).iter().any(|name| name == table), "{table}");
    }
}

#[test]
fn a_start_brings_the_schema_up_to_date_and_keeps_a_backup() {
    let dir = tempfile::tempdir().unwrap();
    let (database, _) = golden(dir.path(), 1);
    let service = Process::start(&database);
    service.client.get("/params/room/1").expect(200);
    assert_eq!(service.terminate().0, Some(0));
    assert!(schema(&database) > 1);
    assert_eq!(schema(&dir.path().join("golden-1.db.schema-1.backup")), 1);
}

#[test]
fn a_killed_upgrade_is_gone_on_with() {
    let dir = tempfile::tempdir().unwrap();
    let kills = if full() { 50 } else { 10 };
    let mut seed = 3;
    let mut unfinished = 0;
    for (released, _) in RELEASED {
        let (golden, body) = golden(dir.path(), released);
        for round in 0..kills {
            let database = dir.path().join(format!("{released}-{round}.db"));
            std::fs::copy(&golden, &database).unwrap();
            let mut child = upgrade(&database, "").spawn().unwrap();
            std::thread::sleep(Duration::from_micros(random(&mut seed) % 60_000));
            child.kill().unwrap();
            child.wait().unwrap();
            unfinished += u64::from(is_gone_on_with(&database, &golden, &body));
        }
    }
    println!(
        "MIGRATE-1: {} upgrades were killed, {unfinished} of them before their end",
        RELEASED.len() * kills
    );
}

#[test]
fn an_upgrade_that_dies_in_any_of_its_transactions_is_gone_on_with() {
    let dir = tempfile::tempdir().unwrap();
    for (released, _) in RELEASED {
        let (golden, body) = golden(dir.path(), released);
        let mut deaths = 0;
        // In the backup before, then before each commit, until there is no further one.
        for point in
            std::iter::once("in_backup".to_owned()).chain((1..).map(|pass| format!("in_migration:{pass}")))
        {
            let database = dir.path().join(format!("{released}-{deaths}.db"));
            std::fs::copy(&golden, &database).unwrap();
            if upgrade(&database, &point).status().unwrap().success() {
                break;
            }
            deaths += 1;
            is_gone_on_with(&database, &golden, &body);
        }
        // Every migration is at least one transaction.
        let newest = migrate(&golden)["to"].as_i64().unwrap();
        let migrations = rows(&golden, "SELECT CAST(version AS TEXT) FROM _sqlx_migrations");
        let missing = migrations
            .iter()
            .filter(|version| (released + 1..=newest).contains(&version.parse().unwrap()))
            .count();
        assert!(deaths > missing, "{deaths} deaths in {missing} migrations");
        println!(
            "MIGRATE-1: the upgrade from schema {released} died in each of {deaths} places and was gone on \
            with"
        );
    }
}

/// The upgrade as a process of its own, which dies at a point of the code where one is named.
fn upgrade(database: &Path, point: &str) -> Command {
    let mut command = program();
    command.args(["migrate", "--database", database.to_str().unwrap()]).env("LAMPYRIS_ABORT_AT", point);
    command.stdout(Stdio::null()).stderr(Stdio::null());
    command
}

/// Goes on with an upgrade that died, and looks for everything that was there before it. Says whether
/// anything was left to do.
#[track_caller]
fn is_gone_on_with(database: &Path, golden: &Path, body: &str) -> bool {
    check_database(&copied(database));
    let reached = schema(&copied(database));
    let newest = migrate(database)["to"].as_i64().unwrap();
    check_database(database);
    for sql in [
        "SELECT served FROM revisions",
        "SELECT id FROM windows",
        "SELECT id || state FROM jobs",
        "SELECT CAST(document AS TEXT) FROM fits",
    ] {
        assert_eq!(rows(database, sql), rows(golden, sql));
    }
    let served = Process::start(database).client.get("/params/room/1").expect(200).text;
    assert!(served.starts_with(body.strip_suffix('}').unwrap()), "{served}");
    reached < newest
}
