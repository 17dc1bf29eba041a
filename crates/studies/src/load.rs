//! How long a controller waits for its parameters while both cores are busy with fits, and while windows pour
//! in.
//!
//! The load is an open one: every poll has its time, whatever became of the one before, and its latency
//! counts from that time. A service that stands still for a second therefore shows as what it is.

use super::row::Row;
use lampyris::cli::server::{Call, Server};
use lampyris::cli::{Failure, faults};
use lampyris_core::twin;
use serde_json::{Value, json};
use std::ffi::OsStr;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Controllers that poll once a second, and one that polls much more often.
const POLLERS: u32 = 50;
const BUSY_POLLER: u32 = 100;
/// Clients that send windows without a pause.
const WRITERS: usize = 8;
/// Rows of such a window: a week of minutes, about a megabyte.
const ROWS: usize = 10_080;
/// Fits that run or wait, and the rooms that they are of.
const FITS: usize = 102;
const ROOMS: usize = 4;
/// A poll that takes longer has failed.
const PATIENCE: Duration = Duration::from_secs(10);
/// The path that is polled.
const POLLED: &str = "/params/room/1";

/// Latencies in milliseconds, in order, and polls without the right answer.
struct Measured {
    latencies: Vec<f64>,
    errors: usize,
}

impl Measured {
    /// The nearest rank.
    fn percentile(&self, percent: f64) -> f64 {
        let rank = (percent / 100.0 * self.latencies.len() as f64).ceil() as usize;
        self.latencies.get(rank.max(1) - 1).copied().unwrap_or(f64::NAN)
    }

    /// What is shown; milliseconds depend on the machine, so their targets do not bind.
    fn rows(&self, what: &str, targets: [Option<f64>; 3], idle: Option<&Measured>) -> Vec<Row> {
        let mut rows = Vec::new();
        for (percent, target) in [50.0, 99.0, 99.9].into_iter().zip(targets) {
            let aim = target.map_or_else(String::new, |target| format!(" (target {target} ms)"));
            rows.push(Row::new(
                format!("{what}: poll, percentile {percent}{aim}"),
                self.percentile(percent),
                "ms",
            ));
            if let Some(idle) = idle {
                rows.push(Row::new(
                    "  beside an idle service",
                    self.percentile(percent) / idle.percentile(percent),
                    "x",
                ));
            }
        }
        rows.push(
            Row::new(
                format!("{what}: polls that failed, of {}", self.latencies.len()),
                self.errors as f64,
                "",
            )
            .at_most(0.0),
        );
        rows
    }
}

/// A service in a process of its own, as a controller meets it.
pub struct Service {
    child: Child,
    address: String,
}

impl Service {
    /// Where it listens.
    pub fn address(&self) -> &str {
        &self.address
    }

    /// The number of its process.
    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Waits for its end.
    pub fn wait(&mut self) {
        let _ = self.child.wait();
    }

    /// Ends it without a word.
    pub fn kill(&mut self) {
        let _ = self.child.kill();
        self.wait();
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        self.kill();
    }
}

pub fn text(error: impl std::fmt::Display) -> Failure {
    Failure::Error(error.to_string())
}

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// How long the controller's path is polled beside fits; half as long beside fits and uploads.
    #[arg(long, default_value_t = 30)]
    pub seconds: u64,
    /// What live samples cost instead; a thousand systems send theirs for so long.
    #[arg(long)]
    pub samples: bool,
}

pub fn run(asked: &Arguments) -> Result<Vec<Row>, Failure> {
    let folder = std::env::temp_dir().join(format!("lampyris-load-{}", std::process::id()));
    std::fs::create_dir_all(&folder).map_err(text)?;
    let rows = measure(&folder, asked.seconds);
    std::fs::remove_dir_all(&folder).map_err(text)?;
    rows
}

fn measure(folder: &Path, seconds: u64) -> Result<Vec<Row>, Failure> {
    let service = start(folder)?;
    let server = Server::at(format!("http://{}", service.address));
    publish(&server)?;
    let length = Duration::from_secs(seconds.max(1));
    let idle = poll(&service.address, length / 5)?;
    saturate(&server)?;
    let fits = poll(&service.address, length)?;
    let (stop, taken, refused) = (AtomicBool::new(false), AtomicUsize::new(0), AtomicUsize::new(0));
    let mut weeks = Vec::new();
    for writer in 0..WRITERS {
        server.call("PUT", &room(writer), Call::json(&json!({ "model": "rc2" })))?;
        weeks.push(week(writer)?);
    }
    let storm = thread::scope(|scope| {
        for (writer, week) in weeks.iter().enumerate() {
            let system = room(writer);
            let (server, stop, taken, refused) = (&server, &stop, &taken, &refused);
            scope.spawn(move || {
                for turn in 0.. {
                    if stop.load(Ordering::Relaxed) {
                        break;
                    }
                    let counter = if write(server, &system, week, turn).is_ok() { taken } else { refused };
                    counter.fetch_add(1, Ordering::Relaxed);
                }
            });
        }
        let storm = poll(&service.address, length / 2);
        stop.store(true, Ordering::Relaxed);
        storm
    })?;
    let running =
        server.get("/jobs?state=running&page_size=10")?.document["items"].as_array().map_or(0, Vec::len);
    let mut rows = idle.rows("idle service", [None; 3], None);
    rows.extend(fits.rows("all cores busy with fits", [Some(1.0), Some(10.0), Some(50.0)], Some(&idle)));
    rows.extend(storm.rows(
        "fits, and 8 clients that send windows",
        [Some(1.0), Some(20.0), Some(50.0)],
        Some(&idle),
    ));
    let windows = taken.load(Ordering::Relaxed) as f64;
    rows.push(Row::new(
        "  windows of a megabyte that were taken",
        windows / (length / 2).as_secs_f64(),
        "1/s",
    ));
    rows.push(
        Row::new("  windows that were refused", refused.load(Ordering::Relaxed) as f64, "").at_most(0.0),
    );
    rows.push(Row::new("fits that were still running at the end", running as f64, "").at_least(2.0));
    Ok(rows)
}

pub fn start(folder: &Path) -> Result<Service, Failure> {
    start_with(folder, &[])
}

/// A service of the database in a folder, with these settings.
pub fn start_with(folder: &Path, settings: &[(&str, &str)]) -> Result<Service, Failure> {
    start_on(folder.join("load.db").as_os_str(), settings)
}

/// Starts a service on a database, wherever that is.
pub fn start_on(database: &OsStr, settings: &[(&str, &str)]) -> Result<Service, Failure> {
    let program = std::env::current_exe().map_err(text)?.with_file_name("lampyris");
    let mut child = Command::new(program)
        .args(["serve", "--bind", "127.0.0.1:0", "--database"])
        .arg(database)
        .envs(settings.iter().copied())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .map_err(text)?;
    let out = child.stdout.take();
    let mut service = Service { child, address: String::new() };
    let mut line = String::new();
    out.map(|out| BufReader::new(out).read_line(&mut line)).transpose().map_err(text)?;
    let address = line
        .trim()
        .strip_prefix("listening on http://")
        .ok_or_else(|| Failure::Error("the service did not start".to_owned()))?;
    service.address = address.to_owned();
    Ok(service)
}

/// Rooms with measurements; the parameters of the first one are served.
fn publish(server: &Server) -> Result<(), Failure> {
    for room in 1..=ROOMS {
        let twin = twin::room(room as u64, 0, 28, 30).map_err(|found| faults(&found))?;
        server.call("PUT", &format!("/systems/room/{room}"), Call::json(&json!({ "model": "room3" })))?;
        let body = Some(("text/csv", twin.csv.into_bytes()));
        server.call("POST", &format!("/systems/room/{room}/windows"), Call { body, ..Call::default() })?;
    }
    server.call("POST", "/jobs", Call::json(&json!({"kind": "estimate", "system": "room/1"})))?;
    until(server, POLLED, |_| true)
}

/// More fits than there are workers, none of which ends while it is needed.
fn saturate(server: &Server) -> Result<(), Failure> {
    for fit in 0..FITS {
        let room = 1 + fit % ROOMS;
        let body = json!({
            "kind": "estimate", "system": format!("room/{room}"), "experiment": true,
            "method": {"name": "cfa_thesis", "seed": fit, "generations": 10_000},
            "budget": {"evaluations": 100_000_000},
        });
        server.call("POST", "/jobs", Call::json(&body))?;
    }
    until(server, "/jobs?state=running&page_size=10", |jobs| {
        jobs["items"].as_array().is_some_and(|jobs| jobs.len() >= 2)
    })
}

/// Asks until there is an answer that will do.
pub fn until(server: &Server, path: &str, will_do: impl Fn(&Value) -> bool) -> Result<(), Failure> {
    let begun = Instant::now();
    while begun.elapsed() < Duration::from_secs(60) {
        if server.get(path).is_ok_and(|answer| will_do(&answer.document)) {
            return Ok(());
        }
        thread::sleep(Duration::from_millis(50));
    }
    Err(Failure::Error(format!("{path} was not ready in a minute")))
}

/// The system of a writer.
fn room(writer: usize) -> String {
    format!("/systems/room/w{writer}")
}

/// A week of ten channels in a system of the writer's own.
fn week(writer: usize) -> Result<String, Failure> {
    let mut csv = String::from(
        "time,T_room,T_out,T_forward,P_heater,cloud_cover,wind_speed,CO2,occupancy,flow,irradiance\n",
    );
    let start: jiff::Timestamp = "2026-01-05T00:00:00Z".parse().map_err(text)?;
    for row in 0..ROWS {
        csv.push_str(&(start + jiff::SignedDuration::from_mins(row as i64)).to_string());
        let wave = (row as f64 / 230.0 + writer as f64).sin();
        for (level, swing) in [
            (20.0, 2.0),
            (4.0, 6.0),
            (32.0, 5.0),
            (1.5, 1.5),
            (0.5, 0.4),
            (5.0, 4.0),
            (700.0, 300.0),
            (0.5, 0.5),
            (0.5, 0.5),
            (200.0, 200.0),
        ] {
            csv.push_str(&format!(",{:.4}", level + swing * wave));
        }
        csv.push('\n');
    }
    Ok(csv)
}

/// Sends the week with one minute more, which was never sent before, and takes it away again.
fn write(server: &Server, system: &str, week: &str, turn: usize) -> Result<(), Failure> {
    let csv = format!("{week}2026-01-12T00:00:00Z,{:.4}\n", 15.0 + turn as f64 / 10_000.0);
    let body = Some(("text/csv", csv.into_bytes()));
    let taken = server.call("POST", &format!("{system}/windows"), Call { body, ..Call::default() })?;
    let id = taken.document["id"].as_str().unwrap_or_default().to_owned();
    server.call("DELETE", &format!("/windows/{id}"), Call::default()).map(drop)
}

/// Polls for so long.
fn poll(address: &str, length: Duration) -> Result<Measured, Failure> {
    let begun = Instant::now() + Duration::from_millis(100);
    let mut measured = Measured { latencies: Vec::new(), errors: 0 };
    thread::scope(|scope| {
        let slow =
            (0..POLLERS).map(|poller| (Duration::from_secs(1), Duration::from_secs(1) * poller / POLLERS));
        let pollers: Vec<_> = slow
            .chain([(Duration::from_secs(1) / BUSY_POLLER, Duration::ZERO)])
            .map(|(period, offset)| {
                scope.spawn(move || poller(address, begun + offset, period, begun + length))
            })
            .collect();
        for poller in pollers {
            let one = poller.join().map_err(|_| Failure::Error("a poller panicked".to_owned()))?;
            measured.latencies.extend(one.latencies);
            measured.errors += one.errors;
        }
        Ok::<(), Failure>(())
    })?;
    measured.latencies.sort_by(f64::total_cmp);
    Ok(measured)
}

/// One controller: polls at its times, over one connection as long as that holds.
fn poller(address: &str, first: Instant, period: Duration, end: Instant) -> Measured {
    let mut measured = Measured { latencies: Vec::new(), errors: 0 };
    let mut connection = None;
    let mut intended = first;
    while intended < end {
        thread::sleep(intended.saturating_duration_since(Instant::now()));
        match ask(address, &mut connection) {
            Ok(()) => {}
            Err(_) => {
                measured.errors += 1;
                connection = None;
            }
        }
        measured.latencies.push(1000.0 * intended.elapsed().as_secs_f64());
        intended += period;
    }
    measured
}

/// One poll and its answer, which has to be 200 and whole.
fn ask(address: &str, connection: &mut Option<BufReader<TcpStream>>) -> std::io::Result<()> {
    let mut stream = match connection.take() {
        Some(stream) => stream,
        None => {
            let stream = TcpStream::connect(address)?;
            stream.set_nodelay(true)?;
            stream.set_read_timeout(Some(PATIENCE))?;
            BufReader::new(stream)
        }
    };
    stream.get_mut().write_all(format!("GET {POLLED} HTTP/1.1\r\nhost: {address}\r\n\r\n").as_bytes())?;
    let (mut line, mut length) = (String::new(), 0);
    stream.read_line(&mut line)?;
    if !line.starts_with("HTTP/1.1 200") {
        return Err(std::io::Error::other(line));
    }
    while line != "\r\n" {
        line.clear();
        if stream.read_line(&mut line)? == 0 {
            return Err(std::io::ErrorKind::UnexpectedEof.into());
        }
        if let Some(value) = line.strip_prefix("content-length: ") {
            length = value.trim().parse().map_err(std::io::Error::other)?;
        }
    }
    let mut body = vec![0; length];
    stream.read_exact(&mut body)?;
    *connection = Some(stream);
    Ok(())
}
