//! Backups, their way back, and what a database looks like that is not to be trusted.

use crate::database::{check_database, random, rows};
use crate::support::process::{Process, Said, serve, verb};
use crate::support::rooms::room_csv;
use crate::support::{full, quick};
use crate::traffic::StopOnDrop;
use lampyris::app::App;
use lampyris::settings::Settings;
use serde_json::json;
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How many damages are tried.
fn damages() -> u64 {
    if full() { 500 } else { 25 }
}

/// A verb about a database file.
pub fn about(database: &Path, words: &[&str]) -> Said {
    let mut arguments = words.to_vec();
    arguments.extend(["--database", database.to_str().unwrap()]);
    verb("http://127.0.0.1:1", &arguments)
}

/// A day of measurements that no other number gives.
fn day(number: u64) -> String {
    let date = format!("{}-{:02}-{:02}", 1990 + number / 336 % 35, 1 + number / 28 % 12, 1 + number % 28);
    room_csv(number, 1).replace("2026-01-01", &date)
}

/// A served room, and the body that is served; the service was killed, so that its log is still there.
pub fn served(database: &Path) -> String {
    let service = Process::start(database);
    service.client.room("1", 1);
    assert_eq!(service.client.ended(&service.client.post_job(&quick("room/1")))["outcome"], "accepted");
    let body = service.client.get("/params/room/1").expect(200).text;
    service.kill();
    body
}

/// A service in this process on a database, or why there is none.
fn open(database: &Path) -> Result<(tokio::runtime::Runtime, App), String> {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let settings = Settings {
        bind: "127.0.0.1:0".parse().unwrap(),
        database: database.into(),
        threads: 1,
        ..Settings::default()
    };
    let app = runtime.block_on(App::start(settings)).map_err(|error| error.to_string())?;
    Ok((runtime, app))
}

#[test]
fn a_backup_beside_a_busy_service_holds_everything_acknowledged() {
    let dir = tempfile::tempdir().unwrap();
    let database = dir.path().join("busy.db");
    let body = served(&database);
    let service = Process::start(&database);
    let client = &service.client;
    client.json("PUT", "/systems/room/2", &json!({"model": "rc2"})).expect(201);
    let (backups, pause) =
        if full() { (24, Duration::from_secs(5)) } else { (4, Duration::from_millis(300)) };
    let (taken, stop) = (Mutex::new(Vec::new()), AtomicBool::new(false));
    let (longest_write, longest_poll) = (Mutex::new(Duration::ZERO), Mutex::new(Duration::ZERO));
    let until_stopped = |longest: &Mutex<Duration>, step: &dyn Fn(u64)| {
        let mut number = 0;
        while !stop.load(Ordering::Relaxed) {
            let begun = Instant::now();
            step(number);
            let took = begun.elapsed();
            let mut longest = longest.lock().unwrap();
            *longest = longest.max(took);
            number += 1;
        }
    };
    let write = |number| {
        let window = client.csv("/systems/room/2/windows", &day(number)).expect(201).json();
        taken.lock().unwrap().push(window["id"].as_str().unwrap().to_owned());
    };
    let poll = |_| {
        assert_eq!(client.get("/params/room/1").expect(200).text, body);
        std::thread::sleep(Duration::from_millis(2));
    };
    std::thread::scope(|scope| {
        let stopping = StopOnDrop(&stop);
        for writer in 0..4 {
            let (until_stopped, write, longest) = (&until_stopped, &write, &longest_write);
            scope.spawn(move || until_stopped(longest, &|number| write(4 * number + writer)));
        }
        scope.spawn(|| until_stopped(&longest_poll, &poll));
        for round in 0..backups {
            std::thread::sleep(pause);
            let before = taken.lock().unwrap().clone();
            let file = dir.path().join(format!("{round}.backup"));
            let made = about(&database, &["backup", file.to_str().unwrap(), "--json"]).expect(0).json();
            assert_eq!(made["bytes"], file.metadata().unwrap().len());
            check_database(&file);
            let kept: HashSet<String> = rows(&file, "SELECT id FROM windows").into_iter().collect();
            let lost = before.iter().filter(|window| !kept.contains(*window)).count();
            assert_eq!(lost, 0, "of {} windows", before.len());
            assert!(before.len() > round, "nothing was written");
        }
        drop(stopping);
    });
    println!(
        "BACKUP-1: {backups} backups under {} writes held all that was acknowledged before; longest write \
        {:?}, longest poll {:?}",
        taken.into_inner().unwrap().len(),
        longest_write.into_inner().unwrap(),
        longest_poll.into_inner().unwrap()
    );
    service.kill();
    // A file that is there is never replaced, not even by a newer backup.
    let file = dir.path().join("0.backup");
    let before = std::fs::read(&file).unwrap();
    assert!(about(&database, &["backup", file.to_str().unwrap()]).expect(1).err.contains("is there already"));
    assert_eq!(std::fs::read(&file).unwrap(), before);
    about(&dir.path().join("none.db"), &["backup", dir.path().join("x").to_str().unwrap()]).expect(4);
    assert!(!dir.path().join("x").exists() && !dir.path().join("none.db").exists());
    // The last one, brought back in the place of what was killed.
    about(&database, &["restore", dir.path().join(format!("{}.backup", backups - 1)).to_str().unwrap()])
        .expect(0);
    check_database(&database);
    assert_eq!(Process::start(&database).client.get("/params/room/1").expect(200).text, body);
}

#[test]
fn a_raw_copy_of_the_database_file_lacks_acknowledged_writes() {
    let dir = tempfile::tempdir().unwrap();
    let database = dir.path().join("raw.db");
    let service = Process::start(&database);
    service.client.room("1", 1);
    let raw = dir.path().join("copy.db");
    std::fs::copy(&database, &raw).unwrap();
    let file = dir.path().join("sound.db");
    about(&database, &["backup", file.to_str().unwrap()]).expect(0);
    let windows = "SELECT CAST(COUNT(*) AS TEXT) FROM windows";
    assert_eq!([rows(&raw, windows), rows(&file, windows)], [["0"], ["1"]], "the window waits in the log");
}

#[test]
fn a_backup_comes_back_and_what_was_there_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let database = dir.path().join("restore.db");
    let body = served(&database);
    let (file, name) = {
        let file = dir.path().join("good.backup");
        (file.clone(), file.to_str().unwrap().to_owned())
    };
    about(&database, &["backup", &name]).expect(0);
    // Later writes, of which the backup knows nothing, and a death that leaves them in the log.
    let service = Process::start(&database);
    service.client.csv("/systems/room/1/windows", &day(7)).expect(201);
    assert!(
        about(&database, &["restore", &name]).expect(1).err.contains("another service"),
        "a server has the database open"
    );
    service.kill();
    assert!(database.with_extension("db-wal").metadata().unwrap().len() > 0);

    let told = about(&database, &["restore", &name, "--json"]).expect(0).json();
    let replaced = PathBuf::from(told["replaced"].as_str().unwrap());
    assert!(replaced.to_str().unwrap().contains("restore.db.replaced-20"), "{replaced:?}");
    let windows = "SELECT CAST(COUNT(*) AS TEXT) FROM windows";
    assert_eq!(
        [rows(&database, windows), rows(&replaced, windows)],
        [["1"], ["2"]],
        "neither has the rows of the other"
    );
    check_database(&database);
    let service = Process::start(&database);
    assert_eq!(service.client.get("/params/room/1").expect(200).text, body);
    assert_eq!(service.terminate().0, Some(0));

    // What is no backup changes nothing.
    let before = std::fs::read(&database).unwrap();
    let refused = |file: &Path, code: i32, word: &str| {
        let said = about(&database, &["restore", file.to_str().unwrap()]).expect(code);
        assert!(said.err.contains(word), "{}", said.err);
        assert_eq!(std::fs::read(&database).unwrap(), before);
    };
    refused(&dir.path().join("none"), 4, "no file");
    let text = dir.path().join("text");
    std::fs::write(&text, "not a database at all".repeat(100)).unwrap();
    refused(&text, 1, "damaged");
    let damaged = dir.path().join("damaged");
    std::fs::write(&damaged, flipped(&file, 4096 + 1)).unwrap();
    refused(&damaged, 1, "damaged");
    let newer = dir.path().join("newer");
    std::fs::copy(&file, &newer).unwrap();
    let sql = "INSERT INTO _sqlx_migrations (version, description, success, checksum, execution_time) VALUES \
        (9999, '', TRUE, x'00', 0)";
    rows(&newer, sql);
    refused(&newer, 1, "schema 9999");
}

#[test]
fn what_was_migrated_is_neither_newer_nor_edited() {
    let dir = tempfile::tempdir().unwrap();
    let database = dir.path().join("edited.db");
    let service = Process::start(&database);
    assert_eq!(service.terminate().0, Some(0));
    rows(&database, "UPDATE _sqlx_migrations SET checksum = x'00' WHERE version = 2");
    for said in [about(&database, &["migrate"]), serve(&database)] {
        assert!(said.expect(1).err.contains("migration 2 was applied to the database with another text"));
    }
    rows(&database, "UPDATE _sqlx_migrations SET version = 9999 WHERE version = 2");
    for said in [about(&database, &["migrate"]), serve(&database)] {
        let said = said.expect(1).err;
        assert!(
            said.contains("schema 9999")
                && said.contains(env!("CARGO_PKG_VERSION"))
                && said.contains("up to "),
            "{said}"
        );
    }
    // A database of somebody else is left alone to the byte.
    let foreign = dir.path().join("foreign.db");
    rows(&foreign, "CREATE TABLE theirs (x)");
    let before = std::fs::read(&foreign).unwrap();
    assert!(serve(&foreign).expect(1).err.contains("another program"));
    assert_eq!(std::fs::read(&foreign).unwrap(), before);
}

/// The bytes of a file, one of them with its bits turned over.
fn flipped(file: &Path, at: usize) -> Vec<u8> {
    let mut bytes = std::fs::read(file).unwrap();
    bytes[at] ^= 0xff;
    bytes
}

#[test]
fn a_damaged_database_is_not_served_from() {
    let dir = tempfile::tempdir().unwrap();
    let (database, whole) = (dir.path().join("whole.db"), dir.path().join("backup"));
    let body: serde_json::Value = serde_json::from_str(&served(&database)).unwrap();
    about(&database, &["backup", whole.to_str().unwrap()]).expect(0);
    let damaged = dir.path().join("damaged.db");
    // The kind of the second page: the built service says what to do and ends.
    std::fs::write(&damaged, flipped(&whole, 4096)).unwrap();
    let said = serve(&damaged).expect(1).err;
    assert!(
        said.contains("damaged")
            && said.contains("lampyris restore FILE")
            && said.contains("lampyris backup"),
        "{said}"
    );
    // A digit of a parameter, which is no contradiction to SQLite.
    let digits = body["parameters"]["alpha_e"]["value"].to_string();
    let bytes = std::fs::read(&whole).unwrap();
    let places: Vec<usize> =
        (0..bytes.len() - digits.len()).filter(|at| bytes[*at..].starts_with(digits.as_bytes())).collect();
    assert!(!places.is_empty(), "{digits}");
    let mut other = bytes.clone();
    places.iter().for_each(|at| other[at + 3] = if other[at + 3] == b'1' { b'2' } else { b'1' });
    std::fs::write(&damaged, other).unwrap();
    let said = serve(&damaged).expect(1).err;
    assert!(said.contains("room/1") && said.contains("lampyris restore FILE"), "{said}");
    // Anywhere: it is refused, or what is served is what was published.
    let (mut seed, mut refused) = (11, 0);
    for _ in 0..damages() {
        let at = random(&mut seed) as usize % bytes.len();
        std::fs::write(&damaged, flipped(&whole, at)).unwrap();
        match open(&damaged) {
            Err(_) => refused += 1,
            Ok((runtime, app)) => {
                let served = app
                    .service()
                    .params
                    .entry("room/1")
                    .and_then(|entry| entry.validated().map(|one| one.body.clone()));
                if let Some(served) = served {
                    let served: serde_json::Value = serde_json::from_slice(&served).unwrap();
                    assert_eq!(served["parameters"], body["parameters"], "byte {at}");
                }
                runtime.block_on(app.shutdown()).unwrap();
            }
        }
        for ending in ["db-wal", "db-shm"] {
            let _ = std::fs::remove_file(damaged.with_extension(ending));
        }
    }
    println!(
        "CRASH-2: {refused} of {} flipped bytes were refused, with the others what was published was served",
        damages()
    );
}

#[test]
fn a_torn_log_leaves_the_first_writes_and_nothing_else() {
    let dir = tempfile::tempdir().unwrap();
    let database = dir.path().join("torn.db");
    let service = Process::start(&database);
    service.client.json("PUT", "/systems/room/1", &json!({"model": "rc2"})).expect(201);
    let windows: Vec<String> = (0..30)
        .map(|number| {
            service.client.csv("/systems/room/1/windows", &day(number)).expect(201).json()["id"]
                .as_str()
                .unwrap()
                .to_owned()
        })
        .collect();
    service.kill();
    let (file, log) =
        (std::fs::read(&database).unwrap(), std::fs::read(database.with_extension("db-wal")).unwrap());
    let (mut seed, mut least) = (5, windows.len());
    for round in 0..damages() {
        let torn = dir.path().join(format!("torn-{round}.db"));
        std::fs::write(&torn, &file).unwrap();
        let mut rest = log.clone();
        if round % 2 == 0 {
            rest.truncate(random(&mut seed) as usize % log.len());
        } else {
            let last = log.len().min(64 << 10);
            rest[log.len() - last + random(&mut seed) as usize % last] ^= 0xff;
        }
        std::fs::write(torn.with_extension("db-wal"), rest).unwrap();
        let (runtime, app) = open(&torn).unwrap_or_else(|error| panic!("round {round}: {error}"));
        runtime.block_on(app.shutdown()).unwrap();
        check_database(&torn);
        let kept = rows(&torn, "SELECT id FROM windows ORDER BY sequence");
        assert_eq!(kept, windows[..kept.len()], "round {round}");
        least = least.min(kept.len());
    }
    assert!(least < windows.len(), "no log was torn");
    println!(
        "CRASH-2: {} torn logs, each left the first writes and nothing else, {least} of {} at least",
        damages(),
        windows.len()
    );
}

#[test]
fn the_doctor_tells_a_sound_database_from_others() {
    let dir = tempfile::tempdir().unwrap();
    let database = dir.path().join("doctor.db");
    let status = |said: &serde_json::Value, name: &str| {
        let check = said["checks"]
            .as_array()
            .unwrap()
            .iter()
            .find(|check| check["name"] == name)
            .cloned()
            .unwrap_or_default();
        (
            check["status"].as_str().unwrap_or_default().to_owned(),
            check["detail"].as_str().unwrap_or_default().to_owned(),
        )
    };
    // Nothing there yet is no fault.
    assert_eq!(status(&about(&database, &["doctor", "--json"]).expect(0).json(), "database").0, "warn");
    let service = Process::start(&database);
    service.client.room("1", 1);
    let told = about(&database, &["doctor", "--json"]).expect(0).json();
    for name in ["configuration", "database", "schema", "log", "clock", "folder", "cpu"] {
        assert_ne!(status(&told, name).0, "fail", "{told}");
    }
    assert!(status(&told, "database").1.contains("a service has it open"), "{told}");
    assert_eq!(service.terminate().0, Some(0));
    let lines = about(&database, &["doctor"]).expect(0).out;
    assert!(lines.contains("ok    database") && lines.contains("no service has it open"), "{lines}");
    // A clock that was set back, a row that refers to nothing, an older schema, a setting that is none.
    rows(&database, "UPDATE windows SET uploaded_at = uploaded_at + 86400000");
    assert!(
        status(&about(&database, &["doctor", "--json"]).expect(1).json(), "clock")
            .1
            .contains("set the clock")
    );
    rows(&database, "UPDATE windows SET uploaded_at = 0");
    rows(&database, "PRAGMA foreign_keys = OFF; DELETE FROM systems");
    let said = status(&about(&database, &["doctor", "--json"]).expect(1).json(), "database").1;
    let tables =
        said.split_once("rows of ").and_then(|(_, rest)| rest.split_once(" refer to rows")).unwrap().0;
    assert!(tables.split(", ").any(|table| table == "windows"), "{said}");
    rows(&database, "DELETE FROM days; DELETE FROM measured; DELETE FROM windows");
    about(&database, &["doctor"]).expect(0);
    let config = dir.path().join("lampyris.toml");
    std::fs::write(&config, "zone = \"Mars/Olympus\"\nworkers = 0\n").unwrap();
    let told = about(&database, &["doctor", "--json", "--config", config.to_str().unwrap()]).expect(1).json();
    assert!(status(&told, "configuration").1.contains("/workers"), "{told}");
    // A page that contradicts the others.
    std::fs::write(&database, flipped(&database, 4096)).unwrap();
    assert!(
        status(&about(&database, &["doctor", "--json"]).expect(1).json(), "database")
            .1
            .contains("lampyris restore FILE")
    );
}
