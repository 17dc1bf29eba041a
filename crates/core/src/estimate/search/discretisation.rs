//! Whether the step of a simulation is short enough.

use crate::estimate::problem::Problem;
use crate::model::Stepper;

/// Largest discretisation error in the noise of a sensor before the step is halved: 0.02 K for a thermometer
/// of 0.05 K.
const DISCRETISATION_LIMIT: f64 = 0.4;

/// As fine as the tolerance of a stepper gets that finds its own steps: each doubling divides it by ten.
const FINEST_TOLERANCE: usize = 2;

/// The same problem with half the step, or a tenth of the tolerance, and the largest difference that it
/// makes, in the unit of the output; of several outputs in the noise of their sensors.
pub(in crate::estimate) fn step_error(problem: &Problem, theta: &[f64]) -> (Problem, f64) {
    let finer = problem.with_substeps(2 * problem.simulator().substeps());
    let (coarse, fine) = (problem.simulate(theta), finer.simulate(theta));
    // A difference that is not a number is as large as can be.
    let largest = |worst: f64, d: f64| if d.is_nan() { f64::INFINITY } else { worst.max(d) };
    let of_output = |(output, (coarse, fine)): (usize, (&Vec<f64>, &Vec<f64>))| {
        coarse.iter().zip(fine).map(|(a, b)| (a - b).abs()).fold(0.0, largest) / problem.scale(output)
    };
    let difference = coarse.outputs.iter().zip(&fine.outputs).enumerate().map(of_output).fold(0.0, largest);
    (finer, difference)
}

/// Whether a step is short enough, or as short as a step gets.
pub(in crate::estimate) fn fine_enough(problem: &Problem, difference: f64) -> bool {
    let finest = if problem.model().stepper() == Stepper::Rkc { FINEST_TOLERANCE } else { 64 };
    difference <= DISCRETISATION_LIMIT * problem.scaled_noise() || problem.simulator().substeps() >= finest
}
