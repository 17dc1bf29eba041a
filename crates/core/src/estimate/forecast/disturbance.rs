//! What the model does not explain now: a steady change of the measured state that fades.
//!
//! The linear steps of the last days get one state more, an Ornstein-Uhlenbeck process d that is added to
//! the rate of the state which the first output shows. Its size, its time constant and how much of the
//! process noise is left to the states are those of a grid under which the innovations are most likely;
//! where that is no better than without d, nothing is told. Controllers that are to reach their set points
//! without an offset take d as known and fading (Pannocchia and Rawlings, AIChE Journal 49, 2003).

use super::ahead::Onward;
use crate::simulate::linearise::{LinearStep, Linearisation};
use crate::units::error_unit;
use nalgebra::{DMatrix, DVector};
use serde::Serialize;
use utoipa::ToSchema;

/// How far back is looked, in hours.
const PAST_H: f64 = 72.0;
/// Time constants, in hours.
const TIME_CONSTANTS_H: [f64; 3] = [2.0, 6.0, 24.0];
/// Sizes, in deviations of the sensor's noise per hour.
const SIZES: [f64; 4] = [1.0, 3.0, 10.0, 30.0];
/// What is left of the variances of the process noise.
const SHARES: [f64; 3] = [1.0, 0.25, 0.05];
/// By how much the likelihood must rise, in its logarithm: a chance of one in a hundred for two more numbers.
const GAIN: f64 = 4.6;

/// A rate of change that the model does not explain.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct Disturbance {
    /// The state that it adds to.
    pub state: String,
    /// The unit of the rate.
    #[schema(example = "K/h")]
    pub unit: String,
    /// The rate now.
    pub value: f64,
    /// Its standard deviation.
    pub sd: f64,
    /// It fades with this time constant.
    pub time_constant_h: f64,
    /// The same in a sentence.
    pub comment: String,
}

/// What the filter sees now; `None` where these measurements show none.
pub(super) fn disturbance(ahead: &Onward, theta: &[f64]) -> Option<Disturbance> {
    let (problem, inputs) = (ahead.problem, ahead.problem.inputs());
    let (model, now) = (problem.model(), ahead.now);
    let back = (PAST_H / inputs.hours()) as usize;
    // Behind a gap in the inputs.
    let gap = (0..now).rev().find(|k| !inputs.known(*k)).map_or(0, |k| k + 1);
    let first = now.saturating_sub(back).max(gap);
    let filtered = ahead.filtered(theta);
    let (states, deviations) = (filtered.states.get(first)?, filtered.deviations.get(first)?);
    let linear = Linearisation::of_states(model, inputs, theta);
    let steps = linear.steps(first..now, states, &ahead.noise, problem.brake())?;
    let measured: Vec<Vec<Option<f64>>> = problem
        .measured()
        .iter()
        .map(|(values, valid)| (first..now).map(|k| valid[k].then_some(values[k])).collect())
        .collect();
    let record = Record {
        steps: &steps,
        measured: &measured,
        variances: &ahead.noise.measurement,
        hours: inputs.hours(),
    };
    let seen = record.seen(states, deviations)?;
    let state = model.states().get(seen.state)?;
    let unit = format!("{}/h", error_unit(&state.unit));
    let (does, to) = if seen.value < 0.0 { ("takes", "from") } else { ("adds", "to") };
    let comment = format!(
        "what the model does not know of {does} {:.2} {unit} {to} {} now (sd {:.2}), and fades within {} h",
        seen.value.abs(),
        state.name,
        seen.sd,
        seen.time_constant_h
    );
    Some(Disturbance {
        state: state.name.clone(),
        unit,
        value: seen.value,
        sd: seen.sd,
        time_constant_h: seen.time_constant_h,
        comment,
    })
}

/// The linear steps of a stretch of time, and what was measured at the start of each.
pub(super) struct Record<'a> {
    pub steps: &'a [LinearStep],
    /// By output.
    pub measured: &'a [Vec<Option<f64>>],
    /// Variances of the sensors.
    pub variances: &'a [f64],
    /// The length of a step.
    pub hours: f64,
}

/// What was found.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct SeenRate {
    /// The state that it adds to.
    pub state: usize,
    pub value: f64,
    pub sd: f64,
    pub time_constant_h: f64,
}

/// A disturbance as it may be: its stationary deviation and its time constant.
#[derive(Debug, Clone, Copy)]
struct Guess {
    size: f64,
    time_constant_h: f64,
}

impl Record<'_> {
    /// The likeliest disturbance, from what is known of the states at the start.
    pub fn seen(&self, states: &[f64], deviations: &[f64]) -> Option<SeenRate> {
        let last = self.steps.last()?;
        let n = states.len();
        let shown = |place: &usize| last.c[*place].abs();
        let state = (0..n).max_by(|a, b| shown(a).total_cmp(&shown(b)))?;
        let run = |guess: Guess, share: f64| self.filter(states, deviations, state, guess, share);
        let best = |runs: Vec<(Guess, (f64, f64, f64))>| {
            runs.into_iter()
                .filter(|(_, (likelihood, ..))| likelihood.is_finite())
                .max_by(|(_, a), (_, b)| a.0.total_cmp(&b.0))
        };
        let none = Guess { size: 0.0, time_constant_h: 1.0 };
        let without = best(SHARES.map(|share| (none, run(none, share))).to_vec())?;
        let sensor = self.variances.first()?.sqrt();
        let mut runs = Vec::new();
        for time_constant_h in TIME_CONSTANTS_H {
            for size in SIZES {
                let guess = Guess { size: size * sensor, time_constant_h };
                runs.extend(SHARES.map(|share| (guess, run(guess, share))));
            }
        }
        let (guess, (likelihood, value, sd)) = best(runs)?;
        let Guess { time_constant_h, .. } = guess;
        (likelihood - without.1.0 >= GAIN).then_some(SeenRate { state, value, sd, time_constant_h })
    }

    /// A Kalman filter over the steps: the logarithm of the likelihood, and the disturbance at the end with
    /// its deviation.
    fn filter(
        &self,
        states: &[f64],
        deviations: &[f64],
        state: usize,
        guess: Guess,
        share: f64,
    ) -> (f64, f64, f64) {
        let n = states.len();
        let fades = (-self.hours / guess.time_constant_h).exp();
        let added = guess.size * guess.size;
        let mut z = DVector::from_iterator(n + 1, states.iter().copied().chain([0.0]));
        let variances = deviations.iter().map(|deviation| deviation * deviation).chain([added]);
        let mut p = DMatrix::from_diagonal(&DVector::from_iterator(n + 1, variances));
        let mut likelihood = 0.0;
        for (k, step) in self.steps.iter().enumerate() {
            for (output, measured) in self.measured.iter().enumerate() {
                let Some(measured) = measured[k] else { continue };
                let row = DVector::from_iterator(
                    n + 1,
                    step.c[output * n..(output + 1) * n].iter().copied().chain([0.0]),
                );
                let at = |values: &[f64]| -> f64 {
                    values.iter().zip(row.iter()).map(|(value, slope)| value * slope).sum()
                };
                let expected = step.outputs[output] + at(z.as_slice()) - at(&step.states);
                let spread = &p * &row;
                let variance = row.dot(&spread) + self.variances[output];
                let innovation = measured - expected;
                likelihood -= 0.5 * (innovation * innovation / variance + variance.ln());
                z += &spread * (innovation / variance);
                p -= &spread * spread.transpose() / variance;
            }
            let mut f = DMatrix::zeros(n + 1, n + 1);
            for i in 0..n {
                (0..n).for_each(|j| f[(i, j)] = step.a[i * n + j]);
                f[(i, n)] = step.g[i * n + state];
            }
            f[(n, n)] = fades;
            // Around the point where the step was linearised; the disturbance fades to nothing.
            let from = DVector::from_iterator(n + 1, step.states.iter().copied().chain([0.0]));
            let to = DVector::from_iterator(n + 1, step.next.iter().copied().chain([0.0]));
            z = to + &f * (z - from);
            p = &f * p * f.transpose();
            for i in 0..n {
                (0..n).for_each(|j| p[(i, j)] += share * step.q[i * n + j]);
            }
            p[(n, n)] += added * (1.0 - fades * fades);
        }
        (likelihood, z[n], p[(n, n)].max(0.0).sqrt())
    }
}
