//! What is counted.
//!
//! Handlers and workers add to `metrics`; `/metrics` prints it, and nothing else reads it.

pub mod metrics;
