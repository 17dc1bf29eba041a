//! What is measured around a synthetic room beyond its weather: air that people have breathed, rain, and the
//! meters of a heater and of the flat next door. The effects that these drive are in no catalogue.

use super::climate::{Climate, STEP_MINUTES, STEPS_PER_DAY};
use super::dice::Dice;

/// The effects that no catalogue has, but that follow from something measured.
pub const MEASURED: [&str; 6] = ["co2_ventilation", "blinds", "fan", "rain", "next_door", "heater"];
/// Of the outside air.
const FRESH_PPM: f64 = 420.0;
/// What one person breathes out into the room.
const PPM_PER_HOUR: f64 = 250.0;

/// Series in steps of three minutes.
#[derive(Debug)]
pub struct MoreSeries {
    /// Of the room's air, in ppm.
    pub co2: Vec<f64>,
    /// In mm/h.
    pub rain: Vec<f64>,
    /// Power of the heating next door, in kW.
    pub next_door: Vec<f64>,
    /// Power of an electric heater, in kW.
    pub heater: Vec<f64>,
}

impl MoreSeries {
    /// Draws all of them.
    pub fn new(dice: &mut Dice, climate: &Climate) -> Self {
        let steps = climate.hour.len();
        let days = steps / STEPS_PER_DAY + 1;
        // Adds `size` from an hour of a day on for so many hours.
        let add = |series: &mut [f64], day: usize, hour: f64, hours: f64, size: f64| {
            let from = ((day as f64 + hour / 24.0) * STEPS_PER_DAY as f64) as usize;
            let count = (hours / 24.0 * STEPS_PER_DAY as f64) as usize;
            series.iter_mut().skip(from).take(count).for_each(|value| *value += size);
        };
        let (mut people, mut rain) = (vec![0.0; steps], vec![0.0; steps]);
        let (mut next_door, mut heater) = (vec![0.1; steps], vec![0.05; steps]);
        for day in 0..days {
            for (likely, from, to) in [(0.7, 6.0, 8.0), (0.4, 10.0, 15.0), (0.9, 16.0, 20.0)] {
                if dice.uniform() < likely {
                    let many = 1.0 + (dice.uniform() * 3.0).floor();
                    add(&mut people, day, dice.between(from, to), dice.between(1.0, 4.0), many);
                }
            }
            for _ in 0..(dice.uniform() * 3.0) as usize {
                let size = dice.log_between(0.2, 3.0);
                add(&mut rain, day, dice.between(0.0, 24.0), dice.between(0.5, 6.0), size);
            }
            for _ in 0..1 + (dice.uniform() * 3.0) as usize {
                let size = dice.log_between(0.5, 2.5);
                add(&mut next_door, day, dice.between(5.0, 22.0), dice.between(0.5, 3.0), size);
            }
            for _ in 0..1 + (dice.uniform() * 4.0) as usize {
                let size = dice.log_between(0.1, 2.0);
                add(&mut heater, day, dice.between(5.0, 22.0), dice.between(0.3, 2.5), size);
            }
        }
        let change = dice.between(0.5, 1.2);
        let ppm: Vec<f64> = people.iter().map(|people| people * PPM_PER_HOUR / change).collect();
        let co2 = lagged(&ppm, 1.0 / change).into_iter().map(|more| FRESH_PPM + more).collect();
        Self { co2, rain, next_door, heater }
    }
}

/// A series through a mass with a time constant in hours, from its first value on.
pub fn lagged(series: &[f64], hours: f64) -> Vec<f64> {
    let keep = (-(STEP_MINUTES as f64) / 60.0 / hours).exp();
    let mut value = series.first().copied().unwrap_or_default();
    series
        .iter()
        .map(|now| {
            value = keep * value + (1.0 - keep) * now;
            value
        })
        .collect()
}
