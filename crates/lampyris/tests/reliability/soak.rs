//! The service under twice the load of a house for a while, through kills and a full database: what it holds
//! stays as it is.

use crate::consistency::{Reader, Seen};
use crate::support::process::Process;
use crate::support::rooms::room_csv;
use crate::support::{endless, full, quick};
use serde_json::json;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// A log that grew beyond this was never folded into the database.
const LOG_BYTES: u64 = 64 << 20;
/// What a database may still take before it is full.
const ROOM_BYTES: u64 = 2 << 20;
/// A load that leaves some of that.
const SHORT_LOAD: Duration = Duration::from_secs(3);
/// More windows than fit into that.
const MOST_WINDOWS: u64 = 2000;

/// Resident memory and open files of a process.
type Sample = (u64, usize);

/// What was done, and seen, by all the processes.
#[derive(Default)]
struct Soak {
    seen: Seen,
    reads: AtomicUsize,
    windows: AtomicUsize,
    jobs: AtomicUsize,
    log: u64,
}

impl Soak {
    /// Reads, uploads, fits and changes of mind for a while.
    fn load(&mut self, service: &Process, database: &Path, length: Duration) -> Vec<Sample> {
        let (stop, reads, windows, jobs) = (AtomicBool::new(false), &self.reads, &self.windows, &self.jobs);
        let (stop, seen, mut samples) = (&stop, &mut self.seen, Vec::new());
        std::thread::scope(|scope| {
            scope.spawn(|| seen.watch(&mut Reader::new(service.base()), 0, stop, reads));
            // Windows come and go, so that the database may stay as large as it is.
            scope.spawn(move || {
                for round in 0.. {
                    if stop.load(Ordering::Relaxed) {
                        break;
                    }
                    let taken =
                        service.client.csv("/systems/room/2/windows", &room_csv(round, 3)).expect(201).json();
                    service
                        .client
                        .send("DELETE", &format!("/windows/{}", taken["id"].as_str().unwrap()), &[], None)
                        .unwrap()
                        .expect(204);
                    windows.fetch_add(1, Ordering::Relaxed);
                    std::thread::sleep(Duration::from_millis(50));
                }
            });
            // Fits that end, fits that are called off, and operators who change their mind.
            scope.spawn(move || {
                for round in 0u64.. {
                    if stop.load(Ordering::Relaxed) {
                        break;
                    }
                    let mut body = if round.is_multiple_of(3) { endless("room/1") } else { quick("room/1") };
                    body["method"]["seed"] = json!(round);
                    body["experiment"] = json!(true);
                    let job = service.client.post_job(&body);
                    if round.is_multiple_of(3) {
                        service.client.post(&format!("/jobs/{job}/cancel")).expect(200);
                    }
                    service.client.ended(&job);
                    let (method, body) = if round.is_multiple_of(2) {
                        ("PUT", Some(json!({"reason": "soak"}).to_string()))
                    } else {
                        ("DELETE", None)
                    };
                    let headers = [("content-type", "application/json")];
                    let answer = service
                        .client
                        .send(method, "/params/room/1/pin", &headers, body.as_deref().map(str::as_bytes))
                        .unwrap();
                    assert!(answer.status < 300, "{}", answer.text);
                    jobs.fetch_add(1, Ordering::Relaxed);
                }
            });
            let begun = Instant::now();
            while begun.elapsed() < length {
                std::thread::sleep(length / 80);
                samples.push((service.status("VmRSS"), service.open_files()));
                self.log =
                    self.log.max(database.with_extension("db-wal").metadata().map_or(0, |log| log.len()));
            }
            stop.store(true, Ordering::Relaxed);
        });
        samples
    }
}

/// Fills the database until it refuses, and makes room again; what is served is served all the while.
fn fill_up(service: &Process) {
    let served = service.client.get("/params/room/1").expect(200).text;
    let mut taken = Vec::new();
    for number in 0..MOST_WINDOWS {
        let answer = service.client.csv("/systems/room/2/windows", &room_csv(10_000 + number, 14));
        if answer.status == 507 {
            break;
        }
        taken.push(answer.expect(201).json()["id"].as_str().unwrap().to_owned());
    }
    assert!(!taken.is_empty() && (taken.len() as u64) < MOST_WINDOWS, "{} windows were taken", taken.len());
    assert_eq!(service.client.get("/params/room/1").expect(200).text, served);
    for id in &taken {
        service.client.send("DELETE", &format!("/windows/{id}"), &[], None).unwrap().expect(204);
    }
}

/// The median of some samples, by memory and by files.
fn middle(part: &[Sample]) -> Sample {
    let (mut memory, mut files): (Vec<u64>, Vec<usize>) = part.iter().copied().unzip();
    memory.sort();
    files.sort();
    (memory[memory.len() / 2], files[files.len() / 2])
}

#[test]
fn under_a_steady_load_memory_files_and_log_stay_as_they_are() {
    // Of the lives of the service the last one is as long as all the others, which end by a kill.
    let (length, lives) = if full() { (Duration::from_secs(600), 5) } else { (Duration::from_secs(12), 3) };
    let dir = tempfile::tempdir().unwrap();
    let database = dir.path().join("soak.db");
    let service = Process::start(&database);
    service.client.room("1", 1);
    let fit = service.client.ended(&service.client.post_job(&quick("room/1")));
    assert_eq!(fit["outcome"], "accepted");
    service.client.json("PUT", "/systems/room/2", &json!({"model": "rc2"})).expect(201);
    assert_eq!(service.terminate().0, Some(0));
    let mut soak = Soak::default();
    for life in 1..lives {
        // Windows are refused beyond nine tenths.
        let room = ((database.metadata().unwrap().len() + ROOM_BYTES) / 9 * 10).to_string();
        let is_tight = life == lives / 2;
        let environment: &[(&str, &str)] =
            if is_tight { &[("LAMPYRIS_LIMITS_DATABASE_BYTES", &room)] } else { &[] };
        let service = Process::start_with(&database, environment);
        if is_tight {
            soak.load(&service, &database, SHORT_LOAD);
            fill_up(&service);
        } else {
            soak.load(&service, &database, length / 2 / (lives - 2));
        }
        // A fit that nobody calls off, for the next life to find; that one is cancelled then.
        let left = service.client.post_job(&endless("room/1"));
        service.kill();
        let service = Process::start(&database);
        service.client.post(&format!("/jobs/{left}/cancel")).expect(200);
        assert_eq!(service.client.ended(&left)["state"], "cancelled");
        assert_eq!(service.terminate().0, Some(0));
    }
    let service = Process::start(&database);
    let samples = soak.load(&service, &database, length / 2);
    assert_eq!(service.terminate().0, Some(0));
    // The page caches of the database fill for about three minutes: resident 38 to 51 MB, and 53.5 MB after
    // eight.
    let (half, rest) = (samples.len() / 2, samples.len() * 3 / 4);
    let ((before, files_before), (after, files_after)) =
        (middle(&samples[half..rest]), middle(&samples[rest..]));
    let slope = (after as f64 - before as f64) / 1024.0 / (length.as_secs_f64() / 8.0 / 3600.0);
    println!(
        "SOAK-1: {} s, {} kills, a full database, {} reads, {} windows, {} jobs: resident {before} to \
        {after} KiB ({slope:.1} MB/h, target 1), \
         files {files_before} to {files_after}, log at most {} KiB, database {} KiB",
        length.as_secs(),
        lives - 1,
        soak.reads.load(Ordering::Relaxed),
        soak.windows.load(Ordering::Relaxed),
        soak.jobs.load(Ordering::Relaxed),
        soak.log / 1024,
        database.metadata().unwrap().len() / 1024
    );
    assert!(files_after <= files_before + 2, "{files_before} {files_after}");
    assert!(soak.log < LOG_BYTES, "{}", soak.log);
    assert!(
        !full() || after as f64 <= 1.05 * before as f64,
        "resident memory grew from {before} to {after} KiB"
    );
}
