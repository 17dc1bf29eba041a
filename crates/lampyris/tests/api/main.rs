//! The surface, against a service in this process.
#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

mod audit;
mod book;
mod change;
mod compare;
mod comparison;
mod conventions;
mod database;
mod diagnose_batches;
mod diagnoses;
mod events;
mod evidence;
mod export;
mod fast;
mod faults;
mod fits;
mod forecast;
mod forecast_inputs;
mod hostile;
mod influx;
mod jobs;
mod language;
mod layout;
mod likelihood;
mod limits;
mod lines;
mod models;
mod operators;
mod params;
mod plants;
mod preview;
mod retention;
mod samples;
mod schedules;
mod series;
mod service;
mod state;
mod storage;
mod straight;
#[path = "../support/mod.rs"]
mod support;
mod systems;
mod tokens;
mod tuning;
mod web;
mod windows;
