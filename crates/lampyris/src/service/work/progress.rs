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
    /// Seconds until the budget is used up at this pace; it may end sooner. Of a diagnosis the seconds that
    /// its trials will take, once its model is fitted.
    pub eta_s: Option<f64>,
    /// Of a diagnosis, once its model is fitted.
    pub trials: Option<Trials>,
}
