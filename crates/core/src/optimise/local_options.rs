//! The settings of the local stage.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The settings of a local run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LocalOptions {
    /// Levenberg-Marquardt: most iterations of a run.
    pub iterations: usize,
    /// Levenberg-Marquardt: length of the forward differences in the unit cube.
    pub step: f64,
    /// Levenberg-Marquardt: a run ends after two successive iterations that lower the cost by less than this
    /// share, or where none of them lowers it and stronger dampings promise next to nothing.
    pub tolerance: f64,
    /// Levenberg-Marquardt: damping of the first iteration, relative to the largest squared norm of a column.
    pub damping: f64,
    /// Levenberg-Marquardt: damping values tried side by side in an iteration.
    pub trials: usize,
    /// Levenberg-Marquardt: the factor between neighbouring damping values.
    pub spread: f64,
    /// Levenberg-Marquardt: of two runs closer than this in every coordinate only the better one goes on.
    pub merge: f64,
    /// What descends where there are only costs.
    pub on_costs: LocalMethod,
    /// On costs: length of the first steps in the unit cube.
    pub radius: f64,
    /// On costs: length of the last ones, which is the accuracy of the optimum.
    pub radius_end: f64,
    /// On costs: most evaluations of a run.
    pub evaluations: usize,
}

impl LocalOptions {
    /// The same, with forward differences that are not shorter than this.
    #[must_use]
    pub fn with_least_step(self, least: f64) -> Self {
        Self { step: self.step.max(least), ..self }
    }
}

impl Default for LocalOptions {
    fn default() -> Self {
        Self {
            iterations: 200,
            step: 1e-6,
            tolerance: 1e-4,
            damping: 1e-2,
            trials: 4,
            spread: 2.0,
            merge: 1e-3,
            on_costs: LocalMethod::Bobyqa,
            radius: 0.05,
            radius_end: 1e-9,
            evaluations: 20_000,
        }
    }
}

/// A local search that needs costs only.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum LocalMethod {
    /// Powell's trust region with interpolated quadratic models.
    #[default]
    Bobyqa,
    /// Nelder and Mead's simplex.
    NelderMead,
    /// Hooke and Jeeves's pattern search.
    Pattern,
}
