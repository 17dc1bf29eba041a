//! What a doctor wants to know of a database, also of one that a service has open.

use super::backup::require_whole;
use super::error::StoreError;
use super::file::{beside, options_to_read, real, require_no_log_alone};
use super::lock::in_use;
use super::schema::{newest, schema};
use super::value::instant;
use jiff::Timestamp;
use sqlx::{ConnectOptions, Connection, SqliteConnection};
use std::path::Path;

/// A database as it was found.
#[derive(Debug)]
pub struct DatabaseState {
    /// Its schema, and the newest that this program knows.
    pub schema: Result<(i64, i64), StoreError>,
    /// Whether every page, index and reference is in order.
    pub soundness: Result<(), StoreError>,
    /// When its newest row was written, if it has any.
    pub newest_row: Result<Option<Timestamp>, StoreError>,
    /// Size of the file in bytes.
    pub bytes: u64,
    /// Size of the write-ahead log in bytes.
    pub log_bytes: u64,
    /// Whether a service has it open.
    pub in_use: bool,
}

/// Looks at a database without changing it.
///
/// # Errors
/// Where there is no such file, or it cannot be opened at all.
pub(crate) async fn look(path: &Path) -> Result<DatabaseState, StoreError> {
    let file = std::fs::metadata(path).map_err(|_| StoreError::NoFile(path.to_owned()))?;
    let path = &real(path)?;
    require_no_log_alone(path)?;
    let in_use = in_use(path)?;
    let mut connection = options_to_read(path).await?.connect().await?;
    let found = DatabaseState {
        schema: schema(&mut connection, path).await.map(|found| (found, newest())),
        soundness: require_whole(&mut connection).await,
        newest_row: newest_row(&mut connection).await,
        bytes: file.len(),
        log_bytes: std::fs::metadata(beside(path, "-wal")).map_or(0, |log| log.len()),
        in_use,
    };
    connection.close().await?;
    Ok(found)
}

async fn newest_row(connection: &mut SqliteConnection) -> Result<Option<Timestamp>, StoreError> {
    let sql = "SELECT MAX(at) FROM (SELECT MAX(uploaded_at) AS at FROM windows UNION ALL SELECT \
        MAX(created_at) FROM jobs \
        UNION ALL SELECT MAX(ended_at) FROM jobs)";
    let newest: Option<i64> = sqlx::query_scalar(sql).fetch_one(connection).await?;
    newest.map(instant).transpose()
}
