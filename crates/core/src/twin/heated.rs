//! A synthetic room whose heat pump somebody else decides on: the other side of a controller.
//!
//! Five thermal masses, written out by hand and stepped by a fourth-order method, so that no model of the
//! catalogue is the truth. Its parameters drift, and from a day on the wind blows through it.

use super::climate::{Climate, STEP_MINUTES, STEPS_PER_DAY};
use super::dice::Dice;
use super::price::day_ahead;
use crate::data::{MINUTE, SECOND};
use crate::fault::Fault;

/// Minutes between two decisions, and between two samples.
pub const SAMPLE_MINUTES: usize = 30;
/// Samples of a day.
pub const SAMPLES_PER_DAY: usize = 24 * 60 / SAMPLE_MINUTES;
/// Hours of a sample.
pub const SAMPLE_HOURS: f64 = SAMPLE_MINUTES as f64 / 60.0;
/// Steps of the truth in a sample.
const STEPS: usize = SAMPLE_MINUTES / STEP_MINUTES;
/// Hours of a step.
const HOURS: f64 = STEP_MINUTES as f64 / 60.0;
/// Monday, 2026-01-12T00:00:00Z.
const START: i64 = 1_768_176_000 * SECOND;
/// Step of the sensor's display, and deviation of its noise, in K.
const QUANTUM: f64 = 0.1;
const SENSOR_NOISE: f64 = 0.05;
/// The water of the heating in K, and the share of Carnot's efficiency that the heat pump reaches.
const WATER: f64 = 308.15;
const CARNOT_SHARE: f64 = 0.4;
/// Bounds of the coefficient of performance.
const COP: (f64, f64) = (1.5, 6.0);
/// Days over which a drift reaches its factor.
const DRIFT_DAYS: f64 = 56.0;

/// Masses of the truth: room air, emitter, envelope, furniture, outer wall.
pub const MASSES: usize = 5;
/// Their temperatures in degC.
pub type MassTemperatures = [f64; MASSES];
/// `dx/dt = matrix x + heat * kW + constant`, per hour.
#[derive(Debug, Clone, PartialEq)]
pub struct LinearDynamics {
    /// 1/h, a row per mass.
    pub matrix: [MassTemperatures; MASSES],
    /// K/h per kW of heat.
    pub heat: MassTemperatures,
    /// K/h: weather and sun.
    pub constant: MassTemperatures,
}

/// What a forecast tells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Weather {
    /// Outdoors, in degC.
    pub out: f64,
    /// On the horizontal, in W/m2.
    pub irradiance: f64,
    /// In m/s.
    pub wind: f64,
}

/// A room with a heat pump.
#[derive(Debug)]
pub struct HeatedRoom {
    climate: Climate,
    rates: Rates,
    /// Household heat in K/h per step: nobody forecasts it.
    household: Vec<f64>,
    /// The sensor's noise in K per sample.
    noise: Vec<f64>,
    /// EUR/kWh per hour.
    prices: Vec<f64>,
    leak: Leak,
    /// The first step at which parameters drift.
    drifts_from: usize,
}

/// Conductances and capacities over that of the room air.
#[derive(Debug)]
struct Rates {
    emitter: (f64, f64),
    envelope: (f64, f64),
    furniture: (f64, f64),
    wall: (f64, f64),
    outdoors: f64,
    sun: f64,
    heat: f64,
    /// Growth per day of the conductance through the wall, of the sun's gain and of the heat's.
    drift: [f64; 3],
}

/// Infiltration: 1/h per m/s, and the first step at which there is any.
#[derive(Debug)]
struct Leak {
    strength: f64,
    from: usize,
}

/// The heat per electric energy at an outdoor temperature: a share of Carnot's.
pub fn cop(out: f64) -> f64 {
    let lift = (WATER - 273.15 - out).max(5.0);
    (CARNOT_SHARE * WATER / lift).clamp(COP.0, COP.1)
}

/// Largest electric power of the heat pump in kW.
pub const LARGEST_POWER: f64 = 3.0;

impl HeatedRoom {
    /// A room over so many days. Its parameters drift from one day on, and the wind blows through it from
    /// another.
    ///
    /// # Errors
    /// Where the position of the sun cannot be computed.
    pub fn new(seed: u64, days: usize, drifts_from: usize, leaks_from: usize) -> Result<Self, Fault> {
        let mut dice = Dice::new(seed);
        let steps = days * STEPS_PER_DAY + 1;
        let climate = Climate::new(&mut dice, START, steps)?;
        let (deviation, memory) = (dice.between(0.02, 0.08), dice.between(0.5, 3.0) / HOURS);
        let household = dice.wander(steps, deviation, memory);
        let noise = (0..=days * SAMPLES_PER_DAY).map(|_| SENSOR_NOISE * dice.normal()).collect();
        let prices = day_ahead(&mut dice, days);
        let rates = Rates {
            emitter: (dice.log_between(1.0, 2.0), dice.log_between(0.15, 0.4)),
            envelope: (dice.log_between(0.4, 0.9), dice.log_between(4.0, 8.0)),
            furniture: (dice.log_between(0.3, 0.8), dice.log_between(0.4, 1.0)),
            wall: (dice.log_between(0.06, 0.12), dice.log_between(2.0, 5.0)),
            outdoors: dice.log_between(0.3, 0.6),
            sun: dice.log_between(0.4, 0.9),
            heat: dice.log_between(0.3, 0.5),
            drift: std::array::from_fn(|_| {
                let factor = dice.log_between(1.2, 1.45).ln();
                (if dice.uniform() < 0.5 { -factor } else { factor }) / DRIFT_DAYS
            }),
        };
        let leak = Leak { strength: dice.between(0.002, 0.004), from: leaks_from * STEPS_PER_DAY };
        Ok(Self { climate, rates, household, noise, prices, leak, drifts_from: drifts_from * STEPS_PER_DAY })
    }

    /// Unix milliseconds of a sample.
    pub fn time(&self, sample: usize) -> i64 {
        self.climate.start + (sample * SAMPLE_MINUTES) as i64 * MINUTE
    }

    /// The local time of day at a sample in hours, and the day of the week, Monday 1.
    pub fn clock(&self, sample: usize) -> (f64, f64) {
        (self.climate.hour[sample * STEPS], self.climate.weekday[sample * STEPS])
    }

    /// What the price is from a sample to the next, in EUR/kWh.
    pub fn price(&self, sample: usize) -> f64 {
        self.prices[sample * SAMPLE_MINUTES / 60]
    }

    /// The weather at a sample.
    pub fn weather(&self, sample: usize) -> Weather {
        let step = sample * STEPS;
        Weather {
            out: self.climate.out[step],
            irradiance: 1000.0 * self.climate.sun(step),
            wind: self.climate.wind[step],
        }
    }

    /// What the sensor shows where the room has this temperature.
    pub fn measured(&self, sample: usize, room: f64) -> f64 {
        ((room + self.noise[sample]) / QUANTUM).round() * QUANTUM
    }

    /// Where the masses start.
    pub const fn start() -> MassTemperatures {
        [20.5, 28.0, 18.0, 20.5, 8.0]
    }

    /// Moves the masses from a sample to the next under so many kW of heat; the room's temperature after each
    /// step of three minutes.
    pub fn advance(&self, state: &mut MassTemperatures, sample: usize, heat: f64) -> [f64; STEPS] {
        std::array::from_fn(|step| {
            let k = sample * STEPS + step;
            let at = |x: &MassTemperatures, part: f64| self.slope(x, k, part, heat);
            let moved = |x: &MassTemperatures, slope: &MassTemperatures, part: f64| -> MassTemperatures {
                std::array::from_fn(|i| x[i] + part * HOURS * slope[i])
            };
            let k1 = at(state, 0.0);
            let k2 = at(&moved(state, &k1, 0.5), 0.5);
            let k3 = at(&moved(state, &k2, 0.5), 0.5);
            let k4 = at(&moved(state, &k3, 1.0), 1.0);
            *state =
                std::array::from_fn(|i| state[i] + HOURS / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i]));
            state[0]
        })
    }

    /// The equations in the middle between a sample and the next, without the household heat: what a model
    /// that knows everything knows.
    pub fn linear(&self, sample: usize) -> LinearDynamics {
        self.equations(sample * STEPS + STEPS / 2, 0.0)
    }

    fn slope(&self, x: &MassTemperatures, k: usize, part: f64, heat: f64) -> MassTemperatures {
        let linear = self.equations(k, part);
        std::array::from_fn(|i| {
            let household = if i == 0 { self.household[k] } else { 0.0 };
            let moved: f64 = linear.matrix[i].iter().zip(x).map(|(rate, x)| rate * x).sum();
            moved + linear.heat[i] * heat + linear.constant[i] + household
        })
    }

    fn equations(&self, k: usize, part: f64) -> LinearDynamics {
        let (rates, climate) = (&self.rates, &self.climate);
        let line = |series: &[f64]| series[k] + part * (series[k + 1] - series[k]);
        let (out, sun) = (line(&climate.out), climate.sun(k) + part * (climate.sun(k + 1) - climate.sun(k)));
        let days = k.saturating_sub(self.drifts_from) as f64 / STEPS_PER_DAY as f64;
        let [through, shine, warmth] = rates.drift.map(|rate| (rate * days).exp());
        let leak = if k >= self.leak.from { self.leak.strength * line(&climate.wind) } else { 0.0 };
        let mut linear =
            LinearDynamics { matrix: [[0.0; MASSES]; MASSES], heat: [0.0; MASSES], constant: [0.0; MASSES] };
        let mut joined = |i: usize, j: usize, conductance: f64, capacities: [f64; 2]| {
            for (from, to, capacity) in [(i, j, capacities[0]), (j, i, capacities[1])] {
                linear.matrix[from][from] -= conductance / capacity;
                linear.matrix[from][to] += conductance / capacity;
            }
        };
        joined(0, 1, rates.emitter.0, [1.0, rates.emitter.1]);
        joined(0, 2, rates.envelope.0, [1.0, rates.envelope.1]);
        joined(0, 3, rates.furniture.0, [1.0, rates.furniture.1]);
        joined(2, 4, rates.wall.0 * through, [rates.envelope.1, rates.wall.1]);
        for (mass, conductance) in [(0, leak), (4, rates.outdoors / rates.wall.1)] {
            linear.matrix[mass][mass] -= conductance;
            linear.constant[mass] += conductance * out;
        }
        linear.constant[0] += rates.sun * shine * sun;
        linear.heat[1] = rates.heat * warmth / rates.emitter.1;
        linear
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A heat pump gives less in the cold, and never less than one and a half times what it takes.
    #[test]
    fn the_heat_pump_follows_the_outdoor_temperature() {
        // 0.4 of Carnot between 0 and 35 degC, by hand.
        assert!((cop(0.0) - 0.4 * 308.15 / 35.0).abs() < 1e-12);
        assert!(cop(7.0) > cop(0.0) && cop(0.0) > cop(-10.0));
        assert_eq!((cop(34.0), cop(-90.0)), (6.0, 1.5));
    }

    #[test]
    fn a_room_left_alone_goes_to_the_outdoors_and_heat_balances_its_losses() {
        let room = HeatedRoom::new(5, 30, 30, 30).unwrap();
        let linear = room.linear(0);
        let weather = room.weather(0);
        // In the steady state without sun and heat every mass is as cold as it is outside.
        if weather.irradiance == 0.0 {
            for (row, constant) in linear.matrix.iter().zip(linear.constant) {
                let slope: f64 = row.iter().sum::<f64>() * room.climate.out[STEPS / 2] + constant;
                assert!(slope.abs() < 1e-12, "{slope}");
            }
        }
        let mut state = HeatedRoom::start();
        for sample in 0..20 * SAMPLES_PER_DAY {
            // About what a house of this kind needs at ten degrees outside.
            room.advance(&mut state, sample, 4.0);
        }
        assert!((5.0..40.0).contains(&state[0]), "{state:?}");
    }

    #[test]
    fn drift_and_leak_begin_when_they_are_told_to() {
        let room = HeatedRoom::new(9, 12, 2, 6).unwrap();
        let loss = |day: usize| -> f64 { room.linear(day * SAMPLES_PER_DAY).matrix[0].iter().sum() };
        assert!(loss(5).abs() < 1e-12 && loss(7) < -5e-4, "{} {}", loss(5), loss(7));
        let heat = |day: usize| room.linear(day * SAMPLES_PER_DAY).heat[1];
        assert_eq!(heat(0), heat(1));
        assert!((heat(11) / heat(2)).ln().abs() > 0.5 * 9.0 * 1.2f64.ln() / DRIFT_DAYS);
        assert_eq!(room.measured(3, 20.0), HeatedRoom::new(9, 12, 2, 6).unwrap().measured(3, 20.0));
    }
}
