//! Whether newer measurements contradict parameters that were validated on older ones.

use super::metrics::{FREE_RUN, FilterRun, ahead, horizon_name, measurement_variance};
use crate::data::DAY;
use crate::data::{Duration, read_time, rfc3339};
use crate::estimate::fit::{Fit, Span};
use crate::estimate::problem::Problem;
use crate::estimate::problem::predictor::Predictor;
use crate::estimate::problem::whiten::stride;
use crate::units::error_unit;
use serde::{Deserialize, Deserializer, Serialize};
use std::ops::Range;

/// Newer forecasts may err by this many times what they did on the validation data.
const RATIO: f64 = 2.0;
/// Below this much newer time nothing is said: one odd evening contradicts no model.
const LEAST: i64 = DAY;
/// What a forecast that leaves the numbers is said to err by, in its unit: that of a free run is the noise of
/// the sensors.
const LOST: f64 = 1e6;
/// Older measurements say nothing about now.
const MOST: i64 = 7 * DAY;

/// Forecasts on newer measurements that err by more than they should.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Degradation {
    /// Root mean square of the errors: of forecasts, or of the free run of a model without a filter.
    #[serde(deserialize_with = "lost_where_null")]
    pub error: f64,
    /// Twice that on the validation data, or twice the sensor's noise where that is more.
    pub limit: f64,
    /// Unit of both.
    pub unit: String,
    /// How far ahead the forecasts look; `free_run` where a model without a filter is left to itself.
    pub horizon: String,
    /// First instant of the newer measurements, RFC 3339.
    pub from: String,
    /// Last instant.
    pub to: String,
}

/// An error that an earlier version has written although it was no number.
fn lost_where_null<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(LOST))
}

/// What newer measurements say of a fit.
#[derive(Debug, Clone, PartialEq)]
pub enum Newer {
    /// There are too few of them, or nothing to compare with.
    Silent,
    /// They are forecast as well as the validation data, or nearly so.
    Agree {
        /// Root mean square of the forecast errors.
        error: f64,
        /// How far ahead the forecasts look.
        horizon: String,
    },
    /// They are not.
    Contradict(Degradation),
}

impl Newer {
    /// Root mean square of the forecast errors, and how far ahead the forecasts look.
    pub fn error(&self) -> Option<(f64, &str)> {
        match self {
            Newer::Silent => None,
            Newer::Agree { error, horizon } => Some((*error, horizon)),
            Newer::Contradict(found) => Some((found.error, &found.horizon)),
        }
    }
}

/// Forecasts the measurements behind the fit's own, `horizon` ahead from re-estimated states, and compares
/// the errors with those on the fit's validation part; both from one run of the filter over `problem`, whose
/// window holds both. A model without a filter is left to itself from the start of the fit's window, at which
/// `problem` must start too, and the errors of that free run are compared: all outputs together, counted in
/// [`Problem::scale`].
pub fn newer(problem: &Problem, fit: &Fit, run: &FilterRun, horizon: Duration) -> Newer {
    let grid = problem.grid();
    let step = grid.step();
    let oldest = grid.len().saturating_sub((MOST / step) as usize);
    let newer = behind(problem, fit.window().1).max(oldest)..grid.len();
    if (newer.len() as i64) * step < LEAST {
        return Newer::Silent;
    }
    let Some(validation) = &fit.parts.validation else { return Newer::Silent };
    let theta = fit.theta();
    let (name, errors, noise, unit) = match problem.predictor() {
        Predictor::Filtered => {
            let name = horizon_name(horizon);
            let leads = [(name.as_str(), horizon.millis())];
            let error = |range: Range<usize>| {
                ahead(problem, &theta, run, range, &leads)
                    .into_values()
                    .next()
                    .map(|error| (error.rmse, error.n))
            };
            let errors = error(part(problem, validation)).zip(error(newer.clone()));
            let unit = problem.model().outputs().first().map_or("-", |output| error_unit(&output.unit));
            (name, errors, measurement_variance(problem).first().copied().unwrap_or(0.0).sqrt(), unit)
        }
        Predictor::FreeRun => {
            let trajectory = problem.simulate(&theta);
            let error = |range: Range<usize>| {
                Some((problem.free_run_error(&trajectory, range.clone())?, least_samples(problem, range)))
            };
            let then = error(part(problem, validation));
            let lost = trajectory.diverged.then(|| (LOST, least_samples(problem, newer.clone())));
            (
                FREE_RUN.to_owned(),
                then.zip(lost.or_else(|| error(newer.clone()))),
                problem.scaled_noise(),
                problem.scale_in_words(),
            )
        }
    };
    let Some(((then, _), (now, samples))) = errors else { return Newer::Silent };
    // Forecasts need half a day of targets to say anything; gaps may have eaten the rest.
    if (samples as i64) * step < LEAST / 2 {
        return Newer::Silent;
    }
    // A document cannot hold what is no number.
    let now = now.min(LOST);
    let limit = RATIO * then.max(noise);
    if now <= limit {
        return Newer::Agree { error: now, horizon: name };
    }
    Newer::Contradict(Degradation {
        error: now,
        limit,
        unit: unit.to_owned(),
        horizon: name,
        from: rfc3339(grid.time(newer.start)),
        to: rfc3339(grid.time(grid.len() - 1)),
    })
}

/// Over how many samples of the grid the output that is measured least is known.
fn least_samples(problem: &Problem, range: Range<usize>) -> usize {
    let known = |output: usize| problem.usable(output, range.clone());
    (0..problem.model().outputs().len()).map(known).map(|used| used.len() * stride(&used)).min().unwrap_or(0)
}

/// Whether what a fit says of its own window goes on over the longer one of a problem. A filter forgets where
/// it has begun; a free run that starts elsewhere says nothing of the one that was judged.
pub fn goes_on(problem: &Problem, fit: &Fit) -> bool {
    match problem.predictor() {
        Predictor::Filtered => true,
        Predictor::FreeRun => rfc3339(problem.grid().start()) == fit.window().0,
    }
}

/// The problem of a longer window, stepped and led to its first sample as that of the fit was.
pub fn as_fitted(problem: &Problem, fit: &Fit) -> Problem {
    fit.simulated(&problem.averaged_over(part(problem, &fit.parts.train)))
}

/// The first sample behind an instant.
fn behind(problem: &Problem, instant: &str) -> usize {
    let grid = problem.grid();
    // A fit's own instants can be read; one that could not would leave nothing to compare.
    read_time("", instant)
        .map_or(grid.len(), |time| (0..grid.len()).find(|k| grid.time(*k) > time).unwrap_or(grid.len()))
}

/// The samples of a part of the fit's window.
fn part(problem: &Problem, span: &Span) -> Range<usize> {
    let to = behind(problem, &span.to);
    behind(problem, &span.from).saturating_sub(1).min(to)..to
}
