//! The system-identification step: a problem is asked, a search answers, a gate judges.
//!
//! `request` says what is wanted and `method` how it is searched, `problem` puts model and window together, `objective`
//! weighs the residuals, `run` drives the optimiser until it or `stop` says that it is over, `metrics` and `uncertainty`
//! describe what was found, `rules` look at it and `validate` decides, `served` is what may go out. Whether the inputs move the
//! room at all is asked by `hearing`, of `evidence` from `segments` and a `regression`, of `opponents` and of the `channels`. `replay` puts the
//! problem of a stored fit together again, `comparison` lays it beside the measurements and `compare` beside other fits,
//! `skill` puts both into numbers; `degradation` asks whether newer measurements contradict it. `tune` chooses settings of the search.

pub mod basis;
pub mod bounds;
mod case;
mod change;
pub mod channels;
pub mod check;
pub mod compare;
pub mod comparison;
pub mod control;
mod ctsm;
#[cfg(test)]
mod ctsm_tests;
mod curvature;
pub mod degradation;
mod discretisation;
mod drive;
pub mod evidence;
pub mod fit;
mod hearing;
#[cfg(test)]
mod hearing_tests;
pub mod incumbent;
pub mod levels;
pub mod likelihood;
pub mod likely;
mod limits;
pub mod method;
pub mod metrics;
pub mod objective;
pub mod opponents;
pub mod past;
pub mod peak;
pub mod physics;
pub mod preview;
pub mod problem;
pub mod ratio;
pub mod regression;
pub mod replay;
#[cfg(test)]
mod replay_tests;
mod report;
pub mod request;
pub mod ridge;
pub mod rules;
pub mod run;
pub mod segments;
pub mod served;
pub mod shooting;
pub mod skill;
pub mod stop;
pub mod summary;
pub mod table;
pub mod tune;
pub mod uncertainty;
pub mod validate;
pub mod whiten;

pub use control::{Control, EstimateError, Interrupt, Progress, Trials};
pub use fit::{Fit, Stop};
pub use incumbent::Incumbent;
pub use past::{Past, Policy, Reference};
pub use problem::Problem;
pub use replay::Replay;
pub use request::{EstimateRequest, Site, prepare};
pub use run::estimate;
pub use served::{Offer, ServedParameters};
pub use stop::EarlyStopping;
pub use validate::{Acceptance, Holding, Judgement, Verdict, validate};
