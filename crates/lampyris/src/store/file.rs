//! The file of a database: its name, how it is opened, and what lies beside it.

use super::error::StoreError;
use sqlx::sqlite::{SqliteConnectOptions, SqliteLockingMode};
use sqlx::{ConnectOptions, Connection};
use std::fs::{self, File};
use std::io::ErrorKind;
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How long a statement waits for another process that holds the database.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);
/// Who may do what with a new database, before the mask of the process: as SQLite makes it.
const MODE: u32 = 0o644;

/// How every connection is opened.
pub(super) fn options(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new().filename(path).busy_timeout(BUSY_TIMEOUT).foreign_keys(true)
}

/// How one connection reads a database whose disk may take no writes: the first way that works.
///
/// # Errors
/// Where none does.
pub(super) async fn options_to_read(path: &Path) -> Result<SqliteConnectOptions, StoreError> {
    let mut failed = None;
    for way in ways_to_read(path) {
        match read(&way).await {
            Err(error) if error.is_unreadable() => failed = Some(error),
            Err(error) if error.is_busy() => return Err(error),
            // What else is wrong with the database shows where it is read in earnest.
            _ => return Ok(way),
        }
    }
    Err(failed.unwrap_or_else(|| StoreError::NoFile(path.to_owned())))
}

async fn read(way: &SqliteConnectOptions) -> Result<(), StoreError> {
    let mut connection = way.connect().await?;
    let read = sqlx::query("SELECT COUNT(*) FROM sqlite_schema").execute(&mut connection).await;
    let closed = connection.close().await;
    read?;
    Ok(closed?)
}

fn ways_to_read(path: &Path) -> Vec<SqliteConnectOptions> {
    let options = options(path).pragma("query_only", "on");
    let mut ways = vec![
        // As beside a service, through an index of the log in shared memory, which is a file.
        options.clone().read_only(true),
        // On a full disk, where that file finds no room: alone, with the index in memory.
        options.clone().locking_mode(SqliteLockingMode::Exclusive),
    ];
    // On a read-only disk, where nobody can lock a file either, nothing changes the database. This way
    // looks at no log, so it is none where writes wait in one.
    if !has_log(path) {
        ways.push(options.read_only(true).immutable(true));
    }
    ways
}

/// Whether writes may wait in the write-ahead log of a database.
fn has_log(path: &Path) -> bool {
    fs::metadata(beside(path, "-wal")).is_ok_and(|log| log.len() > 0)
}

/// The path of a database without symbolic links: SQLite keeps the log beside the real file.
pub(super) fn real(path: &Path) -> Result<PathBuf, StoreError> {
    let failed = |error| StoreError::Open(path.to_owned(), error);
    match path.canonicalize() {
        Err(error) if error.kind() == ErrorKind::NotFound => {
            let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
            let name = path.file_name().ok_or_else(|| failed(error))?;
            Ok(folder.unwrap_or(Path::new(".")).canonicalize().map_err(failed)?.join(name))
        }
        found => found.map_err(failed),
    }
}

/// Refuses an empty database beside a log. SQLite takes such a log away, and it may be all that is left of
/// what was acknowledged.
pub(super) fn require_no_log_alone(path: &Path) -> Result<(), StoreError> {
    let is_empty = fs::metadata(path).map_or(true, |file| file.len() == 0);
    if is_empty && has_log(path) { Err(StoreError::LogAlone(path.to_owned())) } else { Ok(()) }
}

/// The real path of a database, which is made empty where it is not there and no log lies beside it: what can
/// be locked is a file.
pub(super) fn made(path: &Path) -> Result<PathBuf, StoreError> {
    let found = real(path)?;
    require_no_log_alone(&found)?;
    if found.exists() {
        return Ok(found);
    }
    let options = File::options().write(true).create(true).truncate(false).mode(MODE).open(&found);
    options.map_err(|error| StoreError::Open(found, error))?;
    real(path)
}

/// The path of a file beside a database: its name with an ending.
pub(super) fn beside(path: &Path, ending: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(ending);
    PathBuf::from(name)
}
