//! A night of very many rooms on one machine: what a start, a batch of all of them and a fit cost, by how
//! many there are.
//!
//! One room is measured and sent; the others are copies of it in the database, so that a hundred thousand are
//! there in a minute. Its model is the smallest, whose fit takes a hundredth of a second: what the database
//! and the queue cost shows beside it. The gate says of all what it says of the first.

use super::load::{Service, start_with, text};
use super::row::Row;
use super::samples::{cpu, status};
use lampyris::cli::server::{Call, Server};
use lampyris::cli::{Failure, faults};
use lampyris_core::twin;
use serde_json::json;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{AssertSqlSafe, ConnectOptions, SqliteConnection};
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

/// Days of the room, and minutes between two of its samples.
const DAYS: usize = 28;
const STEP: usize = 30;
const MODEL: &str = "rc1";
/// The columns of a synthetic room that the model reads, behind the time.
const READ: [&str; 2] = ["T_room", "T_out"];
/// The tables that hold something of a room that was measured, with what makes a copy its own.
const TABLES: [(&str, &[(&str, &str)]); 4] = [
    ("systems", &[("system", "copy.system")]),
    (
        "windows",
        &[("system", "copy.system"), ("id", "'win_' || copy.number"), ("sequence", "1000 + copy.number")],
    ),
    ("days", &[("system", "copy.system")]),
    ("measured", &[("system", "copy.system")]),
];
/// Changes of a system beside the fits.
const CHANGES: usize = 50;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// How many rooms, one night after another.
    #[arg(long, value_delimiter = ',', default_values_t = [1_000, 10_000])]
    pub rooms: Vec<usize>,
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
    let nights = asked.rooms.iter().map(|rooms| {
        std::fs::create_dir_all(&folder).map_err(text)?;
        let night = night(&folder, *rooms, Duration::from_secs(asked.seconds.max(1)));
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

fn serve(folder: &Path) -> Result<Service, Failure> {
    start_with(folder, &[("LAMPYRIS_LIMITS_QUEUE", "10000000")])
}

/// A service with one room that was measured.
fn furnished(folder: &Path) -> Result<Service, Failure> {
    let service = serve(folder)?;
    let server = Server::at(format!("http://{}", service.address()));
    let twin = twin::room(1, 0, DAYS, STEP).map_err(|found| faults(&found))?;
    server.call("PUT", "/systems/room/0", Call::json(&json!({ "model": MODEL })))?;
    let body = Some(("text/csv", read(&twin.csv).into_bytes()));
    server.call("POST", "/systems/room/0/windows", Call { body, ..Call::default() })?;
    Ok(service)
}

/// The columns that the model reads.
fn read(csv: &str) -> String {
    let names: Vec<&str> = csv.lines().next().unwrap_or_default().split(',').collect();
    let places: Vec<usize> = std::iter::once("time")
        .chain(READ)
        .filter_map(|name| names.iter().position(|column| column.starts_with(name)))
        .collect();
    let line = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        places.iter().filter_map(|place| cells.get(*place).copied()).collect::<Vec<_>>().join(",") + "\n"
    };
    csv.lines().map(line).collect()
}

/// Copies the one room until there are so many.
fn multiply(database: &Path, rooms: usize) -> Result<(), Failure> {
    on_database(database, async |connection| {
        sqlx::query("PRAGMA synchronous = OFF").execute(&mut *connection).await?;
        let copies = "CREATE TEMP TABLE copy AS WITH RECURSIVE n (number) AS (SELECT 1 UNION ALL SELECT number + 1 \
            FROM n WHERE number < $1) SELECT number, 'room/' || number AS system FROM n";
        sqlx::query(copies).bind(rooms.saturating_sub(1) as i64).execute(&mut *connection).await?;
        for (table, own) in TABLES {
            let names: Vec<String> = sqlx::query_scalar("SELECT name FROM pragma_table_info($1)")
                .bind(table)
                .fetch_all(&mut *connection)
                .await?;
            let value = |name: &String| match own.iter().find(|(column, _)| column == name) {
                Some((_, value)) => (*value).to_owned(),
                None => format!("one.{name}"),
            };
            let values: Vec<String> = names.iter().map(value).collect();
            let sql = format!(
                "INSERT INTO {table} ({}) SELECT {} FROM copy, {table} one WHERE one.system = 'room/0'",
                names.join(", "),
                values.join(", ")
            );
            sqlx::query(AssertSqlSafe(sql)).execute(&mut *connection).await?;
        }
        Ok(())
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

fn on_database<T>(
    database: &Path,
    work: impl AsyncFnOnce(&mut SqliteConnection) -> Result<T, sqlx::Error>,
) -> Result<T, Failure> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(text)?;
    runtime.block_on(async {
        let options = SqliteConnectOptions::new().filename(database);
        let mut connection = options.connect().await.map_err(text)?;
        work(&mut connection).await.map_err(text)
    })
}
