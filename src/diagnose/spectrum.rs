//! What is left in series that should be noise: correlation with inputs, with their own past, and by frequency.

use crate::estimate::Problem;
use serde::Serialize;
use utoipa::ToSchema;

/// Longest lag of an input, in hours.
const LAG_HOURS: f64 = 6.0;
/// Lags of the autocorrelation.
const LAGS: usize = 48;
/// Frequencies of the cumulated periodogram that are kept.
const FREQUENCIES: usize = 128;
/// Longest stretch that is transformed; the transform is a plain sum.
const LONGEST: usize = 1024;

/// How a residual goes with an input.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct InputLag {
    /// The input's channel.
    pub channel: String,
    /// The correlation at the lag where it is largest in size. It names a companion, no cause.
    pub correlation: f64,
    /// The lag in hours: the residual follows the input by so much.
    pub lag_hours: f64,
}

/// The innovations by lag and by frequency.
#[derive(Debug, Clone, PartialEq, Default, Serialize, ToSchema)]
pub struct Spectrum {
    /// Innovations compared.
    pub n: usize,
    /// Autocorrelation at lags 1, 2, … samples.
    pub acf: Vec<f64>,
    /// The 95 % band of the autocorrelation of white noise.
    pub acf_band: f64,
    /// Cumulated periodogram at even frequencies from 0 to half the sampling rate; a straight line for white noise.
    pub cumulated_periodogram: Vec<f64>,
    /// Largest distance from the straight line.
    pub largest_distance: f64,
    /// The 95 % limit of that distance for white noise (Kolmogorov and Smirnov).
    pub distance_limit: f64,
}

/// The lag of every input of the grid at which the residual goes with it most, the strongest first.
pub fn input_lags(problem: &Problem, error: &[f64], usable: &[usize]) -> Vec<InputLag> {
    let grid = problem.grid();
    let longest = (LAG_HOURS / grid.step_hours()) as usize;
    let mut lags: Vec<InputLag> = grid
        .columns()
        .filter(|(channel, _)| problem.model().outputs().iter().all(|output| output.channel != *channel))
        .map(|(channel, column)| {
            let at = |lag: usize| correlation(usable.iter().filter(|k| **k >= lag).map(|k| (error[*k], column.values()[k - lag])));
            let best = (0..=longest)
                .map(|lag| (at(lag), lag))
                .fold((0.0, 0), |best, one| if f64::abs(one.0) > f64::abs(best.0) { one } else { best });
            InputLag { channel: channel.to_owned(), correlation: best.0, lag_hours: best.1 as f64 * grid.step_hours() }
        })
        .collect();
    lags.sort_by(|a, b| b.correlation.abs().total_cmp(&a.correlation.abs()));
    lags
}

/// Pearson's correlation; 0 where a series is constant.
fn correlation(pairs: impl Iterator<Item = (f64, f64)>) -> f64 {
    let (mut n, mut x, mut y, mut xx, mut yy, mut xy) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    for (a, b) in pairs {
        n += 1.0;
        x += a;
        y += b;
        xx += a * a;
        yy += b * b;
        xy += a * b;
    }
    let spread = (xx - x * x / n) * (yy - y * y / n);
    if spread > 0.0 { (xy - x * y / n) / spread.sqrt() } else { 0.0 }
}

/// Autocorrelation and cumulated periodogram of innovations, whose gaps are closed up.
pub fn spectrum(innovations: &[Option<f64>]) -> Spectrum {
    let known: Vec<f64> = innovations.iter().flatten().copied().collect();
    let n = known.len();
    if n < 8 {
        return Spectrum::default();
    }
    let mean = known.iter().sum::<f64>() / n as f64;
    let series: Vec<f64> = known.iter().map(|value| value - mean).collect();
    let power: f64 = series.iter().map(|x| x * x).sum();
    let acf = (1..=LAGS.min(n / 4))
        .map(|lag| series[lag..].iter().zip(&series).map(|(a, b)| a * b).sum::<f64>() / power.max(f64::MIN_POSITIVE))
        .collect();
    let part = &series[n - n.min(LONGEST)..];
    let half = (part.len() - 1) / 2;
    let periodogram = (1..=half).map(|frequency| {
        let angle = 2.0 * std::f64::consts::PI * frequency as f64 / part.len() as f64;
        let (sine, cosine) =
            part.iter().enumerate().fold((0.0, 0.0), |(s, c), (t, x)| (s + x * (angle * t as f64).sin(), c + x * (angle * t as f64).cos()));
        sine * sine + cosine * cosine
    });
    let mut cumulated: Vec<f64> = periodogram
        .scan(0.0, |sum, value| {
            *sum += value;
            Some(*sum)
        })
        .collect();
    let total = cumulated.last().copied().unwrap_or(1.0).max(f64::MIN_POSITIVE);
    cumulated.iter_mut().for_each(|value| *value /= total);
    let distance = |(i, value): (usize, &f64)| (value - (i + 1) as f64 / half as f64).abs();
    let largest_distance = cumulated.iter().enumerate().map(distance).fold(0.0, f64::max);
    let every = half.div_ceil(FREQUENCIES).max(1);
    Spectrum {
        n,
        acf,
        acf_band: 1.96 / (n as f64).sqrt(),
        cumulated_periodogram: cumulated.into_iter().step_by(every).collect(),
        largest_distance,
        distance_limit: 1.358 / (half as f64).sqrt(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_sine_stands_out_at_its_frequency_and_its_lag() {
        let wave: Vec<Option<f64>> = (0..512).map(|t| Some((2.0 * std::f64::consts::PI * f64::from(t) / 16.0).sin())).collect();
        let found = spectrum(&wave);
        assert!(found.acf[15] > 0.9 && found.acf[7] < -0.9, "{:?}", &found.acf[..16]);
        assert!(found.largest_distance > found.distance_limit);
        // All power lies at one sixteenth of the sampling rate, an eighth of the way to its half.
        let place = found.cumulated_periodogram.iter().position(|value| *value > 0.5).unwrap() as f64;
        assert!((place / found.cumulated_periodogram.len() as f64 - 0.125).abs() < 0.02);
        assert_eq!(spectrum(&[None; 20]), Spectrum::default());
    }

    #[test]
    fn correlation_is_that_of_the_closed_form() {
        let pairs: Vec<(f64, f64)> = vec![(1.0, 2.0), (2.0, 1.0), (3.0, 4.0), (4.0, 3.0)];
        assert!((correlation(pairs.into_iter()) - 0.6).abs() < 1e-12);
    }
}
