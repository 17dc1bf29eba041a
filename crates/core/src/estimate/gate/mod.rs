//! The gate between a fit and the controller.
//!
//! ```text
//! Fit, Past, Policy --context--> ValidationContext --rules: change, physics, hearing--> Table --validate--> Verdict --served--> ServedParameters
//!                              |
//!                  evidence: segments, regression, opponents; channels
//! ```
//!
//! A rule looks at a context and writes `check`s into a table; it knows no other rule, and none decides.
//! `limits` says what so many kelvin are for an output in another unit. `hearing` asks whether the inputs
//! move the room at all. Only `validate` makes an `Acceptance`.

mod change;
pub mod channels;
pub mod check;
mod context;
pub mod evidence;
mod hearing;
#[cfg(test)]
mod hearing_tests;
mod limits;
pub mod opponents;
pub mod past;
pub mod physics;
pub mod regression;
pub mod rules;
pub mod served;
pub mod table;
pub mod validate;
