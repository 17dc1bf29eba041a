//! How long the searches of a diagnosis go on.

use crate::estimate::Problem;

/// Iterations of Levenberg and Marquardt's method, and when a run ends before.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    /// Of a null model: it must be no less converged than those that are compared with it.
    pub settle: usize,
    /// After which the ways from several starts are told apart.
    pub restart: usize,
    /// Of a candidate.
    pub refit: usize,
    /// A run ends after two iterations that lower the cost by less than this share.
    pub tolerance: f64,
}

impl Effort {
    /// What the last iterations would gain is little beside what the gates ask for: with a share of 1e-5,
    /// thousands of samples gain less than a tenth in BIC. A simulation of a large model takes a hundred
    /// times as long as one of a room; with a share of 1e-4 they gain less than one.
    pub fn of(problem: &Problem) -> Self {
        if problem.filters() {
            Self { settle: 60, restart: 15, refit: 30, tolerance: 1e-5 }
        } else {
            Self { settle: 16, restart: 5, refit: 10, tolerance: 1e-4 }
        }
    }
}
