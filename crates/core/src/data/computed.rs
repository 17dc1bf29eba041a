//! The channels that nobody has to measure: the clock, the sun and the openings of a window.

use super::channel::Hold;
use super::grid::Column;
use crate::fault::Fault;
use serde::Serialize;
use utoipa::ToSchema;

/// A channel that is computed where it is not measured.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, ToSchema)]
pub struct ComputedChannel {
    /// Its name.
    pub channel: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// What it is between two points.
    pub hold: Hold,
    /// What it is, and what has to be known for it.
    pub meaning: &'static str,
}

pub(super) const HOUR: ComputedChannel = ComputedChannel {
    channel: "hour_of_day",
    unit: "h",
    hold: Hold::ZeroOrder,
    meaning: "hours since midnight, from 0 to below 24, on the wall of the system's zone",
};
pub(super) const WEEKDAY: ComputedChannel = ComputedChannel {
    channel: "weekday",
    unit: "-",
    hold: Hold::ZeroOrder,
    meaning: "1 on Mondays to 7 on Sundays, in the system's zone",
};
pub(super) const ALTITUDE: ComputedChannel = ComputedChannel {
    channel: "sun_altitude",
    unit: "deg",
    hold: Hold::Linear,
    meaning: "the sun above the horizon, negative at night, where the system's place is known",
};
pub(super) const AZIMUTH: ComputedChannel = ComputedChannel {
    channel: "sun_azimuth",
    unit: "deg",
    hold: Hold::Linear,
    meaning: "the sun clockwise from north, where the system's place is known",
};
pub(super) const DROP: ComputedChannel = ComputedChannel {
    channel: "window_drop",
    unit: "-",
    hold: Hold::ZeroOrder,
    meaning: "1 while the first output falls sharply, else 0: it follows from what the model explains",
};

/// Every channel that is computed where it is not measured.
pub const COMPUTED: [ComputedChannel; 5] = [HOUR, WEEKDAY, ALTITUDE, AZIMUTH, DROP];
/// The channels of the clock on the wall.
pub const CALENDAR: [&str; 2] = [HOUR.channel, WEEKDAY.channel];
/// The channels of the sun.
pub const SUN: [&str; 2] = [ALTITUDE.channel, AZIMUTH.channel];
/// The channel of a window's openings, which is made from the output itself.
pub const DROPS: &str = DROP.channel;

/// Whether a channel is computed where it is not measured.
pub fn is_computed(channel: &str) -> bool {
    COMPUTED.iter().any(|computed| computed.channel == channel)
}

impl ComputedChannel {
    /// The column of these values.
    pub(super) fn column(&self, values: Vec<f64>) -> Result<Column, Fault> {
        Column::complete(self.unit, self.hold, values)
    }
}
