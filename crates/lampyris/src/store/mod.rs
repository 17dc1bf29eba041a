//! The only SQL. One file per noun; functions take the [`Store`] and return records, never open transactions.
//!
//! SQLite in WAL mode with `synchronous = FULL`: what was acknowledged survives the power cord. There is one
//! writer connection and a small pool of readers, and every writing transaction is `BEGIN IMMEDIATE`, because
//! SQLite refuses a transaction that reads first and writes later as soon as somebody else has written.
//!
//! | file | what it keeps |
//! |---|---|
//! | `systems` | documents of rooms and plants |
//! | `windows` | uploaded measurements, one block per channel |
//! | `models` | model and effect documents of users, versions made by adding effects |
//! | `jobs` | the queue: submit, claim with a lease, cancel, recover |
//! | `events` | jobs that came or ended after a number |
//! | `finish` | the end of a job: job, fit, verdict and revision in one transaction |
//! | `batches` | recalibrations and diagnoses of several systems |
//! | `fits` | what was found, with its verdict |
//! | `diagnoses` | which effects models are missing, and the error ladders |
//! | `evidence` | what every window showed of every effect, for longer than its diagnosis |
//! | `params` | what is served, with all that is said of it |
//! | `revisions` | everything that was ever served |
//! | `decisions`, `pins` | an operator's word: on held and suggested fits, and on what stays in service |
//! | `audit` | what operators did, when, and under which name |
//! | `degradations` | what newer measurements say of what is served |
//! | `metrics` | how long the queue is |
//! | `retry` | jobs that are done again |
//! | `retention` | what is old and goes |
//! | `schedules` | when batches are submitted |
//! | `tokens`, `reach` | who may ask, and about which systems |
//! | `idempotency` | keys of requests that created something |
//! | `migrate` | which schema a database has, and how it is brought up to date |
//! | `write` | write transactions, and what they tell of the disk |
//! | `backup` | copies of a database, and their way back |
//! | `doctor` | how a database fares |
//! | `failpoint` | where tests let the process die |

pub mod audit;
pub mod backup;
pub mod batches;
pub mod decisions;
pub mod degradations;
pub mod diagnoses;
pub mod doctor;
mod error;
pub mod events;
pub mod evidence;
pub mod failpoint;
pub mod finish;
pub mod fits;
pub mod idempotency;
mod job;
pub mod jobs;
pub mod metrics;
pub mod migrate;
pub mod models;
pub mod params;
pub mod pins;
pub mod reach;
pub mod retention;
pub mod retry;
pub mod revisions;
mod row;
pub mod schedules;
pub mod systems;
pub mod tokens;
pub mod windows;
mod write;

pub use error::{StoreError, busy};

use backup::beside;
use jiff::Timestamp;
use sqlx::SqliteConnection;
use sqlx::sqlite::{SqliteConnectOptions, SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous};
use std::fs::{File, TryLockError};
use std::path::Path;
use std::time::Duration;
use write::{Quota, Writing};

/// How long a statement waits for another process that holds the database.
const BUSY_TIMEOUT: Duration = Duration::from_secs(10);
/// Enough for the short reads of the handlers; SQLite readers do not wait for each other.
const READERS: u32 = 4;

/// The database of one service.
#[derive(Debug)]
pub struct Store {
    writer: SqlitePool,
    reader: SqlitePool,
    writing: Writing,
    quota: Option<Quota>,
    /// Held as long as the store lives, so that no second service claims the same jobs. A visitor has none.
    lock: Option<File>,
}

impl Store {
    /// Opens a database, makes it if it is not there, and brings its schema up to date. A quota limits its size in bytes.
    ///
    /// # Errors
    /// Where another service has it open, the file cannot be used, it is damaged, or the schema is not one that this
    /// program knows.
    pub async fn open(path: &Path, quota: Option<u64>) -> Result<Self, StoreError> {
        let lock = lock(path)?;
        let migrated = migrate::bring_up_to_date(path).await?;
        if let Some(backup) = &migrated.backup {
            tracing::warn!(from = migrated.from, to = migrated.to, backup = %backup.display(), "the database has a new schema");
        }
        Self::connect(path, quota, Some(lock)).await
    }

    /// Opens a database as [`Store::open`] does, also where a service has it open: for short transactions that claim
    /// no jobs. The service has brought the schema up to date.
    ///
    /// # Errors
    /// Where the file cannot be used, or the schema is not one that this program knows.
    pub async fn visit(path: &Path) -> Result<Self, StoreError> {
        match Self::open(path, None).await {
            Err(StoreError::InUse(_)) => Self::connect(path, None, None).await,
            opened => opened,
        }
    }

    async fn connect(path: &Path, quota: Option<u64>, lock: Option<File>) -> Result<Self, StoreError> {
        let options = options(path).journal_mode(SqliteJournalMode::Wal).synchronous(SqliteSynchronous::Full);
        let quota = quota.map(Quota::of_bytes);
        // Whatever a transaction writes is written by its commit, so that the commit is what fails (`write`).
        let mut writing = options.clone().pragma("cache_spill", "off");
        if let Some(quota) = &quota {
            writing = writing.pragma("max_page_count", quota.pages.to_string());
        }
        let writer = SqlitePoolOptions::new()
            .max_connections(1)
            .after_release(|connection, _| Box::pin(write::is_clean(connection)))
            .connect_with(writing)
            .await?;
        let reader = SqlitePoolOptions::new().max_connections(READERS).connect_with(options.pragma("query_only", "on")).await?;
        Ok(Self { writer, reader, writing: Writing::default(), quota, lock })
    }

    /// The number of this start of the service, which its leases carry. No clock and no chance is involved.
    ///
    /// # Errors
    /// Where the database fails.
    pub async fn next_boot(&self) -> Result<i64, StoreError> {
        let mut tx = self.write().await?;
        let boot = next(&mut tx, "boot").await?;
        tx.commit().await?;
        Ok(boot)
    }

    /// Ends all connections, which also folds the write-ahead log into the database, and lets another service have it:
    /// a request that is still being answered may hold this store for a while.
    pub async fn close(&self) {
        self.reader.close().await;
        self.writer.close().await;
        if let Some(Err(error)) = self.lock.as_ref().map(File::unlock) {
            tracing::error!(%error, "the lock of the database stays until the end of the process");
        }
    }
}

/// How every connection is opened.
fn options(path: &Path) -> SqliteConnectOptions {
    SqliteConnectOptions::new().filename(path).busy_timeout(BUSY_TIMEOUT).foreign_keys(true)
}

/// Takes the lock file beside the database. The system frees it when the process ends, however it ends.
fn lock(path: &Path) -> Result<File, StoreError> {
    let lock_path = beside(path, ".lock");
    let failed = |error| StoreError::Open(lock_path.clone(), error);
    let file = File::options().create(true).truncate(false).write(true).open(&lock_path).map_err(failed)?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(StoreError::InUse(path.to_owned())),
        Err(TryLockError::Error(error)) => Err(failed(error)),
    }
}

/// The next number of a counter.
async fn next(tx: &mut SqliteConnection, counter: &'static str) -> Result<i64, StoreError> {
    let query = sqlx::query_scalar("UPDATE counters SET value = value + 1 WHERE name = $1 RETURNING value");
    Ok(query.bind(counter).fetch_one(tx).await?)
}

/// An id that nobody has: a sequence number and the time, hashed so that ids neither sort nor show how many there are.
fn derive_id(prefix: &str, sequence: i64, now: Timestamp) -> String {
    let hash = blake3::hash(format!("{prefix} {sequence} {now}").as_bytes()).to_hex();
    format!("{prefix}_{}", &hash[..20])
}

/// Milliseconds since 1970, as instants are stored.
fn millis(instant: Timestamp) -> i64 {
    instant.as_millisecond()
}

fn instant(millis: i64) -> Result<Timestamp, StoreError> {
    Timestamp::from_millisecond(millis).map_err(|error| corrupt("an instant", &error))
}

fn corrupt(what: impl Into<String>, detail: &dyn std::fmt::Display) -> StoreError {
    StoreError::Corrupt { what: what.into(), detail: detail.to_string() }
}

/// Reads a text that this program wrote.
fn parse<T: std::str::FromStr<Err: std::fmt::Display>>(what: &str, text: &str) -> Result<T, StoreError> {
    text.parse().map_err(|error| corrupt(format!("{what} `{text}`"), &error))
}

/// Reads a document that this program wrote.
fn from_json<T: serde::de::DeserializeOwned>(what: &str, text: &str) -> Result<T, StoreError> {
    serde_json::from_str(text).map_err(|error| corrupt(what, &error))
}

/// Writes a document.
fn to_json<T: serde::Serialize + ?Sized>(what: &str, value: &T) -> Result<String, StoreError> {
    serde_json::to_string(value).map_err(|error| corrupt(what, &error))
}

/// The text of an enum whose variants are words, as `serde` spells it.
macro_rules! words {
    ($(#[doc = $doc:literal])+ $name:ident { $($(#[$variant_doc:meta])* $variant:ident = $word:literal),+ $(,)? }) => {
        $(#[doc = $doc])+
        #[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
        pub enum $name {
            $($(#[$variant_doc])* #[serde(rename = $word)] $variant,)+
        }

        impl $name {
            /// Every variant, in order.
            pub const ALL: &'static [Self] = &[$(Self::$variant),+];

            /// The word in the database and in documents.
            pub const fn word(self) -> &'static str {
                match self { $(Self::$variant => $word),+ }
            }
        }

        impl utoipa::PartialSchema for $name {
            fn schema() -> utoipa::openapi::RefOr<utoipa::openapi::Schema> {
                lampyris_core::schema::word([$($word),+], concat!($($doc),+).trim())
            }
        }

        impl utoipa::ToSchema for $name {}

        impl std::str::FromStr for $name {
            type Err = $crate::store::UnknownWord;

            fn from_str(text: &str) -> Result<Self, Self::Err> {
                match text {
                    $($word => Ok(Self::$variant),)+
                    _ => Err($crate::store::UnknownWord { text: text.chars().take(40).collect(), known: &[$($word),+] }),
                }
            }
        }
    };
}
use words;

/// A text that is none of the words of an enum.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnknownWord {
    /// The text, shortened.
    pub text: String,
    /// The words that would have been right.
    pub known: &'static [&'static str],
}

impl std::fmt::Display for UnknownWord {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "`{}` is none of {}", self.text.escape_debug(), self.known.join(", "))
    }
}
