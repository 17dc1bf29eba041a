//! In which circumstances a model errs: means over regimes with intervals that resample whole days.

use crate::data::{Column, DROPS, Grid, is_compass};
use crate::estimate::Problem;
use crate::schema::Interval;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// Resamples of a day-block bootstrap.
const RESAMPLES: usize = 400;
/// Fewest days on which a regime has to occur.
const LEAST_DAYS: usize = 4;

/// How a model errs in some circumstances.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Regime {
    /// The circumstances, such as `wind_speed high`.
    pub regime: String,
    /// Share of the time.
    pub time_share: f64,
    /// Mean of measured minus simulated, in the output's unit.
    pub bias: f64,
    /// Its 95 % interval: residuals are dependent within a day, so days are resampled, not samples.
    #[schema(value_type = Option<Interval>)]
    pub bias_ci95: Option<[f64; 2]>,
    /// Root mean square error.
    pub rmse: f64,
    /// Share of the squared error; more than the share of the time says where the model fails.
    pub error_share: f64,
}

/// The columns of a grid that do not come from what the model is judged by: a window that is read off a
/// falling room temperature is open wherever the room was warm, whatever the model says.
pub fn circumstances<'a>(
    problem: &'a Problem,
    grid: &'a Grid,
) -> impl Iterator<Item = (&'a str, &'a Column)> {
    let is_output = |channel: &str| problem.model().outputs().iter().any(|output| output.channel == channel);
    grid.columns().filter(move |(channel, _)| !is_output(channel) && *channel != DROPS)
}

/// All regimes that the columns of the grid define, the most telling first: thirds of what varies, on and off
/// of what is either, day and night, weekdays and weekends.
pub fn regimes(problem: &Problem, grid: &Grid, error: &[f64], usable: &[usize], seed: u64) -> Vec<Regime> {
    let mut labels: Vec<(String, Vec<usize>)> = Vec::new();
    for (channel, column) in circumstances(problem, grid).filter(|(channel, _)| !is_compass(channel)) {
        let value = |k: &usize| column.values()[*k];
        let part = |test: &dyn Fn(f64) -> bool| {
            usable.iter().copied().filter(|k| test(value(k))).collect::<Vec<usize>>()
        };
        match channel {
            "hour_of_day" => {
                labels.push(("night (22 to 6 h)".to_owned(), part(&|hour| !(6.0..22.0).contains(&hour))));
                labels.push(("morning (6 to 12 h)".to_owned(), part(&|hour| (6.0..12.0).contains(&hour))));
                labels
                    .push(("afternoon (12 to 17 h)".to_owned(), part(&|hour| (12.0..17.0).contains(&hour))));
                labels.push(("evening (17 to 22 h)".to_owned(), part(&|hour| (17.0..22.0).contains(&hour))));
            }
            "weekday" => {
                labels.push(("weekdays".to_owned(), part(&|day| day < 5.5)));
                labels.push(("weekends".to_owned(), part(&|day| day > 5.5)));
            }
            "sun_altitude" => {
                labels.push(("sun up".to_owned(), part(&|altitude| altitude > 0.0)));
                labels.push(("sun down".to_owned(), part(&|altitude| altitude <= 0.0)));
            }
            _ => {
                let mut sorted: Vec<f64> = usable.iter().map(value).collect();
                sorted.sort_by(f64::total_cmp);
                let (Some(first), Some(last)) = (sorted.first(), sorted.last()) else { continue };
                let (low, high) = (sorted[sorted.len() / 3], sorted[2 * sorted.len() / 3]);
                if low > *first && high < *last && high > low {
                    labels.push((format!("{channel} low"), part(&|x| x <= low)));
                    labels.push((format!("{channel} high"), part(&|x| x > high)));
                } else if last > first {
                    let middle = 0.5 * (first + last);
                    labels.push((format!("{channel} on"), part(&|x| x > middle)));
                    labels.push((format!("{channel} off"), part(&|x| x <= middle)));
                }
            }
        }
    }
    let total: f64 = usable.iter().map(|k| error[*k] * error[*k]).sum();
    let mut regimes: Vec<Regime> = labels
        .into_iter()
        .filter(|(_, samples)| !samples.is_empty())
        .map(|(regime, samples)| {
            let n = samples.len() as f64;
            let squares: f64 = samples.iter().map(|k| error[*k] * error[*k]).sum();
            Regime {
                regime,
                time_share: n / usable.len() as f64,
                bias: samples.iter().map(|k| error[*k]).sum::<f64>() / n,
                bias_ci95: interval(problem, error, &samples, seed),
                rmse: (squares / n).sqrt(),
                error_share: squares / total.max(f64::MIN_POSITIVE),
            }
        })
        .collect();
    regimes.sort_by(|a, b| b.bias.abs().total_cmp(&a.bias.abs()).then_with(|| a.regime.cmp(&b.regime)));
    regimes
}

/// The 95 % interval of a mean over some samples from resampled days; `None` where there are too few.
pub fn interval(problem: &Problem, error: &[f64], samples: &[usize], seed: u64) -> Option<[f64; 2]> {
    let mut days: BTreeMap<i64, (f64, f64)> = BTreeMap::new();
    for k in samples {
        let entry = days.entry(problem.grid().time(*k).div_euclid(86_400)).or_default();
        *entry = (entry.0 + error[*k], entry.1 + 1.0);
    }
    let days: Vec<(f64, f64)> = days.into_values().collect();
    if days.len() < LEAST_DAYS {
        return None;
    }
    let mut stream = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut means: Vec<f64> = (0..RESAMPLES)
        .map(|_| {
            let drawn = (0..days.len()).map(|_| days[stream.random_range(0..days.len())]);
            let (sum, count) = drawn.fold((0.0, 0.0), |(sum, count), (s, c)| (sum + s, count + c));
            sum / count
        })
        .collect();
    means.sort_by(f64::total_cmp);
    Some([means[RESAMPLES / 40], means[RESAMPLES - 1 - RESAMPLES / 40]])
}

#[cfg(test)]
mod tests {
    use super::super::tests::small_world;
    use super::*;

    #[test]
    fn the_share_of_the_error_in_a_regime_is_that_of_the_closed_form() {
        let (problem, _) = small_world(&[]);
        let grid = problem.grid();
        let out = grid.column("T_out").unwrap().values();
        let usable: Vec<usize> = (0..grid.len()).collect();
        // The error changes where the upper third of the outdoor temperatures begins, whatever the weather.
        let mut sorted = out.to_vec();
        sorted.sort_by(f64::total_cmp);
        let limit = sorted[2 * sorted.len() / 3];
        let error: Vec<f64> = out.iter().map(|t| if *t > limit { 0.5 } else { -0.1 }).collect();
        let found = regimes(&problem, grid, &error, &usable, 1);
        let warm = found.iter().find(|one| one.regime == "T_out high").unwrap();
        assert_eq!(warm.bias, 0.5);
        assert!((warm.time_share - 1.0 / 3.0).abs() < 0.01, "{}", warm.time_share);
        let (high, low) = (0.25 * warm.time_share, 0.01 * (1.0 - warm.time_share));
        assert!((warm.error_share - high / (high + low)).abs() < 1e-9, "{}", warm.error_share);
        assert!(warm.bias_ci95.is_some_and(|[low, high]| low <= 0.5 && 0.5 <= high));
        assert_eq!(
            found,
            regimes(&problem, grid, &error, &usable, 1),
            "the same seed resamples the same days"
        );
    }
}
