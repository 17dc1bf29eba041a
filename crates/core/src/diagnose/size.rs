//! How large a finding is: its coefficients from where they were seen, with intervals that are robust by
//! days.
//!
//! Three objectives estimate the same coefficients: the likelihood of the innovations, a step ahead, segments
//! of a day with states of their own, and the free run of weeks. Were the model the room, they would differ
//! by chance alone; but sensors blur steps, and heat that nobody logged drowns weeks. What even the nearer of
//! the two others disagrees by is added to the variance, so that an interval is as wide as the model is wrong
//! (after Hausman 1978, Econometrica 46, 1251-1271).

use super::library::CandidateEffect;
use super::null_model::NullModel;
use crate::data::HOUR;
use crate::estimate::Problem;
use crate::estimate::segments::shooting::{Settled, settle};
use crate::estimate::segments::{Moved, Segments, moved};
use crate::estimate::uncertainty::uncertainty;
use crate::simulate::trajectory::Halt;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Hours of the segments.
const HOURS: f64 = 24.0;
/// How far ahead it is asked what an effect does to a forecast, in hours.
pub const AHEAD_HOURS: f64 = 12.0;

/// A quantity of a finding.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Size {
    /// In its own unit.
    pub value: f64,
    /// 95 % interval; `None` where the data do not determine it within its bounds, or nobody can say.
    pub ci95: Option<[f64; 2]>,
}

/// How large a finding is.
#[derive(Debug, Clone, PartialEq)]
pub struct Sizes {
    /// The candidate's own coefficients.
    pub coefficients: Vec<Size>,
    /// What forecasts over the next [`AHEAD_HOURS`] lose without it: the root mean square of the difference
    /// that it makes to the first output, over the record cut into stretches of that length, each from the
    /// model's own states. `None` of large models.
    pub ahead: Option<Size>,
}

/// How large a candidate is in the model that has it: from segments of a day where segments have `shown` it,
/// else from the likelihood that did. What is read off the output itself has no interval, because its error
/// goes with what it explains; large models have no segments, and take the free run.
pub fn sizes(model: &NullModel, candidate: &CandidateEffect, shown: bool, halt: Halt) -> Sizes {
    by_days(model, candidate, shown, halt)
        .unwrap_or_else(|| Sizes { coefficients: of_free_run(model, candidate), ahead: None })
}

fn by_days(model: &NullModel, candidate: &CandidateEffect, shown: bool, halt: Halt) -> Option<Sizes> {
    let (problem, white, plain) = (&model.problem, &model.fitted.white, &model.fitted.plain);
    let samples = problem.split().train.start..problem.split().validation.end;
    let segments = Segments::new(problem, samples, HOURS)?;
    let settled = settle(problem, &segments, white, &segments.starts(problem, white), halt)?;
    let spread = settled.spread(problem, &segments)?;
    let days = segments.by_day(|_| 0.0).len();
    let quantile =
        StudentsT::new(0.0, 1.0, days.max(2) as f64 - 1.0).map_or(1.96, |student| student.inverse_cdf(0.975));
    let optima = if shown { [&settled.theta, white, plain] } else { [white, &settled.theta, plain] };
    // A quantity at its optimum, how far the others are apart from it, and the rest.
    let size = |value: f64, apart: f64, gradient: &[f64], [lower, upper]: [f64; 2]| {
        // Of two that differ by that much the variance is half its square.
        let half = quantile * (spread.deviation(gradient).powi(2) + apart.powi(2) / 2.0).sqrt();
        let (low, high) = (value - half, value + half);
        // An interval that covers the whole search says nothing about the quantity.
        let told = half.is_finite() && (low > lower || high < upper) && !candidate.endogenous;
        Size { value, ci95: told.then(|| [low.max(lower), high.min(upper)]) }
    };
    let Settled { linear, .. } = &settled;
    let coefficient = |(index, _): &(usize, f64)| {
        let place = linear.along.iter().position(|along| along == index)?;
        let gradient: Vec<f64> =
            (0..linear.along.len()).map(|i| if i == place { linear.slopes[i] } else { 0.0 }).collect();
        let [value, other, third] = optima.map(|theta| theta[*index]);
        let nearer = (value - other).abs().min((value - third).abs());
        Some(size(value, nearer, &gradient, problem.bounds()[*index]))
    };
    let coefficients = candidate.own.iter().map(coefficient).collect::<Option<_>>()?;
    let stretches = Segments::new(problem, first_stretch(problem)..problem.grid().len(), AHEAD_HOURS)?;
    let Moved { steps, thetas, .. } = moved(problem, optima[0]);
    let around: Vec<&[f64]> = std::iter::once(optima[0]).chain(&thetas).map(Vec::as_slice).collect();
    let moved = ahead(problem, candidate, &stretches, &around);
    let gradient: Vec<f64> =
        moved[1..].iter().zip(steps).map(|(there, step)| (there - moved[0]) / step).collect();
    // All parameters take part in a forecast, and the objectives agree on fewer of them than on the effect:
    // the farther one counts.
    let farther = [optima[1], optima[2]]
        .map(|theta| (ahead(problem, candidate, &stretches, &[theta])[0] - moved[0]).abs());
    let farther = farther[0].max(farther[1]);
    Some(Sizes { coefficients, ahead: Some(size(moved[0], farther, &gradient, [0.0, f64::INFINITY])) })
}

/// Where the first stretch begins: at midnight or noon, as those of others do. Who forecasts from the morning
/// and from the evening finds another loss without the sun.
fn first_stretch(problem: &Problem) -> usize {
    let lead = (AHEAD_HOURS * HOUR as f64) as i64;
    let begins = |k: &usize| problem.inputs().known(*k) && problem.grid().time(*k) % lead == 0;
    (0..problem.grid().len()).find(begins).unwrap_or(0)
}

/// What forecasts along stretches lose without the candidate, for some parameter vectors, from the states of
/// the first one's free run.
fn ahead(
    problem: &Problem,
    candidate: &CandidateEffect,
    stretches: &Segments,
    thetas: &[&[f64]],
) -> Vec<f64> {
    let off = |theta: &[f64]| {
        let mut off = theta.to_vec();
        candidate.own.iter().for_each(|(index, nothing)| off[*index] = *nothing);
        off
    };
    let without: Vec<Vec<f64>> = thetas.iter().map(|theta| off(theta)).collect();
    let both: Vec<&[f64]> = thetas.iter().copied().chain(without.iter().map(Vec::as_slice)).collect();
    let outputs =
        stretches.outputs(problem, problem.simulator(), &both, &stretches.starts(problem, thetas[0]));
    let (with, without) = outputs.split_at(thetas.len());
    let first: Vec<bool> = stretches.rows().map(|(output, _)| output == 0).collect();
    let root_mean_square = |(with, without): (&Vec<f64>, &Vec<f64>)| {
        let squares = with
            .iter()
            .zip(without)
            .zip(&first)
            .filter(|(_, first)| **first)
            .map(|((with, without), _)| (with - without).powi(2));
        (squares.sum::<f64>() / first.iter().filter(|first| **first).count().max(1) as f64).sqrt()
            * problem.scale(0)
    };
    with.iter().zip(without).map(root_mean_square).collect()
}

fn of_free_run(model: &NullModel, candidate: &CandidateEffect) -> Vec<Size> {
    let (problem, plain) = (&model.problem, &model.fitted.plain);
    let uncertain = uncertainty(problem, plain, None);
    let size = |(index, _): &(usize, f64)| {
        let place = problem.free().iter().position(|free| free == index).filter(|_| !candidate.endogenous);
        Size {
            value: plain[*index],
            ci95: place.and_then(|place| uncertain.ci95.get(place).copied().flatten()),
        }
    };
    candidate.own.iter().map(size).collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::{site, small_world};
    use super::*;
    use crate::data::{DAY, Series, SplitRequest, Window};
    use crate::estimate::{EstimateRequest, Problem, prepare};
    use crate::model::Catalogue;

    /// The wind's coefficient without one day after the other, each settled anew, against the one step from
    /// the whole.
    #[test]
    fn a_step_without_a_day_is_what_a_new_fit_without_it_does() {
        let (_, window) = small_world(&["wind_infiltration"]);
        let request = EstimateRequest { split: SplitRequest::DIAGNOSE, ..EstimateRequest::default() };
        let catalogue = Catalogue::builtin().unwrap();
        let of = |window: &Window| {
            prepare(&catalogue, &"room3+wind_infiltration".parse().unwrap(), &request, window, &site())
                .unwrap()
        };
        let whole = of(&window);
        let model = NullModel::settle(whole.clone(), whole.nominal(), None, &|| false).unwrap();
        let index =
            whole.model().parameters().iter().position(|parameter| parameter.name == "c_wind").unwrap();
        let settled = |problem: &Problem, from: &[f64]| {
            let samples = whole.split().train.start..whole.split().validation.end;
            let segments = Segments::new(problem, samples, HOURS).unwrap();
            (settle(problem, &segments, from, &segments.starts(problem, from), &|| false).unwrap(), segments)
        };
        let (all, segments) = settled(&whole, &model.fitted.white);
        let place = all.linear.along.iter().position(|along| *along == index).unwrap();
        let gradient: Vec<f64> = (0..all.linear.along.len())
            .map(|i| if i == place { all.linear.slopes[i] } else { 0.0 })
            .collect();
        let deviation = all.spread(&whole, &segments).unwrap().deviation(&gradient);
        let grid = whole.grid();
        let days = (grid.time(whole.split().validation.end) - grid.start()) / DAY;
        let without = |day: i64| {
            let [from, to] = [day, day + 1].map(|day| grid.start() + day * DAY);
            let thinned = window.iter().map(|series| {
                let kept = series
                    .times()
                    .iter()
                    .zip(series.values())
                    .filter(|(time, _)| !(from..to).contains(*time));
                let (times, values) = kept.map(|(time, value)| (*time, *value)).unzip();
                Series::new(series.channel(), series.unit(), series.hold(), times, values).unwrap()
            });
            let thinned = thinned
                .zip(window.iter())
                .map(|(thinned, whole)| if whole.channel() == "T_room" { thinned } else { whole.clone() });
            settled(&of(&Window::from_series(thinned.collect()).unwrap()), &all.theta).0.theta[index]
        };
        let found: Vec<f64> = (0..days).map(without).collect();
        let mean = found.iter().sum::<f64>() / days as f64;
        let brute = ((days - 1) as f64 / days as f64
            * found.iter().map(|value| (value - mean).powi(2)).sum::<f64>())
        .sqrt();
        assert!((0.8..1.25).contains(&(deviation / brute)), "{deviation} {brute}");
    }
}
