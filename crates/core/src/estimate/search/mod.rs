//! A search from its first question to its end.
//!
//! ```text
//! Problem, Method --drive: ask, simulate, tell--> SearchResult
//! ```
//!
//! `control` is what a caller sees of it and how it is stopped. `near` is the short way of a night, from the
//! parameters that are served.

pub mod control;
pub(super) mod drive;
pub(super) mod near;
