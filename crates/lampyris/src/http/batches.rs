//! Reports of recalibrations and of diagnoses of several systems.

use super::access::Caller;
use super::extract::Asked;
use super::page::{Page, PageQuery};
use super::problem::{ApiError, Problems};
use super::shared::Shared;
use crate::service::Service;
use crate::service::serving::body::Status;
use crate::store;
use crate::store::batches::{BatchKind, BatchMember, BatchRecord, BatchSummary};
use crate::store::jobs::{JobStatus, Outcome};
use axum::extract::{Path, State};
use jiff::Timestamp;
use lampyris_core::diagnose::Adequacy;
use serde::Serialize;
use serde_json::Value;
use std::cmp::Reverse;
use std::collections::BTreeMap;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(list_batches)).routes(routes!(get_batch))
}

/// A recalibration: who improved, who was refused and why, who was left out. Or diagnoses: what is missing,
/// and where.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Batch)]
pub struct BatchAnswer {
    id: String,
    /// What its jobs do.
    kind: BatchKind,
    /// The schedule that submitted it.
    schedule: Option<String>,
    /// Whether all jobs have ended.
    finished: bool,
    /// How many jobs stand how: states, outcomes of estimates that succeeded, and verdicts of diagnoses.
    counts: BTreeMap<&'static str, usize>,
    /// The report in a sentence.
    #[schema(example = "of 3 systems 2 have new parameters, 1 had their fit refused")]
    summary: String,
    /// Systems that have new parameters now.
    improved: Vec<String>,
    /// Systems whose fit was refused or whose job failed, with the reason.
    rejected: Vec<Refusal>,
    /// Systems of which newer measurements contradict what they serve.
    degraded: Vec<String>,
    /// What the diagnoses came to; `null` where nothing was diagnosed.
    diagnosed: Option<Diagnosed>,
    /// What was asked.
    #[schema(value_type = Object)]
    request: Value,
    jobs: Vec<BatchRow>,
    /// Systems that were left out.
    skipped: Vec<store::batches::Skipped>,
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
}

/// What diagnoses of several systems came to, so far. Those that failed stand among the refused.
#[derive(Debug, Serialize, ToSchema)]
struct Diagnosed {
    /// Effects that are missing, the one that most systems lack first.
    named: Vec<NamedEffect>,
    /// Systems whose model explains the data down to their noise.
    adequate: Vec<String>,
    /// Systems that lack something that no effect explains.
    unknown: Vec<String>,
    /// Systems whose record is too short to tell.
    not_enough_data: Vec<String>,
}

/// An effect, and who lacks it.
#[derive(Debug, Serialize, ToSchema)]
struct NamedEffect {
    effect: String,
    systems: Vec<String>,
}

/// One batch in a list.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = BatchSummary)]
pub(super) struct BatchListRow {
    id: String,
    /// What its jobs do.
    kind: BatchKind,
    /// The schedule that submitted it.
    schedule: Option<String>,
    /// How many jobs it has.
    jobs: i64,
    /// Whether all of them have ended.
    finished: bool,
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
}

impl From<BatchSummary> for BatchListRow {
    fn from(record: BatchSummary) -> Self {
        Self {
            id: record.id,
            kind: record.kind,
            schedule: record.schedule,
            jobs: record.jobs,
            finished: record.unfinished == 0,
            created_at: record.created_at,
        }
    }
}

/// A system that keeps what it had, and why.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = RefusedSystem)]
struct Refusal {
    system: String,
    why: String,
}

/// One job of a batch.
#[derive(Debug, Serialize, ToSchema)]
struct BatchRow {
    job: String,
    system: String,
    state: JobStatus,
    outcome: Option<Outcome>,
    fit: Option<String>,
    /// What it diagnosed.
    diagnosis: Option<String>,
    /// What the diagnosis comes to.
    verdict: Option<Adequacy>,
    /// The sentence of the diagnosis or of the gate, or the reason of a failure.
    why: Option<String>,
    /// The forecast error over that of the parameters before, on the same unseen data: below 1 is better.
    /// `null` where there were none.
    error_ratio: Option<f64>,
}

impl BatchAnswer {
    /// A batch as it is shown.
    pub fn of(service: &Service, batch: BatchRecord) -> Self {
        let mut counts = BTreeMap::new();
        for job in &batch.jobs {
            *counts.entry(standing(job)).or_insert(0) += 1;
        }
        let systems = |wanted: &dyn Fn(&BatchMember) -> bool| -> Vec<String> {
            batch.jobs.iter().filter(|job| wanted(job)).map(|job| job.system.to_string()).collect()
        };
        let is_degraded = |job: &BatchMember| {
            let entry = service.params.entry(&job.system.to_string());
            entry.is_some_and(|entry| {
                entry.validated().is_some_and(|served| served.status == Status::Degraded)
            })
        };
        let improved = systems(&|job| job.outcome == Some(Outcome::Accepted));
        let degraded = systems(&is_degraded);
        let refused =
            |job: &&BatchMember| job.outcome == Some(Outcome::Rejected) || job.state == JobStatus::Failed;
        let why =
            |job: &BatchMember| job.summary.clone().or(job.error.as_ref().map(|error| error.detail.clone()));
        let refusal =
            |job: &BatchMember| Refusal { system: job.system.to_string(), why: why(job).unwrap_or_default() };
        let rejected: Vec<Refusal> = batch.jobs.iter().filter(refused).map(refusal).collect();
        let diagnosed = (batch.kind == BatchKind::Diagnose).then(|| Diagnosed::of(&batch.jobs));
        let named = diagnosed.as_ref().map(Diagnosed::names).unwrap_or_default();
        let summary = sentence(batch.kind, &counts, &named, batch.jobs.len(), batch.skipped.len());
        let row = |job: BatchMember| BatchRow {
            system: job.system.to_string(),
            why: why(&job),
            error_ratio: job.error_ratio,
            job: job.job,
            state: job.state,
            outcome: job.outcome,
            fit: job.fit,
            verdict: job.diagnosis.as_ref().map(|found| found.verdict),
            diagnosis: job.diagnosis.map(|found| found.id),
        };
        Self {
            kind: batch.kind,
            finished: !batch.entering && batch.jobs.iter().all(|job| job.state.is_final()),
            counts,
            summary,
            improved,
            rejected,
            degraded,
            diagnosed,
            jobs: batch.jobs.into_iter().map(row).collect(),
            id: batch.id,
            schedule: batch.schedule,
            request: batch.request,
            skipped: batch.skipped,
            created_at: batch.created_at,
        }
    }
}

impl Diagnosed {
    fn of(jobs: &[BatchMember]) -> Self {
        let found = || jobs.iter().filter_map(|job| Some((job.system.to_string(), job.diagnosis.as_ref()?)));
        let with = |verdict: Adequacy| {
            found().filter(|(_, one)| one.verdict == verdict).map(|(system, _)| system).collect()
        };
        let mut named: BTreeMap<&str, Vec<String>> = BTreeMap::new();
        for (system, one) in found() {
            for effect in &one.named {
                named.entry(effect).or_default().push(system.clone());
            }
        }
        let mut named: Vec<NamedEffect> = named
            .into_iter()
            .map(|(effect, systems)| NamedEffect { effect: effect.to_owned(), systems })
            .collect();
        named.sort_by_key(|one| Reverse(one.systems.len()));
        Self {
            named,
            adequate: with(Adequacy::Adequate),
            unknown: with(Adequacy::Unknown),
            not_enough_data: with(Adequacy::NotEnoughData),
        }
    }

    /// The effects that were named, and how often.
    fn names(&self) -> String {
        let names: Vec<String> =
            self.named.iter().map(|one| format!("{} {}", one.effect, one.systems.len())).collect();
        if names.is_empty() { String::new() } else { format!(" ({})", names.join(", ")) }
    }
}

/// Where a job stands, in a word: a diagnosis by what it comes to.
fn standing(job: &BatchMember) -> &'static str {
    let found = job.diagnosis.as_ref().map(|found| found.verdict.as_str());
    found.unwrap_or_else(|| job.outcome.map_or(job.state.as_str(), Outcome::as_str))
}

/// The report in words. `named` is what diagnoses have named.
fn sentence(
    kind: BatchKind,
    counts: &BTreeMap<&'static str, usize>,
    named: &str,
    jobs: usize,
    skipped: usize,
) -> String {
    let [failed, running] = match kind {
        BatchKind::Recalibrate => ["got no fit", "are being fitted"],
        BatchKind::Diagnose => ["got no diagnosis", "are being diagnosed"],
    };
    let lack = format!("lack something that has a name{named}");
    let known = [
        (Adequacy::Named.as_str(), lack.as_str()),
        (Adequacy::Unknown.as_str(), "lack something that no effect explains"),
        (Adequacy::Adequate.as_str(), "lack nothing"),
        (Adequacy::NotEnoughData.as_str(), "have too few data to tell"),
        (Outcome::Accepted.as_str(), "have new parameters"),
        (Outcome::Unchanged.as_str(), "were good already"),
        (Outcome::Suggested.as_str(), "have a fit that waits for an operator's word"),
        (Outcome::Held.as_str(), "have a fit that the gate holds"),
        (Outcome::Rejected.as_str(), "had their fit refused"),
        (JobStatus::Failed.as_str(), failed),
        (JobStatus::Cancelled.as_str(), "were called off"),
        (JobStatus::Running.as_str(), running),
        (JobStatus::Queued.as_str(), "wait"),
    ];
    let parts: Vec<String> = known
        .iter()
        .filter_map(|(word, text)| counts.get(word).map(|count| format!("{count} {text}")))
        .collect();
    let left_out = if skipped == 0 { String::new() } else { format!("; {skipped} left out") };
    format!(
        "of {jobs} systems {}{left_out}",
        if parts.is_empty() { "none was selected".to_owned() } else { parts.join(", ") }
    )
}

/// Batches, newest first.
#[utoipa::path(
    get,
    path = "/batches",
    tag = "jobs",
    params(PageQuery),
    responses((status = 200, body = Page<BatchListRow>), Problems)
)]
async fn list_batches(
    State(service): State<Shared>,
    caller: Caller,
    Asked(page): Asked<PageQuery>,
) -> Result<axum::Json<Page<BatchListRow>>, ApiError> {
    let size = page.size()?;
    let records =
        store::batches::page(&service.store, caller.reach(), false, page.before()?, size + 1).await?;
    Ok(axum::Json(Page::of(records, size, |record| record.sequence.to_string(), BatchListRow::from)))
}

/// One batch.
#[utoipa::path(
    get,
    path = "/batches/{id}",
    tag = "jobs",
    params(("id" = String, Path)),
    responses((status = 200, body = BatchAnswer), Problems)
)]
async fn get_batch(
    State(service): State<Shared>,
    Path(id): Path<String>,
) -> Result<axum::Json<BatchAnswer>, ApiError> {
    let batch = store::batches::get(&service.store, &id).await?.ok_or(ApiError::NotFound("batch", id))?;
    Ok(axum::Json(BatchAnswer::of(&service, batch)))
}
