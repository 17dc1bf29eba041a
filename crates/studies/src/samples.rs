//! What a live sample costs: the last as much as the first, and a thousand systems of one a minute.
//!
//! Rooms whose parameters are served get the rows of another month one by one, so that their states go on.
//! Costs are CPU seconds of the service's process, which do not depend on who else runs.

use super::load::{Service, start, text, until};
use super::row::Row;
use lampyris::cli::server::{Call, Server};
use lampyris::cli::{Failure, faults};
use lampyris_core::twin;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::thread;
use std::time::{Duration, Instant};

/// Single-row posts to one system.
const POSTS: usize = 10_000;
/// Posts over which the cost of one is told, at the beginning and at the end.
const TOLD: usize = 500;
/// Systems of one sample a minute, and those of them whose parameters are served.
const SYSTEMS: usize = 1_000;
const SERVED: usize = 50;
/// Days that a fit is made from, and minutes between two of their rows.
const DAYS: usize = 28;
const STEP: usize = 30;

/// A row: its time, then its values by the names of the header.
type Sample = (String, Value);

pub fn run(seconds: u64) -> Result<Vec<Row>, Failure> {
    let folder = std::env::temp_dir().join(format!("lampyris-samples-{}", std::process::id()));
    let rows = single(&folder.join("single")).and_then(|mut rows| {
        rows.extend(thousand(&folder.join("thousand"), Duration::from_secs(seconds))?);
        Ok(rows)
    });
    std::fs::remove_dir_all(&folder).map_err(text)?;
    rows
}

fn single(folder: &Path) -> Result<Vec<Row>, Failure> {
    std::fs::create_dir_all(folder).map_err(text)?;
    let service = start(folder)?;
    let server = Server::at(format!("http://{}", service.address()));
    serve(&server, 1)?;
    let samples = samples(1, POSTS)?;
    let mut costs = Vec::new();
    for (index, sample) in samples.iter().enumerate() {
        if [0, TOLD, POSTS - TOLD].contains(&index) {
            costs.push(cpu(&service)?);
        }
        post(&server, 1, sample)?;
    }
    costs.push(cpu(&service)?);
    let of = |from: usize, to: usize| 1000.0 * (costs[to] - costs[from]) / TOLD as f64;
    let (first, last) = (of(0, 1), of(2, 3));
    let newest = samples.last().map_or("", |(time, _)| time);
    let state = server.get("/systems/room/1/state")?.document;
    let behind = seconds_between(state["at"].as_str().unwrap_or_default(), newest)?;
    let path = format!("/systems/room/1/series?from={}T00:00:00Z", &newest[..10]);
    let mut answers: Vec<f64> = Vec::new();
    for _ in 0..20 {
        let begun = Instant::now();
        server.get(&path)?;
        answers.push(1000.0 * begun.elapsed().as_secs_f64());
    }
    answers.sort_by(f64::total_cmp);
    let windows = server.get("/systems/room/1/windows")?.document["items"].as_array().map_or(0, Vec::len);
    let bytes = size(service, folder)?;
    let whole = whole(&folder.with_file_name("whole"), &samples)?;
    Ok(vec![
        Row::new(format!("CPU of a single-row post, the first {TOLD}"), first, "ms").at_most(5.0),
        Row::new(format!("CPU of a single-row post, the last {TOLD} of {POSTS}"), last, "ms").at_most(5.0),
        Row::new("  beside the first", last / first, "x").at_most(1.5),
        Row::new("steps of the model that its states are behind", behind / (60.0 * STEP as f64), "")
            .at_most(1.0),
        Row::new("series of the last day, median (target 20 ms)", answers[answers.len() / 2], "ms"),
        Row::new("windows that hold the posts", windows as f64 - 1.0, "").at_most(2.0),
        Row::new("database beside the same rows in one window", bytes / whole, "x").at_most(2.0),
    ])
}

/// The size of a database that got the same samples as one window.
fn whole(folder: &Path, samples: &[Sample]) -> Result<f64, Failure> {
    std::fs::create_dir_all(folder).map_err(text)?;
    let service = start(folder)?;
    let server = Server::at(format!("http://{}", service.address()));
    serve(&server, 1)?;
    let names: Vec<&String> = samples[0].1.as_object().map_or_else(Vec::new, |row| row.keys().collect());
    let column = |name: &&String| (*name).clone();
    let values: serde_json::Map<String, Value> = names
        .iter()
        .map(|name| (column(name), samples.iter().map(|(_, row)| row[name.as_str()].clone()).collect()))
        .collect();
    let times: Vec<&String> = samples.iter().map(|(time, _)| time).collect();
    server.call(
        "POST",
        "/systems/room/1/windows",
        Call::json(&json!({ "time": times, "values": values })),
    )?;
    size(service, folder)
}

/// Many systems of one sample a minute, until the process is killed.
fn thousand(folder: &Path, length: Duration) -> Result<Vec<Row>, Failure> {
    std::fs::create_dir_all(folder).map_err(text)?;
    let mut service = start(folder)?;
    let server = Server::at(format!("http://{}", service.address()));
    for room in 1..=SERVED {
        serve(&server, room)?;
    }
    for room in SERVED + 1..=SYSTEMS {
        server.call("PUT", &format!("/systems/room/{room}"), Call::json(&json!({ "model": "rc2" })))?;
    }
    let minutes = length.as_secs() as usize / 60 + 1;
    let samples = samples(1, minutes + 1)?;
    // The first round begins the states, which is no part of the cost of a sample.
    for room in 1..=SYSTEMS {
        post(&server, room, &samples[0])?;
    }
    thread::sleep(Duration::from_secs(10));
    let (begun, before) = (Instant::now(), cpu(&service)?);
    let gap = Duration::from_secs(60) / SYSTEMS as u32;
    let mut acknowledged = vec![1; SYSTEMS + 1];
    let mut turn = 0_u32;
    while begun.elapsed() < length {
        thread::sleep((gap * turn).saturating_sub(begun.elapsed()));
        let (minute, room) = (1 + turn as usize / SYSTEMS, 1 + turn as usize % SYSTEMS);
        post(&server, room, &samples[minute])?;
        acknowledged[room] = minute + 1;
        turn += 1;
    }
    let share = 100.0 * (cpu(&service)? - before) / begun.elapsed().as_secs_f64();
    let resident = status(&service, "VmRSS:")? / 1024.0;
    service.kill();
    drop(service);
    let service = start(folder)?;
    let server = Server::at(format!("http://{}", service.address()));
    let mut lost = 0;
    for (room, count) in acknowledged.iter().enumerate().skip(1) {
        let series = server.get(&format!("/systems/room/{room}/series?channels=T_room"))?.document;
        let newest = series["to"].as_str().unwrap_or_default();
        lost += usize::from(seconds_between(newest, &samples[count - 1].0)? > 0.0);
    }
    Ok(vec![
        Row::new(format!("{SYSTEMS} systems of a sample a minute: share of one core"), share, "%")
            .at_most(10.0),
        Row::new("  posts", f64::from(turn), ""),
        Row::new("  resident", resident, "MiB"),
        Row::new("  systems that lost a sample when the process was killed", lost as f64, "").at_most(0.0),
    ])
}

/// A room whose parameters are served: they are all alike, and the gate accepts them.
fn serve(server: &Server, room: usize) -> Result<(), Failure> {
    let twin = twin::room(1, 0, DAYS, STEP).map_err(|found| faults(&found))?;
    server.call("PUT", &format!("/systems/room/{room}"), Call::json(&json!({ "model": "room3" })))?;
    let body = Some(("text/csv", twin.csv.into_bytes()));
    server.call("POST", &format!("/systems/room/{room}/windows"), Call { body, ..Call::default() })?;
    let job = json!({"kind": "estimate", "system": format!("room/{room}")});
    server.call("POST", "/jobs", Call::json(&job))?;
    until(server, &format!("/params/room/{room}"), |_| true)
}

/// Rows of a minute each behind the days of a twin.
fn samples(seed: u64, count: usize) -> Result<Vec<Sample>, Failure> {
    let days = DAYS + count / 1440 + 2;
    let twin = twin::room(seed, 0, days, STEP).map_err(|found| faults(&found))?;
    let mut lines = twin.csv.lines();
    let names: Vec<&str> = lines.next().unwrap_or_default().split(',').skip(1).collect();
    let mut samples = Vec::new();
    for line in lines.skip(DAYS * 24 * 60 / STEP) {
        let mut cells = line.split(',');
        let begun: jiff::Timestamp = cells.next().unwrap_or_default().parse().map_err(text)?;
        let values: serde_json::Map<String, Value> = names
            .iter()
            .zip(cells)
            .map(|(name, cell)| ((*name).to_owned(), cell.parse::<f64>().map_or(Value::Null, Value::from)))
            .collect();
        for minute in 0..STEP {
            let time = begun + jiff::SignedDuration::from_mins(minute as i64);
            samples.push((time.to_string(), Value::Object(values.clone())));
        }
        if samples.len() >= count {
            samples.truncate(count);
            return Ok(samples);
        }
    }
    Err(Failure::Error("the twin has too few rows".to_owned()))
}

fn post(server: &Server, room: usize, (time, values): &Sample) -> Result<(), Failure> {
    let body = json!({ "time": time, "values": values });
    server.call("POST", &format!("/systems/room/{room}/samples"), Call::json(&body)).map(drop)
}

/// CPU seconds that the service has used, in its own code and in the system's for it.
pub fn cpu(service: &Service) -> Result<f64, Failure> {
    let stat = std::fs::read_to_string(format!("/proc/{}/stat", service.id())).map_err(text)?;
    cpu_of(&stat).ok_or_else(|| Failure::Error("no CPU time".to_owned()))
}

/// The same of any process, by what the system says in its `stat`.
pub fn cpu_of(stat: &str) -> Option<f64> {
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace().skip(11).map(str::parse::<f64>);
    Some((fields.next()?.ok()? + fields.next()?.ok()?) / 100.0)
}

/// A number of the process's status, in kB.
pub fn status(service: &Service, name: &str) -> Result<f64, Failure> {
    let status = std::fs::read_to_string(format!("/proc/{}/status", service.id())).map_err(text)?;
    let line = status.lines().find_map(|line| line.strip_prefix(name)).unwrap_or_default();
    line.split_whitespace().next().unwrap_or_default().parse().map_err(text)
}

/// Stops a service and gives the size of its database in bytes, the log folded into it.
fn size(mut service: Service, folder: &Path) -> Result<f64, Failure> {
    let ended = Command::new("kill").arg(service.id().to_string()).status().map_err(text)?;
    if !ended.success() {
        return Err(Failure::Error("the service could not be stopped".to_owned()));
    }
    service.wait();
    let files = ["load.db", "load.db-wal"].map(|name| folder.join(name));
    let bytes = |file: &PathBuf| file.metadata().map_or(0, |file| file.len());
    Ok(files.iter().map(bytes).sum::<u64>() as f64)
}

fn seconds_between(from: &str, to: &str) -> Result<f64, Failure> {
    let [from, to] = [from, to].map(|time| time.parse::<jiff::Timestamp>().map_err(text));
    Ok(to?.duration_since(from?).as_secs_f64())
}
