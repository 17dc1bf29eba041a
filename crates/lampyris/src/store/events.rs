//! Jobs that came or ended after a number, in the order in which that was committed.
//!
//! Submissions and ends take their numbers from one counter inside their transactions, and transactions that
//! write follow one another; so whoever has seen a number has seen all smaller ones.

use super::database::Store;
use super::error::StoreError;
use super::job_record::{JobRecord, Row};
use super::statement::{query_as, query_scalar};
use lampyris_core::data::SystemId;

/// Numbers between which listeners have missed something.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Missed {
    /// The last number that was seen.
    pub after: i64,
    /// The last one that is told by other means no more.
    pub up_to: i64,
}

impl Missed {
    /// Whether a number is among them.
    pub const fn has(self, number: i64) -> bool {
        self.after < number && number <= self.up_to
    }
}

/// The newest number.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn newest(store: &Store) -> Result<i64, StoreError> {
    Ok(query_scalar("SELECT value FROM counters WHERE name = 'sequence'").fetch_one(&store.reader).await?)
}

/// Jobs that were submitted or ended between two numbers, as they are now.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn news(store: &Store, missed: Missed) -> Result<Vec<JobRecord>, StoreError> {
    let sql = "SELECT * FROM jobs WHERE (sequence > $1 AND sequence <= $2) OR (end_sequence > $1 AND \
        end_sequence <= $2)";
    let rows: Vec<Row> = query_as(sql).bind(missed.after).bind(missed.up_to).fetch_all(&store.reader).await?;
    rows.into_iter().map(Row::record).collect()
}

/// Jobs that ended between two numbers, in that order: the first ones.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn ended(
    store: &Store,
    missed: Missed,
    system: Option<&SystemId>,
    limit: i64,
) -> Result<Vec<JobRecord>, StoreError> {
    let sql =
        "SELECT * FROM jobs WHERE end_sequence > $1 AND end_sequence <= $2 AND ($3 IS NULL OR system = $3)
               ORDER BY end_sequence LIMIT $4";
    let query =
        query_as(sql).bind(missed.after).bind(missed.up_to).bind(system.map(ToString::to_string)).bind(limit);
    let rows: Vec<Row> = query.fetch_all(&store.reader).await?;
    rows.into_iter().map(Row::record).collect()
}

/// Jobs that wait and were submitted between two numbers, or were put back into the queue, in the order of
/// submission: the first ones after `cursor`.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn waiting(
    store: &Store,
    missed: Missed,
    system: Option<&SystemId>,
    cursor: i64,
    limit: i64,
) -> Result<Vec<JobRecord>, StoreError> {
    let sql = "SELECT * FROM jobs WHERE state = 'queued' AND sequence > $4 AND sequence <= $2 AND (sequence \
        > $1 OR requeued) \
        AND ($3 IS NULL OR system = $3) ORDER BY sequence LIMIT $5";
    let query = query_as(sql)
        .bind(missed.after)
        .bind(missed.up_to)
        .bind(system.map(ToString::to_string))
        .bind(cursor)
        .bind(limit);
    let rows: Vec<Row> = query.fetch_all(&store.reader).await?;
    rows.into_iter().map(Row::record).collect()
}
