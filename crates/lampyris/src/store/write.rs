//! Write transactions, and what their ends tell of the disk.
//!
//! A full disk is a state that passes: every transaction is tried, and the first that is committed ends it. A
//! failed write is none: after one the system may have dropped pages that it calls written, and only a new
//! start, which reads the files anew, knows what is on the disk. From then on nothing is written. The same
//! holds where the files are no longer those that were opened: what reaches them is found by nobody. They are
//! looked at before every transaction and after its commit, before anybody hears of it.

use super::changes::{Changes, touched};
use super::engine::{Pool, Session};
use super::error::StoreError;
use super::files::Files;
use super::postgres;
use super::statement::{query, query_scalar};
use sqlx::{AssertSqlSafe, Connection as _, SqliteConnection};
use std::ops::{Deref, DerefMut};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::oneshot;

/// A row that no request can make: keys of requests have no tabs.
const PROBE: &str = "\tprobe";

/// The page size of every database that this program makes: SQLite's own.
const PAGE: u64 = 4096;
/// How long a commit proves that the disk takes writes: whoever asks more often makes no more writes.
const PROVEN: Duration = Duration::from_secs(1);
/// Bytes by which the log may grow before SQLite folds it: a thousand pages, with their headers. A disk with
/// less room may take the next commit and refuse the one after.
const LOG: u64 = 1000 * (PAGE + 24);
/// Windows are refused beyond this part of a quota in per cent, so that results still fit.
const FOR_WINDOWS: u64 = 90;

/// How large a database may become.
#[derive(Debug, Clone, Copy)]
pub(super) struct Quota {
    bytes: u64,
    pub(super) pages: u64,
}

impl Quota {
    pub(super) fn of_bytes(bytes: u64) -> Self {
        Self { bytes, pages: bytes / PAGE }
    }

    /// Refuses a window of so many bytes where the database would use most of its quota.
    pub(super) async fn require_room(&self, tx: &mut Session, bytes: usize) -> Result<(), StoreError> {
        let sql = "SELECT page_count - freelist_count FROM pragma_page_count, pragma_freelist_count";
        let pages: i64 = query_scalar(sql).fetch_one(tx).await?;
        let used = pages.unsigned_abs() * PAGE + bytes as u64;
        if used > self.bytes / 100 * FOR_WINDOWS {
            return Err(StoreError::Full(format!(
                "a window would take the database to {used} of {} bytes",
                self.bytes
            )));
        }
        Ok(())
    }
}

/// What is known of the writing of a database. What is worse comes later.
#[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord)]
enum Health {
    /// The last transaction was committed.
    #[default]
    Well,
    /// A transaction ended without a commit: because it had nothing to write, or because it could not.
    Doubtful,
    /// There was no room for the last transaction.
    Full,
    /// A write has failed.
    Broken,
    /// The files are no longer those that were opened, and how.
    Gone(String),
    /// Nothing could be written at the start, and why.
    ReadOnly(String),
}

/// What is known of a database while it is open.
#[derive(Debug, Default)]
struct Known {
    health: Health,
    /// The files, where somebody watches them.
    files: Option<Files>,
    /// When something was last committed.
    committed: Option<Instant>,
    /// How many rows the writer had changed by then.
    changed: i64,
}

/// What is known of a database, which its transactions share.
#[derive(Debug, Clone, Default)]
pub(super) struct Writing(Arc<Mutex<Known>>);

/// A transaction that holds the write lock from its first statement. Without a commit nothing of it remains.
pub(super) struct Write {
    tx: Session,
    open: Open,
    changes: Changes,
}

/// A transaction whose end is not known yet.
struct Open {
    writing: Writing,
    is_known: bool,
}

impl Known {
    /// Looks at the files, unless nothing is written any more.
    fn look(&mut self) {
        if self.health < Health::Broken
            && let Some(Err(why)) = self.files.as_mut().map(Files::check)
        {
            tracing::error!("{why}: nothing is written until the next start");
            self.health = Health::Gone(why);
        }
    }

    /// After a failed write, and in files that are gone, there is no other.
    fn require_writable(&mut self) -> Result<(), StoreError> {
        self.look();
        match &self.health {
            Health::Broken => Err(StoreError::Broken("an earlier write failed".to_owned())),
            Health::Gone(why) => Err(StoreError::Gone(why.clone())),
            Health::ReadOnly(why) => Err(StoreError::ReadOnly(why.clone())),
            Health::Well | Health::Doubtful | Health::Full => Ok(()),
        }
    }

    /// What went wrong stays until a commit.
    fn note(&mut self, news: Health) {
        if news > self.health {
            self.health = news;
        }
    }
}

impl Writing {
    /// Of a database that takes no writes, and why.
    pub(super) fn refused(why: String) -> Self {
        Self(Arc::new(Mutex::new(Known { health: Health::ReadOnly(why), ..Known::default() })))
    }

    /// From now on these files are watched, or none any more.
    pub(super) fn watch(&self, files: Option<Files>) {
        self.known().files = files;
    }

    /// A transaction that holds the write lock from its first statement.
    pub(super) async fn begin(&self, writer: &Pool, changes: &Changes) -> Result<Write, StoreError> {
        self.begin_by(writer, postgres::BEGIN_ALONE, changes).await
    }

    /// A transaction beside others, where the engine has any.
    pub(super) async fn begin_beside(&self, writer: &Pool, changes: &Changes) -> Result<Write, StoreError> {
        self.begin_by(writer, postgres::BEGIN_BESIDE, changes).await
    }

    async fn begin_by(
        &self,
        writer: &Pool,
        on_postgres: &'static str,
        changes: &Changes,
    ) -> Result<Write, StoreError> {
        self.known().require_writable()?;
        let begun = writer.begin_to_write(on_postgres).await.map_err(StoreError::from);
        let tx = begun.inspect_err(|error| self.note_error(error))?;
        // The transaction that this one has waited for may have been the one that failed.
        self.known().require_writable()?;
        let open = Open { writing: self.clone(), is_known: false };
        Ok(Write { tx, open, changes: changes.clone() })
    }

    /// Writes something, where that needs no room but in the log.
    pub(super) async fn touch(&self, writer: &Pool, changes: &Changes) -> Result<(), StoreError> {
        let mut tx = self.begin(writer, changes).await?;
        touch(&mut tx).await?;
        tx.commit().await
    }

    /// Finds out whether the database can be written now.
    pub(super) async fn prove(&self, writer: &Pool, changes: &Changes) -> Result<(), StoreError> {
        let mut tx = self.begin_beside(writer, changes).await?;
        touch(&mut tx).await?;
        if matches!(writer, Pool::Postgres(_)) {
            return tx.take_back().await;
        }
        if self.is_proven() {
            tx.take_back().await?;
        } else {
            // Only pages that reach the disk are a proof. A row that is left behind is forgotten as an old
            // key.
            let sql = "INSERT OR REPLACE INTO idempotency (key, fingerprint, resource, status, created_at) \
                VALUES ($1, hex(zeroblob(8192)), '', 0, 0)";
            query(sql).bind(PROBE).execute(&mut *tx).await.map_err(|error| self.noted(error))?;
            tx.commit().await?;
            let mut tx = self.begin(writer, changes).await?;
            query("DELETE FROM idempotency WHERE key = $1").bind(PROBE).execute(&mut *tx).await?;
            tx.commit().await?;
        }
        match self.known().files.as_ref().and_then(Files::free) {
            Some(free) if free < LOG => Err(StoreError::Full(format!("{free} bytes are free on its disk"))),
            _ => Ok(()),
        }
    }

    /// Whether the files are those that were opened.
    pub(super) fn require_files(&self) -> Result<(), StoreError> {
        match self.known().require_writable() {
            Err(error @ StoreError::Gone(_)) => Err(error),
            _ => Ok(()),
        }
    }

    /// Whether nothing could be written at the start.
    pub(super) fn is_refused(&self) -> bool {
        matches!(self.known().health, Health::ReadOnly(_))
    }

    /// Whether the log can be folded into the database although one of the names is gone.
    pub(super) fn can_fold(&self) -> bool {
        self.known().files.as_mut().is_some_and(Files::can_fold)
    }

    fn is_proven(&self) -> bool {
        let known = self.known();
        known.health == Health::Well && known.committed.is_some_and(|at| at.elapsed() < PROVEN)
    }

    fn noted(&self, error: sqlx::Error) -> StoreError {
        let error = StoreError::from(error);
        self.note_error(&error);
        error
    }

    fn known(&self) -> MutexGuard<'_, Known> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn note_error(&self, error: &StoreError) {
        self.known().note(match error {
            StoreError::Full(_) => Health::Full,
            StoreError::Broken(_) => Health::Broken,
            _ => Health::Doubtful,
        });
    }

    /// Notes how a commit ended, and says whether it counts: nothing mends a disk that has failed but a new
    /// start, and what was committed to files that are gone is lost.
    fn ended(&self, committed: Result<(), sqlx::Error>) -> Result<(), StoreError> {
        self.require_files()?;
        committed.map_err(|error| self.noted(error))?;
        let mut known = self.known();
        if known.health < Health::Broken {
            known.health = Health::Well;
        }
        known.committed = Some(Instant::now());
        Ok(())
    }
}

/// Rewrites a row as it is: a file that has become read-only shows here and not in a user's request.
async fn touch(tx: &mut Write) -> Result<(), StoreError> {
    query("UPDATE counters SET value = value WHERE name = 'boot'").execute(&mut **tx).await?;
    Ok(())
}

impl Drop for Open {
    fn drop(&mut self) {
        if !self.is_known {
            self.writing.known().note(Health::Doubtful);
        }
    }
}

impl Deref for Write {
    type Target = Session;

    fn deref(&self) -> &Session {
        &self.tx
    }
}

impl DerefMut for Write {
    fn deref_mut(&mut self) -> &mut Session {
        &mut self.tx
    }
}

impl Write {
    /// Makes it durable: what is acknowledged after this survives the power cord. Where it has changed what
    /// is served, that is served as soon as this returns.
    pub async fn commit(self) -> Result<(), StoreError> {
        // Whoever waits for this may leave at any moment; what was committed is told all the same.
        let ended = tokio::spawn(self.end()).await;
        let wait = ended.map_err(|error| StoreError::Sql(sqlx::Error::Io(error.into())))??;
        if let Some(wait) = wait {
            // A follower that is gone has nothing to show any more.
            let _ = wait.await;
        }
        Ok(())
    }

    /// Commits, and tells of which systems. What comes back ends when that was followed.
    async fn end(mut self) -> Result<Option<oneshot::Receiver<()>>, StoreError> {
        self.mark().await.inspect_err(|error| self.open.writing.note_error(error))?;
        let touched = touched(&mut self.tx).await.inspect_err(|error| self.open.writing.note_error(error))?;
        self.open.is_known = true;
        let committed = self.tx.commit().await;
        self.open.writing.ended(committed)?;
        Ok(self.changes.tell(touched))
    }

    /// Counts the commit in the header of the database, which SQLite does not while there is a log: by that
    /// `files` tells an older copy of the file.
    async fn mark(&mut self) -> Result<(), StoreError> {
        if matches!(self.tx, Session::Postgres(_)) {
            return Ok(());
        }
        let changed: i64 = query_scalar("SELECT total_changes()").fetch_one(&mut self.tx).await?;
        let before = std::mem::replace(&mut self.open.writing.known().changed, changed);
        if changed != before {
            let count: i32 = query_scalar("PRAGMA user_version").fetch_one(&mut self.tx).await?;
            let next = format!("PRAGMA user_version = {}", count.wrapping_add(1));
            query(AssertSqlSafe(next)).once().execute(&mut self.tx).await?;
        }
        Ok(())
    }

    /// Ends it without a trace, as planned.
    pub(super) async fn take_back(mut self) -> Result<(), StoreError> {
        self.open.is_known = true;
        Ok(self.tx.rollback().await?)
    }
}

/// Whether a connection can be used for the next transaction. SQLite takes a transaction back by itself where
/// there is no room; the driver's own ROLLBACK then fails, and it would count that transaction as open for
/// ever.
pub(super) async fn is_clean(connection: &mut SqliteConnection) -> Result<bool, sqlx::Error> {
    // An answer comes after the ROLLBACK that an abandoned transaction has left in the line.
    connection.ping().await?;
    Ok(!connection.is_in_transaction())
}
