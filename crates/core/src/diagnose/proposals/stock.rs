//! What terms are made of: the channels that were measured, the sun and the clock, sample by sample.

use crate::data::{CALENDAR, Column, Grid, Hold, is_computed};
use crate::estimate::Problem;
use crate::units::Unit;

/// The channels of the outdoors, the sun and the clouds, as models and effects call them.
const OUTDOORS: &str = "T_out";
const ALTITUDE: &str = "sun_altitude";
const CLOUDS: &str = "cloud_cover";
const IRRADIANCE: &str = "irradiance";
/// Of a clear sun at the zenith, in W/m2, as the models count it.
const CLEAR: f64 = 1000.0;

/// A measured channel.
#[derive(Debug, Clone)]
pub(super) struct StockChannel {
    pub name: String,
    pub unit: String,
    /// At each sample.
    pub values: Vec<f64>,
    pub hold: Hold,
    /// Whether it is a temperature, which acts by its difference from a state.
    pub is_warmth: bool,
    /// Whether the model reads it already.
    pub is_used: bool,
}

/// Everything that terms are made of.
#[derive(Debug)]
pub(super) struct Stock {
    pub channels: Vec<StockChannel>,
    /// Sun on the horizontal as a share of the clear sun at the zenith, where it is known.
    pub sun: Option<StockChannel>,
    /// The outdoor temperature, by its place among the channels.
    pub outdoors: Option<usize>,
    /// The hour of the local day, 0 to below 24, and the day of the week, 1 on Mondays, at each sample.
    pub clock: Option<(Vec<f64>, Vec<f64>)>,
    /// Samples of a day, where a day is a whole number of them.
    pub per_day: Option<usize>,
    /// Hours between samples.
    pub hours: f64,
}

impl Stock {
    /// All channels of a grid that change and do not follow from the outputs.
    pub fn new(problem: &Problem, grid: &Grid) -> Self {
        let model = problem.model();
        let is_output = |name: &str| model.outputs().iter().any(|output| output.channel == name);
        let is_used = |name: &str| model.inputs().iter().any(|input| input.channel == name);
        let channel = |(name, column): (&str, &Column)| StockChannel {
            name: name.to_owned(),
            unit: column.unit().to_owned(),
            values: column.values().to_vec(),
            hold: column.hold(),
            is_warmth: is_warmth(column.unit()),
            is_used: is_used(name),
        };
        let changes = |column: &Column| column.values().windows(2).any(|pair| pair[0] != pair[1]);
        let of_sun = |name: &str| [CLOUDS, IRRADIANCE].contains(&name);
        let channels: Vec<StockChannel> = grid
            .columns()
            .filter(|(name, column)| {
                !is_output(name) && !is_computed(name) && !of_sun(name) && changes(column)
            })
            .map(channel)
            .collect();
        let values = |name: &str| grid.column(name).map(|column| column.values().to_vec());
        let clock = match CALENDAR.map(values) {
            [Some(hours), Some(days)] => Some((hours, days)),
            _ => None,
        };
        let hours = grid.step_hours();
        let per_day = (24.0 / hours).round();
        Self {
            sun: sun(grid).map(|values| StockChannel {
                name: "S".to_owned(),
                unit: "-".to_owned(),
                values,
                hold: Hold::Linear,
                is_warmth: false,
                is_used: is_used(ALTITUDE) || is_used(IRRADIANCE),
            }),
            outdoors: channels.iter().position(|channel| channel.name == OUTDOORS),
            channels,
            clock,
            per_day: ((per_day * hours - 24.0).abs() < 1e-9).then_some(per_day as usize),
            hours,
        }
    }
}

/// Whether a unit is one of temperature.
fn is_warmth(unit: &str) -> bool {
    let kelvin = Unit::parse("K").ok();
    Unit::parse(unit).ok().zip(kelvin).is_some_and(|(unit, kelvin)| unit.same_dimension(&kelvin))
}

/// The sun as the models have it: an irradiance that is measured, or Kasten and Czeplak's clouds.
fn sun(grid: &Grid) -> Option<Vec<f64>> {
    let column = |name: &str| grid.column(name).map(Column::values);
    if let Some(irradiance) = column(IRRADIANCE) {
        return Some(irradiance.iter().map(|sun| sun / CLEAR).collect());
    }
    let clear = column(ALTITUDE)?.iter().map(|altitude| altitude.to_radians().sin().max(0.0));
    Some(match column(CLOUDS) {
        Some(clouds) => {
            clear.zip(clouds).map(|(sun, cloud)| sun * (1.0 - 0.75 * cloud.max(0.0).powf(3.4))).collect()
        }
        None => clear.collect(),
    })
}
