//! Jobs that are done again.

use super::database::Store;
use super::entry::{NewJob, SubmitError};
use super::idempotency::{KeyState, RequestKey, look_up, remember};
use super::job::{JobStatus, Origin, Priority};
use super::job_record::{JobRecord, Row};
use super::queue::{Submitted, submit_in};
use super::statement::{query, query_as};
use super::value::to_json;
use jiff::Timestamp;

/// What became of a wish to do a job again.
#[derive(Debug, Clone, PartialEq)]
pub enum Retried {
    /// There is no such job.
    NoJob,
    /// It has not ended yet.
    NotFinished(JobStatus),
    /// A new job with the same request entered the queue, or an equal one waits.
    Submitted(Box<Submitted>),
}

/// Takes a new job with the request of one that has ended into the queue.
///
/// # Errors
/// Where the queue is full, the key belongs to another request, or the database fails.
pub(crate) async fn retry(
    store: &Store,
    id: &str,
    key: Option<&RequestKey>,
    limit: i64,
    now: Timestamp,
) -> Result<Retried, SubmitError> {
    let mut tx = store.write().await?;
    match look_up(&mut tx, key).await? {
        KeyState::Reused => return Err(SubmitError::KeyReused),
        KeyState::Seen(earlier) => return Ok(Retried::Submitted(Box::new(Submitted::Earlier(earlier)))),
        KeyState::Fresh => {}
    }
    let row: Option<Row> =
        query_as("SELECT * FROM jobs WHERE id = $1").bind(id).fetch_optional(&mut *tx).await?;
    let Some(row) = row else {
        return Ok(Retried::NoJob);
    };
    let ended = row.record()?;
    if !ended.state.is_final() {
        return Ok(Retried::NotFinished(ended.state.status()));
    }
    let new = NewJob {
        kind: ended.kind,
        request: to_json("a request", &ended.request)?.into(),
        system: ended.system,
        model: ended.model,
        experiment: ended.experiment,
        origin: Origin::Posted,
        priority: Priority::Operator,
    };
    let (job, is_new) = submit_in(&mut tx, &new, limit, now).await?;
    let job = if is_new {
        query("UPDATE jobs SET retry_of = $2 WHERE id = $1").bind(&job.id).bind(id).execute(&mut *tx).await?;
        JobRecord { retry_of: Some(id.to_owned()), ..job }
    } else {
        job
    };
    remember(&mut tx, key, &job.id, if is_new { 202 } else { 200 }, now).await?;
    tx.commit().await?;
    Ok(Retried::Submitted(Box::new(if is_new { Submitted::New(job) } else { Submitted::Waiting(job) })))
}
