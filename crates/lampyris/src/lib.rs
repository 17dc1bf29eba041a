//! Lampyris keeps grey-box models honest: measurements in, validated parameters out. This is the service
//! around [`lampyris_core`].
//!
//! # The map
//! | stage | turns | into |
//! |---|---|---|
//! | [`store`] | accepted fits | durable revisions |
//! | [`service`] | requests | running work on the CPU pool |
//! | [`http`] | all of it | the service |
//! | [`cli`] | words on the command line | all of it |
//!
//! [`app`] composes them, [`settings`] says how. Tests enforce who may import whom (`tests/layers.rs`), and
//! that nobody imports in circles (`tests/circles.rs`).

pub mod http;
pub mod service;
pub mod store;

pub mod app;
pub mod cli;
pub mod settings;
