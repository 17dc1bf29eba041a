//! Reports of recalibrations.

use super::Shared;
use super::problem::{ApiError, Problems};
use crate::store;
use crate::store::batches::BatchRecord;
use crate::store::jobs::{JobState, Outcome};
use axum::extract::{Path, State};
use jiff::Timestamp;
use serde::Serialize;
use serde_json::Value;
use std::collections::BTreeMap;
use utoipa::ToSchema;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// The paths of this file.
pub fn router() -> OpenApiRouter<Shared> {
    OpenApiRouter::new().routes(routes!(get_batch))
}

/// A recalibration: who improved, who was refused and why, who was left out.
#[derive(Debug, Serialize, ToSchema)]
#[schema(as = Batch)]
pub struct BatchAnswer {
    id: String,
    /// `recalibrate`.
    kind: &'static str,
    /// The schedule that submitted it.
    schedule: Option<String>,
    /// Whether all jobs have ended.
    finished: bool,
    /// How many jobs stand how: states, and outcomes for those that succeeded.
    counts: BTreeMap<&'static str, usize>,
    /// What was asked.
    #[schema(value_type = Object)]
    request: Value,
    jobs: Vec<BatchRow>,
    /// Systems that were left out.
    skipped: Vec<store::batches::Skipped>,
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
}

/// One job of a batch.
#[derive(Debug, Serialize, ToSchema)]
struct BatchRow {
    job: String,
    system: String,
    state: JobState,
    outcome: Option<Outcome>,
    fit: Option<String>,
    /// The gate's sentence, or the reason of a failure.
    why: Option<String>,
}

impl BatchAnswer {
    /// A batch as it is shown.
    pub fn of(batch: BatchRecord) -> Self {
        let mut counts = BTreeMap::new();
        for job in &batch.jobs {
            *counts.entry(job.outcome.map_or(job.state.word(), Outcome::word)).or_insert(0) += 1;
        }
        let row = |job: store::batches::BatchJob| BatchRow {
            system: job.system.to_string(),
            why: job.summary.or(job.error.map(|error| error.detail)),
            job: job.job,
            state: job.state,
            outcome: job.outcome,
            fit: job.fit,
        };
        Self {
            kind: "recalibrate",
            finished: batch.jobs.iter().all(|job| job.state.is_final()),
            counts,
            jobs: batch.jobs.into_iter().map(row).collect(),
            id: batch.id,
            schedule: batch.schedule,
            request: batch.request,
            skipped: batch.skipped,
            created_at: batch.created_at,
        }
    }
}

/// One batch.
#[utoipa::path(get, path = "/batches/{id}", tag = "jobs", params(("id" = String, Path)), responses((status = 200, body = BatchAnswer), Problems))]
async fn get_batch(State(service): State<Shared>, Path(id): Path<String>) -> Result<axum::Json<BatchAnswer>, ApiError> {
    let batch = store::batches::get(&service.store, &id).await?.ok_or(ApiError::NotFound("batch", id))?;
    Ok(axum::Json(BatchAnswer::of(batch)))
}
