//! The surface, against a service in this process.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

mod database;
mod faults;
mod hostile;
mod jobs;
mod models;
mod params;
mod schedules;
mod straight;
#[path = "../support/mod.rs"]
mod support;
