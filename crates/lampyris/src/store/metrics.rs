//! How long the queue is.

use super::database::Store;
use super::error::StoreError;
use super::job::JobStatus;
use super::statement::query_as;
use super::value::{instant, parse};
use jiff::Timestamp;

/// The jobs that stand alike.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct QueueCounts {
    /// Where they stand.
    pub state: JobStatus,
    /// How many there are.
    pub count: i64,
    /// Since when the one that has stood so longest has.
    pub oldest: Option<Timestamp>,
}

/// The jobs that wait, and those that run.
///
/// # Errors
/// Where the database fails.
pub async fn queue(store: &Store) -> Result<Vec<QueueCounts>, StoreError> {
    // The one that waits longest came first: its row alone is read, however many wait.
    let sql =
        "SELECT 'queued', COUNT(*), (SELECT created_at FROM jobs WHERE state = 'queued' ORDER BY sequence \
               LIMIT 1) FROM jobs WHERE state = 'queued'
               UNION ALL SELECT 'running', COUNT(*), MIN(started_at) FROM jobs WHERE state = 'running'";
    let rows: Vec<(String, i64, Option<i64>)> = query_as(sql).fetch_all(&store.reader).await?;
    let standing = |(state, count, oldest): (String, i64, Option<i64>)| {
        Ok(QueueCounts { state: parse("a state", &state)?, count, oldest: oldest.map(instant).transpose()? })
    };
    rows.into_iter().map(standing).collect()
}
