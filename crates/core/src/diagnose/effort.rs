//! How long the searches of a diagnosis go on.

use crate::estimate::Problem;
use crate::estimate::problem::predictor::Predictor;

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
    /// The largest cost of the free run to which a restart from the nominal values has come, over the null
    /// model's, at which it goes on for as many iterations again.
    pub goes_on: f64,
    /// Parts of the linearised step, of which the one that costs least is the start.
    pub parts: &'static [f64],
    /// Whether the free run goes on from its own best start and from that of the innovations, or only from
    /// the better of the two.
    pub two_ways: bool,
    /// Whether a candidate that has shown nothing after the first part of its way goes on all the same where
    /// nobody leads clearly.
    pub patient: bool,
}

impl Effort {
    /// What the last iterations would gain is little beside what the gates ask for: with a share of 1e-5,
    /// thousands of samples gain less than a tenth in BIC. A simulation of a large model takes a hundred
    /// times as long as one of a room; with a share of 1e-4 they gain less than one.
    pub fn of(problem: &Problem) -> Self {
        match problem.predictor() {
            Predictor::Filtered => Self {
                settle: 60,
                restart: 15,
                refit: 30,
                tolerance: 1e-5,
                // The way from the nominal values is long.
                goes_on: 2.0,
                parts: &[1.0],
                // The free run has more local optima than the innovations, whose way to theirs shows it a
                // way out of its own.
                two_ways: true,
                patient: false,
            },
            Predictor::FreeRun => Self {
                settle: 16,
                restart: 5,
                refit: 10,
                tolerance: 1e-4,
                // A restart has to have come to the null model's cost.
                goes_on: 1.0,
                // A whole step of what is far from linear can lead so far astray that the few iterations such
                // a model can afford do not find back.
                parts: &[1.0, 0.3, 0.1],
                two_ways: false,
                // Those few show little after a fifth of them.
                patient: true,
            },
        }
    }
}
