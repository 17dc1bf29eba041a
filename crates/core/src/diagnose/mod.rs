//! Which physical effect is a model missing?
//!
//! ```text
//! Problem, theta --null_model--> NullModel --screen, surrogates--> scores --selection--> Round --findings--> Diagnosis
//!                                    |                                                     |
//!                             residual, failures                                  up to three rounds
//! ```
//!
//! `library` compiles the catalogue into the model. `screen` scores a candidate by one linearised simulation,
//! `score_test` along segments of hours and `surrogates` with its channels shifted by days. `refit` and
//! `null_model` bring null model and candidates to their optima, `chosen` says who is refitted, `selection`
//! tries them all and `acceptance` decides, `ways` says by which way heat comes that is missing and `naming`
//! writes the finding; `course` tells how far that has come, `size`
//! how large a finding is. `present` asks whether a window still shows what the model has already, `ledger`
//! adds up what the windows of a system show, `failures` says where a model fails, `unexplained` what is left
//! by hour of the day, `missing_heat` what flows unseen at every hour, `proposals` which term of what was
//! measured explains it, `change` since when a parameter is another one, `evidence` lays the error beside an
//! effect's shape, `ladder` adds effects one after another, `nested` by likelihood-ratio tests. `experiment`
//! plans which inputs to drive so that more is known. `lampyris bench diagnose`, `real`, `missing-heat`,
//! `proposals`, `change` and `experiments` measure all of it, on synthetic rooms and real ones.

mod acceptance;
pub mod change;
mod chosen;
pub mod course;
mod effort;
mod error;
pub mod evidence;
pub mod experiment;
pub mod failures;
mod findings;
pub mod ladder;
pub mod ledger;
#[cfg(test)]
mod ledger_tests;
pub mod library;
pub mod missing_heat;
mod naming;
pub mod nested;
pub mod null_model;
mod present;
pub mod proposals;
mod refit;
pub mod report;
pub mod residual;
mod score_test;
mod screen;
pub mod selection;
mod size;
pub mod spectrum;
pub mod surrogates;
#[cfg(test)]
mod tests;
mod unexplained;
mod ways;

pub use error::DiagnoseError;
pub use findings::{ADEQUATE_RHO, diagnose, preview};
pub use report::{Adequacy, Diagnosis, Finding};
