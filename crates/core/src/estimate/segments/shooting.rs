//! A fit to segments with states of their own: multiple shooting by the method of Gauss and Newton (Bock
//! 1983), with the starts projected out of every step.
//!
//! Its parameters explain where the room goes from here over some hours, and not where a free run of weeks
//! ends up.

use crate::estimate::problem::Problem;
use crate::estimate::segments::{Linear, REACH, Segments, slices};
use crate::gram::{dot, gram};
use nalgebra::{DMatrix, DVector};

/// Most steps, and the share of the cost below which one gains too little for another.
const STEPS: usize = 12;
const GAIN: f64 = 1e-5;
/// Dampings that are tried before a step is given up, the first one, and the factors by which it grows and
/// falls.
const DAMPINGS: usize = 4;
const DAMPING: f64 = 1e-3;
const HARDER: f64 = 10.0;
const SOFTER: f64 = 0.2;

/// Where a fit to segments ends.
#[derive(Debug, Clone)]
pub struct Settled {
    /// The full parameter vector.
    pub theta: Vec<f64>,
    /// The model along the segments there.
    pub linear: Linear,
}

/// Goes from a parameter vector and states at the segments' starts to the least squares of the segments, each
/// parameter within reach of where it began. `None` where the model leaves the numbers at once.
pub fn settle(
    problem: &Problem,
    segments: &Segments,
    theta: &[f64],
    starts: &[Vec<f64>],
    halt: &dyn Fn() -> bool,
) -> Option<Settled> {
    let anchor = problem.candidate(theta);
    let mut here = Settled {
        theta: theta.to_vec(),
        linear: segments.linearise(problem, problem.simulator(), theta, starts)?,
    };
    let place: Vec<usize> = here
        .linear
        .along
        .iter()
        .filter_map(|index| problem.free().iter().position(|free| free == index))
        .collect();
    let mut damping = DAMPING;
    for _ in 0..STEPS {
        let cube = problem.candidate(&here.theta);
        let Linear { residual, columns, .. } = &here.linear;
        let pull = dot(residual, residual) / residual.len().max(1) as f64 / REACH.powi(2);
        let strayed = |at: &[f64]| place.iter().map(|i| (at[*i] - anchor.0[*i]).powi(2)).sum::<f64>();
        let cost = |linear: &Linear, at: &[f64]| dot(&linear.residual, &linear.residual) + pull * strayed(at);
        let normal = DMatrix::from_vec(place.len(), place.len(), gram(&slices(columns)[..place.len()]));
        let right = DVector::from_fn(place.len(), |i, _| {
            dot(&columns[i], residual) + pull * (anchor.0[place[i]] - cube.0[place[i]])
        });
        let before = cost(&here.linear, &cube.0);
        let mut next = None;
        for _ in 0..DAMPINGS {
            if halt() {
                return Some(here);
            }
            let mut damped = normal.clone();
            (0..place.len()).for_each(|i| damped[(i, i)] += pull + damping * normal[(i, i)]);
            let there = damped.cholesky().and_then(|factor| {
                let step = factor.solve(&right);
                let mut there = cube.clone();
                place
                    .iter()
                    .zip(step.iter())
                    .for_each(|(i, step)| there.0[*i] = (there.0[*i] + step).clamp(0.0, 1.0));
                let theta = problem.theta(&there);
                let linear = segments.linearise(problem, problem.simulator(), &theta, &here.linear.starts)?;
                let after = cost(&linear, &there.0);
                (after < before).then_some((Settled { theta, linear }, after))
            });
            if there.is_some() {
                next = there;
                break;
            }
            damping *= HARDER;
        }
        let Some((there, after)) = next else { break };
        here = there;
        damping *= SOFTER;
        if after > (1.0 - GAIN) * before {
            break;
        }
    }
    Some(here)
}

/// How far the parameters of a fit to segments may lie from the truth, in the unit cube of the search.
#[derive(Debug, Clone)]
pub struct Spread {
    /// The step of all parameters when one day is left out, day by day.
    steps: Vec<DVector<f64>>,
    /// The inverse of the normal matrix, times what each parameter is pulled by towards where it began.
    held: DMatrix<f64>,
}

impl Settled {
    /// Without one day after the other, each by one step (the jackknife of clusters; Bell and McCaffrey 2002,
    /// Survey Methodology 28, 169-181). `None` where there are fewer than three days or one of them is all
    /// that determines a parameter.
    pub fn spread(&self, problem: &Problem, segments: &Segments) -> Option<Spread> {
        // Once more from the starts that belong to these parameters.
        let linear = segments.linearise(problem, problem.simulator(), &self.theta, &self.linear.starts)?;
        let (residual, columns) = (&linear.residual, &linear.columns);
        let n = columns.len();
        let by_day = |i: usize, other: &[f64]| segments.by_day(|row| columns[i][row] * other[row]);
        let scores: Vec<Vec<f64>> = (0..n).map(|i| by_day(i, residual)).collect();
        let squares: Vec<Vec<Vec<f64>>> =
            (0..n).map(|i| columns[..=i].iter().map(|column| by_day(i, column)).collect()).collect();
        let days = scores.first().map_or(0, Vec::len);
        if days < 3 {
            return None;
        }
        let square =
            |i: usize, j: usize, day: usize| if j <= i { squares[i][j][day] } else { squares[j][i][day] };
        let pull = dot(residual, residual) / residual.len() as f64 / REACH.powi(2);
        let mut all = DMatrix::from_fn(n, n, |i, j| (0..days).map(|day| square(i, j, day)).sum());
        (0..n).for_each(|i| all[(i, i)] += pull);
        let step = |day: usize| {
            let without = &all - DMatrix::from_fn(n, n, |i, j| square(i, j, day));
            Some(without.cholesky()?.solve(&DVector::from_fn(n, |i, _| scores[i][day])))
        };
        let steps = (0..days).map(step).collect::<Option<_>>()?;
        Some(Spread { steps, held: pull * all.cholesky()?.inverse() })
    }
}

impl Spread {
    /// The deviation of a function of the parameters, by its gradient along [`Linear::along`] in the unit
    /// cube: the jackknife's, and what the pull towards the beginning may hold back where the data ask for
    /// little.
    pub fn deviation(&self, gradient: &[f64]) -> f64 {
        let gradient = DVector::from_column_slice(gradient);
        let days = self.steps.len() as f64;
        let jackknife =
            (days - 1.0) / days * self.steps.iter().map(|step| gradient.dot(step).powi(2)).sum::<f64>();
        (jackknife + (REACH * (&self.held * gradient).norm()).powi(2)).sqrt()
    }
}
