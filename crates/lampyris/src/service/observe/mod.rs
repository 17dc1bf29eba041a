//! What is counted.
//!
//! Handlers and workers add to `metrics`; `/metrics` prints it, and nothing else reads it. `lines` remembers
//! by name what came by the line protocol and has no place.

pub mod lines;
pub mod metrics;
pub mod pulls;
