//! The database of one service: its lock, its writer and its readers.

use super::changes::{Change, Changes, NOTES};
use super::engine::{Pool, Session};
use super::error::StoreError;
use super::file::{made, options, options_to_read, real};
use super::files::Files;
use super::lock::{Lock, lock};
use super::migrate;
use super::place::DatabasePlace;
use super::postgres;
use super::statement::query_scalar;
use super::write::{Quota, Write, Writing, is_clean};
use lampyris_core::data::SystemId;
use sqlx::sqlite::{SqliteJournalMode, SqlitePoolOptions, SqliteSynchronous};
use std::collections::BTreeSet;
use std::mem;
use std::path::Path;
use std::pin::Pin;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::mpsc::UnboundedReceiver;

/// Enough for the short reads of the handlers; SQLite readers do not wait for each other.
const READERS: u32 = 4;

/// How long a server may take to show that it can be written.
const LONGEST_PROOF: Duration = Duration::from_secs(5);

/// The database of one service.
#[derive(Debug)]
pub struct Store {
    writer: Pool,
    pub(super) reader: Pool,
    writing: Writing,
    changes: Changes,
    quota: Option<Quota>,
    /// Held until the database is closed, so that no second service claims the same jobs. A visitor has none.
    lock: Mutex<Option<Lock>>,
}

impl Store {
    /// Opens a database, makes it if it is not there, and brings its schema up to date. A quota limits its
    /// size in bytes. Where its disk takes no writes, it is only read.
    ///
    /// # Errors
    /// Where another service has it open, the file cannot be used, it is damaged, or the schema is not one
    /// that this program knows, or an older one on a disk that takes no writes.
    pub fn open(
        place: &DatabasePlace,
        quota: Option<u64>,
    ) -> Pin<Box<dyn Future<Output = Result<Self, StoreError>> + Send + '_>> {
        Box::pin(async move {
            match place {
                DatabasePlace::File(path) => Self::open_file(path, quota).await,
                DatabasePlace::Server(url) => Self::open_server(url).await,
            }
        })
    }

    /// Connects to a database that other services may have open as well. Its room is its administrator's to
    /// limit.
    async fn open_server(url: &str) -> Result<Self, StoreError> {
        let pool = Pool::Postgres(postgres::open(url).await?);
        let (writing, changes) = (Writing::default(), Changes::default());
        let (writer, reader) = (pool.clone(), pool);
        Ok(Self { writer, reader, writing, changes, quota: None, lock: Mutex::default() })
    }

    async fn open_file(path: &Path, quota: Option<u64>) -> Result<Self, StoreError> {
        let path = &made(path)?;
        let lock = lock(path)?;
        let store = match Self::open_to_write(path, quota, &lock).await {
            Err(error) if error.is_unwritable() => Self::open_to_read(path, &error).await?,
            opened => opened?,
        };
        Ok(Self { lock: Mutex::new(Some(lock)), ..store })
    }

    /// Opens a database as [`Store::open`] does, also where a service has it open: for short transactions
    /// that claim no jobs. The service has brought the schema up to date.
    ///
    /// # Errors
    /// Where the file cannot be used, or the schema is not one that this program knows.
    pub async fn visit(place: &DatabasePlace) -> Result<Self, StoreError> {
        match (Self::open(place, None).await, place) {
            (Err(StoreError::InUse(_)), DatabasePlace::File(path)) => Self::connect(&real(path)?, None).await,
            (opened, _) => opened,
        }
    }

    async fn open_to_write(path: &Path, quota: Option<u64>, lock: &Lock) -> Result<Self, StoreError> {
        let migrated = migrate::bring_up_to_date(path).await?;
        if let Some(backup) = &migrated.backup {
            tracing::warn!(from = migrated.from, to = migrated.to, backup = %backup.display(), "the database \
                has a new schema");
        }
        let store = Self::connect(path, quota).await?;
        // A disk without room, or one that can only be read, may show at no earlier moment.
        let touched = match Files::of(path, lock) {
            Ok(files) => {
                store.writing.watch(files);
                store.writing.touch(&store.writer, &store.changes).await
            }
            Err(error) => Err(error),
        };
        match touched {
            Ok(()) => Ok(store),
            Err(error) => {
                store.release().await;
                Err(error)
            }
        }
    }

    /// Ends all connections. Whoever opens the database next must not find them half gone: the last one takes
    /// the index of the log along. The files are let go behind them: to close one of them any earlier would
    /// end the locks that SQLite has on it.
    async fn release(&self) {
        self.reader.close().await;
        self.writer.close().await;
        self.writing.watch(None);
    }

    /// The same database without writing: where its disk takes no more writes after all.
    ///
    /// # Errors
    /// Where it cannot be read either.
    pub async fn without_writing(self, path: &Path, unwritable: &StoreError) -> Result<Self, StoreError> {
        self.release().await;
        let store = Self::open_to_read(&real(path)?, unwritable).await?;
        Ok(Self { lock: self.lock, ..store })
    }

    /// Opens a database whose disk takes no writes.
    async fn open_to_read(path: &Path, unwritable: &StoreError) -> Result<Self, StoreError> {
        let way = options_to_read(path).await?;
        let reader = lasting().max_connections(1).connect_with(way).await?;
        migrate::require_up_to_date(&mut *reader.acquire().await?, path, unwritable).await?;
        let why = unwritable.cause();
        tracing::warn!("the database cannot be written ({why}): it is only read until the next start");
        let writing = Writing::refused(why);
        let reader = Pool::Sqlite(reader);
        let writer = reader.clone();
        Ok(Self { writer, reader, writing, changes: Changes::default(), quota: None, lock: Mutex::default() })
    }

    async fn connect(path: &Path, quota: Option<u64>) -> Result<Self, StoreError> {
        let options = options(path).journal_mode(SqliteJournalMode::Wal).synchronous(SqliteSynchronous::Full);
        let quota = quota.map(Quota::of_bytes);
        // Whatever a transaction writes is written by its commit, so that the commit is what fails (`write`).
        let mut writing = options.clone().pragma("cache_spill", "off").pragma("temp_store", "memory");
        if let Some(quota) = &quota {
            writing = writing.pragma("max_page_count", quota.pages.to_string());
        }
        let writer = lasting()
            .max_connections(1)
            .after_connect(|connection, _| {
                Box::pin(async { sqlx::raw_sql(NOTES).execute(connection).await.map(|_| ()) })
            })
            .after_release(|connection, _| Box::pin(is_clean(connection)))
            .connect_with(writing)
            .await?;
        let reader =
            lasting().max_connections(READERS).connect_with(options.pragma("query_only", "on")).await?;
        let (writer, reader) = (Pool::Sqlite(writer), Pool::Sqlite(reader));
        let (writing, changes) = (Writing::default(), Changes::default());
        Ok(Self { writer, reader, writing, changes, quota, lock: Mutex::default() })
    }

    /// Whether the disk took no writes when the database was opened, so that it is only read.
    pub fn is_read_only(&self) -> bool {
        self.writing.is_refused()
    }

    /// The commits that change what is served, or what is said of it, from now on. Whoever writes one waits
    /// until it was followed, so the follower itself writes nothing.
    pub fn follow(&self) -> UnboundedReceiver<Change> {
        self.changes.follow()
    }

    /// A transaction that holds the write lock from its first statement.
    pub(super) async fn write(&self) -> Result<Write, StoreError> {
        self.writing.begin(&self.writer, &self.changes).await
    }

    /// A transaction that writes beside others, of what those leave alone. On SQLite it is as any other.
    pub(super) async fn write_beside(&self) -> Result<Write, StoreError> {
        self.writing.begin_beside(&self.writer, &self.changes).await
    }

    /// Whether other services may have the database open, so that not all that happens happens here.
    pub fn is_shared(&self) -> bool {
        matches!(self.writer, Pool::Postgres(_))
    }

    /// Has the follower read some systems anew, as after a commit, and waits for it.
    pub async fn read_anew(&self, systems: BTreeSet<SystemId>) {
        if let Some(wait) = self.changes.tell(systems) {
            // A follower that is gone has nothing to show any more.
            let _ = wait.await;
        }
    }

    /// Whether the database can be written now.
    ///
    /// # Errors
    /// Where it cannot.
    pub async fn writable(&self) -> Result<(), StoreError> {
        let proof = self.writing.prove(&self.writer, &self.changes);
        if !self.is_shared() {
            return proof.await;
        }
        let silent = |_| StoreError::Sql(sqlx::Error::PoolTimedOut);
        tokio::time::timeout(LONGEST_PROOF, proof).await.unwrap_or_else(|elapsed| Err(silent(elapsed)))
    }

    /// Whether the files are still those that were opened. What is read from others is not believed where it
    /// decides who may ask, or what is served.
    ///
    /// # Errors
    /// Where they are not.
    pub fn require_files(&self) -> Result<(), StoreError> {
        self.writing.require_files()
    }

    /// Folds the log, which is still open, into a database that is in its place: where a name of the log was
    /// removed, that keeps what was acknowledged.
    ///
    /// # Errors
    /// Where the database fails.
    pub async fn save(&self) -> Result<(), StoreError> {
        if self.writing.can_fold() {
            let waits: i64 = query_scalar("PRAGMA wal_checkpoint(FULL)").fetch_one(&self.writer).await?;
            match waits {
                0 => tracing::warn!("what was in the write-ahead log is in the database now"),
                _ => tracing::error!("somebody reads the database for long: not all of the log is in it"),
            }
        }
        Ok(())
    }

    /// Refuses a window of so many bytes where the database would use most of its quota.
    pub(super) async fn require_room(&self, tx: &mut Session, bytes: usize) -> Result<(), StoreError> {
        match &self.quota {
            Some(quota) => quota.require_room(tx, bytes).await,
            None => Ok(()),
        }
    }

    /// Ends all connections, which also folds the write-ahead log into the database, and lets another service
    /// have it: a request that is still being answered may hold this store for a while.
    pub async fn close(&self) {
        if self.require_files().is_ok() {
            self.release().await;
        } else {
            if let Err(error) = self.save().await {
                tracing::error!(%error, "the write-ahead log could not be saved");
            }
            // The last connection removes the log of its path, which belongs to another database by now, or
            // may be put back beside its own.
            mem::forget((self.reader.clone(), self.writer.clone()));
        }
        self.writing.watch(None);
        self.lock.lock().unwrap_or_else(PoisonError::into_inner).take();
    }
}

/// Connections that stay: a new one would open whatever is at the path by then, and as long as one is open
/// nobody else takes the log away.
fn lasting() -> SqlitePoolOptions {
    SqlitePoolOptions::new().idle_timeout(None).max_lifetime(None)
}
