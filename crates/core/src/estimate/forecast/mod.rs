//! What a fitted model says of the hours to come, from the states at its newest measurement.
//!
//! ```text
//! Replay (states now) + inputs to come --ahead--> Forecast: outputs and states with standard deviations
//!                                            └--> Matrices: the linear discrete model along the same way
//! ```
//!
//! The states go on by the model's own stepper, so that the mean is its free run from them. What is not known
//! of it has three parts: the states at the start and the process noise since, which the filter's covariance
//! carries on; the parameters, by the covariance of the fit (delta method: they are moved along its axes, and
//! the states are estimated again); and, where a sensor will be read, its noise. `disturbance` is what the
//! newest measurements show beside the model. `score` says how far off forecasts were when the truth had
//! come.

mod ahead;
pub mod disturbance;
#[cfg(test)]
mod disturbance_tests;
mod inputs;
pub mod matrices;
pub mod score;

pub use ahead::{ForecastAsked, LONGEST};
pub use inputs::InputsToCome;

use super::assess::replay::Replay;
use super::fit::Fit;
use super::fit::covariance::Covariance;
use crate::data::{Window, rfc3339};
use crate::estimate::decompose::symmetric;
use crate::fault::Fault;
use crate::simulate::kalman::Kalman;
use crate::simulate::predict::{Belief, Prediction};
use crate::simulate::{Simulator, substeps};
use ahead::Onward;
use disturbance::{Disturbance, disturbance};
use indexmap::IndexMap;
use nalgebra::{DMatrix, DVector, SymmetricEigen};
use rayon::prelude::*;
use serde::Serialize;
use utoipa::ToSchema;

/// How far parameters are moved for the slopes of a forecast, in standard deviations.
const MOVED: f64 = 0.1;

/// A quantity over the instants of a forecast.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ForecastSeries {
    /// Unit of the values.
    pub unit: String,
    /// A value per instant.
    pub values: Vec<f64>,
    /// Their standard deviations: of an output that of what its sensor will show.
    pub sd: Vec<f64>,
}

/// An input over the instants of a forecast.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ForecastInput {
    /// Unit of the values.
    pub unit: String,
    /// A value per instant.
    pub values: Vec<f64>,
}

/// What a model says of the hours to come.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = ForecastBody)]
pub struct Forecast {
    /// The model.
    pub model: String,
    /// The newest measurement, from which it starts.
    #[schema(format = DateTime)]
    pub at: String,
    /// The instants, the first of which is `at`.
    #[schema(value_type = Vec<String>)]
    pub time: Vec<String>,
    /// The outputs by channel.
    pub outputs: IndexMap<String, ForecastSeries>,
    /// The states by name.
    pub states: IndexMap<String, ForecastSeries>,
    /// What drives it, computed channels included.
    pub inputs: IndexMap<String, ForecastInput>,
    /// Whether the deviations know of the uncertainty of the parameters: the fit has a covariance.
    pub with_parameters: bool,
    /// What the model does not explain now, which this forecast does not count on; `null` where the
    /// measurements of the last three days show none.
    pub disturbance: Option<Disturbance>,
}

/// Forecasts from the newest measurement of a replay. `measured` holds what was measured, `to_come` the
/// inputs of the hours to come.
///
/// # Errors
/// Every fault: a model without a filter, a step or a horizon out of range, an input that ends too early.
pub fn forecast(
    replay: &Replay,
    fit: &Fit,
    measured: &Window,
    to_come: &InputsToCome,
    asked: ForecastAsked,
) -> Result<Forecast, Vec<Fault>> {
    let ahead = Onward::new(replay, fit, measured, to_come, asked)?;
    let (problem, inputs, step) = (ahead.problem, &ahead.inputs, asked.step.millis());
    let model = problem.model();
    let fine = (fit.substeps as i64 * step + fit.sample_s.millis() - 1) / fit.sample_s.millis().max(1);
    let fine = substeps(model.stepper(), inputs.hours()).max(usize::try_from(fine).unwrap_or(1));
    let simulator = Simulator::new(model, inputs, &[], model.stepper(), fine).with_brake(problem.brake());
    let onward = Kalman::new(model, &simulator, &[]);
    let predict = |theta: &[f64]| {
        let filtered = ahead.filtered(theta);
        let innovations: Vec<f64> =
            filtered.innovations.iter().flatten().map(|one| one.unwrap_or(0.0)).collect();
        (onward.predict(theta, &ahead.noise, ahead.past, &Belief::of(filtered)), innovations)
    };
    let theta = fit.theta();
    let (found, innovations) = predict(&theta);
    let now = Run { found: &found, innovations: &innovations };
    let moved = fit.covariance.as_ref().and_then(|covariance| slopes(covariance, fit, &theta, now, &predict));
    if found.states.iter().flatten().chain(found.outputs.iter().flatten()).any(|value| !value.is_finite()) {
        let detail = "the forecast leaves the numbers: look at the inputs";
        return Err(vec![Fault::new("/inputs", "diverged", detail)]);
    }
    let disturbance = disturbance(&ahead, &theta);
    Ok(Forecast { disturbance, ..document(&ahead, fit, &found, moved.as_ref()) })
}

/// What the uncertainty of the parameters adds to the variances of outputs and states, by instant.
struct Moved {
    outputs: Vec<Vec<f64>>,
    states: Vec<Vec<f64>>,
}

/// A run at the estimates: what it predicts, and the innovations that led there; zero where there is none.
#[derive(Clone, Copy)]
struct Run<'a> {
    found: &'a Prediction,
    innovations: &'a [f64],
}

/// The delta method along the axes of the covariance: parameters that only together are known are moved
/// together, so that nothing large has to cancel. What they may be off by is bounded by the innovations up to
/// now as well, which would show it: in the units of the axes the information of the fit is one, and theirs
/// is `J'J` over the variance of an innovation.
fn slopes(
    covariance: &Covariance,
    fit: &Fit,
    theta: &[f64],
    now: Run,
    predict: &(impl Fn(&[f64]) -> (Prediction, Vec<f64>) + Sync),
) -> Option<Moved> {
    let places: Vec<usize> =
        covariance.parameters.iter().filter_map(|name| fit.parameters.get_index_of(name)).collect();
    let d = places.len();
    let deviations: Vec<f64> = (0..d).map(|i| covariance.matrix[i][i].max(0.0).sqrt()).collect();
    let correlation = DMatrix::from_fn(d, d, |i, j| {
        let scale = deviations[i] * deviations[j];
        if scale > 0.0 { covariance.matrix[i][j] / scale } else { 0.0 }
    });
    let SymmetricEigen { eigenvalues, eigenvectors } = symmetric(correlation)?;
    let runs: Vec<(Prediction, Vec<f64>)> = (0..d)
        .into_par_iter()
        .map(|axis| {
            let length = MOVED * eigenvalues[axis].max(0.0).sqrt();
            let mut theta = theta.to_vec();
            for (i, place) in places.iter().enumerate() {
                theta[*place] += length * eigenvectors[(i, axis)] * deviations[i];
            }
            predict(&theta)
        })
        .collect();
    let count = now.innovations.iter().filter(|one| **one != 0.0).count().max(1) as f64;
    let variance = now.innovations.iter().map(|one| one * one).sum::<f64>() / count;
    let jacobian = DMatrix::from_fn(now.innovations.len(), d, |row, axis| {
        (runs[axis].1[row] - now.innovations[row]) / MOVED
    });
    let information = jacobian.tr_mul(&jacobian) / variance.max(f64::MIN_POSITIVE) + DMatrix::identity(d, d);
    let bound = information.cholesky()?;
    let of = |series: &dyn Fn(&Prediction) -> &Vec<Vec<f64>>| -> Vec<Vec<f64>> {
        let variance = |k: usize, one: usize| -> f64 {
            let slope = |axis: usize| (series(&runs[axis].0)[k][one] - series(now.found)[k][one]) / MOVED;
            let slopes = DVector::from_fn(d, |axis, _| slope(axis));
            slopes.dot(&bound.solve(&slopes)).max(0.0)
        };
        let rows = series(now.found).iter().enumerate();
        rows.map(|(k, row)| (0..row.len()).map(|one| variance(k, one)).collect()).collect()
    };
    Some(Moved { outputs: of(&|run| &run.outputs), states: of(&|run| &run.states) })
}

fn document(ahead: &Onward, fit: &Fit, found: &Prediction, moved: Option<&Moved>) -> Forecast {
    let Onward { problem, grid, noise, past, .. } = ahead;
    let (model, past) = (problem.model(), *past);
    let more = |of: Option<&Vec<Vec<f64>>>, k: usize, one: usize| of.map_or(0.0, |rows| rows[k][one]);
    let series = |unit: &str,
                  one: usize,
                  values: &[Vec<f64>],
                  sd: &[Vec<f64>],
                  moved: Option<&Vec<Vec<f64>>>,
                  sensor: f64| {
        let sd = sd.iter().enumerate();
        ForecastSeries {
            unit: unit.to_owned(),
            values: values.iter().map(|row| row[one]).collect(),
            sd: sd.map(|(k, row)| (row[one].powi(2) + more(moved, k, one) + sensor).sqrt()).collect(),
        }
    };
    let output = |(one, output): (usize, &crate::model::Output)| {
        let moved = moved.map(|moved| &moved.outputs);
        let sensor = noise.measurement[one];
        let series = series(&output.unit, one, &found.outputs, &found.output_deviations, moved, sensor);
        (output.channel.clone(), series)
    };
    let state = |(one, state): (usize, &crate::model::State)| {
        let moved = moved.map(|moved| &moved.states);
        (state.name.clone(), series(&state.unit, one, &found.states, &found.deviations, moved, 0.0))
    };
    let input = |input: &crate::model::Input| {
        let column = grid.column(&input.channel)?;
        let values = column.values()[past..].to_vec();
        Some((input.channel.clone(), ForecastInput { unit: column.unit().to_owned(), values }))
    };
    Forecast {
        model: fit.model.clone(),
        at: rfc3339(grid.time(past)),
        time: (past..grid.len()).map(|k| rfc3339(grid.time(k))).collect(),
        outputs: model.outputs().iter().enumerate().map(output).collect(),
        states: model.states().iter().enumerate().map(state).collect(),
        inputs: model.inputs().iter().filter_map(input).collect(),
        with_parameters: moved.is_some(),
        disturbance: None,
    }
}
