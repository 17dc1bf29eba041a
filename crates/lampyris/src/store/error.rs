//! Why the database could not do what was asked, with what to do about it.

use std::path::PathBuf;
use std::sync::atomic::{AtomicU64, Ordering};

/// SQLite's primary result code for a database that somebody else holds.
const BUSY: i32 = 5;
/// How often that was met in this process.
static BUSY_COUNT: AtomicU64 = AtomicU64::new(0);
/// SQLite's primary result code for a system that could not read or write.
const IO: i32 = 10;
/// SQLite's primary result code for a database that finds no room.
const FULL: i32 = 13;
/// SQLite's primary result code for a database whose pages contradict each other.
const CORRUPT: i32 = 11;
/// SQLite's primary result code for a file that is no database.
const NO_DATABASE: i32 = 26;

/// Why the database could not do what was asked.
#[derive(Debug)]
pub enum StoreError {
    /// SQLite or the connection to it failed.
    Sql(sqlx::Error),
    /// A migration failed; it left nothing behind.
    Migration(sqlx::migrate::MigrateError),
    /// A newer program has written the database.
    Newer {
        /// The schema of the database.
        found: i64,
        /// The newest schema of this program.
        known: i64,
    },
    /// This migration was applied with another text than this program has.
    Edited(i64),
    /// The database was made by another program.
    Foreign(PathBuf),
    /// Pages of the database contradict each other: what SQLite says of it.
    Damaged(String),
    /// There is no room, on the disk or in the quota: what was to be written.
    Full(String),
    /// The system could not read or write the files; nothing is written until the next start.
    Broken(String),
    /// Another service has this database open.
    InUse(PathBuf),
    /// The database file or its lock could not be opened.
    Open(PathBuf, std::io::Error),
    /// There is no such file.
    NoFile(PathBuf),
    /// The file is there already.
    Taken(PathBuf),
    /// The file has a write-ahead log of its own, so it is a raw copy and no backup.
    RawCopy(PathBuf),
    /// A row holds something that this program did not write.
    Corrupt {
        /// Which row.
        what: String,
        /// What is wrong with it.
        detail: String,
    },
    /// The lease of a job is no longer held, so nothing was written.
    LeaseLost,
}

impl std::fmt::Display for StoreError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            StoreError::Sql(error) => write!(f, "the database failed: {error}"),
            StoreError::Migration(error) => {
                write!(f, "the database schema cannot be brought up to date: {error}")
            }
            StoreError::Newer { found, known } => write!(
                f,
                "the database has schema {found}, and lampyris {} knows schemas up to {known}: run the newer \
                program, or bring back a backup from before with `lampyris restore FILE`",
                env!("CARGO_PKG_VERSION")
            ),
            StoreError::Edited(version) => write!(
                f,
                "migration {version} was applied to the database with another text than this program has: \
                run the program that wrote the database; migrations do not change once they are released"
            ),
            StoreError::Foreign(path) => write!(f, "{} is a database of another program", path.display()),
            StoreError::Damaged(detail) => write!(
                f,
                "the database is damaged, and nothing is served from it ({detail}): bring back a file that \
                `lampyris backup` made, with `lampyris restore FILE`; the damaged one is kept"
            ),
            StoreError::Full(detail) => {
                write!(
                    f,
                    "there is no room for the database ({detail}): make room on the disk, or raise its quota"
                )
            }
            StoreError::Broken(detail) => write!(
                f,
                "the files of the database cannot be read or written ({detail}): nothing more is written; \
                see to the disk, run `lampyris doctor`, and start the service again"
            ),
            StoreError::InUse(path) => write!(f, "another service has the database {} open", path.display()),
            StoreError::Open(path, error) => write!(f, "cannot open {}: {error}", path.display()),
            StoreError::NoFile(path) => write!(f, "there is no file {}", path.display()),
            StoreError::Taken(path) => write!(
                f,
                "{} is there already, and a backup replaces nothing: name another file",
                path.display()
            ),
            StoreError::RawCopy(path) => write!(
                f,
                "{0} has a write-ahead log beside it, so it is a raw copy: make a backup of it with \
                `lampyris backup --database {0} FILE`, and restore that",
                path.display()
            ),
            StoreError::Corrupt { what, detail } => {
                write!(f, "the database holds something unreadable in {what}: {detail}")
            }
            StoreError::LeaseLost => f.write_str("the lease of the job is no longer held"),
        }
    }
}

impl std::error::Error for StoreError {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        match self {
            StoreError::Sql(error) => Some(error),
            StoreError::Migration(error) => Some(error),
            StoreError::Open(_, error) => Some(error),
            _ => None,
        }
    }
}

impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        match primary_code(&error) {
            Some(CORRUPT | NO_DATABASE) => StoreError::Damaged(error.to_string()),
            Some(FULL) => StoreError::Full(error.to_string()),
            Some(IO) => StoreError::Broken(error.to_string()),
            Some(BUSY) => {
                BUSY_COUNT.fetch_add(1, Ordering::Relaxed);
                StoreError::Sql(error)
            }
            _ => StoreError::Sql(error),
        }
    }
}

/// How often somebody else held the database for longer than a statement waits.
pub fn busy() -> u64 {
    BUSY_COUNT.load(Ordering::Relaxed)
}

/// SQLite's primary result code, which the low byte of every extended one repeats.
fn primary_code(error: &sqlx::Error) -> Option<i32> {
    let code: i32 = error.as_database_error()?.code()?.parse().ok()?;
    Some(code & 0xff)
}
