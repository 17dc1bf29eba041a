//! Which physical effect is a model missing?
//!
//! ```text
//! Problem, theta --fitted--> Null --screen--> scores --rank--> Round --findings--> Diagnosis
//!                              |                                 |
//!                       residual, failures                 up to three rounds
//! ```
//!
//! `candidates` compiles the catalogue into the model, `screen` scores it by one linearised simulation each, `refit`
//! and `fitted` bring null model and suspects to their optima, `rank` tries them all and `gates` decides, `failures` says
//! where a model fails, `evidence` lays the error beside an effect's shape, `ladder` adds effects one after another, `nested` by likelihood-ratio tests, and
//! `ledger` adds up what the windows of a system show. The method and its thresholds were measured on synthetic rooms; `lampyris bench diagnose` measures them again.

pub mod candidates;
mod effort;
pub mod evidence;
pub mod failures;
mod findings;
pub mod fitted;
mod gates;
pub mod ladder;
pub mod ledger;
#[cfg(test)]
mod ledger_tests;
pub mod nested;
pub mod rank;
mod refit;
pub mod regimes;
pub mod report;
pub mod residual;
mod score_test;
mod screen;
pub mod spectrum;
pub mod surrogates;
#[cfg(test)]
mod tests;

pub use findings::{DiagnoseError, diagnose, preview};
pub use report::{Adequacy, Diagnosis, Finding};
