//! Disks that fail: a write that is refused, a sync that loses what it was to keep, and the power that goes.
//!
//! `shim.c` is such a disk, preloaded into the built service.

use crate::database::{beside, check_database, copied, random, rows};
use crate::support::process::{Process, program};
use crate::support::rooms::room_csv;
use crate::support::{Answer, Client, PATIENCE, endless, full, quick, seeded};
use crate::traffic::{Oracle, Traffic, prepare};
use crate::upgrades::golden;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::thread;
use std::time::{Duration, Instant};

/// A disk under one database.
struct Disk {
    library: PathBuf,
    folder: PathBuf,
}

impl Disk {
    /// Compiles it; there is none where there is no C compiler, which the test then says.
    fn build(folder: &Path, bar: &str) -> Option<Self> {
        // The system names files by their real paths.
        let folder = folder.canonicalize().unwrap();
        let (library, source) =
            (folder.join("disk.so"), Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/reliability/shim.c"));
        let built = Command::new("cc")
            .args(["-O1", "-shared", "-fPIC", "-pthread", "-o"])
            .args([&library, &source])
            .status();
        match built {
            Ok(status) => assert!(status.success(), "the disk does not compile"),
            Err(error) => {
                println!("SKIPPED {bar}: no C compiler: {error}");
                return None;
            }
        }
        Some(Self { library, folder })
    }

    fn told(&self) -> PathBuf {
        self.folder.join("told")
    }

    /// Starts the service on it, with variables for `shim.c`; there is none where it ends before it listens.
    fn start(&self, database: &Path, variables: &[(&str, &str)]) -> Option<Process> {
        let _ = fs::remove_file(self.told());
        let mut command = program();
        command.env("LD_PRELOAD", &self.library).env("DISK_DATABASE", database).env("DISK_TOLD", self.told());
        command.envs(variables.iter().copied());
        let log = File::create(self.folder.join("log")).unwrap();
        Process::attempt(command, database, Stdio::from(log))
    }

    /// What the service said while it ran.
    fn log(&self) -> String {
        fs::read_to_string(self.folder.join("log")).unwrap()
    }

    /// The call that failed, and the file as its ending: `fsync -wal`.
    fn failed(&self, database: &Path) -> Option<String> {
        Some(fs::read_to_string(self.told()).ok()?.trim_end().replace(database.to_str().unwrap(), ""))
    }
}

/// What was acknowledged by a disk that failed.
#[derive(Default)]
struct Kept {
    /// Paths that answer.
    paths: Vec<String>,
    revision: i64,
    refused: Option<Answer>,
}

impl Kept {
    /// Takes an answer to a write. After one refusal every write is refused.
    #[track_caller]
    fn write(&mut self, answer: Answer, name: impl Fn(&Value) -> String) -> bool {
        if (200..300).contains(&answer.status) {
            assert!(self.refused.is_none(), "written after {:?}: {}", self.refused, answer.text);
            self.paths.push(name(&serde_json::from_str(&answer.text).unwrap_or_default()));
            return true;
        }
        assert_eq!(answer.status, 503, "{}", answer.text);
        self.refused = Some(answer);
        false
    }
}

fn window(client: &Client, number: u64) -> Answer {
    client.csv("/systems/room/2/windows", &room_csv(number, 1))
}

/// Where a document is found again.
fn path_in(folder: &str) -> impl Fn(&Value) -> String {
    move |body| format!("/{folder}/{}", body["id"].as_str().unwrap())
}

/// Writes of every kind, one after another, whatever becomes of them.
fn write_all(client: &Client, kept: &mut Kept) {
    for number in 100..103 {
        kept.write(window(client, number), path_in("windows"));
    }
    let job = seeded(quick("room/1"), 2);
    let answer = client.json_with("POST", "/jobs", &[("idempotency-key", "job")], &job);
    if kept.write(answer.clone(), path_in("jobs")) {
        // The job ends, or its end cannot be written.
        let (path, begun) = (format!("/jobs/{}", answer.json()["id"].as_str().unwrap()), Instant::now());
        while client.get("/readyz").status == 200 && client.get(&path).json()["ended_at"].is_null() {
            assert!(begun.elapsed() < PATIENCE, "{}", client.get(&path).text);
            thread::sleep(Duration::from_millis(10));
        }
    }
    kept.write(client.json("PUT", "/systems/room/3", &json!({"model": "rc2"})), |_| "/systems/room/3".into());
    let pin = client.json("PUT", "/params/room/1/pin", &json!({"reason": "sensor swap"}));
    if kept.write(pin.clone(), |_| "/params/room/1".into()) {
        kept.revision = pin.json()["revision"].as_i64().unwrap();
    }
    kept.write(window(client, 200), path_in("windows"));
}

#[test]
fn whatever_call_fails_nothing_is_acknowledged_that_is_not_kept() {
    let dir = tempfile::tempdir().unwrap();
    let Some(disk) = Disk::build(dir.path(), "IO-1") else { return };
    let sound = disk.folder.join("sound.db");
    let service = Process::start(&sound);
    prepare(&service.client);
    let served = service.client.get("/params/room/1").expect(200).json();
    assert_eq!(service.terminate().0, Some(0));
    let stride = if full() { 1 } else { 23 };
    let (mut call, mut clean, mut seed) = (1, 0, 1);
    let mut met: BTreeMap<String, u64> = BTreeMap::new();
    while clean < 3 {
        let database = disk.folder.join(format!("call-{call}.db"));
        fs::copy(&sound, &database).unwrap();
        let mut kept = Kept::default();
        let service = disk.start(&database, &[("DISK_FAILS_AT", &call.to_string())]);
        let had_started = service.is_some();
        if let Some(service) = service {
            write_all(&service.client, &mut kept);
            let failed = disk.failed(&database);
            let now = service.client.get("/params/room/1").expect(200).json();
            assert!(
                now["revision"].as_i64() >= served["revision"].as_i64().max(Some(kept.revision)),
                "{now}"
            );
            if kept.refused.is_some() {
                service.client.get("/readyz").expect(503);
            }
            // After a commit that failed, whoever asked for it, nothing more is written.
            if failed.is_some_and(|failed| failed.ends_with("-wal")) {
                kept.write(window(&service.client, 300), path_in("windows"));
                assert!(kept.refused.is_some(), "call {call}: {}", disk.log());
            }
            if random(&mut seed).is_multiple_of(2) {
                service.kill()
            } else {
                let _ = service.terminate();
            }
        }
        assert!(!disk.log().contains("panicked"), "call {call}: {}", disk.log());
        let failed = disk.failed(&database);
        check_database(&copied(&database));
        let service = Process::start(&database);
        for path in &kept.paths {
            service.client.get(path).expect(200);
        }
        let now = service.client.get("/params/room/1").expect(200).json();
        assert!(now["revision"].as_i64() >= served["revision"].as_i64().max(Some(kept.revision)), "{now}");
        let twice = "SELECT MIN(id) FROM jobs GROUP BY system, request HAVING COUNT(*) > 1";
        assert_eq!(rows(&database, twice), Vec::<String>::new());
        service.kill();
        fs::remove_file(&database).unwrap();
        clean = if failed.is_some() { 0 } else { clean + 1 };
        if let Some(failed) = failed {
            let end = if kept.refused.is_some() {
                "refused"
            } else if had_started {
                "went on"
            } else {
                "did not start"
            };
            *met.entry(format!("{failed}: {end}")).or_default() += 1;
        }
        call += 1 + random(&mut seed) % (2 * stride - 1);
    }
    println!("IO-1: calls 1 to {call}, each {stride}th, failed: {met:?}");
}

#[test]
fn when_the_power_goes_nothing_acknowledged_is_lost() {
    let dir = tempfile::tempdir().unwrap();
    let Some(disk) = Disk::build(dir.path(), "CRASH-3") else { return };
    let database = disk.folder.join("power.db");
    let runs = if full() { 300 } else { 12 };
    let service = Process::start(&database);
    prepare(&service.client);
    service.kill();
    let oracle = Mutex::new(Oracle::default());
    let (mut seed, mut at_start) = (17, 0);
    let mut met: BTreeMap<String, u64> = BTreeMap::new();
    for round in 0..runs {
        // Every fourth time soon, which is while the service starts or recovers.
        let longest = if round % 4 == 0 { 60 } else { 3000 };
        let call = 1 + random(&mut seed) % longest;
        match disk.start(
            &database,
            &[("DISK_DIES_AT", &call.to_string()), ("DISK_SEED", &random(&mut seed).to_string())],
        ) {
            None => at_start += 1,
            Some(mut service) => {
                let client = service.client.clone();
                Traffic::run(&client, &oracle, round, || {
                    let begun = Instant::now();
                    while !service.has_ended() {
                        assert!(begun.elapsed() < PATIENCE, "the power never went at call {call}");
                        thread::sleep(Duration::from_millis(5));
                    }
                });
            }
        }
        let begun = Instant::now();
        let failed = loop {
            match disk.failed(&database) {
                Some(failed) if !failed.is_empty() => break failed,
                _ => assert!(begun.elapsed() < PATIENCE, "call {call}: {}", disk.log()),
            }
            thread::sleep(Duration::from_millis(1));
        };
        *met.entry(failed).or_default() += 1;
        oracle.lock().unwrap().check_database(&copied(&database));
    }
    let service = Process::start(&database);
    let mut oracle = oracle.into_inner().unwrap();
    oracle.check_service(&service.client, &database);
    println!(
        "CRASH-3: the power went {runs} times, {at_start} of them in a start, nothing lost of {}; {met:?}",
        oracle.told()
    );
}

/// What a service on a disk that takes no writes does: it serves, and says why nothing more.
#[track_caller]
fn only_reads(service: &Process, served: &str, why: &str) {
    let client = &service.client;
    assert_eq!(client.get("/params/room/1").expect(200).text, served);
    let ready = client.get("/readyz").expect(503).json();
    assert_eq!((&ready["database"], &ready["queue"]), (&json!("read-only"), &json!("stopped")), "{ready}");
    assert!(ready["why"].as_str().unwrap().contains(why), "{ready}");
    for refused in [
        window(client, 100),
        client.json("POST", "/jobs", &quick("room/1")),
        client.json("PUT", "/systems/room/9", &json!({"model": "rc2"})),
    ] {
        refused.problem(503, "storage-read-only");
    }
    assert!(!client.get("/jobs").expect(200).json()["items"].as_array().unwrap().is_empty());
}

#[test]
fn a_start_on_a_disk_that_takes_no_writes_serves_what_was_published() {
    let dir = tempfile::tempdir().unwrap();
    let Some(disk) = Disk::build(dir.path(), "IO-3") else { return };
    let (sound, full_while) = (disk.folder.join("sound.db"), disk.folder.join("full"));
    let service = Process::start(&sound);
    prepare(&service.client);
    assert_eq!(service.terminate().0, Some(0));
    let full = [("DISK_FULL_WHILE", full_while.to_str().unwrap())];
    let read_only = [("DISK_READ_ONLY", "1")];
    for (number, (variables, why, was_killed)) in [
        (full, "full", false),
        (full, "full", true),
        (read_only, "read-only, or", false),
        (read_only, "read-only, or", true),
    ]
    .into_iter()
    .enumerate()
    {
        let database = disk.folder.join(format!("{number}.db"));
        fs::copy(&sound, &database).unwrap();
        let service = Process::start(&database);
        let taken = path_in("windows")(&window(&service.client, 1).expect(201).json());
        let served = service.client.get("/params/room/1").expect(200).text;
        if was_killed {
            service.kill();
        } else {
            assert_eq!(service.terminate().0, Some(0));
        }
        File::create(&full_while).unwrap();
        let service = disk.start(&database, &variables).unwrap_or_else(|| panic!("{}", disk.log()));
        only_reads(&service, &served, why);
        service.client.get(&taken).expect(200);
        assert_eq!(disk.log().matches("it is only read until the next start").count(), 1, "{}", disk.log());
        // Room alone is not enough: what is read is not looked at again.
        fs::remove_file(&full_while).unwrap();
        window(&service.client, 2).problem(503, "storage-read-only");
        File::create(&full_while).unwrap();
        assert_eq!(service.terminate().0, Some(0));
        let mut doctor = program();
        doctor.envs(variables).env("LD_PRELOAD", &disk.library).env("DISK_DATABASE", &disk.folder);
        let told = doctor.args(["doctor", "--database"]).arg(&database).output().unwrap();
        let told = String::from_utf8(told.stdout).unwrap();
        assert!(told.contains("ok    database") && told.contains("ok    schema"), "{told}");
        assert_eq!(told.contains("FAIL  folder"), variables == read_only, "{told}");
        fs::remove_file(&full_while).unwrap();
        let service = Process::start(&database);
        service.client.get(&taken).expect(200);
        assert_eq!(service.client.get("/params/room/1").expect(200).text, served);
        window(&service.client, 2).expect(201);
        service.client.get("/readyz").expect(200);
        service.kill();
        check_database(&copied(&database));
    }
}

#[test]
fn whichever_write_of_a_start_finds_no_room_the_service_serves() {
    let dir = tempfile::tempdir().unwrap();
    let Some(disk) = Disk::build(dir.path(), "IO-4") else { return };
    let sound = disk.folder.join("sound.db");
    let service = Process::start(&sound);
    prepare(&service.client);
    // A job that runs at the end of its process is to be begun again, which is written too.
    let job = service.client.post_job(&endless("room/1"));
    service.client.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
    let served = service.client.get("/params/room/1").expect(200).text;
    service.kill();
    let mut read_only = 0;
    for first in (1..).step_by(if full() { 1 } else { 4 }) {
        let database = disk.folder.join(format!("{first}.db"));
        for name in ["", "-wal"] {
            fs::copy(beside(&sound, name), beside(&database, name)).unwrap();
        }
        let service = disk.start(&database, &[("DISK_FULL_FROM", &first.to_string())]);
        let service = service.unwrap_or_else(|| panic!("no room from call {first} on: {}", disk.log()));
        assert_eq!(service.client.get("/params/room/1").expect(200).text, served, "from call {first} on");
        let ready = service.client.get("/readyz").json();
        if ready["database"] != "read-only" {
            // It had started by then.
            println!("IO-4: of the first {first} calls of a start {read_only} were tried without room");
            break;
        }
        read_only += 1;
        service.kill();
        fs::remove_file(&database).unwrap();
    }
    assert!(read_only >= 10, "{read_only} starts found no room");
}

#[test]
fn a_schema_that_cannot_be_brought_up_to_date_is_said_so() {
    let dir = tempfile::tempdir().unwrap();
    let Some(disk) = Disk::build(dir.path(), "IO-3") else { return };
    let (database, _) = golden(&disk.folder, 1);
    let full_while = disk.folder.join("full");
    File::create(&full_while).unwrap();
    for variable in [("DISK_FULL_WHILE", full_while.to_str().unwrap()), ("DISK_READ_ONLY", "1")] {
        assert!(disk.start(&database, &[variable]).is_none());
        let said = disk.log();
        assert!(said.contains("the database has schema 1, this program needs"), "{said}");
        assert!(said.contains("cannot be written"), "{said}");
    }
    fs::remove_file(&full_while).unwrap();
    Process::start(&database).client.get("/readyz").expect(200);
}

#[test]
fn a_disk_that_fills_while_nobody_writes_is_not_called_writable() {
    let dir = tempfile::tempdir().unwrap();
    let Some(disk) = Disk::build(dir.path(), "IO-2") else { return };
    let (database, full_while) = (disk.folder.join("idle.db"), disk.folder.join("full"));
    let service = disk.start(&database, &[("DISK_FULL_WHILE", full_while.to_str().unwrap())]).unwrap();
    service.client.get("/readyz").expect(200);
    File::create(&full_while).unwrap();
    let ready = service.client.until("/readyz", |ready| ready["database"] != "writable");
    assert_eq!((&ready["ready"], &ready["database"]), (&json!(false), &json!("full")), "{ready}");
    assert!(ready["why"].as_str().unwrap().contains("make room"), "{ready}");
    fs::remove_file(&full_while).unwrap();
    assert_eq!(service.client.get("/readyz").expect(200).json()["why"], Value::Null);
}

#[test]
fn a_full_disk_refuses_writes_until_there_is_room_and_needs_no_restart() {
    let dir = tempfile::tempdir().unwrap();
    let Some(disk) = Disk::build(dir.path(), "IO-2") else { return };
    let (database, full_while) = (disk.folder.join("full.db"), disk.folder.join("full"));
    let service = disk.start(&database, &[("DISK_FULL_WHILE", full_while.to_str().unwrap())]).unwrap();
    let client = &service.client;
    prepare(client);
    let served = client.get("/params/room/1").expect(200).text;
    let (mut taken, mut refused, mut polls, mut resumed) = (Vec::new(), 0, Vec::new(), Vec::new());
    for round in 0..3 {
        // A fit that ends while there is no room for it.
        let mut long = endless("room/2");
        long["budget"]["wall"] = json!("PT1S");
        long["method"]["seed"] = json!(round);
        let job = client.post_job(&long);
        client.until(&format!("/jobs/{job}"), |job| job["state"] == "running");
        for part in 0..100 {
            // Half of the time there is room.
            if part == 50 {
                File::create(&full_while).unwrap();
            }
            let answer = window(client, 1000 * (round + 1) + part);
            if part < 50 {
                taken.push(path_in("windows")(&answer.expect(201).json()));
            } else {
                assert_eq!(answer.header("retry-after"), "10");
                answer.problem(507, "storage-full");
                refused += 1;
            }
            let begun = Instant::now();
            assert_eq!(client.get("/params/room/1").expect(200).text, served);
            polls.push(begun.elapsed());
            thread::sleep(Duration::from_millis(10));
        }
        client.get("/readyz").expect(503);
        thread::sleep(Duration::from_secs(1));
        fs::remove_file(&full_while).unwrap();
        let begun = Instant::now();
        while window(client, 1000 * (round + 1) + 999).status != 201 {
            assert!(begun.elapsed() < PATIENCE, "writes do not go on: {}", disk.log());
            thread::sleep(Duration::from_millis(50));
        }
        resumed.push(begun.elapsed());
        client.get("/readyz").expect(200);
        let ended = client.ended(&job);
        // On a busy machine the grace of a budget of one second may be over before the fit is judged.
        let failed = ended["error"]["code"].as_str().unwrap_or_default();
        let as_expected = ended["state"] == "succeeded" || ["storage", "deadline"].contains(&failed);
        assert!(as_expected, "{}: {}", ended["state"], ended["error"]);
    }
    for path in &taken {
        client.get(path).expect(200);
    }
    service.kill();
    check_database(&copied(&database));
    println!(
        "IO-2: {} windows taken, {refused} refused; writes went on {:?} after there was room (target 10 s); \
        longest poll {:?}",
        taken.len(),
        resumed.iter().max().unwrap(),
        polls.iter().max().unwrap()
    );
}
