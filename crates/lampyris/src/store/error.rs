//! Why the database could not do what was asked, with what to do about it.

use sqlx::error::DatabaseError;
use sqlx::sqlite::SqliteError;
use std::io::{self, ErrorKind};
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
/// SQLite's extended result code for the index of a log that finds no room.
const NO_ROOM_FOR_INDEX: i32 = IO | 19 << 8;
/// SQLite's primary result codes for a file that cannot be written, and for one that cannot be opened.
const READ_ONLY: i32 = 8;
const CANNOT_OPEN: i32 = 14;
/// SQLite's primary result code for a database whose pages contradict each other.
const CORRUPT: i32 = 11;
/// SQLite's primary result code for a file that is no database.
const NO_DATABASE: i32 = 26;

/// Why a disk that has room takes no writes.
const REFUSED: &str = "it is read-only, or not this user's";

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
    /// The files are no longer those that were opened, and how; nothing is written until the next start.
    Gone(String),
    /// The disk took no writes when the database was opened, and why; nothing is written until the next
    /// start.
    ReadOnly(String),
    /// The schema has to be brought up to date, and the disk takes no writes.
    Outdated {
        /// The schema of the database; 0 where it is empty.
        found: i64,
        /// The schema of this program.
        known: i64,
        /// Why nothing can be written.
        why: String,
    },
    /// A database that another is to move into has so many systems already.
    NotEmpty(i64),
    /// Another service has this database open.
    InUse(PathBuf),
    /// Another service has this database open, perhaps under another of its names.
    OtherName(PathBuf),
    /// There is a write-ahead log, and no database that it belongs to.
    LogAlone(PathBuf),
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
            StoreError::Sql(_) if self.is_busy() => f.write_str(
                "another process has the database to itself, as a service on a full disk may: ask again when \
                it has ended",
            ),
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
            StoreError::Gone(detail) => write!(
                f,
                "the files of the database are no longer those that were opened ({detail}): nothing more is \
                written; stop the service, put the files back as they were or restore a backup, and start it \
                again"
            ),
            StoreError::ReadOnly(why) => write!(
                f,
                "the database could not be written at the start ({why}), so it is only read: see to the disk, \
                run `lampyris doctor`, and start the service again"
            ),
            StoreError::Outdated { found, known, why } => write!(
                f,
                "the database has schema {found}, this program needs {known}, and the database cannot be \
                written ({why}): make room on its disk or make it writable, and start again"
            ),
            StoreError::NotEmpty(systems) => {
                write!(f, "the database there has {systems} systems already: move into an empty one")
            }
            StoreError::InUse(path) => write!(f, "another service has the database {} open", path.display()),
            StoreError::OtherName(path) => write!(
                f,
                "another service has the database {} open, and the file has several names (hard links): use \
                the name that the service uses, since the write-ahead log lies beside that",
                path.display()
            ),
            StoreError::LogAlone(path) => write!(
                f,
                "there is no database {0}, but a write-ahead log beside it, in which writes may wait: put the \
                database back, or move {0}-wal away",
                path.display()
            ),
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

impl StoreError {
    /// Whether nothing is written until the next start.
    pub fn is_final(&self) -> bool {
        matches!(self, StoreError::Broken(_) | StoreError::Gone(_) | StoreError::ReadOnly(_))
    }

    /// Whether it was the disk that takes no writes, so that a database may still be read.
    pub fn is_unwritable(&self) -> bool {
        let refused = |error: &sqlx::Error| {
            matches!(primary_code(error), Some(READ_ONLY | CANNOT_OPEN | FULL))
                || result_code(error) == Some(NO_ROOM_FOR_INDEX)
        };
        match self {
            StoreError::Full(_) => true,
            StoreError::Sql(error) => refused(error),
            StoreError::Open(_, error) => is_unwritable(error),
            StoreError::Migration(error) => {
                std::error::Error::source(error).and_then(|error| error.downcast_ref()).is_some_and(refused)
            }
            _ => false,
        }
    }

    /// Whether somebody else held the database for longer than a statement waits.
    pub(super) fn is_busy(&self) -> bool {
        matches!(self, StoreError::Sql(error) if primary_code(error) == Some(BUSY))
    }

    /// Whether this way of reading a database has failed, where another may not.
    pub(super) fn is_unreadable(&self) -> bool {
        self.is_unwritable() || matches!(self, StoreError::Broken(_))
    }

    /// What went wrong, without the place: for those who may not know it.
    pub(super) fn cause(&self) -> String {
        match self {
            StoreError::Full(_) => "it is full".to_owned(),
            StoreError::Sql(error) => format!("{REFUSED}: {error}"),
            StoreError::Open(_, error) => format!("{REFUSED}: {error}"),
            _ => self.to_string(),
        }
    }
}

/// Whether the system refused to write, for want of room or of permission.
pub(super) fn is_unwritable(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::ReadOnlyFilesystem
            | ErrorKind::PermissionDenied
            | ErrorKind::StorageFull
            | ErrorKind::QuotaExceeded
    )
}

impl From<sqlx::Error> for StoreError {
    fn from(error: sqlx::Error) -> Self {
        if result_code(&error) == Some(NO_ROOM_FOR_INDEX) {
            return StoreError::Full(error.to_string());
        }
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
    Some(result_code(error)? & 0xff)
}

/// SQLite's extended result code.
fn result_code(error: &sqlx::Error) -> Option<i32> {
    error.as_database_error()?.try_downcast_ref::<SqliteError>()?.code()?.parse().ok()
}
