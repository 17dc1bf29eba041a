//! The report of a night, as it is told.

use crate::service::serving::body::Status;
use crate::store::batches::BatchKind;
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;

/// What a night has come to.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct NightReport {
    /// The day on the clock of the service, or the batch that was asked for.
    pub night: String,
    /// When the first batch was submitted.
    #[schema(value_type = String, format = DateTime)]
    pub at: Timestamp,
    /// Whether all jobs have ended.
    pub finished: bool,
    /// What was done.
    pub batches: Vec<NightBatch>,
    /// The report in a sentence.
    pub summary: String,
    /// Systems that serve new parameters.
    pub changed: Vec<ChangedSystem>,
    /// Systems whose parameters were good already.
    pub confirmed: Vec<String>,
    /// Fits that are not served and jobs that failed, by reason, the most frequent first.
    pub refused: Vec<RefusalGroup>,
    /// Systems that were left out, by reason.
    pub skipped: Vec<SkippedGroup>,
    /// What is not to be relied on now: degraded systems, then stale ones.
    pub doubtful: Vec<DoubtfulSystem>,
    /// What to do, the most valuable first: what misleads a controller now, then what saves most.
    pub next: Vec<NightStep>,
}

/// A batch of a night.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct NightBatch {
    /// Its id.
    pub batch: String,
    /// What its jobs do.
    pub kind: BatchKind,
    /// The schedule that submitted it.
    pub schedule: Option<String>,
    /// How many jobs it has.
    pub jobs: usize,
    /// When it was submitted.
    #[schema(value_type = String, format = DateTime)]
    pub created_at: Timestamp,
}

/// A system that serves new parameters.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ChangedSystem {
    /// The system.
    pub system: String,
    /// The model that was fitted.
    pub model: String,
    /// The revision that the night has made.
    pub revision: Option<i64>,
    /// The fit behind it.
    pub fit: Option<String>,
    /// The horizon of the errors.
    #[schema(example = "PT6H")]
    pub horizon: Option<String>,
    /// The unit of the errors, of the first output.
    pub unit: Option<String>,
    /// The error of forecasts by the parameters before, on the same unseen data; `null` where there were
    /// none.
    pub before: Option<f64>,
    /// The same by the new ones.
    pub after: Option<f64>,
}

/// Systems that keep what they had, for one reason.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct RefusalGroup {
    /// The rule of the gate, or the code of a failure.
    #[schema(example = "G9 heating")]
    pub rule: String,
    /// `rejected` for good, `held` for an operator, or `failed` without a fit.
    #[schema(value_type = String, example = "held")]
    pub outcome: &'static str,
    /// Who.
    pub systems: Vec<String>,
    /// The reason of the first of them, in a sentence.
    pub why: String,
}

/// Systems that were left out, for one reason.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct SkippedGroup {
    /// A sentence.
    pub why: String,
    /// Who.
    pub systems: Vec<String>,
}

/// A system whose parameters are not to be relied on now.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct DoubtfulSystem {
    /// The system.
    pub system: String,
    /// `degraded` or `stale`.
    pub status: Status,
    /// Since when it is stale.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub since: Option<Timestamp>,
    /// The newest measurement; `null` where there is none.
    #[schema(value_type = Option<String>, format = DateTime)]
    pub measured_to: Option<Timestamp>,
    /// Whether its measurements have stopped.
    pub lost: bool,
    /// In a sentence.
    pub why: String,
}

/// Something worth doing.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct NightStep {
    /// What to do, in a sentence.
    pub what: String,
    /// Whom it is about.
    pub systems: Vec<String>,
    /// Where on the page, as a path of this service.
    #[schema(example = "/ui/building?effect=wind_infiltration")]
    pub link: String,
}
