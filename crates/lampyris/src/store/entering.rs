//! Batches of very many jobs on their way into the queue: some jobs by each transaction, so that nobody waits
//! for all of them, and whoever comes next goes on where a process has died.

use super::database::Store;
use super::engine::Session;
use super::entry::{NewJob, SubmitError, enter, require_room};
use super::error::StoreError;
use super::failpoint;
use super::job::{JobKind, Origin, Priority};
use super::packed::{compress, decompress};
use super::statement::{query, query_as, query_scalar};
use super::value::{corrupt, to_json};
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::model::ModelId;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

/// Jobs that one transaction takes in.
const AT_ONCE: usize = 2000;

/// The jobs of a batch as they are kept until all wait. Most of a night ask for the same.
#[derive(Serialize, Deserialize)]
struct Waiting {
    requests: Vec<Arc<str>>,
    jobs: Vec<WaitingJob>,
}

#[derive(Serialize, Deserialize)]
struct WaitingJob(JobKind, SystemId, ModelId, usize, bool, Origin, Priority);

/// The jobs of a batch that one transaction cannot take in, packed; `None` where it can.
pub(super) fn packed(jobs: &[NewJob]) -> Result<Option<Vec<u8>>, StoreError> {
    if jobs.len() <= AT_ONCE {
        return Ok(None);
    }
    let mut places: HashMap<Arc<str>, usize> = HashMap::new();
    let mut waiting = Waiting { requests: Vec::new(), jobs: Vec::with_capacity(jobs.len()) };
    for job in jobs {
        let place = *places.entry(job.request.clone()).or_insert_with(|| {
            waiting.requests.push(job.request.clone());
            waiting.requests.len() - 1
        });
        let (system, model) = (job.system.clone(), job.model.clone());
        waiting.jobs.push(WaitingJob(
            job.kind,
            system,
            model,
            place,
            job.experiment,
            job.origin,
            job.priority,
        ));
    }
    compress("jobs that wait", &waiting).map(Some)
}

fn unpacked(waiting: &[u8]) -> Result<Vec<NewJob>, StoreError> {
    let Waiting { requests, jobs } = decompress("jobs that wait", waiting)?;
    let job = |WaitingJob(kind, system, model, place, experiment, origin, priority)| {
        let request =
            requests.get(place).ok_or_else(|| corrupt("a job that waits", &"it asks for nothing"))?;
        Ok(NewJob { kind, system, model, request: request.clone(), experiment, origin, priority })
    };
    jobs.into_iter().map(job).collect()
}

/// Takes the first jobs of a new batch in, within its transaction: all of them, unless they are very many.
pub(super) async fn begin(
    tx: &mut Session,
    batch: &str,
    jobs: &[NewJob],
    limit: i64,
    now: Timestamp,
) -> Result<(), SubmitError> {
    if jobs.len() > AT_ONCE {
        require_room(tx, jobs.len() as i64, limit).await?;
    }
    some(tx, batch, jobs, 0, limit, now).await
}

/// Takes the next jobs of a batch in.
async fn some(
    tx: &mut Session,
    batch: &str,
    jobs: &[NewJob],
    from: usize,
    limit: i64,
    now: Timestamp,
) -> Result<(), SubmitError> {
    let to = jobs.len().min(from + AT_ONCE);
    let mut next = Cow::Borrowed(&jobs[from.min(to)..to]);
    if from > 0 {
        // Somebody may have deleted a system meanwhile.
        let names: Vec<String> = next.iter().map(|job| job.system.to_string()).collect();
        let sql = "SELECT system FROM systems WHERE system IN (SELECT value FROM json_each($1))";
        let there: Vec<String> =
            query_scalar(sql).bind(to_json("systems", &names)?).fetch_all(&mut *tx).await?;
        let there: HashSet<String> = there.into_iter().collect();
        if names.iter().any(|name| !there.contains(name)) {
            next.to_mut().retain(|job| there.contains(&job.system.to_string()));
        }
    }
    // An equal job that waits already belongs to this batch, too.
    let entered = enter(tx, &next, limit, now).await?;
    let ids: Vec<String> = entered.into_iter().map(|job| job.id).collect();
    let sql = "INSERT INTO batch_jobs (batch, job) SELECT $1, value FROM json_each($2) WHERE true ON CONFLICT DO \
        NOTHING";
    query(sql).bind(batch).bind(to_json("jobs", &ids)?).execute(&mut *tx).await?;
    let sql = "UPDATE batches SET entered = $2, waiting = CASE WHEN $3 = 1 THEN NULL ELSE waiting END WHERE id = $1";
    let is_last = to == jobs.len();
    query(sql).bind(batch).bind(to as i64).bind(i64::from(is_last)).execute(&mut *tx).await?;
    // With an old picture of the queue a server looks for the next job ten times as long: it is made anew now
    // and then while the queue grows.
    let parts = (to / AT_ONCE) as u64;
    if to >= AT_ONCE && tx.is_postgres() && (is_last || parts.is_power_of_two()) {
        query("ANALYZE jobs").execute(tx).await?;
    }
    Ok(())
}

/// Takes in what is left of a batch.
///
/// # Errors
/// Where the database fails; somebody goes on then.
pub(super) async fn go_on(
    store: &Store,
    batch: &str,
    jobs: &[NewJob],
    now: Timestamp,
) -> Result<(), SubmitError> {
    loop {
        let mut tx = store.write().await?;
        let sql = "SELECT entered FROM batches WHERE id = $1 AND waiting IS NOT NULL";
        let entered: Option<i64> = query_scalar(sql).bind(batch).fetch_optional(&mut *tx).await?;
        let Some(entered) = entered.and_then(|entered| usize::try_from(entered).ok()) else {
            tx.take_back().await?;
            return Ok(());
        };
        // There was room for all of them when the first came.
        some(&mut tx, batch, jobs, entered, i64::MAX, now).await?;
        failpoint::reached("in_entering");
        tx.commit().await?;
    }
}

/// Goes on with batches that somebody has begun and not ended; says with how many.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn go_on_with_all(store: &Store, now: Timestamp) -> Result<usize, SubmitError> {
    let sql = "SELECT id, waiting FROM batches WHERE waiting IS NOT NULL ORDER BY sequence";
    let begun: Vec<(String, Vec<u8>)> = query_as(sql).fetch_all(&store.reader).await?;
    for (batch, waiting) in &begun {
        go_on(store, batch, &unpacked(waiting)?, now).await?;
    }
    Ok(begun.len())
}
