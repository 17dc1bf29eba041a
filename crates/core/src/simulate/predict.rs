//! Where a model goes from states that are known so well: while nothing is measured, or with what is measured
//! from then on.

use super::kalman::{Filtered, Kalman, Noise};

/// States as they are believed to be.
#[derive(Debug, Clone, PartialEq)]
pub struct Belief {
    /// Their mean.
    pub states: Vec<f64>,
    /// Their covariance, by rows.
    pub covariance: Vec<f64>,
}

impl Belief {
    /// What a filter believes at its last sample.
    pub fn of(filtered: Filtered) -> Self {
        Self { states: filtered.states.last().cloned().unwrap_or_default(), covariance: filtered.covariance }
    }
}

/// What is predicted at each sample, in the order of the samples.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Prediction {
    /// The states.
    pub states: Vec<Vec<f64>>,
    /// Their standard deviations: what is not known of the states at the start, and the process noise since.
    pub deviations: Vec<Vec<f64>>,
    /// The outputs.
    pub outputs: Vec<Vec<f64>>,
    /// The standard deviations of the outputs by those of the states, without the noise of their sensors.
    pub output_deviations: Vec<Vec<f64>>,
}

/// Where a filter has come to.
#[derive(Debug, Clone, PartialEq)]
pub struct Advanced {
    /// What it believes there.
    pub belief: Belief,
    /// The innovations there, by output; `None` where nothing was measured.
    pub innovations: Vec<Option<f64>>,
}

impl Kalman<'_> {
    /// Filters on from what is believed at sample `first` to sample `last`: what a filter over both stretches
    /// finds there, as long as the inputs are known between them.
    pub fn go_on(
        &self,
        theta: &[f64],
        noise: &Noise,
        belief: &Belief,
        (first, last): (usize, usize),
    ) -> Advanced {
        let mut walk = self.walk(theta, noise);
        walk.x.copy_from_slice(&belief.states);
        walk.p.copy_from_slice(&belief.covariance);
        let mut innovations = vec![None; noise.measurement.len()];
        for k in first + 1..=last {
            self.advance(k - 1, &mut walk);
            for (output, innovation) in innovations.iter_mut().enumerate() {
                *innovation = self.update(output, k, false, noise, &mut walk, &mut 0.0);
            }
        }
        Advanced { belief: Belief { states: walk.x, covariance: walk.p }, innovations }
    }

    /// Goes on from what is believed at sample `first` to the end of the grid, or to the first interval over
    /// which an input is not known.
    pub fn predict(&self, theta: &[f64], noise: &Noise, first: usize, belief: &Belief) -> Prediction {
        let n = belief.states.len();
        let mut walk = self.walk(theta, noise);
        walk.x.copy_from_slice(&belief.states);
        walk.p.copy_from_slice(&belief.covariance);
        let mut found = Prediction::default();
        for k in first..self.known.len() {
            if k > first {
                if !self.known[k - 1] {
                    break;
                }
                self.advance(k - 1, &mut walk);
            }
            let outputs: Vec<(f64, f64)> =
                (0..noise.measurement.len()).map(|output| self.output(output, k, &mut walk)).collect();
            found.states.push(walk.x.clone());
            found.deviations.push((0..n).map(|i| walk.p[i * n + i].max(0.0).sqrt()).collect());
            found
                .output_deviations
                .push(outputs.iter().map(|(_, variance)| variance.max(0.0).sqrt()).collect());
            found.outputs.push(outputs.into_iter().map(|(value, _)| value).collect());
        }
        found
    }
}
