//! Recalibrations and diagnoses of several systems: ordinary jobs under one name.

use super::database::Store;
use super::engine::Session;
use super::entering;
use super::entry::{NewJob, SubmitError};
use super::error::StoreError;
use super::idempotency::{Earlier, KeyState, RequestKey, look_up, remember};
use super::job::{JobFailure, JobStatus, Outcome};
use super::offers::waits;
use super::packed::decompress;
use super::reach::SystemScope;
use super::row::row;
use super::sequence::{derive_id, next};
use super::statement::{query, query_as, query_scalar};
use super::value::{from_json, from_word, instant, millis, parse, to_json};
use super::words::words;
use indexmap::IndexMap;
use jiff::Timestamp;
use lampyris_core::data::SystemId;
use lampyris_core::diagnose::Adequacy;
use lampyris_core::estimate::gate::check::Severity;
use lampyris_core::estimate::gate::served::ServedError;
use lampyris_core::estimate::gate::validate::NO_WORSE_THAN_INCUMBENT;
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use utoipa::ToSchema;

words! {
    /// What the jobs of a batch do.
    BatchKind {
        /// They estimate, and what is accepted is served.
        Recalibrate = "recalibrate",
        /// They look for what each model is missing.
        Diagnose = "diagnose",
    }
}

impl BatchKind {
    /// The one that documents need not name.
    pub const fn usual() -> Self {
        Self::Recalibrate
    }

    /// Whether documents need not name it.
    pub fn is_usual(&self) -> bool {
        *self == Self::usual()
    }
}

/// A system that was left out, with the reason.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[schema(as = SkippedSystem)]
pub struct Skipped {
    /// The system.
    pub system: SystemId,
    /// A sentence.
    pub why: String,
}

/// A batch to be submitted.
#[derive(Debug, Clone, PartialEq)]
pub struct NewBatch {
    /// What its jobs do.
    pub kind: BatchKind,
    /// The schedule that submits it.
    pub schedule: Option<String>,
    /// The request, JSON.
    pub request: String,
    /// One job per system.
    pub jobs: Vec<NewJob>,
    /// Systems that were left out.
    pub skipped: Vec<Skipped>,
}

/// A batch as it is kept, with where its jobs stand.
#[derive(Debug, Clone, PartialEq)]
pub struct BatchRecord {
    /// Its id.
    pub id: String,
    /// What its jobs do.
    pub kind: BatchKind,
    /// The schedule that submitted it.
    pub schedule: Option<String>,
    /// The request.
    pub request: serde_json::Value,
    /// Systems that were left out.
    pub skipped: Vec<Skipped>,
    /// When.
    pub created_at: Timestamp,
    /// Whether jobs of it are still on their way into the queue.
    pub entering: bool,
    /// Its jobs, in the order of submission.
    pub jobs: Vec<BatchMember>,
}

/// A job of a batch.
#[derive(Debug, Clone, PartialEq)]
pub struct BatchMember {
    /// Its id.
    pub job: String,
    /// The system.
    pub system: SystemId,
    /// Where it stands.
    pub state: JobStatus,
    /// What it led to.
    pub outcome: Option<Outcome>,
    /// What it found.
    pub fit: Option<String>,
    /// Whether that waits for an operator.
    pub waits: bool,
    /// The sentence of the diagnosis where there is one, otherwise the gate's about the fit.
    pub summary: Option<String>,
    /// Its forecast error over that of the parameters that were served before, on the same unseen data;
    /// `None` where there were none to compare with.
    pub error_ratio: Option<f64>,
    /// Why it failed.
    pub error: Option<JobFailure>,
    /// What it diagnosed.
    pub diagnosis: Option<BatchDiagnosis>,
    /// The model that was fitted.
    pub model: String,
    /// The revision that it has made.
    pub revision: Option<i64>,
    /// The errors of that revision by output, as they were let out.
    pub served_error: Option<IndexMap<String, ServedError>>,
    /// The check that held back its fit, or refused it.
    pub stopped: Option<FailedCheck>,
}

/// A check that a fit has failed.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FailedCheck {
    /// The rule, `G4 beats persistence`.
    pub rule: String,
    /// Why, in a sentence.
    pub comment: String,
}

/// What a diagnosis of a batch comes to.
#[derive(Debug, Clone, PartialEq)]
pub struct BatchDiagnosis {
    /// Its id.
    pub id: String,
    /// The verdict.
    pub verdict: Adequacy,
    /// The effects that it names, the most telling first.
    pub named: Vec<String>,
}

/// What became of a batch that was submitted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum SubmittedBatch {
    /// It is new; its id.
    New(String),
    /// The same request came before.
    Earlier(Earlier),
}

row! {
    struct Row {
        id: String,
        kind: String,
        schedule: Option<String>,
        request: String,
        skipped: String,
        created_at: i64,
        entering: bool,
    }
}

row! {
    struct JobRow {
        id: String,
        system: String,
        state: String,
        outcome: Option<String>,
        fit: Option<String>,
        waits: bool,
        summary: Option<String>,
        checks: Option<Vec<u8>>,
        error: Option<String>,
        diagnosis: Option<String>,
        verdict: Option<String>,
        said: Option<String>,
        findings: Option<String>,
        model: String,
        revision: Option<i64>,
        served_error: Option<String>,
    }
}

/// What is read of a finding of a diagnosis.
#[derive(Deserialize)]
struct Finding {
    effect: String,
    way_of: Option<String>,
}

/// What is read of a check of a fit.
#[derive(Deserialize)]
struct Check {
    name: String,
    statistic: Option<f64>,
    pass: bool,
    severity: Severity,
    comment: String,
}

/// What a fit errs beside the one that was served.
fn error_ratio(checks: &[Check]) -> Option<f64> {
    checks.iter().find(|check| check.name == NO_WORSE_THAN_INCUMBENT)?.statistic
}

/// What kept a fit from being served: a refusal comes before a hold.
fn stopped(checks: &[Check]) -> Option<FailedCheck> {
    let failed = |severity| checks.iter().find(|check| !check.pass && check.severity == severity);
    let check = failed(Severity::Reject).or_else(|| failed(Severity::Hold))?;
    Some(FailedCheck { rule: check.name.clone(), comment: check.comment.clone() })
}

impl JobRow {
    fn record(self) -> Result<BatchMember, StoreError> {
        let read = |((id, verdict), findings): ((String, String), String)| {
            let findings: Vec<Finding> = from_json("the findings of a diagnosis", &findings)?;
            let named = findings.into_iter().map(|found| found.way_of.unwrap_or(found.effect)).collect();
            Ok::<_, StoreError>(BatchDiagnosis { id, verdict: from_word("a verdict", &verdict)?, named })
        };
        let checks: Vec<Check> = match &self.checks {
            Some(checks) => decompress("checks", checks)?,
            None => Vec::new(),
        };
        let errors = |text: &str| from_json("the errors of a revision", text);
        let diagnosis = self.diagnosis.zip(self.verdict).zip(self.findings).map(read).transpose()?;
        Ok(BatchMember {
            system: parse("a system", &self.system)?,
            state: parse("a state", &self.state)?,
            outcome: self.outcome.as_deref().map(|word| parse("an outcome", word)).transpose()?,
            error: self.error.as_deref().map(|text| from_json("a failure", text)).transpose()?,
            job: self.id,
            fit: self.fit,
            waits: self.waits,
            summary: self.said.or(self.summary),
            error_ratio: error_ratio(&checks),
            stopped: stopped(&checks),
            model: self.model,
            revision: self.revision,
            served_error: self.served_error.as_deref().map(errors).transpose()?,
            diagnosis,
        })
    }
}

/// Submits a batch with all its jobs.
///
/// # Errors
/// Where the queue cannot take them all, the key belongs to another request, or the database fails.
pub async fn submit(
    store: &Store,
    new: &NewBatch,
    key: Option<&RequestKey>,
    limit: i64,
    now: Timestamp,
) -> Result<SubmittedBatch, SubmitError> {
    let waiting = entering::packed(&new.jobs)?;
    let mut tx = store.write().await?;
    match look_up(&mut tx, key).await? {
        KeyState::Reused => return Err(SubmitError::KeyReused),
        KeyState::Seen(earlier) => return Ok(SubmittedBatch::Earlier(earlier)),
        KeyState::Fresh => {}
    }
    let id = submit_in_batch(&mut tx, new, waiting.as_deref(), limit, now).await?;
    remember(&mut tx, key, &id, 202, now).await?;
    tx.commit().await?;
    if waiting.is_some() {
        entering::go_on(store, &id, &new.jobs, now).await?;
    }
    Ok(SubmittedBatch::New(id))
}

/// Submits a batch inside a transaction; `waiting` are its jobs where they are more than that can take.
pub(super) async fn submit_in_batch(
    tx: &mut Session,
    new: &NewBatch,
    waiting: Option<&[u8]>,
    limit: i64,
    now: Timestamp,
) -> Result<String, SubmitError> {
    let sequence = next(tx, "sequence").await?;
    let id = derive_id("bat", sequence, now);
    let sql = "INSERT INTO batches (id, sequence, kind, schedule, request, skipped, created_at, waiting) VALUES \
        ($1, $2, $3, $4, $5, $6, $7, $8)";
    query(sql)
        .bind(&id)
        .bind(sequence)
        .bind(new.kind.as_str())
        .bind(&new.schedule)
        .bind(&new.request)
        .bind(to_json("skipped systems", &new.skipped)?)
        .bind(millis(now))
        .bind(waiting)
        .execute(&mut *tx)
        .await?;
    entering::begin(tx, &id, &new.jobs, limit, now).await?;
    Ok(id)
}

/// Those of some jobs, by their places, of which an equal one has succeeded since measurements of its system
/// came or went, and its settings changed.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn answered(store: &Store, jobs: &[NewJob]) -> Result<HashSet<usize>, StoreError> {
    let asked: Vec<(usize, String, String)> = jobs
        .iter()
        .enumerate()
        .map(|(place, job)| (place, job.system.to_string(), job.fingerprint()))
        .collect();
    let sql = "WITH asked AS (SELECT CAST(json_extract(value, '$[0]') AS BIGINT) AS place, \
        json_extract(value, '$[1]') AS system, json_extract(value, '$[2]') AS fingerprint \
        FROM json_each($1)) SELECT a.place FROM asked a WHERE EXISTS \
        (SELECT 1 FROM jobs j WHERE j.system = a.system AND j.state = 'succeeded' \
        AND j.fingerprint = a.fingerprint \
        AND j.started_at > (SELECT MAX(uploaded_at) FROM windows WHERE system = a.system) \
        AND j.started_at > (SELECT updated_at FROM systems WHERE system = a.system) \
        AND j.started_at > COALESCE((SELECT MAX(at) FROM audit WHERE system = a.system AND action = \
        'delete_window'), 0))";
    let places: Vec<i64> = query_scalar(sql).bind(to_json("jobs", &asked)?).fetch_all(&store.reader).await?;
    Ok(places.into_iter().filter_map(|place| usize::try_from(place).ok()).collect())
}

/// Whether a batch has jobs that have not ended.
pub(super) async fn is_unfinished(tx: &mut Session, id: &str) -> Result<bool, StoreError> {
    let sql = "SELECT EXISTS (SELECT 1 FROM batches WHERE id = $1 AND waiting IS NOT NULL) OR EXISTS (SELECT 1 FROM \
        batch_jobs b JOIN jobs j ON j.id = b.job WHERE b.batch = $1 AND j.state IN ('queued', 'running'))";
    Ok(query_scalar(sql).bind(id).fetch_one(tx).await?)
}

/// What a batch was asked for.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn request(store: &Store, id: &str) -> Result<Option<serde_json::Value>, StoreError> {
    let text: Option<String> = query_scalar("SELECT request FROM batches WHERE id = $1")
        .bind(id)
        .fetch_optional(&store.reader)
        .await?;
    text.map(|text| from_json("a request", &text)).transpose()
}

/// One batch.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn get(store: &Store, id: &str) -> Result<Option<BatchRecord>, StoreError> {
    let sql = "SELECT id, kind, schedule, request, skipped, created_at, waiting IS NOT NULL AS entering FROM batches \
        WHERE id = $1";
    let Some(row) = query_as::<Row>(sql).bind(id).fetch_optional(&store.reader).await? else {
        return Ok(None);
    };
    let sql = concat!(
        "SELECT j.id, j.system, j.state, j.outcome, j.fit, f.summary, j.error, j.diagnosis, \
        f.checks, d.verdict, json_extract(d.document, '$.summary') AS said, \
        json_extract(d.document, '$.findings') AS findings, j.model, j.revision, \
        json_extract(r.served, '$.error') AS served_error, ",
        waits!("j.fit"),
        " AS waits FROM batch_jobs b JOIN jobs j ON j.id = b.job LEFT JOIN fits f ON f.id = j.fit LEFT JOIN diagnoses d \
        ON d.id = j.diagnosis LEFT JOIN revisions r ON r.system = j.system AND r.revision = j.revision \
        WHERE b.batch = $1 ORDER BY j.sequence"
    );
    let jobs: Vec<JobRow> = query_as(sql).bind(id).fetch_all(&store.reader).await?;
    Ok(Some(BatchRecord {
        kind: parse("a kind", &row.kind)?,
        id: row.id,
        schedule: row.schedule,
        request: from_json("a request", &row.request)?,
        skipped: from_json("skipped systems", &row.skipped)?,
        created_at: instant(row.created_at)?,
        entering: row.entering,
        jobs: jobs.into_iter().map(JobRow::record).collect::<Result<_, _>>()?,
    }))
}

/// The batches of schedules that some jobs belong to and that have ended.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn ended_with(store: &Store, jobs: &[String]) -> Result<Vec<String>, StoreError> {
    let sql = "SELECT b.id FROM batches b WHERE b.id IN (SELECT batch FROM batch_jobs WHERE job IN \
        (SELECT value FROM json_each($1))) AND b.schedule IS NOT NULL AND b.waiting IS NULL AND NOT EXISTS \
        (SELECT 1 FROM batch_jobs o JOIN jobs j ON j.id = o.job WHERE o.batch = b.id \
        AND j.state IN ('queued', 'running')) ORDER BY b.sequence";
    Ok(query_scalar(sql).bind(to_json("jobs", jobs)?).fetch_all(&store.reader).await?)
}

/// The batches of schedules that were submitted from one instant to before another, in their order.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn of_schedules(
    store: &Store,
    from: Timestamp,
    to: Timestamp,
) -> Result<Vec<String>, StoreError> {
    let sql = "SELECT id FROM batches WHERE schedule IS NOT NULL AND created_at >= $1 AND created_at < $2 \
        ORDER BY sequence";
    Ok(query_scalar(sql).bind(millis(from)).bind(millis(to)).fetch_all(&store.reader).await?)
}

/// Batches submitted before a sequence number, of schedules alone or all, newest first, without their jobs,
/// of which every system that they may select lies within a reach: one page of a list.
///
/// # Errors
/// Where the database fails.
pub(crate) async fn page(
    store: &Store,
    reach: &SystemScope,
    scheduled: bool,
    before: i64,
    limit: i64,
) -> Result<Vec<BatchSummary>, StoreError> {
    // The jobs of what is on the page are counted, and of nothing else.
    let sql = "SELECT b.id, b.sequence, b.kind, b.schedule, b.created_at, \
        (SELECT COUNT(*) FROM batch_jobs l WHERE l.batch = b.id) AS jobs, \
        (SELECT COUNT(*) FROM batch_jobs l JOIN jobs j ON j.id = l.job WHERE l.batch = b.id \
        AND j.state IN ('queued', 'running')) + CASE WHEN b.waiting IS NULL THEN 0 ELSE 1 END AS unfinished \
        FROM batches b WHERE b.sequence < $1 AND ($4 = FALSE OR b.schedule IS NOT NULL) \
        AND ($3 IS NULL OR NOT EXISTS (SELECT 1 FROM json_each(b.request, '$.systems') \
        asked \
        WHERE NOT EXISTS (SELECT 1 FROM json_each($3) pattern WHERE glob(pattern.value, asked.value)))) \
        ORDER BY b.sequence DESC LIMIT $2";
    let rows: Vec<SummaryRow> = query_as(sql)
        .bind(before)
        .bind(limit)
        .bind(reach.sql()?)
        .bind(scheduled)
        .fetch_all(&store.reader)
        .await?;
    rows.into_iter().map(SummaryRow::record).collect()
}

/// A batch as it is listed.
#[derive(Debug, Clone, PartialEq)]
pub struct BatchSummary {
    /// Its id.
    pub id: String,
    /// The order of submission.
    pub sequence: i64,
    /// What its jobs do.
    pub kind: BatchKind,
    /// The schedule that submitted it.
    pub schedule: Option<String>,
    /// When.
    pub created_at: Timestamp,
    /// How many jobs it has.
    pub jobs: i64,
    /// How many of them have not ended, and one while others are on their way into the queue.
    pub unfinished: i64,
}

row! {
    struct SummaryRow {
        id: String,
        sequence: i64,
        kind: String,
        schedule: Option<String>,
        created_at: i64,
        jobs: i64,
        unfinished: i64,
    }
}

impl SummaryRow {
    fn record(self) -> Result<BatchSummary, StoreError> {
        Ok(BatchSummary {
            created_at: instant(self.created_at)?,
            kind: parse("a kind", &self.kind)?,
            id: self.id,
            sequence: self.sequence,
            schedule: self.schedule,
            jobs: self.jobs,
            unfinished: self.unfinished,
        })
    }
}
