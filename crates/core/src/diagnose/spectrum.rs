//! What is left in series that should be noise: correlation with inputs, with their own past, and by
//! frequency.

use crate::data::{CALENDAR, Grid, is_compass};
use crate::estimate::Problem;
use crate::estimate::assess::regimes::circumstances;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// Longest lag at which an input is said to go with the residual most, in hours: a day on, the same hour
/// comes again.
const LAG_HOURS: f64 = 6.0;
/// Longest lag that is shown, and the least distance of two, in hours.
const SHOWN_LAG_HOURS: f64 = 24.0;
const SHOWN_LAG_STEP: f64 = 0.5;
/// Lags of the autocorrelation.
const LAGS: usize = 48;
/// Frequencies of the cumulated periodogram that are kept.
const FREQUENCIES: usize = 256;
/// Longest stretch that is transformed; the transform is a plain sum.
const LONGEST: usize = 4096;
/// Most peaks of the periodogram that are told, and the chance that noise shows one.
const PEAKS: usize = 4;
const PEAK_CHANCE: f64 = 0.05;
/// The frequencies that count as nearby: those next to a peak may share it.
const NEARBY: std::ops::RangeInclusive<usize> = 2..=8;
/// Longest period that is looked at, in days: longer ones come too few times.
const LONGEST_PERIOD_DAYS: f64 = 2.0;

/// How a residual goes with an input.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct InputLag {
    /// The input's channel.
    pub channel: String,
    /// The correlation at the lag where it is largest in size. It names a companion, no cause.
    pub correlation: f64,
    /// The lag in hours, six at most: the residual follows the input by so much.
    pub lag_hours: f64,
    /// Whether a controller may move it by what the output does: a valve, a mass flow, the power of a heater.
    /// There the input follows the output, and a correlation is weaker evidence.
    pub feedback: bool,
    /// The lags of `correlations` in hours, up to a day.
    pub lags_hours: Vec<f64>,
    /// The correlation at each of these lags. It has no band: a free-run residual depends on its own past, so
    /// that chance alone gives large ones.
    pub correlations: Vec<f64>,
}

/// The innovations by lag and by frequency.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct Spectrum {
    /// Innovations compared.
    pub n: usize,
    /// Autocorrelation at lags 1, 2, … samples.
    pub acf: Vec<f64>,
    /// The 95 % band of the autocorrelation of white noise.
    pub acf_band: f64,
    /// Hours between two samples: the unit of the lags.
    pub step_hours: f64,
    /// The frequencies of `cumulated_periodogram` in cycles a day, evenly up to half the sampling rate.
    pub cycles_per_day: Vec<f64>,
    /// Share of the power up to each frequency, over as many whole days as the newest samples hold; a
    /// straight line for white noise.
    pub cumulated_periodogram: Vec<f64>,
    /// Largest distance from the straight line.
    pub largest_distance: f64,
    /// The 95 % limit of that distance for white noise (Kolmogorov and Smirnov).
    pub distance_limit: f64,
    /// Periods up to two days that stand out of white noise and of the frequencies around them (95 %), the
    /// strongest first.
    pub peaks: Vec<Peak>,
}

/// A period that stands out.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Peak {
    /// The period in hours.
    pub period_hours: f64,
    /// Its share of the power.
    pub share: f64,
}

/// Whether a controller may move a channel by what the output does.
fn may_be_controlled(channel: &str) -> bool {
    matches!(channel, "flow" | "valve")
        || (channel.starts_with("P_") && channel.to_lowercase().contains("heat"))
}

/// The lag of every input of the grid at which the residual goes with it most, the strongest first.
pub fn input_lags(problem: &Problem, grid: &Grid, error: &[f64], usable: &[usize]) -> Vec<InputLag> {
    let longest = (LAG_HOURS / grid.step_hours()) as usize;
    let every = ((SHOWN_LAG_STEP / grid.step_hours()).round() as usize).max(1);
    let shown: Vec<usize> = (0..=(SHOWN_LAG_HOURS / grid.step_hours()) as usize).step_by(every).collect();
    // Neither the clock nor a compass has more and less.
    let mut lags: Vec<InputLag> = circumstances(problem, grid)
        .filter(|(channel, _)| !CALENDAR.contains(channel) && !is_compass(channel))
        .map(|(channel, column)| {
            let at = |lag: usize| {
                correlation(
                    usable.iter().filter(|k| **k >= lag).map(|k| (error[*k], column.values()[k - lag])),
                )
            };
            let best = (0..=longest)
                .map(|lag| (at(lag), lag))
                .fold((0.0, 0), |best, one| if f64::abs(one.0) > f64::abs(best.0) { one } else { best });
            InputLag {
                channel: channel.to_owned(),
                correlation: best.0,
                lag_hours: best.1 as f64 * grid.step_hours(),
                feedback: may_be_controlled(channel),
                lags_hours: shown.iter().map(|lag| *lag as f64 * grid.step_hours()).collect(),
                correlations: shown.iter().map(|lag| at(*lag)).collect(),
            }
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

/// Autocorrelation and cumulated periodogram of innovations that are so many hours apart, whose gaps are
/// closed up.
pub fn spectrum(innovations: &[Option<f64>], step_hours: f64) -> Spectrum {
    let known: Vec<f64> = innovations.iter().flatten().copied().collect();
    let n = known.len();
    if n < 8 {
        return Spectrum::default();
    }
    let mean = known.iter().sum::<f64>() / n as f64;
    let series: Vec<f64> = known.iter().map(|value| value - mean).collect();
    let power: f64 = series.iter().map(|x| x * x).sum();
    let acf = (1..=LAGS.min(n / 4))
        .map(|lag| {
            series[lag..].iter().zip(&series).map(|(a, b)| a * b).sum::<f64>() / power.max(f64::MIN_POSITIVE)
        })
        .collect();
    // Over whole days the day and its halves are frequencies of the transform, and do not spill into others.
    let (longest, day) = (n.min(LONGEST), ((24.0 / step_hours).round() as usize).max(1));
    let part = &series[n - if longest >= 2 * day { longest - longest % day } else { longest }..];
    let ordinates = periodogram(part);
    let half = ordinates.len();
    let total = ordinates.iter().sum::<f64>().max(f64::MIN_POSITIVE);
    let shares: Vec<f64> = ordinates.iter().map(|ordinate| ordinate / total).collect();
    let cumulated: Vec<f64> = shares
        .iter()
        .scan(0.0, |sum, value| {
            *sum += value;
            Some(*sum)
        })
        .collect();
    let distance = |(i, value): (usize, &f64)| (value - (i + 1) as f64 / half as f64).abs();
    let largest_distance = cumulated.iter().enumerate().map(distance).fold(0.0, f64::max);
    let every = half.div_ceil(FREQUENCIES).max(1);
    let days = part.len() as f64 * step_hours / 24.0;
    let first = ((days / LONGEST_PERIOD_DAYS).ceil() as usize).saturating_sub(1);
    let peak = |(index, share): (usize, f64)| Peak { period_hours: 24.0 * days / (index + 1) as f64, share };
    Spectrum {
        n,
        acf,
        acf_band: 1.96 / (n as f64).sqrt(),
        step_hours,
        cycles_per_day: (0..half).step_by(every).map(|index| (index + 1) as f64 / days).collect(),
        cumulated_periodogram: cumulated.into_iter().step_by(every).collect(),
        largest_distance,
        distance_limit: 1.358 / (half as f64).sqrt(),
        peaks: peaks(&shares, first).into_iter().map(peak).collect(),
    }
}

/// Squared amplitudes at the frequencies of a series, the mean and half the sampling rate left out.
fn periodogram(series: &[f64]) -> Vec<f64> {
    let ordinate = |frequency: usize| {
        let (s, c) = (2.0 * std::f64::consts::PI * frequency as f64 / series.len() as f64).sin_cos();
        // A pointer that turns by one angle at every sample stands for its sine and cosine.
        let mut pointer = (0.0, 1.0);
        let (sine, cosine) = series.iter().fold((0.0, 0.0), |(sine, cosine), x| {
            let sums = (sine + x * pointer.0, cosine + x * pointer.1);
            pointer = (pointer.0 * c + pointer.1 * s, pointer.1 * c - pointer.0 * s);
            sums
        });
        sine * sine + cosine * cosine
    };
    (1..=(series.len() - 1) / 2).map(ordinate).collect()
}

/// The shares that stand out both of white noise and of the frequencies around them, the largest first, with
/// their places; `first` is the first place that is looked at.
///
/// The largest of m shares of white noise exceeds x with a chance of about m (1 - x)^(m - 1) (Fisher 1929).
/// Coloured noise has larger shares somewhere: an ordinate over the mean of k others nearby exceeds x with a
/// chance of (1 + x/k)^-k, where the spectrum is level.
fn peaks(shares: &[f64], first: usize) -> Vec<(usize, f64)> {
    let m = shares.len() as f64;
    let white = 1.0 - (PEAK_CHANCE / m).powf(1.0 / (m - 1.0));
    let at = |index: Option<usize>| index.and_then(|index| shares.get(index)).copied();
    let stands_out = |(index, share): &(usize, f64)| {
        let nearby: Vec<f64> = NEARBY
            .flat_map(|away| [at(index.checked_sub(away)), at(index.checked_add(away))])
            .flatten()
            .collect();
        let k = nearby.len() as f64;
        let most = k * ((m / PEAK_CHANCE).powf(1.0 / k) - 1.0);
        let neighbours = [at(index.checked_sub(1)), at(Some(index + 1))];
        *share > white.max(most * nearby.iter().sum::<f64>() / k)
            && neighbours.into_iter().flatten().all(|other| *share >= other)
    };
    let mut found: Vec<(usize, f64)> =
        shares.iter().copied().enumerate().skip(first).filter(stands_out).collect();
    found.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    found.truncate(PEAKS);
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_xoshiro::Xoshiro256PlusPlus;

    #[test]
    fn a_sine_stands_out_at_its_frequency_and_its_lag() {
        let wave: Vec<Option<f64>> =
            (0..512).map(|t| Some((2.0 * std::f64::consts::PI * f64::from(t) / 16.0).sin())).collect();
        let found = spectrum(&wave, 0.5);
        assert!(found.acf[15] > 0.9 && found.acf[7] < -0.9, "{:?}", &found.acf[..16]);
        assert!(found.largest_distance > found.distance_limit);
        // All power lies at one sixteenth of the sampling rate, an eighth of the way to its half.
        let place = found.cumulated_periodogram.iter().position(|value| *value > 0.5).unwrap() as f64;
        assert!((place / found.cumulated_periodogram.len() as f64 - 0.125).abs() < 0.02);
        // Sixteen samples are eight hours, and nothing else stands out.
        let [peak] = &found.peaks[..] else { panic!("{:?}", found.peaks) };
        assert!((peak.period_hours - 8.0).abs() < 1e-9 && peak.share > 0.999, "{peak:?}");
        let place = found.cycles_per_day.iter().position(|cycles| *cycles >= 3.0).unwrap();
        assert!(found.cumulated_periodogram[place] > 0.999 && found.cumulated_periodogram[place - 1] < 1e-6);
        assert_eq!(spectrum(&[None; 20], 0.5), Spectrum::default());
    }

    #[test]
    fn the_turning_pointer_is_the_transform() {
        let series: Vec<f64> = (0..301).map(|t| f64::from(t * t % 17) - 8.0).collect();
        let ordinates = periodogram(&series);
        assert_eq!(ordinates.len(), 150);
        for frequency in [1usize, 77, 150] {
            let angle = |t: usize| 2.0 * std::f64::consts::PI * (frequency * t) as f64 / 301.0;
            let sum = |part: fn(f64) -> f64| {
                series.iter().enumerate().map(|(t, x)| x * part(angle(t))).sum::<f64>()
            };
            let exact = sum(f64::sin).powi(2) + sum(f64::cos).powi(2);
            assert!((ordinates[frequency - 1] / exact - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn coloured_noise_leaves_the_band_and_has_no_peaks_of_its_own() {
        let mut stream = Xoshiro256PlusPlus::seed_from_u64(6);
        let mut level = 0.0;
        let mut next = || {
            level = 0.8 * level + stream.random_range(-1.0..1.0);
            Some(level)
        };
        let red: Vec<Option<f64>> = (0..1500).map(|_| next()).collect();
        let found = spectrum(&red, 0.5);
        assert!(
            found.largest_distance > 3.0 * found.distance_limit && found.peaks.is_empty(),
            "{:?}",
            found.peaks
        );
    }

    #[test]
    fn white_noise_has_no_peaks_and_a_day_and_its_half_are_named() {
        let mut stream = Xoshiro256PlusPlus::seed_from_u64(5);
        let noise: Vec<f64> = (0..1500).map(|_| stream.random_range(-1.0..1.0)).collect();
        let quiet = spectrum(&noise.iter().copied().map(Some).collect::<Vec<_>>(), 0.5);
        assert!(quiet.peaks.is_empty() && quiet.largest_distance < quiet.distance_limit, "{:?}", quiet.peaks);
        let wave = |t: usize| (2.0 * std::f64::consts::PI * t as f64 / 48.0).sin();
        let daily: Vec<Option<f64>> =
            (0..1500).map(|t| Some(noise[t] + 0.5 * wave(t) + 0.4 * wave(2 * t))).collect();
        let periods: Vec<f64> = spectrum(&daily, 0.5).peaks.iter().map(|peak| peak.period_hours).collect();
        assert_eq!(periods, [24.0, 12.0]);
    }

    #[test]
    fn correlation_is_that_of_the_closed_form() {
        let pairs: Vec<(f64, f64)> = vec![(1.0, 2.0), (2.0, 1.0), (3.0, 4.0), (4.0, 3.0)];
        assert!((correlation(pairs.into_iter()) - 0.6).abs() < 1e-12);
    }
}
