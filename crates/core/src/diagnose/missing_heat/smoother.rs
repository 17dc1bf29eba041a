//! A Kalman filter over the record, and the fixed-interval smoother of Bierman (1973, "Fixed interval
//! smoothing with discrete measurements", International Journal of Control 18): from the end backwards it
//! adds up what later values say, and inverts no covariance, so that what is known exactly does no harm.

use super::guesses::{Guess, GuessedRecord};
use super::record::LinearRecord;
use crate::interrupt::Brake;
use nalgebra::{DMatrix, DVector};

/// The likeliest is found to this factor.
const NEAR: f64 = 1.08;
/// How long the missing rate may remember, in hours.
const MEMORY: [f64; 2] = [0.2, 72.0];
/// How far sensor and size may lie from where the search begins, as factors. A sensor is no better than it is
/// said to be by much, or jumps of the heat would be laid to the room.
const SENSOR: [f64; 2] = [0.7, 10.0];
const SIZE: [f64; 2] = [3e-3, 300.0];

/// What a better guess gains in the logarithm of the likelihood at least.
const GAIN: f64 = 1e-6;

/// What is known of everything that is sought at a sample.
pub(in crate::diagnose) type Smoothed = (DVector<f64>, DMatrix<f64>);

/// What a value changed.
pub(in crate::diagnose) struct Update {
    pub row: DVector<f64>,
    pub gain: DVector<f64>,
    pub innovation: f64,
    pub variance: f64,
    /// The output that it is of.
    pub output: usize,
}

/// A sample of a filter's pass: what is known before its values, what each of them changed, and the step to
/// the next one.
pub(in crate::diagnose) struct Sample {
    before: Smoothed,
    pub updates: Vec<Update>,
    pub step: Option<DMatrix<f64>>,
}

/// Everything that is sought at each sample, given all of the record.
pub(super) fn smooth(record: &LinearRecord, guess: Guess) -> Vec<Smoothed> {
    let (samples, _) = passed(record, guess);
    let width = record.width();
    // What all later values say: the gradient and the curvature of minus the logarithm of their likelihood.
    let mut slope = DVector::zeros(width);
    let mut curvature = DMatrix::zeros(width, width);
    let mut smoothed: Vec<Smoothed> = Vec::with_capacity(samples.len());
    for sample in samples.iter().rev() {
        if let Some(step) = &sample.step {
            slope = step.tr_mul(&slope);
            curvature = step.tr_mul(&curvature) * step;
        }
        for Update { row, gain, innovation, variance, .. } in sample.updates.iter().rev() {
            let along = gain.dot(&slope) + innovation / variance;
            slope.axpy(-along, row, 1.0);
            let bent = &curvature * gain;
            let of_row = gain.dot(&bent) + 1.0 / variance;
            curvature.ger(-1.0, row, &bent, 1.0);
            curvature.ger(-1.0, &bent, row, 1.0);
            curvature.ger(of_row, row, row, 1.0);
        }
        let (mean, covariance) = &sample.before;
        smoothed.push((mean - covariance * &slope, covariance - covariance * &curvature * covariance));
    }
    smoothed.reverse();
    smoothed
}

/// The likeliest guess, by a search along the axes of the logarithms: all neighbours side by side. `begin` is
/// where it begins, `middle` what the bounds are of.
pub(in crate::diagnose) fn likeliest(
    record: &LinearRecord,
    begin: Guess,
    middle: Guess,
    brake: &Brake,
) -> Guess {
    let within = |value: f64, of: f64, [low, high]: [f64; 2]| value.clamp(low * of, high * of);
    let bounded = |guess: Guess| Guess {
        sensor: within(guess.sensor, middle.sensor, SENSOR),
        size: within(guess.size, middle.size, SIZE),
        memory: within(guess.memory, 1.0, MEMORY),
    };
    let guessed = GuessedRecord::new(record);
    let mut best = begin;
    let mut factor = 2.0_f64;
    while factor > NEAR {
        brake.check();
        let less = factor.recip();
        let neighbours = [
            best,
            Guess { sensor: best.sensor * factor, ..best },
            Guess { sensor: best.sensor * less, ..best },
            Guess { size: best.size * factor, ..best },
            Guess { size: best.size * less, ..best },
            Guess { memory: best.memory * factor, ..best },
            Guess { memory: best.memory * less, ..best },
            // Along the ridge on which slow and little is as likely as fast and much.
            Guess { size: best.size * factor, memory: best.memory * less, ..best },
        ]
        .map(bounded);
        let found = guessed.likelihoods(&neighbours);
        let better = found.iter().zip(neighbours).max_by(|one, other| one.0.total_cmp(other.0));
        match better.filter(|(value, _)| **value > found[0] + GAIN) {
            Some((_, guess)) => best = guess,
            None => factor = factor.sqrt(),
        }
    }
    best
}

/// Every sample of the filter's pass, and the logarithm of the likelihood of the record without its constant.
pub(in crate::diagnose) fn passed(record: &LinearRecord, guess: Guess) -> (Vec<Sample>, f64) {
    let mut samples = Vec::with_capacity(record.readings.len());
    let fades = (-record.hours / guess.memory).exp();
    let rate = record.rate();
    let (mut mean, mut covariance) = record.begin(guess.size.powi(2));
    let mut likelihood = 0.0;
    let mut matrix = covariance.clone();
    let (mut half, mut next) = (covariance.clone(), mean.clone());
    let mut spread = mean.clone();
    for (k, readings) in record.readings.iter().enumerate() {
        let before = (mean.clone(), covariance.clone());
        let mut updates = Vec::new();
        for reading in readings {
            let innovation = reading.value - reading.constant - reading.row.dot(&mean);
            spread.gemv(1.0, &covariance, &reading.row, 0.0);
            let variance = reading.row.dot(&spread) + (guess.sensor * reading.scale).powi(2);
            likelihood -= 0.5 * (innovation * innovation / variance + variance.ln());
            mean.axpy(innovation / variance, &spread, 1.0);
            covariance.ger(-1.0 / variance, &spread, &spread, 1.0);
            updates.push(Update {
                row: reading.row.clone(),
                gain: &spread / variance,
                innovation,
                variance,
                output: reading.output,
            });
        }
        let step = record.steps.get(k).map(|step| {
            matrix.copy_from(&step.matrix);
            matrix[(rate, rate)] = fades;
            next.copy_from(&step.constant);
            next.gemv(1.0, &matrix, &mean, 1.0);
            mean.copy_from(&next);
            half.gemm(1.0, &matrix, &covariance, 0.0);
            covariance.copy_from(&step.covariance);
            covariance.gemm(1.0, &half, &matrix.transpose(), 1.0);
            covariance[(rate, rate)] += guess.size.powi(2) * (1.0 - fades * fades);
            matrix.clone()
        });
        samples.push(Sample { before, updates, step });
    }
    (samples, if likelihood.is_finite() { likelihood } else { f64::NEG_INFINITY })
}
