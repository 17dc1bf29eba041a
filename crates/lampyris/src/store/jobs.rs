//! Jobs as they are read: one, the newest of systems, a page of a list. `queue` is where they come from.

use super::database::Store;
use super::error::StoreError;
use super::job_record::Row;
use super::reach::SystemScope;
use super::statement::query_as;
use super::value::{parse, to_json};
use lampyris_core::data::SystemId;
use sqlx::AssertSqlSafe;

pub use super::job::{JobFailure, JobKind, JobOrder, JobStatus, Origin, Outcome, Priority};
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
pub(crate) async fn newest(store: &Store, systems: &[String]) -> Result<Vec<JobRecord>, StoreError> {
    let sql = "SELECT * FROM jobs WHERE sequence IN (SELECT MAX(sequence) FROM jobs WHERE system IN (SELECT \
        value FROM json_each($1)) GROUP BY system)";
    let rows: Vec<Row> = query_as(sql).bind(to_json("systems", systems)?).fetch_all(&store.reader).await?;
    rows.into_iter().map(Row::record).collect()
}

/// The order in which the jobs of a tenant are claimed.
const TURN: &str = "priority, turn, sequence";

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

/// One page of a list of jobs: those behind the place of one in the order, which is its sequence number, or
/// that of its end where ends are listed; from the first on where there is none.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn page(
    store: &Store,
    filter: &Filter,
    order: JobOrder,
    behind: Option<i64>,
    limit: i64,
) -> Result<Vec<JobRecord>, StoreError> {
    let (place, sorted) = match (order, behind) {
        (JobOrder::Submitted, _) => ("sequence < $1", "sequence DESC"),
        (JobOrder::Ended, _) => ("end_sequence < $1", "end_sequence DESC"),
        (JobOrder::Turn, None) => ("state = 'queued' AND sequence < $1", TURN),
        (JobOrder::Turn, Some(_)) => (
            "state = 'queued' AND (priority, turn, sequence) > (SELECT priority, turn, sequence FROM jobs WHERE \
            sequence = $1)",
            TURN,
        ),
    };
    // Only what is asked for stands in the statement, and only the first of it may choose the index (`+`
    // hides a column from SQLite): the jobs of one system are few among many, those in a state are fewer than
    // those of a kind.
    let mut sql = format!("SELECT * FROM jobs WHERE {place}");
    let hidden = if store.is_shared() { "" } else { "+" };
    // Ends have an index in their order.
    let mut hide = if order == JobOrder::Ended { hidden } else { "" };
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
    sql += &format!(" ORDER BY {sorted} LIMIT $2");
    let rows: Vec<Row> = query_as(AssertSqlSafe(sql))
        .bind(behind.unwrap_or(i64::MAX))
        .bind(limit)
        .bind(filter.system.as_ref().map(ToString::to_string))
        .bind(filter.reach.sql()?)
        .fetch_all(&store.reader)
        .await?;
    rows.into_iter().map(Row::record).collect()
}

/// How many jobs of these systems stand how.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn counts(store: &Store, reach: &SystemScope) -> Result<Vec<(JobStatus, i64)>, StoreError> {
    let within = if reach.is_all() {
        ""
    } else {
        " AND EXISTS (SELECT 1 FROM json_each($1) WHERE glob(value, system))"
    };
    // Each state has an index of its own, which is found by the word alone.
    let parts: Vec<String> = JobStatus::ALL
        .iter()
        .map(|state| format!("SELECT '{0}', COUNT(*) FROM jobs WHERE state = '{0}'{within}", state.as_str()))
        .collect();
    let rows: Vec<(String, i64)> = query_as(AssertSqlSafe(parts.join(" UNION ALL ")))
        .bind(reach.sql()?)
        .fetch_all(&store.reader)
        .await?;
    rows.into_iter().map(|(state, count)| Ok((parse("a state", &state)?, count))).collect()
}
