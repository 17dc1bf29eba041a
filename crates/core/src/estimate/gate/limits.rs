//! What the limits of the gate mean for each output.
//!
//! They were set for rooms, in kelvin, beside a day that moves a room by five of them. An output in another
//! unit gets the same limits in the ratio of its own day to that one: so much of its day is as far for it as
//! so many kelvin are for a room. A change of unit moves a value by far more than its own day does.

use crate::data::DAY;
use crate::estimate::problem::Problem;
use crate::estimate::problem::whiten::stride;
use crate::units::error_unit;

/// What a day moves the temperature of a room by, in K.
const DAY_OF_A_ROOM: f64 = 5.0;
/// An output that hardly moves is judged as if its day were so many deviations of its sensor's noise.
const LEAST_DAY: f64 = 10.0;

/// An output of a problem and the scale of its limits.
#[derive(Debug, Clone, Copy)]
pub(super) struct OutputScale<'a> {
    pub output: usize,
    /// Unit of its errors.
    pub unit: &'a str,
    /// How much of it is one kelvin of a room.
    unit_kelvin: f64,
    /// Its channel, where there are several.
    channel: Option<&'a str>,
}

impl<'a> OutputScale<'a> {
    /// Of every output.
    pub fn of(problem: &'a Problem) -> Vec<Self> {
        let outputs = problem.model().outputs();
        let scale = |(index, output): (usize, &'a crate::model::Output)| {
            let unit = error_unit(&output.unit);
            let unit_kelvin = if unit == "K" {
                1.0
            } else {
                usual_day(problem, index).max(LEAST_DAY * output.noise_sd) / DAY_OF_A_ROOM
            };
            Self {
                output: index,
                unit,
                unit_kelvin,
                channel: (outputs.len() > 1).then_some(output.channel.as_str()),
            }
        };
        outputs.iter().enumerate().map(scale).collect()
    }

    /// A limit of rooms, for this output.
    pub fn limit(&self, kelvin: f64) -> f64 {
        kelvin * self.unit_kelvin
    }

    /// A sentence about this output, with its name where there are others.
    pub fn says(&self, sentence: String) -> String {
        match self.channel {
            Some(channel) => format!("{channel}: {sentence}"),
            None => sentence,
        }
    }
}

/// How far an output moves in a day, from its lowest to its highest measurement, on the quietest quarter of
/// the days: not on one with a spike or a change of unit. A record of less than a day is taken as one: what
/// goes by seconds moves as far in minutes.
fn usual_day(problem: &Problem, output: usize) -> f64 {
    let (values, valid) = problem.measured()[output];
    let samples = ((DAY / problem.grid().step()).max(1) as usize).min(values.len().max(1));
    let range = |start: usize| {
        let known = || (start..start + samples).filter(|k| valid[*k]).map(|k| values[k]);
        known().fold(f64::NEG_INFINITY, f64::max) - known().fold(f64::INFINITY, f64::min)
    };
    let mut days: Vec<f64> = (0..values.len() / samples)
        .map(|day| range(day * samples))
        .filter(|range| range.is_finite())
        .collect();
    days.sort_by(f64::total_cmp);
    days.get(days.len().saturating_sub(1) / 4).copied().unwrap_or(0.0)
}

/// The samples at which a sensor may have measured, one after the other: on a grid that is finer than its
/// record not every one.
pub(super) fn ticks(valid: &[bool]) -> impl Iterator<Item = usize> + Clone + use<> {
    let known: Vec<usize> = (0..valid.len()).filter(|k| valid[*k]).collect();
    (known.first().copied().unwrap_or(valid.len())..valid.len()).step_by(stride(&known))
}
