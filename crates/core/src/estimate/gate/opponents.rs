//! What a fit has to beat beside the last measurement held: forecasters that know less, or no physics.

use super::regression::{PairedComparison, Regression};
use crate::data::{DAY, HOUR};
use crate::estimate::assess::metrics::{FilterRun, forecast_series, lead};
use crate::estimate::problem::Problem;

const HOURS: usize = 24;

/// A fit beside an opponent on the same unseen data, in pairs by days.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// Root mean square of the fit's forecast errors.
    pub fit: f64,
    /// The same of the opponent.
    pub opponent: f64,
    /// How sure the difference is, as a t over days: positive where the fit is better.
    pub t: f64,
    /// Hours of targets, counted in days.
    pub days: f64,
}

impl Match {
    /// The fit's error over the opponent's.
    pub fn ratio(&self) -> f64 {
        self.fit / self.opponent.max(f64::MIN_POSITIVE)
    }

    /// From the day, the fit's error and the opponent's of every forecast, and the hours between two.
    fn of(errors: &[(i64, f64, f64)], hours: f64) -> Option<Self> {
        let mut days: Vec<(i64, f64, f64)> = Vec::new();
        for (day, fit, opponent) in errors {
            match days.last_mut() {
                Some((known, ours, theirs)) if known == day => {
                    *ours += fit * fit;
                    *theirs += opponent * opponent;
                }
                _ => days.push((*day, fit * fit, opponent * opponent)),
            }
        }
        if days.is_empty() {
            return None;
        }
        let (ours, theirs): (Vec<f64>, Vec<f64>) =
            days.iter().map(|(_, ours, theirs)| (*ours, *theirs)).unzip();
        let rms = |sums: &[f64]| (sums.iter().sum::<f64>() / errors.len() as f64).sqrt();
        let days = errors.len() as f64 * hours / HOURS as f64;
        Some(Self {
            fit: rms(&ours),
            opponent: rms(&theirs),
            t: PairedComparison::of(&theirs, &ours).t,
            days,
        })
    }
}

/// Forecasts of the first output by nothing but its own past, so many milliseconds ahead on the validation
/// part: the hourly profile of the training days, and what is left of the deviation from it. `None` where
/// nothing can be compared.
pub fn without_inputs(problem: &Problem, theta: &[f64], run: &FilterRun, horizon: i64) -> Option<Match> {
    let (grid, split) = (problem.grid(), problem.split());
    let lead = lead(horizon, grid.step())?;
    let (values, valid) = problem.measured()[0];
    let hour = |k: usize| (grid.time(k).rem_euclid(DAY) / HOUR) as usize;
    let known = || split.train.clone().filter(|k| valid[*k]);
    let mean = known().map(|k| values[k]).sum::<f64>() / known().count().max(1) as f64;
    let mut sums = [(0.0, 0.0); HOURS];
    for k in known() {
        sums[hour(k)].0 += values[k];
        sums[hour(k)].1 += 1.0;
    }
    let profile = |k: usize| {
        let (sum, count) = sums[hour(k)];
        if count > 0.0 { sum / count } else { mean }
    };
    let deviation = |k: usize| values[k] - profile(k);
    let pairs = || (split.train.start + lead..split.train.end).filter(|k| valid[*k] && valid[k - lead]);
    let (mut both, mut first) = (0.0, 0.0);
    for k in pairs() {
        both += deviation(k) * deviation(k - lead);
        first += deviation(k - lead).powi(2);
    }
    let decay = (both / f64::max(first, f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    let forecast = forecast_series(problem, theta, run, split.validation.clone(), &[lead]);
    let error = |k: usize| {
        let ours = forecast[0][0][k]? - values[k];
        Some((grid.time(k).div_euclid(DAY), ours, profile(k) + decay * deviation(k - lead) - values[k]))
    };
    let targets =
        (split.validation.start + lead..split.validation.end).filter(|k| valid[*k] && valid[k - lead]);
    Match::of(&targets.filter_map(error).collect::<Vec<_>>(), grid.step_hours())
}

/// The same beside the free regression on the same inputs, learnt on the training part, six hours ahead.
pub fn with_regression(
    problem: &Problem,
    theta: &[f64],
    run: &FilterRun,
    regression: &Regression,
) -> Option<Match> {
    let (grid, split) = (problem.grid(), problem.split());
    let lead = lead(6 * HOUR, grid.step())?;
    let (values, valid) = problem.measured()[0];
    let forecasts = regression.forecasts(&split.train, &split.validation);
    let series = forecast_series(problem, theta, run, split.validation.clone(), &[lead]);
    let error = |(target, theirs): (std::ops::Range<usize>, f64)| {
        // The regression forecasts means of hours, so the fit's forecasts are taken over the same samples.
        let both: Vec<(f64, f64)> = target
            .clone()
            .filter(|k| valid[*k])
            .filter_map(|k| Some((series[0][0][k]?, values[k])))
            .collect();
        let n = both.len() as f64;
        let (ours, measured) = (
            both.iter().map(|(ours, _)| ours).sum::<f64>() / n,
            both.iter().map(|(_, measured)| measured).sum::<f64>() / n,
        );
        (!both.is_empty())
            .then(|| (grid.time(target.start).div_euclid(DAY), ours - measured, theirs - measured))
    };
    Match::of(&forecasts.into_iter().filter_map(error).collect::<Vec<_>>(), 1.0)
}
