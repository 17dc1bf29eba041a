//! (Model, inputs, parameter vectors) to trajectories, a block of candidates at a time.
//!
//! `stepper` writes one step as an expression graph, `model::tape` stages it, `drive` evaluates what all
//! candidates share, `lanes` evaluates the rest, `trajectory` walks the window, `kalman` filters it.
//!
//! `likelihood` filters with a diffusion per state and gives its slopes: `registers` evaluates a tape on numbers that carry
//! theirs (`dual`), `transition` is the exact step of a linear model.

#[cfg(test)]
mod delay_tests;
pub mod drive;
mod dual;
pub mod kalman;
pub mod lanes;
pub mod likelihood;
#[cfg(test)]
mod likelihood_tests;
mod registers;
pub mod stepper;
pub mod trajectory;
mod transition;

pub use drive::Inputs;
pub use lanes::LANES;
pub use stepper::Stepper;
pub use trajectory::{Simulator, Trajectory};

/// Longest internal step of the default stepper in hours: ten minutes, as measured for rooms.
pub const LONGEST_STEP_HOURS: f64 = 1.0 / 6.0;

/// Sub-steps per sample interval of so many hours.
pub fn substeps(sample_hours: f64) -> usize {
    // The small allowance keeps an interval of exactly ten minutes at one step.
    ((sample_hours / LONGEST_STEP_HOURS - 1e-9).ceil() as usize).max(1)
}
