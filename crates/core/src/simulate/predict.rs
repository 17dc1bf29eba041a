//! Where a model goes from states that are known so well: while nothing is measured, or with what is measured
//! from then on.

use super::kalman::{Filtered, Kalman, Noise};
use super::lane::Lane;
use super::walk::Walk;

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
    /// A filter that goes on from what is believed.
    fn believing(&self, theta: &[f64], noise: &Noise, belief: &Belief) -> Walk<'_, 1> {
        let mut walk = self.walk::<1>(&[theta], std::slice::from_ref(noise));
        walk.x.iter_mut().zip(&belief.states).for_each(|(to, value)| *to = Lane([*value]));
        walk.p.iter_mut().zip(&belief.covariance).for_each(|(to, value)| *to = Lane([*value]));
        walk
    }

    /// Filters on from what is believed at sample `first` to sample `last`: what a filter over both stretches
    /// finds there, as long as the inputs are known between them.
    pub fn go_on(
        &self,
        theta: &[f64],
        noise: &Noise,
        belief: &Belief,
        (first, last): (usize, usize),
    ) -> Advanced {
        let mut walk = self.believing(theta, noise, belief);
        let mut innovations = vec![None; noise.measurement.len()];
        for k in first + 1..=last {
            walk.advance(k - 1);
            for (output, innovation) in innovations.iter_mut().enumerate() {
                *innovation = walk.update(output, k).map(|(innovation, _)| innovation.0[0]);
            }
        }
        let alone = |lanes: &[Lane<1>]| lanes.iter().map(|lanes| lanes.0[0]).collect();
        Advanced { belief: Belief { states: alone(&walk.x), covariance: alone(&walk.p) }, innovations }
    }

    /// Goes on from what is believed at sample `first` to the end of the grid, or to the first interval over
    /// which an input is not known.
    pub fn predict(&self, theta: &[f64], noise: &Noise, first: usize, belief: &Belief) -> Prediction {
        let n = belief.states.len();
        let alone = |(value, variance): (Lane<1>, Lane<1>)| (value.0[0], variance.0[0]);
        let mut walk = self.believing(theta, noise, belief);
        let mut found = Prediction::default();
        let inputs = self.simulator.inputs();
        for k in first..inputs.samples() {
            if k > first {
                if !inputs.known(k - 1) {
                    break;
                }
                walk.advance(k - 1);
            }
            let outputs: Vec<(f64, f64)> =
                (0..noise.measurement.len()).map(|output| walk.output(output, k)).map(alone).collect();
            found.states.push(walk.x.iter().map(|lanes| lanes.0[0]).collect());
            found.deviations.push((0..n).map(|i| walk.p[i * n + i].0[0].max(0.0).sqrt()).collect());
            found
                .output_deviations
                .push(outputs.iter().map(|(_, variance)| variance.max(0.0).sqrt()).collect());
            found.outputs.push(outputs.into_iter().map(|(value, _)| value).collect());
        }
        found
    }
}
