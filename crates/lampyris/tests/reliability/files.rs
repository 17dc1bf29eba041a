//! Files that go away under a running service, and second services by whatever name: what is acknowledged is
//! in the file that is at the path.

use crate::database::{beside, check_database, fold, rows};
use crate::support::process::{Process, Said, program, serve, verb};
use crate::support::rooms::room_csv;
use crate::support::{Answer, Client, PATIENCE};
use crate::traffic::prepare;
use serde_json::json;
use std::fs::{self, File};
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

fn window(client: &Client, number: u64) -> Answer {
    client.csv("/systems/room/2/windows", &room_csv(number, 1))
}

/// Windows that were acknowledged.
fn windows(client: &Client, numbers: std::ops::Range<u64>) -> Vec<String> {
    numbers.map(|number| window(client, number).expect(201).json()["id"].as_str().unwrap().into()).collect()
}

/// A database with parameters in service, and nothing beside it.
fn sound(dir: &Path) -> PathBuf {
    let database = dir.join("sound.db");
    let service = Process::start(&database);
    prepare(&service.client);
    assert_eq!(service.terminate().0, Some(0));
    database
}

/// What happens to files, as a sentence that `/readyz` then says.
type Accident = (&'static str, fn(&Path));

const ACCIDENTS: [Accident; 10] = [
    ("the database was removed", |path| fs::remove_file(path).unwrap()),
    ("the database was truncated", |path| drop(File::create(path).unwrap())),
    // Whoever reads an empty database takes it for a new one, and removes the log of another beside it.
    ("the database was truncated", |path| {
        drop(File::create(path).unwrap());
        rows(path, "SELECT name FROM sqlite_schema");
        assert!(!beside(path, "-wal").exists());
    }),
    ("the database was truncated", |path| {
        File::options().write(true).open(path).unwrap().set_len(8192).unwrap()
    }),
    ("the database was replaced", |path| {
        fs::copy(path, beside(path, ".other")).unwrap();
        fs::rename(beside(path, ".other"), path).unwrap();
    }),
    ("overwritten by an older one", |path| {
        let backup = beside(path, ".backup");
        let arguments = ["backup", backup.to_str().unwrap(), "--database", path.to_str().unwrap()];
        verb("http://127.0.0.1:1", &arguments).expect(0);
        fs::copy(backup, path).unwrap();
    }),
    // A copy of all that was there a moment ago, such as a restore from a snapshot. It may be seen between two of
    // the files.
    ("overwritten", |path| {
        for name in FILES {
            fs::copy(beside(path, &format!("{name}.before")), beside(path, name)).unwrap();
        }
    }),
    ("write-ahead log was removed", |path| fs::remove_file(beside(path, "-wal")).unwrap()),
    ("write-ahead log was truncated", |path| drop(File::create(beside(path, "-wal")).unwrap())),
    ("index of the write-ahead log was removed", |path| fs::remove_file(beside(path, "-shm")).unwrap()),
];

/// The files of a database, by what follows its name.
const FILES: [&str; 3] = ["", "-wal", "-shm"];

#[test]
fn files_that_go_away_take_no_acknowledged_write_with_them() {
    let dir = tempfile::tempdir().unwrap();
    let sound = sound(dir.path());
    for (number, (why, accident)) in ACCIDENTS.into_iter().enumerate() {
        let database = dir.path().join(format!("{number}.db"));
        fs::copy(&sound, &database).unwrap();
        let service = Process::start(&database);
        let client = &service.client;
        windows(client, 100..102);
        for name in FILES {
            fs::copy(beside(&database, name), beside(&database, &format!("{name}.before"))).unwrap();
        }
        windows(client, 102..105);
        client.get("/readyz").expect(200);
        let served = client.get("/params/room/1").expect(200).text;
        accident(&database);
        for refused in [
            window(client, 200),
            window(client, 201),
            client.json("PUT", "/systems/room/9", &json!({"model": "rc2"})),
            client.json("PUT", "/params/room/1/pin", &json!({"reason": "sensor swap"})),
        ] {
            // What is read before a write may fail first, as in a file that is cut off.
            let problem = refused.expect(503).json();
            let slug = problem["type"].as_str().unwrap();
            assert!(["storage-read-only", "storage-unavailable"].contains(&slug), "{why}: {problem}");
        }
        let ready = client.get("/readyz").expect(503).json();
        assert_eq!((&ready["ready"], &ready["database"]), (&json!(false), &json!("read-only")));
        assert!(ready["why"].as_str().unwrap().contains(why), "{why}: {ready}");
        assert_eq!(client.get("/params/room/1").expect(200).text, served, "{why}");
        assert_eq!(service.terminate().0, Some(0), "{why}");
    }
}

#[test]
fn a_log_that_was_removed_is_saved_while_nobody_writes() {
    let dir = tempfile::tempdir().unwrap();
    let database = sound(dir.path());
    for (name, first) in [("-wal", 100), ("-shm", 200)] {
        let service = Process::start(&database);
        let taken = windows(&service.client, first..first + 20);
        fs::remove_file(beside(&database, name)).unwrap();
        let begun = Instant::now();
        let (copy, copied) = (dir.path().join("copy.db"), "SELECT id FROM windows");
        loop {
            fs::copy(&database, &copy).unwrap();
            let there = rows(&copy, copied);
            if taken.iter().all(|id| there.contains(id)) {
                break;
            }
            assert!(begun.elapsed() < PATIENCE, "{name}: {} of {} are saved", there.len(), taken.len());
            thread::sleep(Duration::from_millis(50));
        }
        window(&service.client, 300).problem(503, "storage-read-only");
        service.kill();
        let service = Process::start(&database);
        for id in &taken {
            service.client.get(&format!("/windows/{id}")).expect(200);
        }
        service.client.get("/readyz").expect(200);
        assert_eq!(service.terminate().0, Some(0));
        check_database(&database);
    }
}

#[test]
fn a_log_that_was_removed_is_saved_by_the_end_of_the_service() {
    let dir = tempfile::tempdir().unwrap();
    let database = sound(dir.path());
    let service = Process::start(&database);
    let taken = windows(&service.client, 100..120);
    fs::remove_file(beside(&database, "-wal")).unwrap();
    assert_eq!(service.terminate().0, Some(0));
    let service = Process::start(&database);
    for id in &taken {
        service.client.get(&format!("/windows/{id}")).expect(200);
    }
    check_database(&database);
}

#[test]
fn a_database_that_was_moved_comes_back_with_its_log() {
    let dir = tempfile::tempdir().unwrap();
    let (database, elsewhere) = (sound(dir.path()), dir.path().join("elsewhere.db"));
    let service = Process::start(&database);
    let taken = windows(&service.client, 100..105);
    fs::rename(&database, &elsewhere).unwrap();
    window(&service.client, 200).problem(503, "storage-read-only");
    assert_eq!(service.terminate().0, Some(0), "the end of the service leaves the log where it is");
    // An empty database would take the log away.
    let refused = serve(&database).expect(1).err;
    assert!(refused.contains("write-ahead log beside it"), "{refused}");
    assert!(!database.exists());
    fs::rename(&elsewhere, &database).unwrap();
    let service = Process::start(&database);
    for id in &taken {
        service.client.get(&format!("/windows/{id}")).expect(200);
    }
    window(&service.client, 200).expect(201);
}

#[test]
fn a_database_that_came_in_its_place_is_left_alone() {
    let dir = tempfile::tempdir().unwrap();
    let (database, other) = (sound(dir.path()), dir.path().join("other.db"));
    fs::copy(&database, &other).unwrap();
    let first = Process::start(&database);
    windows(&first.client, 100..105);
    fs::rename(&other, &database).unwrap();
    // The first one holds the name until it ends, unless somebody takes the lock file away too.
    assert!(serve(&database).expect(1).err.contains("another service"));
    for file in [".lock", "-wal", "-shm"] {
        fs::remove_file(beside(&database, file)).unwrap();
    }
    let second = Process::start(&database);
    let taken = windows(&second.client, 300..305);
    window(&first.client, 200).problem(503, "storage-read-only");
    assert_eq!(first.terminate().0, Some(0));
    assert!(beside(&database, "-wal").exists(), "the log of the second service");
    second.kill();
    let second = Process::start(&database);
    for id in &taken {
        second.client.get(&format!("/windows/{id}")).expect(200);
    }
}

#[test]
fn no_second_service_has_the_database_by_another_name() {
    let dir = tempfile::tempdir().unwrap();
    let database = dir.path().join("one.db");
    let service = Process::start(&database);
    let name = |folder: &str, name: &str| {
        let folder = dir.path().join(folder);
        fs::create_dir_all(&folder).unwrap();
        folder.join(name)
    };
    let about = |path: &Path, arguments: &[&str]| -> Said {
        let arguments = [arguments, &["--database", path.to_str().unwrap()]].concat();
        verb("http://127.0.0.1:1", &arguments)
    };
    let link = name("links", "link.db");
    symlink(&database, &link).unwrap();
    assert!(serve(&link).expect(1).err.contains("another service"));
    fs::remove_file(beside(&database, ".lock")).unwrap();
    assert!(serve(&database).expect(1).err.contains("another service"));
    assert!(serve(&link).expect(1).err.contains("another service"));
    // Verbs work beside the service, also by the link, whose log is that of the real file.
    about(&link, &["token", "create", "--name", "logger", "--scope", "operate"]).expect(0);
    assert_eq!(rows(&database, "SELECT name FROM tokens"), ["logger"]);
    let told = about(&link, &["doctor"]).out;
    assert!(told.contains("a service has it open"), "{told}");
    let hard = name("hard", "hard.db");
    fs::hard_link(&database, &hard).unwrap();
    for refused in [
        serve(&hard),
        about(&hard, &["token", "list"]),
        about(&hard, &["backup", dir.path().join("backup.db").to_str().unwrap()]),
    ] {
        assert!(refused.err.contains("hard links"), "{refused:?}");
        assert_eq!(refused.code, Some(1));
    }
    assert!(!beside(&hard, "-wal").exists(), "a second log would tear the database apart");
    fs::remove_file(&hard).unwrap();
    service.client.get("/readyz").expect(200);
    assert_eq!(service.terminate().0, Some(0));
    // The lock goes with its service, and a link alone is a good name.
    let service = Process::start(&link);
    assert!(beside(&database, "-wal").exists());
    assert_eq!(service.terminate().0, Some(0));
    let mut command = program();
    command.args(["migrate", "--database"]).arg(&link);
    assert!(command.status().unwrap().success());
}

#[test]
fn an_older_copy_of_the_database_alone_is_not_taken_for_it() {
    let dir = tempfile::tempdir().unwrap();
    let database = sound(dir.path());
    let before = beside(&database, ".before");
    let service = Process::start(&database);
    windows(&service.client, 100..110);
    // What is copied and what comes after it is in the file, and the file has the same size.
    fold(&database);
    fs::copy(&database, &before).unwrap();
    service.client.json("PUT", "/params/room/1/pin", &json!({"reason": "a visit"})).expect(200);
    fold(&database);
    // The service has seen that by its next look, once a second or here: it was not it that has folded.
    service.client.get("/readyz").expect(200);
    let served = service.client.get("/params/room/1").expect(200).text;
    let older = fs::read(&before).unwrap();
    assert_eq!(older.len() as u64, fs::metadata(&database).unwrap().len());
    std::os::unix::fs::FileExt::write_all_at(
        &File::options().write(true).open(&database).unwrap(),
        &older,
        0,
    )
    .unwrap();
    let refused = service.client.json("PUT", "/systems/room/9", &json!({"model": "rc2"}));
    refused.problem(503, "storage-read-only");
    let ready = service.client.get("/readyz").expect(503).json();
    assert!(ready["why"].as_str().unwrap().contains("overwritten by an older one"), "{ready}");
    assert_eq!(service.client.get("/params/room/1").expect(200).text, served);
}

#[test]
fn verbs_and_refused_starts_leave_the_log_of_another_database() {
    let dir = tempfile::tempdir().unwrap();
    let database = sound(dir.path());
    let damaged = dir.path().join("damaged.db");
    let mut bytes = fs::read(&database).unwrap();
    let length = bytes.len();
    // The roots of its tables.
    bytes[4096..length / 2].fill(7);
    fs::write(&damaged, bytes).unwrap();
    let service = Process::start(&database);
    let taken = windows(&service.client, 100..110);
    service.kill();
    let (log, kept) = (beside(&database, "-wal"), dir.path().join("kept.db"));
    fs::copy(&database, &kept).unwrap();
    let whole = fs::read(&log).unwrap();
    for (what, other) in [("empty", Vec::new()), ("damaged", fs::read(&damaged).unwrap())] {
        fs::write(&database, &other).unwrap();
        for verb in ["serve", "doctor", "migrate", "backup", "token"] {
            let mut command = program();
            match verb {
                "serve" => command.args(["serve", "--bind", "127.0.0.1:0", "--database"]).arg(&database),
                "backup" => {
                    command.arg("backup").arg(dir.path().join("no.db")).arg("--database").arg(&database)
                }
                "token" => command.args(["token", "list", "--database"]).arg(&database),
                verb => command.args([verb, "--database"]).arg(&database),
            };
            let said = command.output().unwrap();
            assert!(!said.status.success(), "{verb} of {what}: {said:?}");
            assert!(fs::read(&log).is_ok_and(|now| now == whole), "{verb} of {what} took the log away");
        }
    }
    fs::copy(&kept, &database).unwrap();
    let service = Process::start(&database);
    for id in &taken {
        service.client.get(&format!("/windows/{id}")).expect(200);
    }
}
