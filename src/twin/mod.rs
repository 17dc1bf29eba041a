//! Synthetic rooms whose truth is known, for tests, benches and teaching.
//!
//! A twin is written as CSV text and read back like any measurement, so it enters by the same door.

pub mod room;

pub use room::{RoomTwin, room};
