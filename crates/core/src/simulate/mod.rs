//! (Model, inputs, parameter vectors) to trajectories, a block of candidates at a time.
//!
//! `stepper` writes one step as an expression graph, `model::tape` stages it, `drive` evaluates what all
//! candidates share, `lanes` evaluates the rest (by the interpreter of `opcode`), `trajectory` walks the
//! window and `run` says which way, `segment` walks stretches of it from states of their own, `kalman`
//! filters it (`walk` is a filter on its way), `predict` goes on from there and `linearise` gives the
//! matrices of every step (`flow`).
//!
//! Large stiff models are stepped explicitly: `rkc` takes one lane through its stages with the coefficients
//! of `chebyshev`, `vectors` does the arithmetic of all lanes, `block` gives lanes to candidates.
//!
//! `likelihood` filters with a diffusion per state and gives its slopes: `registers` evaluates a tape on
//! numbers that carry theirs (`dual`). `transition` is the exact step of a linear model, which both filters
//! take.

mod block;
mod chebyshev;
#[cfg(test)]
mod delay_tests;
pub mod drive;
mod dual;
mod flow;
pub mod kalman;
pub mod lane;
pub mod lanes;
pub mod likelihood;
#[cfg(test)]
mod likelihood_tests;
pub mod linearise;
#[cfg(test)]
mod linearise_tests;
mod opcode;
pub mod predict;
mod registers;
mod rkc;
#[cfg(test)]
mod rkc_tests;
mod run;
pub mod segment;
pub mod stepper;
pub mod trajectory;
mod transition;
mod vectors;
mod walk;

pub use crate::model::Stepper;
pub use drive::Inputs;
pub use lanes::LANES;
pub use segment::StepAlong;
pub use trajectory::{Simulator, Trajectory};

/// Longest internal step of the default stepper in hours: ten minutes, as measured for rooms.
pub const LONGEST_STEP_HOURS: f64 = 1.0 / 6.0;

/// How finely a stepper divides sample intervals of so many hours: sub-steps, or for rkc, which finds its own
/// steps, its tolerance.
pub fn substeps(stepper: Stepper, sample_hours: f64) -> usize {
    match stepper {
        Stepper::Rkc => 1,
        // The small allowance keeps an interval of exactly ten minutes at one step.
        Stepper::Ros2 | Stepper::Rk4 => ((sample_hours / LONGEST_STEP_HOURS - 1e-9).ceil() as usize).max(1),
    }
}
