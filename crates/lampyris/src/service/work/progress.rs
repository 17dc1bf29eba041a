//! How far a job has come, as watchers are told.

use lampyris_core::estimate::Trials;
use serde::Serialize;
use utoipa::ToSchema;

/// How far a job has come.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = Progress)]
pub struct ProgressReport {
    /// Generations or restarts completed.
    pub generation: usize,
    /// Simulations so far.
    pub evaluations: usize,
    /// Best cost on the training part.
    pub best_train: Option<f64>,
    /// Free-run error of the best candidate on the validation part, as of the last look at it.
    pub best_validation: Option<f64>,
    /// Seconds until the budget is used up at this pace; it may end sooner. Of a diagnosis and a ladder the
    /// seconds that are expected to be left, from what each of their stages has taken so far, once the
    /// model is fitted: right within a factor of two, mostly.
    pub eta_s: Option<f64>,
    /// Of a diagnosis and a ladder, once the model is fitted.
    pub trials: Option<Trials>,
}
