//! The system-identification step: a problem is asked, a search answers, a gate judges.
//!
//! ```text
//! request --problem--> Problem --run (search, likelihood, uncertainty)--> Fit --gate--> Verdict
//!                         |                                                |
//!                      segments                          assess: errors, comparisons, degradation
//! ```
//!
//! `problem` says what is asked and puts model and window together. `search` drives an optimiser through it,
//! `likelihood` does so where the stochastic model is estimated, `uncertainty` says how well the data
//! determine what was found (`decompose` takes its matrices apart), `discretisation` whether its step was
//! short enough, and `run` leads through all of it; `report` writes the document, which is a `fit`. `assess`
//! tells in numbers and sentences how good it is. `segments` lays a model along stretches of hours, which the
//! gate and a diagnosis ask, and `pooling` says what the systems of a building have in common. `gate` decides
//! what may be served, and `tune` chooses the settings of a search. No room imports one that stands after it
//! below.

pub(crate) mod decompose;

pub mod problem;

pub mod fit;

pub mod assess;

pub mod forecast;

pub mod search;

pub mod uncertainty;

mod discretisation;

mod report;

pub mod likelihood;

pub mod run;

pub mod segments;

pub mod pooling;

pub mod gate;

pub mod tune;

pub use assess::replay::Replay;
pub use fit::incumbent::Incumbent;
pub use fit::{Fit, Stop};
pub use gate::past::{GatePolicy, Past, Reference};
pub use gate::served::{Offer, ServedParameters};
pub use gate::validate::{Acceptance, Holding, Judgement, Verdict, validate};
pub use problem::Problem;
pub use problem::request::{EstimateRequest, Site, prepare};
pub use problem::stop::EarlyStopping;
pub use run::estimate;
pub use search::control::{Control, EstimateError, Progress, Trials};

pub use crate::interrupt::Interrupt;
