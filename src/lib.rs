//! Lampyris keeps grey-box models honest: measurements in, validated parameters out.
//!
//! # The map
//! Folders are the stages that data pass, in order; every boundary is a change of type.
//!
//! | stage | turns | into |
//! |---|---|---|
//! | [`model`] | documents (TOML, JSON) | [`model::Model`], and a staged tape |
//! | [`data`] | CSV and JSON measurements | [`data::Window`], [`data::Grid`] |
//! | [`simulate`] | a model, inputs, parameter vectors | trajectories, filtered states |
//! | [`optimise`] | answers to candidates | better candidates |
//! | [`estimate`] | a [`estimate::Problem`] | a [`estimate::Fit`] and a [`estimate::Verdict`] |
//! | [`diagnose`] | a problem and its fit | a [`diagnose::Diagnosis`]: what the model is missing |
//! | [`twin`] | a seed | a synthetic room with a known truth |
//! | [`store`] | accepted fits | durable revisions |
//! | [`jobs`] | requests | running work on the CPU pool |
//! | [`http`] | all of it | the service |
//!
//! `units`, `fault` and `schema` are leaves that every stage may use; [`app`] and the command line see everything.
//!
//! # The invariants
//! 1. A [`data::Window`] exists only through parsing, a [`model::Model`] only through compiling.
//! 2. [`optimise::Cost`] is finite or diverged; no NaN can win.
//! 3. The same seed gives the same bits on any number of threads.
//! 4. Only [`estimate::validate()`] makes an [`estimate::Acceptance`], and only an acceptance can be served.
//! 5. Up to `estimate` and `twin` the code is pure: no async, no IO, no clock, no randomness of the system.
//!
//! Tests enforce who may import whom (`tests/layers.rs`).

pub mod fault;
mod schema;
pub mod units;

pub mod data;
pub mod diagnose;
pub mod estimate;
pub mod model;
pub mod optimise;
pub mod simulate;
pub mod twin;

pub mod http;
pub mod jobs;
pub mod store;

pub mod app;
pub mod settings;
