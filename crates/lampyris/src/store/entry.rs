//! How jobs enter the queue, one or a hundred thousand: a few statements for all of them.

use super::engine::Session;
use super::error::StoreError;
use super::job::{JobKind, Origin, Priority};
use super::sequence::{derive_id, next_of};
use super::statement::{query, query_as, query_scalar};
use super::value::{millis, to_json};
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::model::ModelId;
use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

/// Jobs that one statement writes.
const AT_ONCE: usize = 500;

/// A job to be submitted.
#[derive(Debug, Clone, PartialEq)]
pub struct NewJob {
    /// What it does.
    pub kind: JobKind,
    /// To which system.
    pub system: SystemId,
    /// With which model.
    pub model: ModelId,
    /// The request with all defaults filled in, JSON. Most jobs of a night have the same.
    pub request: Arc<str>,
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

/// A job that waits now.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Entered {
    /// Its id.
    pub id: String,
    /// Whether it is new; otherwise an equal one waited already.
    pub is_new: bool,
}

/// A job that is to wait, with its place.
struct Place<'a> {
    job: &'a NewJob,
    fingerprint: &'a str,
    id: String,
    sequence: i64,
    turn: i64,
}

/// Takes jobs into the queue inside a transaction, all or none, and says what waits for each, in their order.
/// An equal job that waits is moved up where the new one is more urgent.
pub(super) async fn enter(
    tx: &mut Session,
    jobs: &[NewJob],
    limit: i64,
    now: Timestamp,
) -> Result<Vec<Entered>, SubmitError> {
    let fingerprints: Vec<String> = jobs.iter().map(NewJob::fingerprint).collect();
    let mut waiting = waiting(tx, &fingerprints).await?;
    let tenants = tenants(tx, jobs).await?;
    let mut turns = Turns::read(tx, jobs, &tenants).await?;
    let new = fingerprints.iter().filter(|fingerprint| !waiting.contains_key(*fingerprint)).count() as i64;
    require_room(tx, new, limit).await?;
    let mut sequence = next_of(tx, "sequence", new).await?;
    let (mut entered, mut places) = (Vec::with_capacity(jobs.len()), Vec::new());
    for (job, fingerprint) in jobs.iter().zip(&fingerprints) {
        if let Some((id, rank)) = waiting.get_mut(fingerprint) {
            if job.priority.rank() < *rank {
                *rank = job.priority.rank();
                query("UPDATE jobs SET priority = $2, turn = $3 WHERE id = $1")
                    .bind(id.as_str())
                    .bind(*rank)
                    .bind(turns.take(job, tenants.of(&job.system)))
                    .execute(&mut *tx)
                    .await?;
            }
            entered.push(Entered { id: id.clone(), is_new: false });
            continue;
        }
        let id = derive_id("job", sequence, now);
        waiting.insert(fingerprint.clone(), (id.clone(), job.priority.rank()));
        entered.push(Entered { id: id.clone(), is_new: true });
        places.push(Place { job, fingerprint, id, sequence, turn: turns.take(job, tenants.of(&job.system)) });
        sequence += 1;
    }
    for places in places.chunks(AT_ONCE) {
        insert(tx, places, &tenants, now).await?;
    }
    Ok(entered)
}

/// Refuses jobs that are more than the queue takes.
pub(super) async fn require_room(tx: &mut Session, new: i64, limit: i64) -> Result<(), SubmitError> {
    let queued: i64 = query_scalar("SELECT COUNT(*) FROM jobs WHERE state = 'queued'").fetch_one(tx).await?;
    if new > 0 && queued + new > limit {
        return Err(SubmitError::QueueFull(format!("{limit} jobs wait already")));
    }
    Ok(())
}

/// Writes the rows of a list. Most of a night ask for the same, which is sent once.
const INSERT: &str = "INSERT INTO jobs (id, sequence, kind, system, model, fingerprint, experiment, origin, \
    priority, turn, tenant, request, state, created_at) \
    SELECT json_extract(value, '$[0]'), CAST(json_extract(value, '$[1]') AS BIGINT), \
    json_extract(value, '$[2]'), json_extract(value, '$[3]'), json_extract(value, '$[4]'), \
    json_extract(value, '$[5]'), CAST(json_extract(value, '$[6]') AS BIGINT) = 1, \
    json_extract(value, '$[7]'), CAST(json_extract(value, '$[8]') AS BIGINT), \
    CAST(json_extract(value, '$[9]') AS BIGINT), json_extract(value, '$[10]'), \
    COALESCE($3, json_extract(value, '$[11]')), 'queued', $2 FROM json_each($1)";

async fn insert(
    tx: &mut Session,
    places: &[Place<'_>],
    tenants: &Tenants,
    now: Timestamp,
) -> Result<(), StoreError> {
    let same = places.first().map(|first| &first.job.request);
    let same = same.filter(|request| places.iter().all(|place| place.job.request == **request));
    let row = |place: &Place<'_>| {
        let Place { job, fingerprint, id, sequence, turn } = place;
        serde_json::json!([
            id,
            sequence,
            job.kind.as_str(),
            job.system,
            job.model.to_string(),
            fingerprint,
            i64::from(job.experiment),
            job.origin.as_str(),
            job.priority.rank(),
            turn,
            tenants.of(&job.system),
            if same.is_some() { None } else { Some(&*job.request) },
        ])
    };
    let rows: Vec<serde_json::Value> = places.iter().map(row).collect();
    let same = same.map(|request| &**request);
    query(INSERT).bind(to_json("jobs", &rows)?).bind(millis(now)).bind(same).execute(tx).await?;
    Ok(())
}

/// The equal jobs that wait, by their fingerprint, with their id and their rank.
async fn waiting(
    tx: &mut Session,
    fingerprints: &[String],
) -> Result<HashMap<String, (String, i64)>, StoreError> {
    let sql = "SELECT fingerprint, id, priority FROM jobs WHERE state = 'queued' AND NOT requeued AND \
        fingerprint IN (SELECT value FROM json_each($1))";
    let rows: Vec<(String, String, i64)> =
        query_as(sql).bind(to_json("fingerprints", fingerprints)?).fetch_all(tx).await?;
    Ok(rows.into_iter().map(|(fingerprint, id, rank)| (fingerprint, (id, rank))).collect())
}

/// Whose the systems of some jobs are.
struct Tenants(HashMap<String, String>);

impl Tenants {
    fn of(&self, system: &SystemId) -> &str {
        self.0.get(&system.to_string()).map_or("", String::as_str)
    }
}

/// Reads them, and has each take turns from now on.
async fn tenants(tx: &mut Session, jobs: &[NewJob]) -> Result<Tenants, StoreError> {
    let systems: Vec<String> = jobs.iter().map(|job| job.system.to_string()).collect();
    let sql = "SELECT system, tenant FROM systems WHERE system IN (SELECT value FROM json_each($1))";
    let rows: Vec<(String, String)> =
        query_as(sql).bind(to_json("systems", &systems)?).fetch_all(&mut *tx).await?;
    let names: BTreeSet<&String> = rows.iter().map(|(_, tenant)| tenant).collect();
    for name in names {
        query("INSERT INTO tenants (tenant, started, ended) VALUES ($1, 0, 0) ON CONFLICT DO NOTHING")
            .bind(name)
            .execute(&mut *tx)
            .await?;
    }
    Ok(Tenants(rows.into_iter().collect()))
}

/// The places in the queue of a tenant: behind the system's own jobs, but not before the round that is being
/// served. A system with one job thus waits for one job of every other system, however many those have.
struct Turns {
    /// The first free turn, by system and rank.
    free: HashMap<(String, i64), i64>,
    /// The round that is being served, by tenant and rank.
    rounds: HashMap<(String, i64), i64>,
}

impl Turns {
    async fn read(tx: &mut Session, jobs: &[NewJob], tenants: &Tenants) -> Result<Self, StoreError> {
        let systems: Vec<String> = jobs.iter().map(|job| job.system.to_string()).collect();
        let sql = "SELECT system, priority, MAX(turn) FROM jobs WHERE state = 'queued' AND system IN (SELECT \
            value FROM json_each($1)) GROUP BY system, priority";
        let own: Vec<(String, i64, i64)> =
            query_as(sql).bind(to_json("systems", &systems)?).fetch_all(&mut *tx).await?;
        let free = own.into_iter().map(|(system, rank, turn)| ((system, rank), turn + 1)).collect();
        let mut rounds: HashMap<(String, i64), i64> = HashMap::new();
        for job in jobs {
            let (tenant, rank) = (tenants.of(&job.system), job.priority.rank());
            if rounds.contains_key(&(tenant.to_owned(), rank)) {
                continue;
            }
            let sql = "SELECT MIN(turn) FROM jobs WHERE state = 'queued' AND tenant = $1 AND priority = $2";
            let round: Option<i64> = query_scalar(sql).bind(tenant).bind(rank).fetch_one(&mut *tx).await?;
            rounds.insert((tenant.to_owned(), rank), round.unwrap_or(0));
        }
        Ok(Self { free, rounds })
    }

    fn take(&mut self, job: &NewJob, tenant: &str) -> i64 {
        let rank = job.priority.rank();
        let round = self.rounds.get(&(tenant.to_owned(), rank)).copied().unwrap_or(0);
        let free = self.free.entry((job.system.to_string(), rank)).or_insert(0);
        let turn = (*free).max(round);
        *free = turn + 1;
        turn
    }
}
