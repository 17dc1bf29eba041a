//! From the claim to the verdict, on the CPU pools.
//!
//! `worker` claims a job, `input` collects what it needs, and `estimate`, `diagnose` or `tune` does it; the
//! worker writes its end. `parameter_changes` looks whether the room has changed. `board` knows who runs now,
//! with the `progress` that watchers are told and the switch that calls a job off.
//!
//! `membership` is the right of this process to work, which others can see; `renewal`
//! keeps it.
//!
//! `interactive` is work of moments and of seconds that somebody waits for: first in line, bounded, kept.
//! `poison` is a hook for tests: jobs that go wrong on purpose.

pub mod board;
pub mod diagnose;
pub mod estimate;
pub mod input;
pub mod interactive;
pub mod membership;
pub mod parameter_changes;
mod poison;
pub mod progress;
pub mod renewal;
mod tune;
pub mod worker;
