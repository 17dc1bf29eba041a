//! Jobs as they are read: one, the newest of systems, a page of a list. `queue` is where they come from.

use super::database::Store;
use super::error::StoreError;
use super::job_record::Row;
use super::reach::SystemScope;
use super::value::to_json;
use lampyris_core::data::SystemId;
use sqlx::{QueryBuilder, Sqlite};

pub use super::job::{JobFailure, JobKind, JobStatus, Origin, Outcome, Priority};
pub use super::job_record::{Ended, FoundFit, JobRecord, JobResult, JobState, Lease};

/// One job.
///
/// # Errors
/// Where the database fails.
pub async fn get(store: &Store, id: &str) -> Result<Option<JobRecord>, StoreError> {
    let row: Option<Row> =
        sqlx::query_as("SELECT * FROM jobs WHERE id = $1").bind(id).fetch_optional(&store.reader).await?;
    row.map(Row::record).transpose()
}

/// The newest job of each of these systems, of those that have one.
///
/// # Errors
/// Where the database fails.
pub async fn newest(store: &Store, systems: &[String]) -> Result<Vec<JobRecord>, StoreError> {
    let sql = "SELECT * FROM jobs WHERE sequence IN (SELECT MAX(sequence) FROM jobs WHERE system IN (SELECT \
        value FROM json_each($1)) GROUP BY system)";
    let rows: Vec<Row> =
        sqlx::query_as(sql).bind(to_json("systems", systems)?).fetch_all(&store.reader).await?;
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
    // hides a column): the jobs of one system are few among many, those in a state are fewer than those of a
    // kind.
    let mut query = QueryBuilder::<Sqlite>::new("SELECT * FROM jobs WHERE sequence < ");
    query.push_bind(before);
    let mut hide = "";
    if let Some(system) = &filter.system {
        query.push(" AND system = ").push_bind(system.to_string());
        hide = "+";
    }
    if let Some(state) = filter.state {
        // Each state has an index of its own, which is found by the word alone.
        query.push(" AND ").push(hide).push("state = '").push(state.as_str()).push("'");
        hide = "+";
    }
    if let Some(kind) = filter.kind {
        query.push(" AND ").push(hide).push("kind = ").push_bind(kind.as_str());
    }
    if let Some(reach) = filter.reach.sql()? {
        query
            .push(" AND EXISTS (SELECT 1 FROM json_each(")
            .push_bind(reach)
            .push(") WHERE system GLOB value)");
    }
    query.push(" ORDER BY sequence DESC LIMIT ").push_bind(limit);
    let rows: Vec<Row> = query.build_query_as().fetch_all(&store.reader).await?;
    rows.into_iter().map(Row::record).collect()
}
