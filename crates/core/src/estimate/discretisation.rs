//! Whether the step of a simulation is short enough.

use crate::estimate::problem::Problem;
use crate::estimate::uncertainty::sensitivity::Sensitivity;
use crate::estimate::uncertainty::{shift, simulations};
use crate::model::Stepper;

/// Largest discretisation error in the noise of a sensor before the step is halved: 0.02 K for a thermometer
/// of 0.05 K.
const DISCRETISATION_LIMIT: f64 = 0.4;

/// How far the difference may move an estimate, in its standard deviations: many samples determine a
/// parameter better than the noise of one. Half of the step has a quarter of the error, so that what is left
/// is a third of this at most.
const SHIFT_LIMIT: f64 = 0.25;

/// As fine as the tolerance of a stepper gets that finds its own steps: each doubling divides it by ten.
const FINEST_TOLERANCE: usize = 2;

/// What half the step, or a tenth of the tolerance, changes.
pub(super) struct StepError {
    /// The same problem with it.
    pub finer: Problem,
    /// The largest difference that it makes, in the unit of the output; of several outputs in the noise of
    /// their sensors.
    pub difference: f64,
    /// Whether the step is short enough, or as short as a step gets.
    pub fine_enough: bool,
    /// What the outputs answer with the problem's own step, where that was asked for.
    pub sensitivity: Option<Sensitivity>,
    /// Simulations spent.
    pub evaluations: usize,
}

/// Compares with half the step, or a tenth of the tolerance.
pub(super) fn step_error(problem: &Problem, theta: &[f64]) -> StepError {
    let finer = problem.with_substeps(2 * problem.simulator().substeps());
    let (coarse, fine) = rayon::join(|| problem.simulate(theta), || finer.simulate(theta));
    let difference = problem.farthest_apart(&coarse, &fine);
    let finest = if problem.model().stepper() == Stepper::Rkc { FINEST_TOLERANCE } else { 64 };
    let mut evaluations = 2;
    let small = difference <= DISCRETISATION_LIMIT * problem.scaled_noise();
    let is_finest = problem.simulator().substeps() >= finest;
    let sensitivity = (small && !is_finest)
        .then(|| {
            evaluations += simulations(problem);
            Sensitivity::new(problem, theta)
        })
        .flatten();
    let shift = sensitivity.as_ref().and_then(|sensitivity| shift(problem, theta, sensitivity, &fine));
    let fine_enough = is_finest || small && shift.is_none_or(|shift| shift <= SHIFT_LIMIT);
    StepError { finer, difference, fine_enough, sensitivity, evaluations }
}
