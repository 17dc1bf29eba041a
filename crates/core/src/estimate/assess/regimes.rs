//! In which circumstances a model errs: means over regimes with intervals that resample whole days.

use crate::data::DAY;
use crate::data::{Column, DROPS, Grid, Window, is_compass};
use crate::estimate::fit::Fit;
use crate::estimate::problem::Problem;
use crate::estimate::problem::request::Site;
use crate::estimate::problem::widen::widen;
use crate::fault::Fault;
use crate::schema::Interval;
use crate::units::error_unit;
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
        let entry = days.entry(problem.grid().time(*k).div_euclid(DAY)).or_default();
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

/// The fit with the circumstances that tell most of its error, in the light of everything that was measured;
/// its seed fixes the resampling of the intervals.
///
/// # Errors
/// A fault where the window does not fit the problem, or its time zone is unknown.
pub fn with_worst_regime(fit: Fit, problem: &Problem, window: &Window) -> Result<Fit, Fault> {
    let (grid, _) = widen(problem, window, &Site::of(problem.basis()))?;
    let (error, usable) = free_run_errors(problem, 0, &fit.theta());
    let found = regimes(problem, &grid, &error, &usable, fit.seed);
    let worst_regime = telling(&found).next().map(|regime| sentence(problem, 0, regime));
    Ok(Fit { worst_regime, ..fit })
}

/// The residual of an output at every sample, and the samples at which it means something.
pub fn free_run_errors(problem: &Problem, output: usize, theta: &[f64]) -> (Vec<f64>, Vec<usize>) {
    let simulated = problem.simulate(theta);
    (problem.residual(output, &simulated.outputs[output]), problem.usable(output, 0..problem.grid().len()))
}

/// Regimes whose bias is sure to be one, and that hold more of the error than of the time, the most telling
/// first.
pub fn telling(regimes: &[Regime]) -> impl Iterator<Item = &Regime> {
    let sure = |regime: &&Regime| regime.bias_ci95.is_some_and(|[low, high]| low > 0.0 || high < 0.0);
    regimes.iter().filter(sure).filter(|regime| regime.error_share > regime.time_share)
}

/// A number with two decimals, or two digits that count where it is small.
pub fn small(value: f64) -> String {
    let digits = if value.abs() > 0.0 { (1.0 - value.abs().log10().floor()).clamp(2.0, 9.0) } else { 2.0 };
    format!("{value:.*}", digits as usize)
}

/// How a model errs in some circumstances, in a sentence.
pub fn sentence(problem: &Problem, output: usize, regime: &Regime) -> String {
    let output = problem.model().outputs().get(output);
    let (channel, unit) =
        output.map_or(("", ""), |output| (output.channel.as_str(), error_unit(&output.unit)));
    format!(
        "{}: {channel} is {} {unit} {} than the model says, {:.0} % of the time, {:.0} % of the squared \
        error.",
        regime.regime,
        small(regime.bias.abs()),
        if regime.bias > 0.0 { "higher" } else { "lower" },
        100.0 * regime.time_share,
        100.0 * regime.error_share
    )
}
