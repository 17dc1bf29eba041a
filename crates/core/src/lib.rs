//! Grey-box models, from their documents to validated parameters and to what they are missing. Pure: no
//! async, no IO, no clock, no randomness of the system.
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
//!
//! [`cpu`], [`gram`], [`units`], [`fault`], [`schema`], [`interrupt`] and [`pace`] are leaves that every
//! stage may use.
//!
//! # The invariants
//! 1. A [`data::Window`] exists only through parsing, a [`model::Model`] only through compiling.
//! 2. [`optimise::Cost`] is finite or diverged; no NaN can win.
//! 3. The same seed gives the same bits on any number of threads.
//! 4. Only [`estimate::validate()`] makes an [`estimate::Acceptance`], and only an acceptance can be served.
//!
//! # An example
//! A room whose truth is known, with a leak that its model does not know: fitted, judged, and asked what is
//! missing.
//! ```
//! use lampyris_core::data::{ColumnBindings, SplitRequest, Window};
//! use lampyris_core::diagnose::diagnose;
//! use lampyris_core::estimate::problem::request::{AccusationRate, EstimateRequest, Site, prepare};
//! use lampyris_core::estimate::{Control, GatePolicy, Past, estimate, validate};
//! use lampyris_core::model::Catalogue;
//! use lampyris_core::twin::{Level, WorldRequest, world};
//!
//! let world = world(&WorldRequest::new(3, &["wind_infiltration"], Level::Matched)).unwrap();
//! let (window, _) = Window::parse_csv(&world.csv, &ColumnBindings::none()).unwrap();
//! let site = Site { sets: [("neighbours".to_owned(), world.neighbours)].into(), ..Site::default() };
//! let request = EstimateRequest { split: SplitRequest::DIAGNOSE, ..EstimateRequest::default() };
//!
//! let catalogue = Catalogue::builtin().unwrap();
//! let problem = prepare(&catalogue, &"room3".parse().unwrap(), &request, &window, &site).unwrap();
//! let fit = estimate(&problem, &request, None, &Control::NONE).unwrap();
//! let judgement = validate(&problem, &fit, &Past::default(), &GatePolicy::default());
//! println!("{}", judgement.summary);
//!
//! let rate = AccusationRate::default();
//! let theta = fit.theta();
//! let missing = diagnose(&catalogue, &problem, &theta, &window, &site, rate, &[], &Control::NONE).unwrap();
//! assert_eq!(missing.findings[0].named(), "wind_infiltration");
//! ```

pub mod cpu;
pub mod fault;
pub mod gram;
pub mod interrupt;
pub mod pace;
pub mod schema;
pub mod units;

pub mod data;
pub mod diagnose;
pub mod estimate;
pub mod model;
pub mod optimise;
pub mod simulate;
pub mod twin;
