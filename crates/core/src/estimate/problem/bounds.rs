//! Whether a parameter sits on a bound of its search.

use crate::estimate::problem::Problem;
use crate::model::Scale;

/// A parameter this close to a bound, as a share of the interval on its scale, sits on it.
pub const AT_BOUND: f64 = 0.01;

/// Whether a parameter lies within one per cent of a bound, on its scale.
pub fn at_bound(problem: &Problem, theta: &[f64], index: usize) -> bool {
    let [lower, upper] = problem.bounds()[index];
    let unit = match problem.model().parameters()[index].scale {
        Scale::Linear => (theta[index] - lower) / (upper - lower),
        Scale::Log => (theta[index] / lower).ln() / (upper / lower).ln(),
    };
    !(AT_BOUND..=1.0 - AT_BOUND).contains(&unit)
}
