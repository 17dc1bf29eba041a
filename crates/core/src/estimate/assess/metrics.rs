//! The measures of a fit: free-run errors, forecasts from re-estimated states, noise floor, rho.

use crate::data::{DAY, HOUR};
use crate::data::{Duration, rfc3339};
use crate::estimate::fit::{AheadError, Fit, OutputMetrics};
use crate::estimate::problem::predictor::Predictor;
use crate::estimate::problem::whiten::Ar;
use crate::estimate::problem::{Problem, mean_square};
use crate::model::{Model, Output};
use crate::simulate::Trajectory;
use crate::simulate::kalman::{Filtered, Noise};
use crate::units::error_unit;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use utoipa::ToSchema;

/// The horizons that every fit reports.
pub const HORIZONS: [(&str, i64); 3] = [("PT1H", HOUR), ("PT6H", 6 * HOUR), ("PT24H", DAY)];

/// The name of a horizon that has no end: the model is left to itself.
pub const FREE_RUN: &str = "free_run";

/// A filter run at a parameter vector, with the noise that it assumed.
#[derive(Debug, Clone)]
pub struct FilterRun {
    /// States and innovations.
    pub filtered: Filtered,
    /// Process noise, per square root of an hour; where states differ in it, its root mean square.
    pub process_noise: f64,
}

/// The variance of each sensor: its declared noise and what its quantisation adds (step2 / 12).
pub fn measurement_variance(problem: &Problem) -> Vec<f64> {
    problem
        .model()
        .outputs()
        .iter()
        .zip(problem.quanta())
        .map(|(output, quantum)| output.noise_sd.powi(2) + quantum.unwrap_or(0.0).powi(2) / 12.0)
        .collect()
}

/// What is known of a process noise before a filter runs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ProcessNoise {
    /// It is the likeliest one on the training part.
    Likeliest,
    /// The same, which is sought about this one first: the peak next to it.
    LikeliestNear(f64),
    /// It is this one.
    Known(f64),
}

impl ProcessNoise {
    /// The noise of a filter that goes through other measurements with the parameters of a fit: that of the
    /// fit, unless its likelihood has a noise for each state.
    pub fn of(fit: &Fit) -> Self {
        match fit.likelihood {
            None => Self::Known(fit.process_noise),
            Some(_) => Self::LikeliestNear(fit.process_noise),
        }
    }
}

/// Filters the window at `theta`.
pub fn filter(problem: &Problem, theta: &[f64], process_noise: ProcessNoise) -> FilterRun {
    let Some(kalman) = problem.filter() else { return unfiltered(problem, &problem.simulate(theta)) };
    let measurement = measurement_variance(problem);
    let likeliest = |near| kalman.likely_process_noise(theta, &measurement, problem.split().train.end, near);
    let process_noise = match process_noise {
        ProcessNoise::Likeliest => likeliest(None),
        ProcessNoise::LikeliestNear(near) => likeliest(Some(near)),
        ProcessNoise::Known(noise) => noise,
    };
    filter_with(
        problem,
        theta,
        &Noise { process: vec![process_noise; problem.model().states().len()], measurement },
    )
}

/// Filters the window at `theta` with this process noise, and runs it freely; a model without a filter has
/// one run for both.
pub fn filtered_and_free(problem: &Problem, theta: &[f64], noise: ProcessNoise) -> (FilterRun, Trajectory) {
    let free = problem.simulate(theta);
    let run = match problem.predictor() {
        Predictor::Filtered => filter(problem, theta, noise),
        Predictor::FreeRun => unfiltered(problem, &free),
    };
    (run, free)
}

/// Filters the window at `theta` with this noise.
pub fn filter_with(problem: &Problem, theta: &[f64], noise: &Noise) -> FilterRun {
    let Some(kalman) = problem.filter() else { return unfiltered(problem, &problem.simulate(theta)) };
    FilterRun {
        filtered: kalman.filter(theta, noise, problem.grid().len()),
        process_noise: mean_square(&noise.process).sqrt(),
    }
}

/// The free run in the place of a filter, for models without one: no state is re-estimated and nothing is
/// innovated.
fn unfiltered(problem: &Problem, trajectory: &Trajectory) -> FilterRun {
    let samples = problem.grid().len();
    let filtered = Filtered {
        states: (0..samples).map(|k| trajectory.states.iter().map(|series| series[k]).collect()).collect(),
        deviations: vec![Vec::new(); samples],
        innovations: vec![vec![None; samples]; problem.model().outputs().len()],
        log_likelihood: 0.0,
        covariance: Vec::new(),
        reached: samples.saturating_sub(1),
    };
    FilterRun { filtered, process_noise: 0.0 }
}

/// The noise that belongs to a fit: what its likelihood says, or one process noise for all states.
pub fn noise_of(problem: &Problem, fit: &Fit) -> Noise {
    let plain = || Noise {
        process: vec![fit.process_noise; problem.model().states().len()],
        measurement: measurement_variance(problem),
    };
    // A model whose states have changed since has no noise of its own.
    fit.likelihood.as_ref().and_then(|likelihood| likelihood.noise(problem.model())).unwrap_or_else(plain)
}

/// Filters the window with the parameters of a fit and the noise that belongs to it.
pub fn filter_fit(problem: &Problem, fit: &Fit) -> FilterRun {
    filter_with(problem, &fit.theta(), &noise_of(problem, fit))
}

/// Forecasts as series: `[output][lead][k]` is the value at sample `k` as it was forecast `leads[lead]`
/// samples before, from the filtered state at an origin in `range` at which that output was measured. Leads
/// are in samples, strictly increasing. A model without a filter forecasts nothing.
pub fn forecast_series(
    problem: &Problem,
    theta: &[f64],
    run: &FilterRun,
    range: Range<usize>,
    leads: &[usize],
) -> Vec<Vec<Vec<Option<f64>>>> {
    let measured = problem.measured();
    let samples = problem.grid().len();
    let mut series = vec![vec![vec![None; samples]; leads.len()]; measured.len()];
    let Some(kalman) = problem.filter() else { return series };
    let origins: Vec<usize> = range.filter(|k| measured.iter().any(|(_, valid)| valid[*k])).collect();
    let forecasts = kalman.forecasts_at(theta, &run.filtered, &origins, leads);
    for (output, (_, valid)) in measured.iter().enumerate() {
        for (index, lead) in leads.iter().enumerate() {
            for (origin, value) in origins.iter().zip(&forecasts[output][index]) {
                if valid[*origin] && origin + lead < samples {
                    series[output][index][origin + lead] = *value;
                }
            }
        }
    }
    series
}

/// Forecast errors of the first output by horizon: an origin at every measured sample of `range`.
pub fn ahead(
    problem: &Problem,
    theta: &[f64],
    run: &FilterRun,
    range: Range<usize>,
    horizons: &[(&str, i64)],
) -> IndexMap<String, AheadError> {
    let mut wanted: Vec<(&str, usize)> = horizons
        .iter()
        .filter_map(|(name, horizon)| lead(*horizon, problem.grid().step()).map(|lead| (*name, lead)))
        .collect();
    wanted.sort_by_key(|(_, lead)| *lead);
    let leads: Vec<usize> = wanted.iter().map(|(_, lead)| *lead).collect();
    let series = forecast_series(problem, theta, run, range.clone(), &leads);
    let measured = problem.measured();
    let (values, valid) = measured[0];
    let mut errors = IndexMap::new();
    for ((name, lead), forecast) in wanted.into_iter().zip(&series[0]) {
        let mut model = Vec::new();
        let mut persistence = Vec::new();
        for k in (range.start + lead..range.end).filter(|k| valid[*k]) {
            if let Some(value) = forecast[k] {
                model.push(value - values[k]);
                persistence.push(values[k - lead] - values[k]);
            }
        }
        if !model.is_empty() {
            let n = model.len();
            let rmse = |errors: &[f64]| mean_square(errors).sqrt();
            errors.insert(
                name.to_owned(),
                AheadError { rmse: rmse(&model), persistence: rmse(&persistence), n },
            );
        }
    }
    errors
}

/// The errors of a free run, and of each output's last measurement at least `lead` samples ago, on the same
/// samples of a range: all outputs together, counted in their [`Problem::scale`]. `None` where nothing is
/// comparable or the run leaves the numbers.
pub fn free_run_ahead(
    problem: &Problem,
    trajectory: &Trajectory,
    range: Range<usize>,
    lead: usize,
) -> Option<AheadError> {
    let (mut model, mut persistence) = (Vec::new(), Vec::new());
    for (output, (simulated, (values, valid))) in
        trajectory.outputs.iter().zip(problem.measured()).enumerate()
    {
        let scale = problem.scale(output);
        let mut last = None;
        for k in range.start + lead..range.end {
            last = if valid[k - lead] { Some(values[k - lead]) } else { last };
            if let Some(last) = last.filter(|_| valid[k] && problem.simulator().predicted(k)) {
                model.push((simulated[k] - values[k]) / scale);
                persistence.push((last - values[k]) / scale);
            }
        }
    }
    let rmse = |errors: &[f64]| mean_square(errors).sqrt();
    (!model.is_empty())
        .then(|| AheadError { rmse: rmse(&model), persistence: rmse(&persistence), n: model.len() })
        .filter(|error| error.rmse.is_finite())
}

/// A horizon in whole samples; `None` where it is shorter than one.
pub fn lead(horizon: i64, step: i64) -> Option<usize> {
    usize::try_from(horizon / step).ok().filter(|lead| *lead > 0)
}

/// Mean square of all 24-hour forecasts from the midnights (UTC) of `range`, pooled.
pub fn day_ahead_mse(problem: &Problem, theta: &[f64], run: &FilterRun, range: Range<usize>) -> Option<f64> {
    let kalman = problem.filter()?;
    let grid = problem.grid();
    let (values, valid) = problem.measured()[0];
    let leads = (DAY / grid.step()) as usize;
    let origins: Vec<usize> = range.clone().filter(|k| grid.time(*k).rem_euclid(DAY) < grid.step()).collect();
    let mut errors = Vec::new();
    for (origin, forecast) in origins.iter().zip(kalman.forecasts(theta, &run.filtered, &origins, leads)) {
        for (lead, value) in forecast.iter().enumerate().skip(1) {
            let target = origin + lead;
            if let (true, Some(value)) = (target < range.end && valid[target], value) {
                errors.push(value - values[target]);
            }
        }
    }
    (!errors.is_empty()).then(|| mean_square(&errors))
}

/// All measures of a parameter vector, by output channel, from its filtered run and its free run.
pub fn metrics(
    problem: &Problem,
    theta: &[f64],
    run: &FilterRun,
    trajectory: &Trajectory,
) -> IndexMap<String, OutputMetrics> {
    let split = problem.split();
    let part = |output: usize, range: &Range<usize>| {
        problem.mean_square_error(trajectory, output, range.clone()).map(f64::sqrt)
    };
    let mut found = IndexMap::new();
    for (index, output) in problem.model().outputs().iter().enumerate() {
        let first = index == 0;
        let judged = if split.validation.is_empty() { split.train.clone() } else { split.validation.clone() };
        let innovations: Vec<f64> = run.filtered.innovations[index].iter().flatten().copied().collect();
        let metrics = OutputMetrics {
            unit: error_unit(&output.unit).to_owned(),
            train_rmse: part(index, &split.train).unwrap_or(f64::INFINITY),
            validation_rmse: part(index, &split.validation),
            test_rmse: part(index, &split.test),
            ahead: if first {
                ahead(problem, theta, run, judged.clone(), &HORIZONS)
            } else {
                IndexMap::new()
            },
            day_ahead_mse: if first { day_ahead_mse(problem, theta, run, judged) } else { None },
            noise_floor: (!innovations.is_empty()).then(|| mean_square(&innovations).sqrt()),
            rho: rho(problem, trajectory, index),
        };
        found.insert(output.channel.clone(), metrics);
    }
    found
}

/// The output that fails most: whose free run errs by the largest multiple of the noise that is left in it,
/// the first of several that do so alike.
pub fn worst_output(problem: &Problem, trajectory: &Trajectory) -> usize {
    let rhos = (0..problem.model().outputs().len()).map(|output| rho(problem, trajectory, output));
    let worse = |worst: (usize, f64), (output, rho): (usize, f64)| {
        if rho > worst.1 { (output, rho) } else { worst }
    };
    rhos.map(|rho| rho.unwrap_or(0.0)).enumerate().fold((0, 0.0), worse).0
}

/// Free-run error over the innovation deviation of the AR model of the free-run residual, on the training
/// part.
fn rho(problem: &Problem, trajectory: &Trajectory, output: usize) -> Option<f64> {
    let measured = problem.measured();
    let (values, _) = measured[output];
    let train = problem.split().train.clone();
    let usable = problem.usable(output, train.clone());
    let rmse = problem.mean_square_error(trajectory, output, train)?.sqrt();
    Ar::fit_samples(&usable, |k| trajectory.outputs[output][k] - values[k])
        .map(|ar| rmse / ar.deviation)
        .filter(|rho| rho.is_finite())
}

/// The states at the newest sample that a job has seen.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CurrentState {
    /// The instant of the sample.
    #[schema(format = DateTime)]
    pub at: String,
    /// Present where the model has no filter: the states are those of a free run from the start of the fit's
    /// window, which no measurement has corrected.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    #[schema(value_type = Option<bool>)]
    pub free_run: bool,
    /// The states by name, in the units of the model.
    pub states: IndexMap<String, f64>,
    /// Standard deviations by state; empty for a free run, which has none.
    pub sd: IndexMap<String, f64>,
    /// Their covariance, a row for each state in the order of `states`; empty for a free run.
    #[serde(default)]
    pub covariance: Vec<Vec<f64>>,
    /// By output, what was measured there minus what the filter had expected of it a sample before; without
    /// those that were not measured.
    #[serde(default)]
    pub innovation: IndexMap<String, f64>,
}

/// Filters the window with a fit's parameters and noise up to its newest sample.
pub fn current_state(problem: &Problem, fit: &Fit) -> Option<CurrentState> {
    newest_state(problem, &filter_fit(problem, fit))
}

/// The states at the newest sample of a filter run that the inputs lead to.
pub fn newest_state(problem: &Problem, run: &FilterRun) -> Option<CurrentState> {
    let filtered = &run.filtered;
    let last = filtered.reached;
    let innovations: Vec<Option<f64>> =
        filtered.innovations.iter().map(|found| found.get(last).copied().flatten()).collect();
    let state = CurrentState::of(
        problem.model(),
        problem.grid().time(last),
        (filtered.states.get(last)?, filtered.deviations.get(last)?, &filtered.covariance),
        &innovations,
    )?;
    Some(CurrentState { free_run: problem.predictor() == Predictor::FreeRun, ..state })
}

impl CurrentState {
    /// Filtered states of a model at an instant, in milliseconds: values, deviations and covariance, and the
    /// innovations by output. `None` where a state is no number.
    pub(super) fn of(
        model: &Model,
        at: i64,
        (states, deviations, covariance): (&[f64], &[f64], &[f64]),
        innovations: &[Option<f64>],
    ) -> Option<Self> {
        let named = |values: &[f64]| {
            let names = model.states().iter().map(|state| state.name.clone());
            let pairs: IndexMap<String, f64> = names.zip(values.iter().copied()).collect();
            pairs.values().all(|value| value.is_finite()).then_some(pairs)
        };
        let named_innovation =
            |(output, innovation): (&Output, &Option<f64>)| Some((output.channel.clone(), (*innovation)?));
        Some(Self {
            at: rfc3339(at),
            free_run: false,
            states: named(states)?,
            sd: named(deviations)?,
            covariance: covariance.chunks(model.states().len().max(1)).map(<[f64]>::to_vec).collect(),
            innovation: model.outputs().iter().zip(innovations).filter_map(named_innovation).collect(),
        })
    }
}

/// The name under which a horizon is reported.
pub fn horizon_name(horizon: Duration) -> String {
    HORIZONS
        .iter()
        .find(|(_, length)| *length == horizon.millis())
        .map_or_else(|| horizon.to_string(), |(name, _)| (*name).to_owned())
}
