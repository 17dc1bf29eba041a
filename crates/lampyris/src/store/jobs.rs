//! The queue: a table, a claim that is one UPDATE, and a lease of boot number and attempt.
//!
//! A lease has no expiry and no clock: it is void as soon as another boot looks at it. The attempt is counted
//! and committed before the job starts, so a job that takes the process down is counted as well.

use super::database::Store;
use super::error::StoreError;
use super::idempotency::{Earlier, KeyState, RequestKey, look_up, remember};
use super::reach::SystemScope;
use super::row::row;
use super::sequence::{derive_id, next};
use super::value::{from_json, instant, millis, parse, to_json};
use super::{failpoint, params};
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::model::ModelId;
use sqlx::{QueryBuilder, Sqlite, SqliteConnection};

pub use super::job::{JobFailure, JobKind, JobState, Origin, Outcome, Priority};

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

/// A job as it is kept.
#[derive(Debug, Clone, PartialEq)]
pub struct JobRecord {
    /// Its id.
    pub id: String,
    /// The order of submission.
    pub sequence: i64,
    /// What it does.
    pub kind: JobKind,
    /// To which system.
    pub system: SystemId,
    /// With which model.
    pub model: ModelId,
    /// The request with all defaults filled in.
    pub request: serde_json::Value,
    /// Whether it never alters what is served.
    pub experiment: bool,
    /// Who asked.
    pub origin: Origin,
    /// Who goes first.
    pub priority: Priority,
    /// Where it stands.
    pub state: JobState,
    /// What it led to, if it succeeded.
    pub outcome: Option<Outcome>,
    /// The boot that runs it, while it runs.
    pub boot: Option<i64>,
    /// How often it was started.
    pub attempt: i64,
    /// Whether somebody called it off while it ran.
    pub cancelling: bool,
    /// What it found.
    pub fit: Option<String>,
    /// The revision that it published.
    pub revision: Option<i64>,
    /// Why it failed.
    pub error: Option<JobFailure>,
    /// Why the search ended.
    pub stopped_by: Option<String>,
    /// What the search cost.
    pub evaluations: Option<i64>,
    /// When it was submitted.
    pub created_at: Timestamp,
    /// When it was last started.
    pub started_at: Option<Timestamp>,
    /// When it ended.
    pub ended_at: Option<Timestamp>,
    /// The place of its end in the order of everything.
    pub end_sequence: Option<i64>,
    /// The job that it repeats.
    pub retry_of: Option<String>,
    /// What it diagnosed.
    pub diagnosis: Option<String>,
    /// The settings that it chose, and why.
    pub tuning: Option<serde_json::Value>,
}

impl JobRecord {
    /// The right to end this job, while it runs.
    pub fn lease(&self) -> Option<Lease> {
        self.boot.map(|boot| Lease { job: self.id.clone(), boot, attempt: self.attempt })
    }
}

/// The right to end a job: void as soon as it was claimed again.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lease {
    /// The job.
    pub job: String,
    /// The boot that claimed it.
    pub boot: i64,
    /// The attempt that was counted.
    pub attempt: i64,
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
    /// So many jobs wait already.
    QueueFull(i64),
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

row! {
    pub(super) struct Row {
        id: String,
        sequence: i64,
        kind: String,
        system: String,
        model: String,
        request: String,
        experiment: bool,
        origin: String,
        priority: i64,
        state: String,
        outcome: Option<String>,
        boot: Option<i64>,
        attempt: i64,
        cancelling: bool,
        fit: Option<String>,
        revision: Option<i64>,
        error: Option<String>,
        stopped_by: Option<String>,
        evaluations: Option<i64>,
        created_at: i64,
        started_at: Option<i64>,
        ended_at: Option<i64>,
        end_sequence: Option<i64>,
        diagnosis: Option<String>,
        tuning: Option<String>,
        retry_of: Option<String>,
    }
}

impl Row {
    pub(super) fn record(self) -> Result<JobRecord, StoreError> {
        Ok(JobRecord {
            kind: parse("a kind of job", &self.kind)?,
            system: parse("a system", &self.system)?,
            model: parse("a model", &self.model)?,
            request: from_json("a request", &self.request)?,
            origin: parse("an origin", &self.origin)?,
            priority: Priority::from_rank(self.priority),
            state: parse("a state", &self.state)?,
            outcome: self.outcome.as_deref().map(|word| parse("an outcome", word)).transpose()?,
            tuning: self.tuning.as_deref().map(|text| from_json("a tuning", text)).transpose()?,
            error: self.error.as_deref().map(|text| from_json("a failure", text)).transpose()?,
            created_at: instant(self.created_at)?,
            started_at: self.started_at.map(instant).transpose()?,
            ended_at: self.ended_at.map(instant).transpose()?,
            id: self.id,
            sequence: self.sequence,
            experiment: self.experiment,
            boot: self.boot,
            attempt: self.attempt,
            cancelling: self.cancelling,
            fit: self.fit,
            revision: self.revision,
            stopped_by: self.stopped_by,
            evaluations: self.evaluations,
            end_sequence: self.end_sequence,
            retry_of: self.retry_of,
            diagnosis: self.diagnosis,
        })
    }
}

/// Takes a job into the queue, unless an equal one waits or the request came before.
///
/// # Errors
/// Where the queue is full, the key belongs to another request, or the database fails.
pub async fn submit(
    store: &Store,
    new: &NewJob,
    key: Option<&RequestKey>,
    limit: i64,
    now: Timestamp,
) -> Result<Submitted, SubmitError> {
    let mut tx = store.write().await?;
    match look_up(&mut tx, key).await? {
        KeyState::Reused => return Err(SubmitError::KeyReused),
        KeyState::Seen(earlier) => return Ok(Submitted::Earlier(earlier)),
        KeyState::Fresh => {}
    }
    let (job, is_new) = submit_in(&mut tx, new, limit, now).await?;
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
        return Err(SubmitError::QueueFull(limit));
    }
    let sequence = next(tx, "sequence").await?;
    let turn = turn(tx, new).await?;
    let sql =
        "INSERT INTO jobs (id, sequence, kind, system, model, request, fingerprint, experiment, origin, \
        priority, turn, state, created_at)
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
    let sql = "UPDATE jobs SET state = 'running', boot = $1, attempt = attempt + 1, started_at = $2
               WHERE id = (
                   SELECT j.id FROM jobs j WHERE j.state = 'queued'
                   AND NOT EXISTS (SELECT 1 FROM jobs r WHERE r.state = 'running' AND r.system = j.system)
                   ORDER BY j.priority, j.turn, j.sequence LIMIT 1)
               AND NOT EXISTS (SELECT 1 FROM jobs r WHERE r.state = 'running' AND (r.attempt >= $3 OR \
        jobs.attempt + 1 >= $3))
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
    Ok(Some(Cancelled { running: job.state == JobState::Running, job }))
}

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
    pub state: Option<JobState>,
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
    let system = filter.system.as_ref().map(ToString::to_string);
    let wanted = [
        (system, "system"),
        (filter.state.map(|state| state.as_str().to_owned()), "state"),
        (filter.kind.map(|kind| kind.as_str().to_owned()), "kind"),
    ];
    let mut query = QueryBuilder::<Sqlite>::new("SELECT * FROM jobs WHERE sequence < ");
    query.push_bind(before);
    let mut hide = "";
    for (value, column) in wanted.into_iter().filter_map(|(value, column)| Some((value?, column))) {
        query.push(" AND ").push(hide).push(column).push(" = ").push_bind(value);
        hide = "+";
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
