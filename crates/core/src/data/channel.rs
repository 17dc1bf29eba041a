//! The channels that the built-in models know: their units, holds and plausible values.
//!
//! A channel is what a model asks for (`T_room`); a column is what a file has (`T_indoor_degC`). This file
//! knows channels, `header` leads from columns to them.

use crate::units::Unit;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What a channel is between two samples.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum Hold {
    /// A straight line from sample to sample: temperatures, weather, the sun.
    Linear,
    /// The sample's value until the next one, stamped at the start of its interval: power, valves, windows,
    /// people.
    ZeroOrder,
}

/// What is known of a channel by its name or its unit.
#[derive(Debug, Clone, PartialEq)]
pub struct ChannelKind {
    /// The unit in which the channel is kept, as a unit text.
    pub unit: String,
    /// What it is between two samples.
    pub hold: Hold,
    /// The lowest and the highest value that a working sensor gives, in `unit`; infinite where nothing is
    /// known.
    pub plausible: (f64, f64),
}

/// The thirteen components of ASM1.
const ASM1: [&str; 13] =
    ["S_I", "S_S", "X_I", "X_S", "X_BH", "X_BA", "X_P", "S_O", "S_NO", "S_NH", "S_ND", "X_ND", "S_ALK"];
/// The effluent measurements.
const EFFLUENT: [&str; 4] = ["S_S_e", "X_S_e", "S_NH_e", "S_NO_e"];

/// Every name with a fixed meaning, for suggestions.
pub(super) const KNOWN: [&str; 19] = [
    "T_room",
    "T_out",
    "T_forward",
    "sun_altitude",
    "sun_azimuth",
    "cloud_cover",
    "irradiance",
    "wind_speed",
    "wind_direction",
    "flow",
    "valve",
    "window_open",
    "occupancy",
    "hour_of_day",
    "weekday",
    "CO2",
    "Q",
    "temperature",
    "S_NH_e",
];

/// Nothing that is measured in rooms and plants is larger in any unit. The squares of what is would leave the
/// numbers, and with them whatever is computed from it.
const LARGEST: f64 = 1e15;
/// The share of a column's values that a unit must explain.
const EXPLAINED: f64 = 0.9;

impl ChannelKind {
    /// The kind of a channel whose name is known, alone or by a pattern such as `T_room_<n>` and `P_<name>`.
    ///
    /// The plausible ranges are wide: they are there to catch Fahrenheit, kelvin and watts, and the dead
    /// sensor's 85 or -127, not to judge the weather. The slight excess below zero is for the offsets of real
    /// instruments.
    pub fn of_name(name: &str) -> Option<Self> {
        let linear = |unit: &str, low, high| {
            Some(Self { unit: unit.to_owned(), hold: Hold::Linear, plausible: (low, high) })
        };
        let held = |unit: &str, low, high| {
            Some(Self { unit: unit.to_owned(), hold: Hold::ZeroOrder, plausible: (low, high) })
        };
        match name {
            "T_room" => linear("degC", -20.0, 50.0),
            "T_out" => linear("degC", -60.0, 60.0),
            "T_forward" => linear("degC", -20.0, 130.0),
            "sun_altitude" => linear("deg", -90.0, 90.0),
            "sun_azimuth" | "wind_direction" => linear("deg", -180.0, 360.0),
            "cloud_cover" => linear("-", -0.01, 1.01),
            "irradiance" => linear("W/m2", -50.0, 1600.0),
            "wind_speed" => linear("m/s", -0.5, 75.0),
            "flow" | "valve" => held("-", -0.05, 1.05),
            "window_open" => held("-", 0.0, 1.0),
            "occupancy" => held("people", 0.0, 10_000.0),
            "hour_of_day" => held("h", 0.0, 24.0),
            "weekday" => held("-", 1.0, 7.0),
            "CO2" => linear("ppm", 200.0, 20_000.0),
            "Q" => linear("m3/d", 0.0, 1e7),
            "temperature" => linear("degC", -5.0, 60.0),
            // Alkalinity is counted in moles throughout the ASM literature.
            "S_ALK" => linear("mol/m3", -1.0, 1e3),
            _ if ASM1.contains(&name) || EFFLUENT.contains(&name) => linear("g/m3", -1.0, 1e5),
            _ if has_tail(name, "T_room_") => linear("degC", -20.0, 50.0),
            _ if has_tail(name, "T_") => linear("degC", -60.0, 150.0),
            _ if has_tail(name, "P_") => held("kW", -100.0, 100.0),
            _ if has_tail(name, "RH_") => linear("pct", -1.0, 105.0),
            _ if has_tail(name, "irradiance_") => linear("W/m2", -50.0, 1600.0),
            _ => None,
        }
    }

    /// The kind of a channel of which only the unit is known: linear, and any number that counts something.
    pub fn of_unit(unit: &str) -> Self {
        Self { unit: canonical_unit(unit).to_owned(), hold: Hold::Linear, plausible: (-LARGEST, LARGEST) }
    }

    /// The same kind where nobody knows the unit, so that no range says what a sensor gives.
    #[must_use]
    pub fn of_any_unit(self) -> Self {
        Self { plausible: (-LARGEST, LARGEST), ..self }
    }

    /// Whether a value, in the channel's unit, is one that a working sensor gives.
    pub fn is_plausible(&self, value: f64) -> bool {
        self.plausible.0 <= value && value <= self.plausible.1
    }

    /// The highest value, in `unit`, that is believed without a word where a column states no unit: 50 watts
    /// of a lamp are no impossible kilowatts, and 50 degrees Fahrenheit outdoors no impossible Celsius.
    pub(super) fn usual_limit(&self, name: &str) -> Option<f64> {
        match self.unit.as_str() {
            "kW" => Some(20.0),
            "degC" if name.starts_with("T_out") => Some(45.0),
            _ => None,
        }
    }

    /// The first of the channel's own unit and those that are mistaken for it in which nearly all values are
    /// usual, or else plausible. Zeros tell nothing: a heater that is off is so in watts and in kilowatts.
    pub(super) fn unit_that_explains(&self, name: &str, values: &[f64]) -> Option<&'static str> {
        let own = Unit::parse(&self.unit).ok()?;
        let told: Vec<f64> = values.iter().copied().filter(|value| *value != 0.0).collect();
        let explains = |text: &str, limit: Option<f64>| {
            let Ok(unit) = Unit::parse(text) else { return false };
            let is_fine = |value: &&f64| {
                unit.convert(&own, **value).is_some_and(|value| {
                    self.is_plausible(value) && limit.is_none_or(|limit| value.abs() <= limit)
                })
            };
            told.iter().filter(is_fine).count() as f64 >= EXPLAINED * told.len() as f64
        };
        let first = |limit| self.mistaken_units().iter().copied().find(|unit| explains(unit, limit));
        first(self.usual_limit(name)).or_else(|| first(None))
    }

    /// The channel's unit, and those that are commonly mistaken for it.
    pub(super) fn mistaken_units(&self) -> &'static [&'static str] {
        match self.unit.as_str() {
            "degC" => &["degC", "degF", "K"],
            "kW" => &["kW", "W"],
            "-" => &["-", "pct"],
            "pct" => &["pct", "-"],
            "ppm" => &["ppm", "-", "pct"],
            "W/m2" => &["W/m2", "kW/m2"],
            _ => &[],
        }
    }
}

/// Whether a channel is an angle of the compass, on which 359 and 1 are two degrees apart.
pub fn is_compass(name: &str) -> bool {
    matches!(name, "sun_azimuth" | "wind_direction")
}

/// Whether a channel begins anew after its largest value, so that the mean of two values lies nowhere near
/// them.
pub(super) fn goes_round(name: &str) -> bool {
    is_compass(name) || matches!(name, "hour_of_day" | "weekday")
}

/// Whether a unit is one of temperature.
pub(super) fn is_temperature(unit: &str) -> bool {
    let kelvin = Unit::parse("K").ok();
    Unit::parse(unit).ok().zip(kelvin).is_some_and(|(unit, kelvin)| unit.same_dimension(&kelvin))
}

/// One text for units with several spellings.
pub(super) fn canonical_unit(text: &str) -> &str {
    match text {
        "C" | "°C" => "degC",
        "F" | "°F" => "degF",
        "%" => "pct",
        "1" | "frac" | "0/1" => "-",
        "L" => "l",
        "W/m²" | "W/m^2" => "W/m2",
        "m³/h" => "m3/h",
        "m³/d" => "m3/d",
        "Grad" | "°" => "deg",
        other => other,
    }
}

/// Whether a number in one unit can mean a number in the other.
///
/// To the algebra of units an angle, a share and a head count are all pure numbers; to a column they are not.
pub(super) fn means_same_quantity(from: &str, to: &str) -> bool {
    let sort = |unit: &str| match unit {
        "deg" | "rad" => 'a',
        "people" => 'n',
        "pct" | "ppm" => 's',
        _ => '-',
    };
    let (from, to) = (sort(from), sort(to));
    from == to || from == '-' || (from == 's' && to == '-')
}

fn has_tail(name: &str, prefix: &str) -> bool {
    name.len() > prefix.len() && name.starts_with(prefix)
}

#[cfg(test)]
mod tests {
    use super::{ASM1, ChannelKind, Hold, KNOWN, canonical_unit};
    use crate::units::Unit;

    #[test]
    fn known_channels_have_readable_units_and_ranges() {
        for name in KNOWN.iter().chain(&ASM1).chain(&[
            "T_room_2",
            "P_heater",
            "irradiance_clear_sky",
            "RH_laundry",
            "S_NO_e",
        ]) {
            let kind = ChannelKind::of_name(name).unwrap();
            assert!(Unit::parse(&kind.unit).is_ok(), "{name} in {}", kind.unit);
            assert!(kind.plausible.0 < kind.plausible.1, "{name}");
            for unit in kind.mistaken_units() {
                let unit = Unit::parse(unit).unwrap();
                assert!(unit.same_dimension(&Unit::parse(&kind.unit).unwrap()), "{name}");
            }
        }
    }

    #[test]
    fn zeros_tell_no_unit() {
        let kind = ChannelKind::of_name("P_heater").unwrap();
        let mostly_off: Vec<f64> = (0..100).map(|hour| if hour < 95 { 0.0 } else { 1200.0 }).collect();
        assert_eq!(kind.unit_that_explains("P_heater", &mostly_off), Some("W"));
        assert_eq!(kind.unit_that_explains("P_heater", &[50_000.0]), Some("W"), "unusual, but plausible");
        assert_eq!(kind.unit_that_explains("P_heater", &[0.0, 2.5]), Some("kW"));
        assert_eq!(kind.unit_that_explains("P_heater", &[1e9]), None);
    }

    #[test]
    fn patterns_need_a_tail() {
        assert_eq!(ChannelKind::of_name("P_heater").unwrap().hold, Hold::ZeroOrder);
        assert_eq!(ChannelKind::of_name("T_room_kitchen").unwrap().unit, "degC");
        for unknown in
            ["P_", "T_", "T_room_x".trim_end_matches("room_x"), "ghi", "heat_input_raw", "", "t_room"]
        {
            assert_eq!(ChannelKind::of_name(unknown), None, "{unknown}");
        }
    }

    #[test]
    fn unknown_channels_follow_their_unit() {
        let kind = ChannelKind::of_unit("%");
        assert_eq!((kind.unit.as_str(), kind.hold), ("pct", Hold::Linear));
        assert!(kind.is_plausible(-1e15) && !kind.is_plausible(1e16) && !kind.is_plausible(f64::NAN));
        assert_eq!(canonical_unit("°C"), "degC");
        assert_eq!(serde_json::to_string(&Hold::ZeroOrder).unwrap(), "\"zero_order\"");
    }
}
