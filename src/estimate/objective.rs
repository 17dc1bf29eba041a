//! What is minimised, as a divisor of squared residuals: the mean of all of them is the objective.

use super::request::Objective;

/// The correlation weight of the shape-weighted error (thesis eq. 7.6).
const SHAPE_DELTA: f64 = 0.5;
/// An output whose variance is below this share of its noise has not moved.
const STILL: f64 = 1e-6;

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
/// The mean square errors of several outputs are weighed by their noise, except where the objective normalises
/// them itself.
pub fn divisor(objective: Objective, pairs: impl Iterator<Item = (f64, f64)> + Clone, share: &Share) -> f64 {
    let weight = if share.outputs == 1 { 1.0 } else { share.noise };
    match objective {
        // Free runs are compared by their errors whatever is searched for.
        Objective::Mse | Objective::Likelihood => weight,
        Objective::Swmse => weight * shape_divisor(pairs),
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

/// `max(delta + (1 - delta) r, 1e-3)` of eq. 7.6, with r = 0 where a series is constant.
fn shape_divisor(pairs: impl Iterator<Item = (f64, f64)> + Clone) -> f64 {
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
    let correlation = if aa > 0.0 && bb > 0.0 { ab / (aa * bb).sqrt() } else { 0.0 };
    (SHAPE_DELTA + (1.0 - SHAPE_DELTA) * correlation).max(1e-3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_shape_divisor_is_that_of_equation_7_6() {
        let wave: Vec<(f64, f64)> = (0..50).map(|i| (f64::from(i).sin(), 2.0 * f64::from(i).sin() + 1.0)).collect();
        assert!((shape_divisor(wave.iter().copied()) - 1.0).abs() < 1e-12);
        let mirrored: Vec<(f64, f64)> = wave.iter().map(|(x, y)| (*x, -y)).collect();
        assert!((shape_divisor(mirrored.iter().copied()) - 1e-3).abs() < 1e-12);
        let constant: Vec<(f64, f64)> = wave.iter().map(|(x, _)| (*x, 3.0)).collect();
        assert!((shape_divisor(constant.iter().copied()) - 0.5).abs() < 1e-12);
    }

    #[test]
    fn the_normalised_error_is_the_mean_of_each_outputs_error_over_its_variance() {
        let large: Vec<(f64, f64)> = (0..40).map(|i| (1000.0 + f64::from(i), 1000.0 + 1.5 * f64::from(i))).collect();
        let small: Vec<(f64, f64)> = (0..13).map(|i| (0.02 * f64::from(i), 0.03 * f64::from(i % 3))).collect();
        let still: Vec<(f64, f64)> = (0..7).map(|i| (5.0 + 0.1 * f64::from(i), 5.0)).collect();
        let outputs = [&large, &small, &still];
        let total = 60;
        let mut squares = 0.0;
        for pairs in outputs {
            let divisor = divisor(Objective::Nmse, pairs.iter().copied(), &Share { noise: 0.01, outputs: 3, total });
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
        assert!((squares / total as f64 - expected).abs() < 1e-12 * expected, "{} {expected}", squares / total as f64);
        // A model that knows the mean alone costs one.
        let mean: Vec<(f64, f64)> = large.iter().map(|(_, y)| (1029.25, *y)).collect();
        let share = Share { noise: 0.01, outputs: 1, total: 40 };
        let one = mean.iter().map(|(x, y)| (x - y).powi(2)).sum::<f64>() / 40.0 / divisor(Objective::Nmse, mean.iter().copied(), &share);
        assert!((one - 1.0).abs() < 1e-12, "{one}");
    }
}
