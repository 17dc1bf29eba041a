//! A house of very many rooms: one is measured and sent, the others are copies of it in the database.

use super::super::load::{Service, start_with, text};
use lampyris::cli::server::{Call, Server};
use lampyris::cli::{Failure, faults};
use lampyris_core::twin;
use serde_json::json;
use sqlx::sqlite::SqliteConnectOptions;
use sqlx::{AssertSqlSafe, ConnectOptions, SqliteConnection};
use std::path::Path;

/// Days of the room, and minutes between two of its samples.
pub const DAYS: usize = 28;
const STEP: usize = 30;
pub const MODEL: &str = "rc1";
/// The columns of a synthetic room that the model reads, behind the time.
pub const READ: [&str; 2] = ["T_room", "T_out"];
/// The tables that hold something of a room that was measured, with what makes a copy its own.
const TABLES: [(&str, &[(&str, &str)]); 5] = [
    ("systems", &[("system", "copy.system")]),
    (
        "windows",
        &[("system", "copy.system"), ("id", "'win_' || copy.number"), ("sequence", "1000 + copy.number")],
    ),
    ("days", &[("system", "copy.system")]),
    ("shares", &[("window_id", "'win_' || copy.number")]),
    ("measured", &[("system", "copy.system")]),
];
/// A service on the file in a folder.
pub fn serve(folder: &Path) -> Result<Service, Failure> {
    start_with(folder, &[("LAMPYRIS_LIMITS_QUEUE", "10000000")])
}

/// A service with one room that was measured.
pub fn furnished(folder: &Path) -> Result<Service, Failure> {
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
pub fn multiply(database: &Path, rooms: usize) -> Result<(), Failure> {
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
            let whose = match names.iter().any(|name| name == "system") {
                true => "one.system = 'room/0'",
                false => "one.window_id IN (SELECT id FROM windows WHERE system = 'room/0')",
            };
            let sql = format!(
                "INSERT INTO {table} ({}) SELECT {} FROM copy, {table} one WHERE {whose}",
                names.join(", "),
                values.join(", ")
            );
            sqlx::query(AssertSqlSafe(sql)).execute(&mut *connection).await?;
        }
        Ok(())
    })
}

/// Does something on a database that a service may have open.
pub fn on_database<T>(
    database: &Path,
    work: impl AsyncFnOnce(&mut SqliteConnection) -> Result<T, sqlx::Error>,
) -> Result<T, Failure> {
    runtime()?.block_on(async {
        let options = SqliteConnectOptions::new().filename(database);
        let mut connection = options.connect().await.map_err(text)?;
        work(&mut connection).await.map_err(text)
    })
}

/// What waits for a database.
pub fn runtime() -> Result<tokio::runtime::Runtime, Failure> {
    tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(text)
}
