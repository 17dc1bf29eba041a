//! The queue: a table, a claim that is one UPDATE, and a lease of boot number and attempt.
//!
//! The right to end a job is void as soon as the row of its process is gone (`workers`). The attempt is
//! counted and committed before the job starts, so a job that takes the process down is counted as well.

use super::database::Store;
use super::engine::Session;
use super::entry::{Entered, NewJob, SubmitError, enter};
use super::error::StoreError;
use super::idempotency::{Earlier, KeyState, RequestKey, look_up, remember};
use super::job::JobFailure;
use super::job_record::{JobRecord, Lease, Row};
use super::statement::{query, query_as, query_scalar};
use super::value::{millis, to_json};
use super::{failpoint, params};
use jiff::Timestamp;

/// A job that was started this often without coming to an end takes no further boot with it.
pub const MAX_ATTEMPTS: i64 = 3;

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
    let waiting: i64 = query_scalar("SELECT COUNT(*) FROM jobs WHERE state = 'queued' AND system = $1")
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
    tx: &mut Session,
    new: &NewJob,
    limit: i64,
    now: Timestamp,
) -> Result<(JobRecord, bool), SubmitError> {
    let mut entered = enter(tx, std::slice::from_ref(new), limit, now).await?;
    let Entered { id, is_new } = entered.swap_remove(0);
    let row: Row = query_as("SELECT * FROM jobs WHERE id = $1").bind(id).fetch_one(tx).await?;
    Ok((row.record()?, is_new))
}

const CLAIM: &str = "UPDATE jobs SET state = 'running', boot = $1, attempt = attempt + 1, started_at = $2 \
    WHERE id = ( \
    SELECT next FROM ( \
    SELECT t.ended, t.tenant, ( \
    SELECT j.id FROM jobs j WHERE j.state = 'queued' AND j.tenant = t.tenant \
    AND NOT EXISTS (SELECT 1 FROM jobs r WHERE r.state = 'running' AND r.system = j.system) \
    ORDER BY j.priority, j.turn, j.sequence LIMIT 1) AS next FROM tenants t) turns \
    WHERE next IS NOT NULL ORDER BY ended, tenant LIMIT 1) \
    AND EXISTS (SELECT 1 FROM workers w WHERE w.worker = $1) \
    AND NOT EXISTS (SELECT 1 FROM jobs r WHERE r.state = 'running' AND r.boot = $1 AND (r.attempt >= $3 OR \
    jobs.attempt + 1 >= $3)) \
    RETURNING *";

/// Waits for the claim before, on PostgreSQL.
const ONE_CLAIM_AT_A_TIME: &str = "SELECT value FROM counters WHERE name = 'claim' FOR UPDATE";

/// The turn of the tenant whose job was claimed is over.
const SERVED: &str = "UPDATE tenants SET started = MAX(ended, (SELECT MAX(started) FROM tenants)), \
    ended = 1 + MAX(ended, (SELECT MAX(started) FROM tenants)) \
    WHERE tenant = (SELECT tenant FROM jobs WHERE id = $1)";

/// Claims the next job of the tenant whose turn it is, and counts the attempt. Two jobs of one system never
/// run at once: both would be judged against the same incumbent. The last attempt of a job is made alone in
/// its process: the jobs that ran beside it when that went down were charged as well, and none may fail for
/// good because of another.
///
/// # Errors
/// Where the database fails.
pub async fn claim(store: &Store, boot: i64, now: Timestamp) -> Result<Option<JobRecord>, StoreError> {
    let mut tx = store.write_beside().await?;
    if store.is_shared() {
        // Claims follow one another, each seeing the one before, and wait for no disk: a claim that a crash
        // of the server takes back is of a job that waits again, and whoever has it ends it in vain.
        query(ONE_CLAIM_AT_A_TIME).execute(&mut *tx).await?;
        query("SET LOCAL synchronous_commit = off").execute(&mut *tx).await?;
    }
    let row: Option<Row> =
        query_as(CLAIM).bind(boot).bind(millis(now)).bind(MAX_ATTEMPTS).fetch_optional(&mut *tx).await?;
    let Some(row) = row else {
        tx.take_back().await?;
        return Ok(None);
    };
    let job = row.record()?;
    query(SERVED).bind(&job.id).execute(&mut *tx).await?;
    tx.commit().await?;
    Ok(Some(job))
}

/// Forgets tenants that have nothing to do, and no turn that would count against them when they are back.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn forget_tenants(store: &Store) -> Result<(), StoreError> {
    let sql = "DELETE FROM tenants WHERE ended <= (SELECT MAX(started) FROM tenants) \
        AND NOT EXISTS (SELECT 1 FROM jobs j WHERE j.state = 'queued' AND j.tenant = tenants.tenant) \
        AND NOT EXISTS (SELECT 1 FROM jobs j WHERE j.state = 'running' AND j.tenant = tenants.tenant)";
    let mut tx = store.write().await?;
    query(sql).execute(&mut *tx).await?;
    tx.commit().await
}

/// Gives a job back without charging the attempt, because the service stops and not the job.
///
/// # Errors
/// Where the database fails or the lease is lost.
pub(crate) async fn requeue(store: &Store, lease: &Lease, now: Timestamp) -> Result<(), StoreError> {
    let sql = "UPDATE jobs SET boot = NULL, attempt = attempt - 1, requeued = TRUE,
                   state = CASE WHEN cancelling THEN 'cancelled' ELSE 'queued' END,
                   ended_at = CASE WHEN cancelling THEN $4 ELSE NULL END
               WHERE id = $1 AND state = 'running' AND boot = $2 AND attempt = $3";
    let mut tx = store.write_beside().await?;
    let done = query(sql)
        .bind(&lease.job)
        .bind(lease.boot)
        .bind(lease.attempt)
        .bind(millis(now))
        .execute(&mut *tx)
        .await?;
    tx.commit().await?;
    if done == 1 { Ok(()) } else { Err(StoreError::LeaseLost) }
}

/// A statement on the running jobs of processes that are gone.
macro_rules! orphans {
    ($what:literal, $which:literal) => {
        concat!(
            $what,
            " WHERE state = 'running' AND NOT EXISTS (SELECT 1 FROM workers w WHERE w.worker = jobs.boot)",
            $which
        )
    };
}

/// Takes the rows of silent processes away, and puts every job of a process that is gone back into the queue,
/// or ends it where it has used up its attempts.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn recover(store: &Store, now: Timestamp) -> Result<Recovered, StoreError> {
    let mut tx = store.write().await?;
    if store.is_shared() {
        let sql = "DELETE FROM workers WHERE until < (SELECT ms FROM clock)";
        query(sql).execute(&mut *tx).await?;
    }
    let failure = JobFailure {
        code: "interrupted".into(),
        detail: format!("the service went down {MAX_ATTEMPTS} times while this job ran"),
        errors: Vec::new(),
    };
    query(orphans!("UPDATE jobs SET state = 'cancelled', boot = NULL, ended_at = $1", " AND cancelling"))
        .bind(millis(now))
        .execute(&mut *tx)
        .await?;
    let sql = orphans!(
        "UPDATE jobs SET state = 'failed', boot = NULL, error = $1, ended_at = $2",
        " AND attempt >= $3 RETURNING *"
    );
    let failed: Vec<Row> = query_as(sql)
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
    let sql = orphans!("UPDATE jobs SET state = 'queued', boot = NULL, requeued = TRUE", " RETURNING id");
    recovered.requeued = query_scalar(sql).fetch_all(&mut *tx).await?;
    failpoint::reached("in_recovery");
    tx.commit().await?;
    Ok(recovered)
}

/// The running jobs of a process that somebody has called off.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn cancelling(store: &Store, worker: i64) -> Result<Vec<String>, StoreError> {
    let sql = "SELECT id FROM jobs WHERE state = 'running' AND cancelling AND boot = $1";
    Ok(query_scalar(sql).bind(worker).fetch_all(&store.reader).await?)
}

/// Notes a job that failed outside of a worker's hands, if it counts.
async fn note_failed_job(tx: &mut Session, job: &JobRecord, now: Timestamp) -> Result<(), StoreError> {
    let system = job.system.to_string();
    let own: Option<String> = query_scalar("SELECT model FROM systems WHERE system = $1")
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
pub(crate) async fn cancel(store: &Store, id: &str, now: Timestamp) -> Result<Option<JobRecord>, StoreError> {
    let mut tx = store.write().await?;
    query("UPDATE jobs SET state = 'cancelled', ended_at = $2 WHERE id = $1 AND state = 'queued'")
        .bind(id)
        .bind(millis(now))
        .execute(&mut *tx)
        .await?;
    query("UPDATE jobs SET cancelling = TRUE WHERE id = $1 AND state = 'running'")
        .bind(id)
        .execute(&mut *tx)
        .await?;
    let row: Option<Row> =
        query_as("SELECT * FROM jobs WHERE id = $1").bind(id).fetch_optional(&mut *tx).await?;
    tx.commit().await?;
    row.map(Row::record).transpose()
}

#[cfg(test)]
mod tests {
    use super::CLAIM;
    use crate::store::schema::MIGRATIONS;
    use sqlx::sqlite::SqliteConnectOptions;
    use sqlx::{AssertSqlSafe, ConnectOptions, Row as _};

    #[tokio::test]
    async fn a_claim_reads_one_waiting_job_of_a_tenant_however_many_there_are() {
        let mut connection = SqliteConnectOptions::new().in_memory(true).connect().await.unwrap();
        MIGRATIONS.run_direct(None, &mut connection, false).await.unwrap();
        let explained = AssertSqlSafe(format!("EXPLAIN QUERY PLAN {CLAIM}"));
        let plan = sqlx::query(explained).fetch_all(&mut connection).await.unwrap();
        let plan: Vec<String> = plan.iter().map(|row| row.get("detail")).collect();
        let asked = |step: &str| plan.iter().any(|known| known.starts_with(step));
        assert!(asked("SEARCH j USING INDEX jobs_waiting (tenant=?)"), "{plan:#?}");
        assert!(asked("SCAN t USING COVERING INDEX tenants_in_turn"), "{plan:#?}");
        assert!(!plan.iter().any(|step| step.contains("TEMP B-TREE")), "{plan:#?}");
    }
}
