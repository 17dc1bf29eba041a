//! Synthetic rooms and plants whose truth is known, for tests, benches and teaching.
//!
//! A twin is written as CSV text and read back like any measurement, so it enters by the same door. `room` is
//! the room of the thesis with nothing hidden; `world` hides effects in it, for `diagnose` to find; `house`
//! is eleven rooms that warm each other, with more sensors than rooms; `noisy` is moved by chance. `heated`
//! is no record: a controller decides step by step what its heat pump does. `plant` is a treatment plant, and
//! `plant_world` hides an effect in one.

mod climate;
mod dice;
pub mod heated;
mod hidden;
pub mod house;
mod measured;
pub mod noisy;
pub mod plant;
pub mod plant_world;
mod price;
mod rates;
pub mod room;
pub mod world;

pub use hidden::{CATALOGUED, STRANGE};
pub use house::{HouseRequest, HouseTwin, RoomTruth, house};
pub use measured::MEASURED;
pub use noisy::{NoisyTwin, noisy};
pub use plant::{PlantRequest, PlantTwin, plant};
pub use rates::ChangedParameter;
pub use room::{RoomTwin, room};
pub use world::{DrivenForward, HiddenEffect, Level, Truth, World, WorldRequest, world};
