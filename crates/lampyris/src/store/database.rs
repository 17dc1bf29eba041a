//! The database of one service: its lock, its writer and its readers.

use super::changes::{Change, Changes, NOTES};
use super::error::StoreError;
use super::file::{lock, options};
use super::migrate;
use super::sequence::next;
use super::write::{Quota, Write, Writing, is_clean};
use sqlx::SqliteConnection;
use sqlx::sqlite::{SqliteJournalMode, SqlitePool, SqlitePoolOptions, SqliteSynchronous};
use std::fs::File;
use std::path::Path;
use tokio::sync::mpsc::UnboundedReceiver;

/// Enough for the short reads of the handlers; SQLite readers do not wait for each other.
const READERS: u32 = 4;

/// The database of one service.
#[derive(Debug)]
pub struct Store {
    writer: SqlitePool,
    pub(super) reader: SqlitePool,
    writing: Writing,
    changes: Changes,
    quota: Option<Quota>,
    /// Held as long as the store lives, so that no second service claims the same jobs. A visitor has none.
    lock: Option<File>,
}

impl Store {
    /// Opens a database, makes it if it is not there, and brings its schema up to date. A quota limits its
    /// size in bytes.
    ///
    /// # Errors
    /// Where another service has it open, the file cannot be used, it is damaged, or the schema is not one
    /// that this program knows.
    pub async fn open(path: &Path, quota: Option<u64>) -> Result<Self, StoreError> {
        let lock = lock(path)?;
        let migrated = migrate::bring_up_to_date(path).await?;
        if let Some(backup) = &migrated.backup {
            tracing::warn!(from = migrated.from, to = migrated.to, backup = %backup.display(), "the database \
                has a new schema");
        }
        Self::connect(path, quota, Some(lock)).await
    }

    /// Opens a database as [`Store::open`] does, also where a service has it open: for short transactions
    /// that claim no jobs. The service has brought the schema up to date.
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
        let mut writing = options.clone().pragma("cache_spill", "off").pragma("temp_store", "memory");
        if let Some(quota) = &quota {
            writing = writing.pragma("max_page_count", quota.pages.to_string());
        }
        let writer = SqlitePoolOptions::new()
            .max_connections(1)
            .after_connect(|connection, _| {
                Box::pin(async { sqlx::raw_sql(NOTES).execute(connection).await.map(|_| ()) })
            })
            .after_release(|connection, _| Box::pin(is_clean(connection)))
            .connect_with(writing)
            .await?;
        let reader = SqlitePoolOptions::new()
            .max_connections(READERS)
            .connect_with(options.pragma("query_only", "on"))
            .await?;
        Ok(Self { writer, reader, writing: Writing::default(), changes: Changes::default(), quota, lock })
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

    /// The commits that change what is served, or what is said of it, from now on. Whoever writes one waits
    /// until it was followed, so the follower itself writes nothing.
    pub fn follow(&self) -> UnboundedReceiver<Change> {
        self.changes.follow()
    }

    /// A transaction that holds the write lock from its first statement.
    pub(super) async fn write(&self) -> Result<Write, StoreError> {
        self.writing.begin(&self.writer, &self.changes).await
    }

    /// Whether the database can be written now.
    ///
    /// # Errors
    /// Where it cannot.
    pub async fn writable(&self) -> Result<(), StoreError> {
        self.writing.prove(&self.writer, &self.changes).await
    }

    /// Refuses a window of so many bytes where the database would use most of its quota.
    pub(super) async fn require_room(
        &self,
        tx: &mut SqliteConnection,
        bytes: usize,
    ) -> Result<(), StoreError> {
        match &self.quota {
            Some(quota) => quota.require_room(tx, bytes).await,
            None => Ok(()),
        }
    }

    /// Ends all connections, which also folds the write-ahead log into the database, and lets another service
    /// have it: a request that is still being answered may hold this store for a while.
    pub async fn close(&self) {
        self.reader.close().await;
        self.writer.close().await;
        if let Some(Err(error)) = self.lock.as_ref().map(File::unlock) {
            tracing::error!(%error, "the lock of the database stays until the end of the process");
        }
    }
}
