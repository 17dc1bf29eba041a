//! The measured houses of the demo.

/// Five weeks of four rooms (CC BY 4.0, see the head of the file).
pub const BELGIAN_HOUSE: &str = include_str!("../../../../../config/demo/belgian_house.csv");
/// A month of a house with a heating channel (MIT, see the head of the file).
pub const HOURLY_HOUSE: &str = include_str!("../../../../../config/demo/hourly_house.csv");
