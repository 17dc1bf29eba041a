//! Jobs as they are read: one, the newest of systems, a page of a list. `queue` is where they come from.

use super::database::Store;
use super::error::StoreError;
use super::job_record::Row;
use super::reach::SystemScope;
use super::statement::query_as;
use super::value::to_json;
use lampyris_core::data::SystemId;
use sqlx::AssertSqlSafe;

pub use super::job::{JobFailure, JobKind, JobStatus, Origin, Outcome, Priority};
pub use super::job_record::{Ended, FoundFit, JobRecord, JobResult, JobState, Lease};

/// One job.
///
/// # Errors
/// Where the database fails.
pub async fn get(store: &Store, id: &str) -> Result<Option<JobRecord>, StoreError> {
    let row: Option<Row> =
        query_as("SELECT * FROM jobs WHERE id = $1").bind(id).fetch_optional(&store.reader).await?;
    row.map(Row::record).transpose()
}

/// The newest job of each of these systems, of those that have one.
///
/// # Errors
/// Where the database fails.
pub async fn newest(store: &Store, systems: &[String]) -> Result<Vec<JobRecord>, StoreError> {
    let sql = "SELECT * FROM jobs WHERE sequence IN (SELECT MAX(sequence) FROM jobs WHERE system IN (SELECT \
        value FROM json_each($1)) GROUP BY system)";
    let rows: Vec<Row> = query_as(sql).bind(to_json("systems", systems)?).fetch_all(&store.reader).await?;
    rows.into_iter().map(Row::record).collect()
}

/// Which jobs a list shows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Filter {
    /// Only those that stand so.
    pub state: Option<JobStatus>,
    /// Only those of this system.
    pub system: Option<SystemId>,
    /// Only those of this kind.
    pub kind: Option<JobKind>,
    /// Only those of these systems.
    pub reach: SystemScope,
}

/// Jobs submitted before a sequence number, newest first: one page of a list.
///
/// # Errors
/// Where the database fails.
pub async fn page(
    store: &Store,
    filter: &Filter,
    before: i64,
    limit: i64,
) -> Result<Vec<JobRecord>, StoreError> {
    // Only what is asked for stands in the statement, and only the first of it may choose the index (`+`
    // hides a column from SQLite): the jobs of one system are few among many, those in a state are fewer than
    // those of a kind.
    let mut sql = "SELECT * FROM jobs WHERE sequence < $1".to_owned();
    let mut hide = "";
    let hidden = if store.is_shared() { "" } else { "+" };
    if filter.system.is_some() {
        sql += " AND system = $3";
        hide = hidden;
    }
    if let Some(state) = filter.state {
        // Each state has an index of its own, which is found by the word alone.
        sql += &format!(" AND {hide}state = '{}'", state.as_str());
        hide = hidden;
    }
    if let Some(kind) = filter.kind {
        sql += &format!(" AND {hide}kind = '{}'", kind.as_str());
    }
    if !filter.reach.is_all() {
        sql += " AND EXISTS (SELECT 1 FROM json_each($4) WHERE glob(value, system))";
    }
    sql += " ORDER BY sequence DESC LIMIT $2";
    let rows: Vec<Row> = query_as(AssertSqlSafe(sql))
        .bind(before)
        .bind(limit)
        .bind(filter.system.as_ref().map(ToString::to_string))
        .bind(filter.reach.sql()?)
        .fetch_all(&store.reader)
        .await?;
    rows.into_iter().map(Row::record).collect()
}
