//! A night of very many rooms on one machine: what a start, a batch of all of them and a fit cost, by how
//! many there are.
//!
//! One room is measured and sent; the others are copies of it in the database, so that a hundred thousand are
//! there in a minute. Its model is the smallest, whose fit takes a hundredth of a second: what the database
//! and the queue cost shows beside it. The gate says of all what it says of the first.

mod house;
mod shared;

use super::load::text;
use super::row::Row;
use super::samples::{cpu, status};
use house::{DAYS, MODEL, READ, furnished, multiply, on_database, serve};
use lampyris::cli::Failure;
use lampyris::cli::server::{Call, Server};
use serde_json::json;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

/// Changes of a system beside the fits.
const CHANGES: usize = 50;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// How many rooms, one night after another.
    #[arg(long, value_delimiter = ',', default_values_t = [1_000, 10_000])]
    pub rooms: Vec<usize>,
    /// A PostgreSQL on which the same nights are run by several processes: `postgres://user@host:port`.
    #[arg(long)]
    pub server: Option<String>,
    /// How many processes that fit, one night after another.
    #[arg(long, value_delimiter = ',', default_values_t = [1, 2, 4])]
    pub processes: Vec<usize>,
    /// For how many seconds each night is looked at.
    #[arg(long, default_value_t = 20)]
    pub seconds: u64,
}

/// What a night costs.
struct Night {
    rooms: usize,
    start: f64,
    submission: f64,
    change: f64,
    fits: f64,
    cpu: f64,
    memory: f64,
    stored: f64,
}

pub fn run(asked: &Arguments) -> Result<Vec<Row>, Failure> {
    let folder = std::env::temp_dir().join(format!("lampyris-fleet-{}", std::process::id()));
    let length = Duration::from_secs(asked.seconds.max(1));
    if let Some(server) = &asked.server {
        return shared::run(&folder, server, &asked.rooms, &asked.processes, length);
    }
    let nights = asked.rooms.iter().map(|rooms| {
        std::fs::create_dir_all(&folder).map_err(text)?;
        let night = night(&folder, *rooms, length);
        std::fs::remove_dir_all(&folder).map_err(text)?;
        night
    });
    let nights = nights.collect::<Result<Vec<_>, _>>()?;
    let Some(first) = nights.first() else { return Ok(Vec::new()) };
    let mut rows = Vec::new();
    for night in &nights {
        let per_room = |seconds: f64| 1e3 * seconds / night.rooms as f64;
        rows.push(Row::new(format!("{} rooms: a start", night.rooms), night.start, "s"));
        rows.push(Row::new("  submitting a job for each", night.submission, "s"));
        rows.push(Row::new("  of that, for a room", per_room(night.submission), "ms"));
        rows.push(Row::new("  a change of a system meanwhile, median", 1e3 * night.change, "ms"));
        rows.push(Row::new("  fits, judged and kept", night.fits, "1/s"));
        rows.push(Row::new("  of both cores' time for a fit", 1e3 * night.cpu, "ms"));
        rows.push(Row::new("  beside the first night", night.cpu / first.cpu, "x").at_most(1.1));
        rows.push(Row::new("  memory", night.memory / 1024.0, "MiB"));
        rows.push(Row::new("  database, for a channel and day of 48 samples", night.stored, "B"));
    }
    Ok(rows)
}

fn night(folder: &Path, rooms: usize, length: Duration) -> Result<Night, Failure> {
    drop(furnished(folder)?);
    let database = folder.join("load.db");
    multiply(&database, rooms)?;
    let bytes = database.metadata().map_err(text)?.len() as f64;
    let begun = Instant::now();
    let service = serve(folder)?;
    let start = begun.elapsed().as_secs_f64();
    let server = Server::at(format!("http://{}", service.address()));
    let begun = Instant::now();
    server.call("POST", "/jobs", Call::json(&json!({"kind": "recalibrate", "systems": ["room/*"]})))?;
    let submission = begun.elapsed().as_secs_f64();
    let mut changes = Vec::new();
    for room in 0..CHANGES.min(rooms) {
        let begun = Instant::now();
        let document = json!({"model": MODEL, "label": "changed"});
        server.call("PUT", &format!("/systems/room/{room}"), Call::json(&document))?;
        changes.push(begun.elapsed().as_secs_f64());
    }
    changes.sort_by(f64::total_cmp);
    let before = (ended(&database)?, cpu(&service)?, Instant::now());
    while before.2.elapsed() < length && ended(&database)? < rooms as f64 {
        thread::sleep(Duration::from_millis(250));
    }
    let (spent, seconds) = (cpu(&service)? - before.1, before.2.elapsed().as_secs_f64());
    let fits = ended(&database)? - before.0;
    Ok(Night {
        rooms,
        start,
        submission,
        change: changes.get(changes.len() / 2).copied().unwrap_or(f64::NAN),
        fits: fits / seconds,
        cpu: spent / fits,
        memory: status(&service, "VmRSS:")?,
        stored: bytes / (rooms * DAYS * READ.len()) as f64,
    })
}

/// How many jobs have ended.
fn ended(database: &Path) -> Result<f64, Failure> {
    on_database(database, async |connection| {
        let sql = "SELECT COUNT(*) FROM jobs WHERE ended_at IS NOT NULL";
        let count: i64 = sqlx::query_scalar(sql).fetch_one(connection).await?;
        Ok(count as f64)
    })
}
