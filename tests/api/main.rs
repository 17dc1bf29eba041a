//! The surface, against a service in this process.

mod faults;
mod jobs;
mod models;
mod params;
mod schedules;
mod straight;
#[path = "../support/mod.rs"]
mod support;
