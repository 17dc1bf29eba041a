//! The caller's hands on a running search: how far it has come, whether it is to end, and why there is no
//! fit.

use crate::interrupt::Interrupt;
use crate::pace::Plan;
use indexmap::IndexMap;
use serde::Serialize;
use std::sync::Arc;
use utoipa::ToSchema;

/// The caller's hands on a running search. The core has no clock, so deadlines come from here.
pub struct Control<'a> {
    /// Asked before every batch, and in the middle of simulations. Whatever it once says it goes on to say.
    pub interrupt: &'a (dyn Fn() -> Option<Interrupt> + Sync),
    /// Told after every batch.
    pub progress: &'a (dyn Fn(&Progress) + Sync),
}

impl Control<'_> {
    /// Never interrupts, tells nobody.
    pub const NONE: Control<'static> = Control { interrupt: &|| None, progress: &|_| () };

    /// Whether the work is to end now.
    pub fn halts(&self) -> bool {
        (self.interrupt)().is_some()
    }
}

/// How far a search has come, or the diagnosis behind it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Progress {
    /// Generations or restarts completed.
    pub generation: usize,
    /// Simulations so far.
    pub evaluations: usize,
    /// Best cost so far.
    pub best_train: Option<f64>,
    /// Free-run RMSE of the best candidate on the validation part, as of the last look at it; of several
    /// outputs in the noise of their sensors.
    pub best_validation: Option<f64>,
    /// The best parameters so far, by name; another one with every improvement.
    pub incumbent: Option<Arc<IndexMap<String, f64>>>,
    /// The trials of a diagnosis, once its search is over.
    pub trials: Option<Trials>,
}

/// How far the trials of a diagnosis have come.
#[derive(Debug, Clone, PartialEq, Default, Serialize, ToSchema)]
pub struct Trials {
    /// The round, from 1 on; a round looks for one more effect. 0 while the model without any is brought to
    /// its optima.
    pub round: usize,
    /// Effects that have been tried in this round, or ruled out.
    pub tried: usize,
    /// Of so many.
    pub of: usize,
    /// The effect that gains most in this round so far.
    pub leader: Option<String>,
    /// What it gains in BIC.
    pub gain: Option<f64>,
    /// The error of the free run on unseen data with it, over that of the model without.
    pub fall: Option<f64>,
    /// The share of the time that has passed, as far as anything was measured; whoever has a clock says it.
    pub share: Option<f64>,
    /// What is done and what is left, for whoever has a clock.
    #[serde(skip)]
    pub plan: Plan,
}

/// Why there is no fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EstimateError {
    /// Every candidate diverged.
    NothingFinite,
    /// Stopped before a single candidate was evaluated, or cancelled: a cancelled search has no result.
    Interrupted(Interrupt),
}

impl std::fmt::Display for EstimateError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            EstimateError::NothingFinite => {
                "every candidate diverged: the model cannot follow these data inside its bounds"
            }
            EstimateError::Interrupted(Interrupt::Cancelled) => "the estimation was cancelled",
            EstimateError::Interrupted(Interrupt::Deadline) => {
                "the wall time was used up before anything was found"
            }
        })
    }
}

impl std::error::Error for EstimateError {}
