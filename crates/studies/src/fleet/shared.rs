//! The same night on a PostgreSQL that several processes share: what the database takes beside the fits.

use super::super::load::{Service, start_on, text};
use super::super::row::Row;
use super::super::samples::{cpu, cpu_of};
use super::house::{furnished, multiply, runtime};
use lampyris::cli::Failure;
use lampyris::cli::server::{Call, Server};
use lampyris::store::moving;
use serde_json::json;
use sqlx::{AssertSqlSafe, Connection, PgConnection};
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

/// What a night costs.
struct Night {
    rooms: usize,
    processes: usize,
    moved: f64,
    submission: f64,
    fits: f64,
    transactions: f64,
    /// Of all CPU time, what the server took.
    share: f64,
    /// Bytes of a room, measured and fitted.
    room: f64,
}

/// Nights of so many rooms, each with so many processes that fit, on databases of this server.
///
/// # Errors
/// Where the server cannot be reached, or a service fails.
pub fn run(
    folder: &Path,
    server: &str,
    rooms: &[usize],
    processes: &[usize],
    length: Duration,
) -> Result<Vec<Row>, Failure> {
    let mut rows = Vec::new();
    for (rooms, processes) in
        rooms.iter().flat_map(|rooms| processes.iter().map(move |count| (*rooms, *count)))
    {
        std::fs::create_dir_all(folder).map_err(text)?;
        let name = format!("lampyris_bench_{}", std::process::id());
        asked(server, "postgres", &format!("CREATE DATABASE {name}"))?;
        let night = night(folder, (server, &name), (rooms, processes), length);
        asked(server, "postgres", &format!("DROP DATABASE {name} WITH (FORCE)"))?;
        std::fs::remove_dir_all(folder).map_err(text)?;
        rows.extend(night?.rows());
    }
    Ok(rows)
}

impl Night {
    fn rows(&self) -> Vec<Row> {
        vec![
            Row::new(
                format!("PostgreSQL, {} rooms, {} processes: moving there", self.rooms, self.processes),
                self.moved,
                "s",
            ),
            Row::new("  submitting a job for each", self.submission, "s"),
            Row::new("  fits, judged and kept", self.fits, "1/s"),
            Row::new("  transactions", self.transactions, "1/s"),
            Row::new("  of all CPU time, the server's", 100.0 * self.share, "%"),
            Row::new("  database, for a room", self.room, "B"),
        ]
    }
}

fn night(
    folder: &Path,
    (server, name): (&str, &str),
    (rooms, processes): (usize, usize),
    length: Duration,
) -> Result<Night, Failure> {
    drop(furnished(folder)?);
    let (file, url) = (folder.join("load.db"), format!("{server}/{name}"));
    multiply(&file, rooms)?;
    let begun = Instant::now();
    runtime()?.block_on(moving::move_to(&file, &url)).map_err(text)?;
    let moved = begun.elapsed().as_secs_f64();
    let node = |roles: &str| {
        let settings = [
            ("LAMPYRIS_ROLES", roles),
            ("LAMPYRIS_WORKERS", "1"),
            ("LAMPYRIS_THREADS", "1"),
            ("LAMPYRIS_LIMITS_QUEUE", "10000000"),
        ];
        start_on(url.as_ref(), &settings)
    };
    let api = node("api,scheduler")?;
    let workers = (0..processes).map(|_| node("worker")).collect::<Result<Vec<_>, _>>()?;
    let begun = Instant::now();
    let all = json!({"kind": "recalibrate", "systems": ["room/*"]});
    Server::at(format!("http://{}", api.address())).call("POST", "/jobs", Call::json(&all))?;
    let submission = begun.elapsed().as_secs_f64();
    let count = |sql: &str| asked(server, name, sql).map(|found| found.unwrap_or_default());
    let ended = || count("SELECT COUNT(*) FROM jobs WHERE ended_at IS NOT NULL");
    let commits = || count("SELECT xact_commit FROM pg_stat_database WHERE datname = current_database()");
    let spent = || -> Result<f64, Failure> {
        workers.iter().chain([&api]).try_fold(0.0, |sum, service: &Service| Ok(sum + cpu(service)?))
    };
    let before = (ended()?, commits()?, spent()?, servers_cpu()?, Instant::now());
    while before.4.elapsed() < length && ended()? < rooms as i64 {
        thread::sleep(Duration::from_millis(250));
    }
    let seconds = before.4.elapsed().as_secs_f64();
    let (ours, theirs) = (spent()? - before.2, servers_cpu()? - before.3);
    Ok(Night {
        rooms,
        processes,
        moved,
        submission,
        fits: (ended()? - before.0) as f64 / seconds,
        transactions: (commits()? - before.1) as f64 / seconds,
        share: theirs / (ours + theirs),
        room: count("SELECT pg_database_size(current_database())")? as f64 / rooms as f64,
    })
}

/// The number that a statement gives, if it gives any.
fn asked(server: &str, name: &str, sql: &str) -> Result<Option<i64>, Failure> {
    runtime()?.block_on(async {
        let mut connection = PgConnection::connect(&format!("{server}/{name}")).await.map_err(text)?;
        let found = sqlx::query_scalar(AssertSqlSafe(sql.to_owned())).fetch_optional(&mut connection).await;
        connection.close().await.map_err(text)?;
        found.map_err(text)
    })
}

/// CPU seconds of all processes of PostgreSQL on this machine.
fn servers_cpu() -> Result<f64, Failure> {
    let processes = std::fs::read_dir("/proc").map_err(text)?.flatten();
    let stats = processes.filter_map(|entry| std::fs::read_to_string(entry.path().join("stat")).ok());
    Ok(stats.filter(|stat| stat.contains("(postgres)")).filter_map(|stat| cpu_of(&stat)).sum())
}
