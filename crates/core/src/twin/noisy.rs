//! A room and its envelope that chance moves: a stochastic differential equation with known parameters and
//! known noise, for the question whether intervals hold what they promise.

use super::dice::Dice;
use crate::data::SECOND;
use crate::data::rfc3339;
use std::fmt::Write;

/// Start of every window: 2026-01-12T00:00:00Z.
const START: i64 = 1_768_176_000 * SECOND;
/// Seconds of a step of the truth.
const STEP: usize = 15;
/// Seconds between samples.
const SAMPLE: usize = 600;

/// The parameters of the model `tite`, but for the envelope's temperature at the start, which each twin
/// draws.
const PARAMETERS: [(&str, f64); 5] =
    [("alpha_e", 0.8), ("beta_e", 4.0), ("alpha_a", 0.08), ("c_P_heater", 1.6), ("c_solar", 2.5)];
/// Diffusions of room air and envelope in K per square root of an hour, and the deviation of the sensor in K.
const NOISE: [f64; 3] = [0.15, 0.10, 0.05];

/// A synthetic room of the model `tite` with process noise.
#[derive(Debug, Clone)]
pub struct NoisyTwin {
    /// The measurements as CSV.
    pub csv: String,
    /// The true values by name: the parameters, `sigma(T_r)`, `sigma(T_e)` and `sd(T_room)`.
    pub truth: Vec<(String, f64)>,
}

/// Makes a room with so many days of samples, ten minutes apart, so that a training part of as many days
/// starts where the truth does. The drift goes by Heun's method over steps of 15 seconds, and the noise,
/// which no state changes, is exact in each; heater, sun and weather are as the model reads them between
/// samples.
pub fn noisy(seed: u64, days: usize) -> NoisyTwin {
    let mut dice = Dice::new(seed);
    let samples = days * 86_400 / SAMPLE;
    let day = 86_400.0 / SAMPLE as f64;
    let outdoors: Vec<f64> = dice.wander(samples, 3.0, day).into_iter().map(|x| 3.0 + x).collect();
    let clear = dice.wander(samples, 0.5, day / 8.0);
    let sun: Vec<f64> = clear
        .iter()
        .enumerate()
        .map(|(k, x)| {
            (500.0
                * (std::f64::consts::TAU * (k as f64 / day - 0.25)).sin()
                * (0.6 + 0.5 * x).clamp(0.1, 1.0))
            .max(0.0)
        })
        .collect();
    let mut on = false;
    let heater: Vec<f64> = (0..samples)
        .map(|_| {
            on = if dice.uniform() < 0.06 { !on } else { on };
            if on { 2.0 } else { 0.0 }
        })
        .collect();
    let [alpha_e, beta_e, alpha_a, gain, solar] = PARAMETERS.map(|(_, value)| value);
    let start = dice.between(18.0, 22.0);
    let (mut room, mut envelope) = (20.0 + dice.normal(), start);
    let parts = SAMPLE / STEP;
    let hours = STEP as f64 / 3600.0;
    let mut csv = String::from("time,T_room,T_out,P_heater,irradiance\n");
    for k in 0..samples {
        let measured = room + NOISE[2] * dice.normal();
        let time = rfc3339(START + (k * SAMPLE) as i64 * SECOND);
        let _ = writeln!(csv, "{time},{measured:.6},{:.6},{:.3},{:.6}", outdoors[k], heater[k], sun[k]);
        let next = (k + 1).min(samples - 1);
        let between = |values: &[f64], share: f64| values[k] + (values[next] - values[k]) * share;
        let rate = |room: f64, envelope: f64, share: f64| {
            let air = alpha_e * (envelope - room) + gain * heater[k] + solar * between(&sun, share) / 1000.0;
            (air, alpha_e / beta_e * (room - envelope) + alpha_a * (between(&outdoors, share) - envelope))
        };
        for part in 0..parts {
            let (from, to) = (part as f64 / parts as f64, (part + 1) as f64 / parts as f64);
            let first = rate(room, envelope, from);
            let second = rate(room + hours * first.0, envelope + hours * first.1, to);
            room += 0.5 * hours * (first.0 + second.0) + NOISE[0] * hours.sqrt() * dice.normal();
            envelope += 0.5 * hours * (first.1 + second.1) + NOISE[1] * hours.sqrt() * dice.normal();
        }
    }
    let noise = ["sigma(T_r)", "sigma(T_e)", "sd(T_room)"].into_iter().zip(NOISE);
    let truth = PARAMETERS.into_iter().chain([("T_e0", start)]).chain(noise);
    NoisyTwin { csv, truth: truth.map(|(name, value)| (name.to_owned(), value)).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_noisy_room_is_plausible_and_the_same_for_the_same_seed() {
        let twin = noisy(3, 4);
        assert_eq!(twin.csv, noisy(3, 4).csv);
        assert_ne!(twin.csv, noisy(4, 4).csv);
        let temperatures: Vec<f64> =
            twin.csv.lines().skip(1).map(|line| line.split(',').nth(1).unwrap().parse().unwrap()).collect();
        assert_eq!(temperatures.len(), 4 * 144);
        assert!(temperatures.iter().all(|t| (5.0..45.0).contains(t)), "{temperatures:?}");
    }
}
