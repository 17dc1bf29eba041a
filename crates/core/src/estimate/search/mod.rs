//! A search from its first question to its end.
//!
//! ```text
//! Problem, Method --drive: ask, simulate, tell--> SearchResult
//! ```
//!
//! `control` is what a caller sees of it and how it is stopped, `pace` how long what comes behind it
//! will take.

pub mod control;
pub(super) mod drive;
