//! The queue: a table, a claim that is one UPDATE, and a lease of boot number and attempt.
//!
//! A lease has no expiry and no clock: it is void as soon as another boot looks at it. The attempt is counted
//! and committed before the job starts, so a job that takes the process down is counted as well.

use super::database::Store;
use super::error::StoreError;
use super::idempotency::{Earlier, KeyState, RequestKey, look_up, remember};
use super::job::{JobFailure, JobKind, JobStatus, Origin, Priority};
use super::job_record::{JobRecord, Lease, Row};
use super::sequence::{derive_id, next};
use super::value::{millis, to_json};
use super::{failpoint, params};
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::model::ModelId;
use sqlx::SqliteConnection;

/// A job that was started this often without coming to an end takes no further boot with it.
pub const MAX_ATTEMPTS: i64 = 3;

/// A job to be submitted.
#[derive(Debug, Clone, PartialEq)]
pub struct NewJob {
    /// What it does.
    pub kind: JobKind,
    /// To which system.
    pub system: SystemId,
    /// With which model.
    pub model: ModelId,
    /// The request with all defaults filled in, JSON.
    pub request: String,
    /// Whether it never alters what is served.
    pub experiment: bool,
    /// Who asked.
    pub origin: Origin,
    /// Who goes first.
    pub priority: Priority,
}

impl NewJob {
    /// Equal jobs have equal fingerprints, whoever asked.
    pub(super) fn fingerprint(&self) -> String {
        let text = format!(
            "{} {} {} {} {}",
            self.kind.as_str(),
            self.system,
            self.model,
            self.experiment,
            self.request
        );
        blake3::hash(text.as_bytes()).to_hex().to_string()
    }
}

/// What became of a job that was submitted.
#[derive(Debug, Clone, PartialEq)]
pub enum Submitted {
    /// It waits.
    New(JobRecord),
    /// An equal one waits already.
    Waiting(JobRecord),
    /// The same request came before.
    Earlier(Earlier),
}

/// Why a job was not taken.
#[derive(Debug)]
pub enum SubmitError {
    /// The database failed.
    Store(StoreError),
    /// So many jobs wait already, in a sentence.
    QueueFull(String),
    /// The idempotency key belongs to another request.
    KeyReused,
}

impl<E: Into<StoreError>> From<E> for SubmitError {
    fn from(error: E) -> Self {
        SubmitError::Store(error.into())
    }
}

/// What a cancellation met.
#[derive(Debug, Clone, PartialEq)]
pub struct Cancelled {
    /// The job as it is now.
    pub job: JobRecord,
    /// Whether a worker has it and must be told.
    pub running: bool,
}

/// What a boot found.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Recovered {
    /// Jobs that wait again.
    pub requeued: Vec<String>,
    /// Jobs that failed for good.
    pub failed: Vec<String>,
}

/// Takes a job into the queue, unless an equal one waits or the request came before. There are limits of all
/// jobs that wait, and of those of one system.
///
/// # Errors
/// Where the queue is full, the key belongs to another request, or the database fails.
pub async fn submit(
    store: &Store,
    new: &NewJob,
    key: Option<&RequestKey>,
    (limit, of_system): (i64, i64),
    now: Timestamp,
) -> Result<Submitted, SubmitError> {
    let mut tx = store.write().await?;
    match look_up(&mut tx, key).await? {
        KeyState::Reused => return Err(SubmitError::KeyReused),
        KeyState::Seen(earlier) => return Ok(Submitted::Earlier(earlier)),
        KeyState::Fresh => {}
    }
    let (job, is_new) = submit_in(&mut tx, new, limit, now).await?;
    let waiting: i64 = sqlx::query_scalar("SELECT COUNT(*) FROM jobs WHERE state = 'queued' AND system = $1")
        .bind(new.system.to_string())
        .fetch_one(&mut *tx)
        .await?;
    // Whoever may ask for one system alone leaves the queue to the others.
    if is_new && waiting > of_system {
        let detail = format!("{of_system} jobs of {} wait already", new.system);
        return Err(SubmitError::QueueFull(detail));
    }
    remember(&mut tx, key, &job.id, if is_new { 202 } else { 200 }, now).await?;
    tx.commit().await?;
    Ok(if is_new { Submitted::New(job) } else { Submitted::Waiting(job) })
}

/// Takes a job into the queue inside a transaction; says whether it is new or an equal one waits.
pub(super) async fn submit_in(
    tx: &mut SqliteConnection,
    new: &NewJob,
    limit: i64,
    now: Timestamp,
) -> Result<(JobRecord, bool), SubmitError> {
    let fingerprint = new.fingerprint();
    let waiting: Option<Row> =
        sqlx::query_as("SELECT * FROM jobs WHERE fingerprint = $1 AND state = 'queued' AND NOT requeued")
            .bind(&fingerprint)
            .fetch_optional(&mut *tx)
            .await?;
    if let Some(row) = waiting {
        return Ok((raised(tx, row.record()?, new).await?, false));
    }
    let queued: i64 =
        sqlx::query_scalar("SELECT COUNT(*) FROM jobs WHERE state = 'queued'").fetch_one(&mut *tx).await?;
    if queued >= limit {
        return Err(SubmitError::QueueFull(format!("{limit} jobs wait already")));
    }
    let sequence = next(tx, "sequence").await?;
    let turn = turn(tx, new).await?;
    let sql = "INSERT INTO jobs (id, sequence, kind, system, model, request, fingerprint, experiment, origin, \
        priority, turn, state, created_at) \
        VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, 'queued', $12) RETURNING *";
    let row: Row = sqlx::query_as(sql)
        .bind(derive_id("job", sequence, now))
        .bind(sequence)
        .bind(new.kind.as_str())
        .bind(new.system.to_string())
        .bind(new.model.to_string())
        .bind(&new.request)
        .bind(fingerprint)
        .bind(new.experiment)
        .bind(new.origin.as_str())
        .bind(new.priority.rank())
        .bind(turn)
        .bind(millis(now))
        .fetch_one(tx)
        .await?;
    Ok((row.record()?, true))
}

/// The equal job that waits, moved up where the new one is more urgent.
async fn raised(
    tx: &mut SqliteConnection,
    waiting: JobRecord,
    new: &NewJob,
) -> Result<JobRecord, StoreError> {
    if new.priority.rank() >= waiting.priority.rank() {
        return Ok(waiting);
    }
    let turn = turn(tx, new).await?;
    let query = sqlx::query_as("UPDATE jobs SET priority = $2, turn = $3 WHERE id = $1 RETURNING *");
    let row: Row = query.bind(&waiting.id).bind(new.priority.rank()).bind(turn).fetch_one(tx).await?;
    row.record()
}

/// The place in a fair queue: behind the system's own jobs, but not before the round that is being served.
/// A system with one job thus waits for one job of every other system, however many those have.
async fn turn(tx: &mut SqliteConnection, new: &NewJob) -> Result<i64, StoreError> {
    let own: Option<i64> = sqlx::query_scalar(
        "SELECT MAX(turn) FROM jobs WHERE state = 'queued' AND system = $1 AND priority = $2",
    )
    .bind(new.system.to_string())
    .bind(new.priority.rank())
    .fetch_one(&mut *tx)
    .await?;
    let round: Option<i64> =
        sqlx::query_scalar("SELECT MIN(turn) FROM jobs WHERE state = 'queued' AND priority = $1")
            .bind(new.priority.rank())
            .fetch_one(tx)
            .await?;
    Ok(own.map_or(0, |turn| turn + 1).max(round.unwrap_or(0)))
}

/// Claims the next job, and counts the attempt. Two jobs of one system never run at once: both would be
/// judged against the same incumbent. The last attempt of a job is made alone: the jobs that ran beside it
/// when the process went down were charged as well, and none may fail for good because of another.
///
/// # Errors
/// Where the database fails.
pub async fn claim(store: &Store, boot: i64, now: Timestamp) -> Result<Option<JobRecord>, StoreError> {
    let sql = "UPDATE jobs SET state = 'running', boot = $1, attempt = attempt + 1, started_at = $2 \
        WHERE id = ( \
        SELECT j.id FROM jobs j WHERE j.state = 'queued' \
        AND NOT EXISTS (SELECT 1 FROM jobs r WHERE r.state = 'running' AND r.system = j.system) \
        ORDER BY j.priority, j.turn, j.sequence LIMIT 1) \
        AND NOT EXISTS (SELECT 1 FROM jobs r WHERE r.state = 'running' AND (r.attempt >= $3 OR jobs.attempt \
        + 1 >= $3)) \
        RETURNING *";
    let mut tx = store.write().await?;
    let row: Option<Row> =
        sqlx::query_as(sql).bind(boot).bind(millis(now)).bind(MAX_ATTEMPTS).fetch_optional(&mut *tx).await?;
    let Some(row) = row else {
        tx.take_back().await?;
        return Ok(None);
    };
    tx.commit().await?;
    row.record().map(Some)
}

/// Gives a job back without charging the attempt, because the service stops and not the job.
///
/// # Errors
/// Where the database fails or the lease is lost.
pub async fn requeue(store: &Store, lease: &Lease, now: Timestamp) -> Result<(), StoreError> {
    let sql = "UPDATE jobs SET boot = NULL, attempt = attempt - 1, requeued = TRUE,
                   state = CASE WHEN cancelling THEN 'cancelled' ELSE 'queued' END,
                   ended_at = CASE WHEN cancelling THEN $4 ELSE NULL END
               WHERE id = $1 AND state = 'running' AND boot = $2 AND attempt = $3";
    let mut tx = store.write().await?;
    let done = sqlx::query(sql)
        .bind(&lease.job)
        .bind(lease.boot)
        .bind(lease.attempt)
        .bind(millis(now))
        .execute(&mut *tx)
        .await?;
    tx.commit().await?;
    if done.rows_affected() == 1 { Ok(()) } else { Err(StoreError::LeaseLost) }
}

/// Puts every job of an earlier boot back into the queue, or ends it where it has used up its attempts.
///
/// # Errors
/// Where the database fails.
pub async fn recover(store: &Store, boot: i64, now: Timestamp) -> Result<Recovered, StoreError> {
    let mut tx = store.write().await?;
    let failure = JobFailure {
        code: "interrupted".into(),
        detail: format!("the service went down {MAX_ATTEMPTS} times while this job ran"),
        errors: Vec::new(),
    };
    sqlx::query(
        "UPDATE jobs SET state = 'cancelled', boot = NULL, ended_at = $2 WHERE state = 'running' AND \
        boot <> $1 AND cancelling",
    )
    .bind(boot)
    .bind(millis(now))
    .execute(&mut *tx)
    .await?;
    let sql = "UPDATE jobs SET state = 'failed', boot = NULL, error = $2, ended_at = $3
               WHERE state = 'running' AND boot <> $1 AND attempt >= $4 RETURNING *";
    let failed: Vec<Row> = sqlx::query_as(sql)
        .bind(boot)
        .bind(to_json("a failure", &failure)?)
        .bind(millis(now))
        .bind(MAX_ATTEMPTS)
        .fetch_all(&mut *tx)
        .await?;
    let mut recovered = Recovered::default();
    for row in failed {
        let job = row.record()?;
        note_failed_job(&mut tx, &job, now).await?;
        recovered.failed.push(job.id);
    }
    let sql = "UPDATE jobs SET state = 'queued', boot = NULL, requeued = TRUE WHERE state = 'running' AND \
        boot <> $1 RETURNING id";
    recovered.requeued = sqlx::query_scalar(sql).bind(boot).fetch_all(&mut *tx).await?;
    failpoint::reached("in_recovery");
    tx.commit().await?;
    Ok(recovered)
}

/// Notes a job that failed outside of a worker's hands, if it counts.
async fn note_failed_job(
    tx: &mut SqliteConnection,
    job: &JobRecord,
    now: Timestamp,
) -> Result<(), StoreError> {
    let system = job.system.to_string();
    let own: Option<String> = sqlx::query_scalar("SELECT model FROM systems WHERE system = $1")
        .bind(&system)
        .fetch_optional(&mut *tx)
        .await?;
    if !job.experiment && own.is_some_and(|model| model == job.model.to_string()) {
        params::fall_back(tx, &system, &job.id, None, now).await?;
    }
    Ok(())
}

/// Calls a job off: one that waits is over at once, one that runs is marked. One that has ended stays as it
/// is.
///
/// # Errors
/// Where the database fails.
pub async fn cancel(store: &Store, id: &str, now: Timestamp) -> Result<Option<Cancelled>, StoreError> {
    let mut tx = store.write().await?;
    sqlx::query("UPDATE jobs SET state = 'cancelled', ended_at = $2 WHERE id = $1 AND state = 'queued'")
        .bind(id)
        .bind(millis(now))
        .execute(&mut *tx)
        .await?;
    sqlx::query("UPDATE jobs SET cancelling = TRUE WHERE id = $1 AND state = 'running'")
        .bind(id)
        .execute(&mut *tx)
        .await?;
    let row: Option<Row> =
        sqlx::query_as("SELECT * FROM jobs WHERE id = $1").bind(id).fetch_optional(&mut *tx).await?;
    tx.commit().await?;
    let Some(row) = row else { return Ok(None) };
    let job = row.record()?;
    Ok(Some(Cancelled { running: job.state.status() == JobStatus::Running, job }))
}
