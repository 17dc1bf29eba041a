//! The processes that work, each by a row for one start of it.
//!
//! A process that several machines may outlive holds a lease by the clock of the database and renews it.
//! Whoever finds a lease that has ended takes the row away, and with it every right to end a job
//! ([`super::queue::recover`]); a process that comes back later is another one. On a file there is one, which
//! the lock keeps alone, and a start takes the rows of all earlier ones away.

use super::database::Store;
use super::error::StoreError;
use super::sequence::next;
use super::statement::{query, query_scalar};
use super::value::millis;
use super::words::{UnknownWord, words};
use jiff::Timestamp;
use std::time::Duration;

words! {
    /// What a process does.
    ProcessRole {
        /// Answers requests.
        Api = "api",
        /// Runs jobs.
        Worker = "worker",
        /// Submits what schedules say, asks sources, and looks at what has arrived; one of several does.
        Scheduler = "scheduler",
    }
}

impl ProcessRole {
    /// Reads roles that commas separate.
    ///
    /// # Errors
    /// A word that is none.
    pub fn list(text: &str) -> Result<Vec<Self>, UnknownWord> {
        text.split(',').map(|word| word.trim().parse()).collect()
    }
}

/// Enters a start of a process, which has a number that no other has, with its first lease.
///
/// # Errors
/// Where the database fails.
pub async fn enlist(
    store: &Store,
    (name, roles): (&str, &str),
    lease: Duration,
    now: Timestamp,
) -> Result<i64, StoreError> {
    let mut tx = store.write().await?;
    let worker = next(&mut tx, "boot").await?;
    if !store.is_shared() {
        query("DELETE FROM workers").execute(&mut *tx).await?;
    }
    let sql = "INSERT INTO workers (worker, name, roles, started_at, until) \
        SELECT $1, $2, $3, $4, ms + $5 FROM clock";
    query(sql)
        .bind(worker)
        .bind(name)
        .bind(roles)
        .bind(millis(now))
        .bind(lease.as_millis() as i64)
        .execute(&mut *tx)
        .await?;
    tx.commit().await?;
    Ok(worker)
}

/// Renews the lease of a process; `false` where it has ended.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn renew(store: &Store, worker: i64, lease: Duration) -> Result<bool, StoreError> {
    let sql = "UPDATE workers SET until = (SELECT ms FROM clock) + $2 WHERE worker = $1 AND until >= (SELECT ms \
        FROM clock)";
    let mut tx = store.write_beside().await?;
    let renewed = query(sql).bind(worker).bind(lease.as_millis() as i64).execute(&mut *tx).await?;
    tx.commit().await?;
    Ok(renewed == 1)
}

/// Takes the row of a process away that stops.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn dismiss(store: &Store, worker: i64) -> Result<(), StoreError> {
    let mut tx = store.write().await?;
    query("DELETE FROM workers WHERE worker = $1").bind(worker).execute(&mut *tx).await?;
    tx.commit().await
}

/// Whether the lease of some process has ended.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn somebody_is_silent(store: &Store) -> Result<bool, StoreError> {
    let sql = "SELECT EXISTS (SELECT 1 FROM workers WHERE until < (SELECT ms FROM clock))";
    Ok(query_scalar(sql).fetch_one(&store.reader).await?)
}

/// Whether a process is the eldest of those with a role, which alone does what need not be done twice.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn is_eldest(store: &Store, worker: i64, role: &str) -> Result<bool, StoreError> {
    let sql = "SELECT COALESCE(MIN(worker) = $1, FALSE) FROM workers WHERE until >= (SELECT ms FROM clock) AND \
        glob('*' || $2 || '*', roles)";
    Ok(query_scalar(sql).bind(worker).bind(role).fetch_one(&store.reader).await?)
}
