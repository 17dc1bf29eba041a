//! The service under twice the load of a house for a while: what it holds stays as it is.

use crate::consistency::{Reader, Seen};
use crate::support::process::Process;
use crate::support::{endless, full, quick, room_csv};
use serde_json::json;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

/// A log that grew beyond this was never folded into the database.
const LOG_BYTES: u64 = 64 << 20;

#[test]
fn under_a_steady_load_memory_files_and_log_stay_as_they_are() {
    let length = Duration::from_secs(if full() { 600 } else { 8 });
    let dir = tempfile::tempdir().unwrap();
    let database = dir.path().join("soak.db");
    let service = Process::start(&database);
    service.client.room("1", 1);
    let fit = service.client.ended(&service.client.post_job(&quick("room/1")));
    assert_eq!(fit["outcome"], "accepted");
    service.client.json("PUT", "/systems/room/2", &json!({"model": "rc2"})).expect(201);
    let (stop, reads, windows, jobs) = (AtomicBool::new(false), AtomicUsize::new(0), AtomicUsize::new(0), AtomicUsize::new(0));
    let (mut seen, mut samples, mut log) = (Seen::default(), Vec::new(), 0);
    std::thread::scope(|scope| {
        let (service, stop, reads) = (&service, &stop, &reads);
        scope.spawn(|| seen.watch(&mut Reader::new(service.base()), 0, stop, reads));
        // Windows come and go, so that the database may stay as large as it is.
        scope.spawn(|| {
            for round in 0.. {
                if stop.load(Ordering::Relaxed) {
                    break;
                }
                let taken = service.client.csv("/systems/room/2/windows", &room_csv(round, 3)).expect(201).json();
                service.client.send("DELETE", &format!("/windows/{}", taken["id"].as_str().unwrap()), &[], None).unwrap().expect(204);
                windows.fetch_add(1, Ordering::Relaxed);
                std::thread::sleep(Duration::from_millis(50));
            }
        });
        // Fits that end, fits that are called off, and operators who change their mind.
        scope.spawn(|| {
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
                let (method, body) =
                    if round.is_multiple_of(2) { ("PUT", Some(json!({"reason": "soak"}).to_string())) } else { ("DELETE", None) };
                let headers = [("content-type", "application/json")];
                let answer = service.client.send(method, "/params/room/1/pin", &headers, body.as_deref().map(str::as_bytes)).unwrap();
                assert!(answer.status < 300, "{}", answer.text);
                jobs.fetch_add(1, Ordering::Relaxed);
            }
        });
        let begun = Instant::now();
        while begun.elapsed() < length {
            std::thread::sleep(length / 80);
            samples.push((service.status("VmRSS"), service.open_files()));
            log = log.max(database.with_extension("db-wal").metadata().map_or(0, |log| log.len()));
        }
        stop.store(true, Ordering::Relaxed);
    });
    // The median of a part of the samples, by memory and by files.
    let middle = |part: &[(u64, usize)]| {
        let (mut memory, mut files): (Vec<u64>, Vec<usize>) = part.iter().copied().unzip();
        memory.sort();
        files.sort();
        (memory[memory.len() / 2], files[files.len() / 2])
    };
    let third = samples.len() / 3;
    let ((before, files_before), (after, files_after)) = (middle(&samples[third..2 * third]), middle(&samples[2 * third..]));
    let slope = (after as f64 - before as f64) / 1024.0 / (length.as_secs_f64() / 3.0 / 3600.0);
    println!(
        "SOAK-1: {} s, {} reads, {windows:?} windows, {jobs:?} jobs: resident {before} to {after} KiB ({slope:.1} MB/h, target 1), \
         files {files_before} to {files_after}, log at most {} KiB",
        length.as_secs(),
        reads.load(Ordering::Relaxed),
        log / 1024
    );
    assert!(files_after <= files_before + 2, "{files_before} {files_after}");
    assert!(log < LOG_BYTES, "{log}");
    assert!(!full() || after as f64 <= 1.05 * before as f64, "resident memory grew from {before} to {after} KiB");
}
