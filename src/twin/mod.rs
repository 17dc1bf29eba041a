//! Synthetic rooms whose truth is known, for tests, benches and teaching.
//!
//! A twin is written as CSV text and read back like any measurement, so it enters by the same door. `room` is the
//! room of the thesis with nothing hidden; `world` hides effects in it, for `diagnose` to find; `noisy` is moved
//! by chance.

mod climate;
mod dice;
mod hidden;
pub mod noisy;
pub mod room;
pub mod world;

pub use hidden::{CATALOGUED, STRANGE};
pub use noisy::{NoisyTwin, noisy};
pub use room::{RoomTwin, room};
pub use world::{Level, Truth, World, WorldRequest, world};
