//! The only axum. Each file owns its paths: router, request and response types, handlers.
//!
//! A handler checks, asks `service` or `store`, and answers; long work is for the CPU pools. The guard
//! (`access`) lies around every operation. The controller's paths (`params`) lie outside of all other layers,
//! so that a poll costs no more than its body; the page (`web`) and the book hold no data and lie outside of
//! all.

mod access;
mod audit;
mod batches;
mod book;
mod comparison;
mod conditions;
mod constant;
mod decisions;
mod description;
mod diagnoses;
mod diagnostics;
mod dialect;
mod docs;
mod effects;
mod events;
mod evidence;
mod examples;
mod experiments;
mod export;
mod extract;
mod fits;
mod forecast;
mod history;
mod influx;
mod jobs;
mod language;
mod layout;
mod listen;
mod matrix;
mod metrics;
mod missing_heat;
mod models;
mod negotiate;
mod night_page;
mod nights;
mod origin;
mod overview;
mod page;
mod parameter_changes;
mod params;
mod patience;
mod places;
mod preview;
mod problem;
mod prometheus;
mod proposals;
mod samples;
mod schedules;
mod series;
mod service;
mod shared;
mod state;
mod storage;
mod surface;
mod systems;
mod tls;
mod unpack;
mod waiting;
mod web;
mod windows;
mod wording;

pub use access::declared_operations;
pub use book::book_text;
pub use models::document as model_document;
pub use surface::{described_documents, described_paths, openapi_json, openapi_yaml};
pub use tls::Tls;
pub use web::page_part;

pub(crate) use listen::listen;
