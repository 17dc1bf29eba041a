//! What is minimised, as a divisor of squared residuals: the mean of all of them is the objective.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The correlation weight of the thesis.
const USUAL_DELTA: f64 = 0.5;
/// The least that the shape-weighted error is divided by (thesis eq. 7.6).
const LEAST_DIVISOR: f64 = 1e-3;
/// An output whose variance is below this share of its noise has not moved.
const STILL: f64 = 1e-6;

/// `delta` of thesis eq. 7.6, from 0 to 1: 1 looks at the error alone, 0 divides it by the correlation of the
/// shapes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "f64", into = "f64")]
pub struct ShapeDelta(f64);

impl ShapeDelta {
    /// Whether it is the thesis's own, which documents need not name.
    pub fn is_usual(&self) -> bool {
        self.0 == USUAL_DELTA
    }

    /// `max(delta + (1 - delta) r, 1e-3)` of eq. 7.6, with r = 0 where a series is constant.
    fn divisor(self, pairs: impl Iterator<Item = (f64, f64)> + Clone) -> f64 {
        (self.0 + (1.0 - self.0) * correlation(pairs)).max(LEAST_DIVISOR)
    }
}

impl Default for ShapeDelta {
    fn default() -> Self {
        Self(USUAL_DELTA)
    }
}

impl TryFrom<f64> for ShapeDelta {
    type Error = String;

    fn try_from(delta: f64) -> Result<Self, String> {
        if (0.0..=1.0).contains(&delta) {
            Ok(Self(delta))
        } else {
            Err(format!("delta is a number from 0 to 1, not {delta}"))
        }
    }
}

impl From<ShapeDelta> for f64 {
    fn from(delta: ShapeDelta) -> f64 {
        delta.0
    }
}

/// The shape-weighted mean square error of simulated and measured values (thesis eq. 7.6); `None` for no
/// values.
pub fn swmse(pairs: &[(f64, f64)], delta: ShapeDelta) -> Option<f64> {
    let mean = pairs.iter().map(|(simulated, measured)| (simulated - measured).powi(2)).sum::<f64>()
        / pairs.len() as f64;
    Some(mean / delta.divisor(pairs.iter().copied())).filter(|error| error.is_finite())
}

/// What an output is among the others.
#[derive(Debug, Clone, Copy)]
pub struct Share {
    /// Variance of its sensor.
    pub noise: f64,
    /// How many outputs there are.
    pub outputs: usize,
    /// How many residuals all outputs have together.
    pub total: usize,
}

/// What each squared residual of an output is divided by. `pairs` are its simulated and measured values.
///
/// The mean square errors of several outputs are weighed by their noise, except where the objective
/// normalises them itself.
pub fn divisor(
    objective: Objective,
    delta: ShapeDelta,
    pairs: impl Iterator<Item = (f64, f64)> + Clone,
    share: &Share,
) -> f64 {
    let weight = if share.outputs == 1 { 1.0 } else { share.noise };
    match objective {
        // Free runs are compared by their errors whatever is searched for.
        Objective::Mse | Objective::Likelihood => weight,
        Objective::Swmse => weight * delta.divisor(pairs),
        Objective::Nmse => {
            let n = pairs.clone().count() as f64;
            let variance = variance(pairs.map(|(_, measured)| measured));
            let scale = if variance > STILL * share.noise { variance } else { share.noise };
            // The mean over all residuals has to become the mean over the outputs of their own means.
            scale * n * share.outputs as f64 / share.total as f64
        }
    }
}

/// Mean square of the deviations from the mean.
fn variance(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let n = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / n;
    values.map(|value| (value - mean).powi(2)).sum::<f64>() / n
}

/// Pearson's correlation, 0 where a series is constant.
fn correlation(pairs: impl Iterator<Item = (f64, f64)> + Clone) -> f64 {
    let n = pairs.clone().count() as f64;
    let (sum_a, sum_b) = pairs.clone().fold((0.0, 0.0), |(a, b), (x, y)| (a + x, b + y));
    let (mean_a, mean_b) = (sum_a / n, sum_b / n);
    let (mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0);
    for (x, y) in pairs {
        let (x, y) = (x - mean_a, y - mean_b);
        aa += x * x;
        bb += y * y;
        ab += x * y;
    }
    if aa > 0.0 && bb > 0.0 { ab / (aa * bb).sqrt() } else { 0.0 }
}

/// What is minimised on the training part.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Objective {
    /// Mean square error of the free run (thesis eq. 6.6).
    #[default]
    Mse,
    /// Mean square error weighted by the correlation of the shapes (thesis eq. 7.6).
    Swmse,
    /// Mean square error of each output over the variance of its measurements, averaged over the outputs:
    /// `1/J sum_j [mean_k (y_j(k) - ym_j(k))^2 / mean_k (ym_j(k) - mean ym_j)^2]`. It is 1 for a model that
    /// knows nothing but the means, and outputs of any size and number of samples count alike.
    Nmse,
    /// The likelihood of one-step innovations under the stochastic model; it goes with the method `ctsm`, as
    /// the others go with the other methods.
    Likelihood,
}

impl Objective {
    /// The word for documents.
    pub fn as_str(self) -> &'static str {
        match self {
            Objective::Mse => "mse",
            Objective::Swmse => "swmse",
            Objective::Nmse => "nmse",
            Objective::Likelihood => "likelihood",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shape_divisor_is_that_of_equation_7_6() {
        let wave: Vec<(f64, f64)> =
            (0..50).map(|i| (f64::from(i).sin(), 2.0 * f64::from(i).sin() + 1.0)).collect();
        let usual = ShapeDelta::default();
        assert!((usual.divisor(wave.iter().copied()) - 1.0).abs() < 1e-12);
        let mirrored: Vec<(f64, f64)> = wave.iter().map(|(x, y)| (*x, -y)).collect();
        assert!((usual.divisor(mirrored.iter().copied()) - 1e-3).abs() < 1e-12);
        // A constant output has no shape: r = 0, whichever of the two stands still.
        let constant: Vec<(f64, f64)> = wave.iter().map(|(x, _)| (*x, 3.0)).collect();
        let still: Vec<(f64, f64)> = wave.iter().map(|(_, y)| (3.0, *y)).collect();
        for delta in [0.0, 0.25, 0.5, 1.0] {
            let delta = ShapeDelta::try_from(delta).unwrap();
            for pairs in [&constant, &still] {
                let mean = pairs.iter().map(|(x, y)| (x - y).powi(2)).sum::<f64>() / 50.0;
                let expected = mean / f64::from(delta).max(1e-3);
                assert!((swmse(pairs, delta).unwrap() / expected - 1.0).abs() < 1e-12);
            }
        }
        assert_eq!(swmse(&[], usual), None);
        assert!(ShapeDelta::try_from(1.5).is_err() && ShapeDelta::try_from(f64::NAN).is_err());
    }

    #[test]
    fn the_normalised_error_is_the_mean_of_each_outputs_error_over_its_variance() {
        let large: Vec<(f64, f64)> =
            (0..40).map(|i| (1000.0 + f64::from(i), 1000.0 + 1.5 * f64::from(i))).collect();
        let small: Vec<(f64, f64)> =
            (0..13).map(|i| (0.02 * f64::from(i), 0.03 * f64::from(i % 3))).collect();
        let still: Vec<(f64, f64)> = (0..7).map(|i| (5.0 + 0.1 * f64::from(i), 5.0)).collect();
        let outputs = [&large, &small, &still];
        let total = 60;
        let mut squares = 0.0;
        for pairs in outputs {
            let divisor = divisor(
                Objective::Nmse,
                ShapeDelta::default(),
                pairs.iter().copied(),
                &Share { noise: 0.01, outputs: 3, total },
            );
            squares += pairs.iter().map(|(x, y)| (x - y).powi(2)).sum::<f64>() / divisor;
        }
        let by_hand = |pairs: &[(f64, f64)]| {
            let n = pairs.len() as f64;
            let mean = pairs.iter().map(|(_, y)| y).sum::<f64>() / n;
            let variance = pairs.iter().map(|(_, y)| (y - mean) * (y - mean)).sum::<f64>() / n;
            pairs.iter().map(|(x, y)| (x - y) * (x - y)).sum::<f64>() / n / variance
        };
        let last = still.iter().map(|(x, y)| (x - y).powi(2)).sum::<f64>() / 7.0 / 0.01;
        let expected = (by_hand(&large) + by_hand(&small) + last) / 3.0;
        assert!(
            (squares / total as f64 - expected).abs() < 1e-12 * expected,
            "{} {expected}",
            squares / total as f64
        );
        // A model that knows the mean alone costs one.
        let mean: Vec<(f64, f64)> = large.iter().map(|(_, y)| (1029.25, *y)).collect();
        let share = Share { noise: 0.01, outputs: 1, total: 40 };
        let divisor = divisor(Objective::Nmse, ShapeDelta::default(), mean.iter().copied(), &share);
        let one = mean.iter().map(|(x, y)| (x - y).powi(2)).sum::<f64>() / 40.0 / divisor;
        assert!((one - 1.0).abs() < 1e-12, "{one}");
    }
}
