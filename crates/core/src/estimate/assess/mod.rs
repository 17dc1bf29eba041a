//! How good a fit is, and where it fails.
//!
//! ```text
//! Fit --metrics--> errors of a free run, ahead, noise floor          (what every fit reports)
//! Fit --replay--> Replay --comparison, compare--> series              (beside the measurements, beside other fits)
//!                    +-----skill, summary--> numbers and sentences
//! Fit, Window --regimes--> in which circumstances it fails most
//! served, newer measurements --degradation--> still true?
//!                            --live--> the states, sample by sample
//! ```
//!
//! `preview` simulates a model before there is a fit at all.

pub mod compare;
pub mod comparison;
pub mod degradation;
pub mod live;
pub mod metrics;
pub mod preview;
pub mod regimes;
pub mod replay;
#[cfg(test)]
mod replay_tests;
pub mod skill;
pub mod summary;
