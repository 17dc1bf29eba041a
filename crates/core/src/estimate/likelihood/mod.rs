//! Maximum likelihood of the stochastic model.
//!
//! ```text
//! Problem --objective--> LikelihoodObjective --ctsm--> optimum --curvature--> standard errors, profiles, ridges
//! ```
//!
//! `ml_estimate` is the optimum of one problem from a known place, `ratio` tests nested models against each
//! other.

mod ctsm;
#[cfg(test)]
mod ctsm_tests;
mod curvature;
pub mod ml_estimate;
pub mod objective;
pub mod ratio;

pub(in crate::estimate) use ctsm::estimate;
