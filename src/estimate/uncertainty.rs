//! How well the data determine the parameters.
//!
//! The residuals of a free run are autocorrelated, so the Jacobian and the residual are whitened by the AR
//! model of the residual first; only then is the inverse of J'J a covariance.

use super::fit::CorrelatedPair;
use super::problem::Problem;
use super::whiten::Ar;
use crate::optimise::Candidate;
use nalgebra::DMatrix;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Correlations above this are reported.
const CORRELATED: f64 = 0.95;
/// Step of the forward differences in the unit cube.
const DIFFERENCE: f64 = 1e-5;

/// Intervals and correlations of the free parameters.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Uncertainty {
    /// 95 % intervals in physical units, in the order of the space; `None` where the data do not determine
    /// the parameter within its bounds.
    pub ci95: Vec<Option<[f64; 2]>>,
    /// Pairs that the data can hardly tell apart.
    pub correlated: Vec<CorrelatedPair>,
    /// Simulations spent.
    pub evaluations: usize,
}

/// Uncertainty at a full parameter vector, from the first output on the training part.
pub fn uncertainty(problem: &Problem, theta: &[f64]) -> Uncertainty {
    let space = problem.space();
    let none = Uncertainty { ci95: vec![None; space.len()], ..Uncertainty::default() };
    let centre = problem.candidate(theta);
    let mut points = vec![centre.clone()];
    let mut steps = Vec::new();
    for i in 0..space.len() {
        let mut moved = centre.0.clone();
        let step = if moved[i] + DIFFERENCE > 1.0 { -DIFFERENCE } else { DIFFERENCE };
        moved[i] += step;
        steps.push(step);
        points.push(Candidate(moved));
    }
    let thetas: Vec<Vec<f64>> = points.iter().map(|point| problem.theta(point)).collect();
    let slices: Vec<&[f64]> = thetas.iter().map(Vec::as_slice).collect();
    let end = problem.split().train.end;
    let runs = problem.simulator().run(&slices, end);
    let evaluations = runs.len();
    let none = Uncertainty { evaluations, ..none };
    if runs.iter().any(|run| run.diverged) {
        return none;
    }
    let used = problem.usable(0, problem.split().train.clone());
    let measured = problem.measured();
    let (values, _) = measured[0];
    let series = |f: &dyn Fn(usize) -> f64| {
        let mut series = vec![None; end];
        used.iter().for_each(|k| series[*k] = Some(f(*k)));
        series
    };
    let residual = series(&|k| runs[0].outputs[0][k] - values[k]);
    let Some(ar) = Ar::fit(&residual) else {
        return none;
    };
    let white = ar.whiten(&residual);
    let rows: Vec<usize> = (0..end).filter(|k| white[*k].is_some()).collect();
    if rows.len() <= space.len() + 1 {
        return none;
    }
    let mut jacobian = DMatrix::zeros(rows.len(), space.len());
    for (i, step) in steps.iter().enumerate() {
        let column = ar.whiten(&series(&|k| (runs[i + 1].outputs[0][k] - runs[0].outputs[0][k]) / step));
        for (row, k) in rows.iter().enumerate() {
            jacobian[(row, i)] = column[*k].unwrap_or(0.0);
        }
    }
    let freedom = (rows.len() - space.len()) as f64;
    let variance = rows.iter().filter_map(|k| white[*k]).map(|w| w * w).sum::<f64>() / freedom;
    let Some(covariance) = covariance(&jacobian, variance) else {
        return none;
    };
    let quantile = StudentsT::new(0.0, 1.0, freedom).map_or(1.96, |t| t.inverse_cdf(0.975));
    let deviation = |i: usize| covariance[(i, i)].max(0.0).sqrt();
    let ci95 = space
        .dimensions()
        .iter()
        .enumerate()
        .map(|(i, dimension)| {
            let half = quantile * deviation(i);
            let (low, high) = (centre.0[i] - half, centre.0[i] + half);
            // An interval that covers the whole search says nothing about the parameter.
            let told = half.is_finite() && (low > 0.0 || high < 1.0);
            told.then(|| [dimension.value(low.max(0.0)), dimension.value(high.min(1.0))])
        })
        .collect();
    let mut correlated = Vec::new();
    for i in 0..space.len() {
        for j in 0..i {
            let correlation = covariance[(i, j)] / (deviation(i) * deviation(j));
            if correlation.abs() > CORRELATED {
                let name = |i: usize| space.dimensions()[i].name.clone();
                correlated.push(CorrelatedPair { parameters: [name(j), name(i)], correlation });
            }
        }
    }
    Uncertainty { ci95, correlated, evaluations }
}

/// s2 (J'J)^-1 by singular values; directions that the data do not see get a huge variance instead of none.
fn covariance(jacobian: &DMatrix<f64>, variance: f64) -> Option<DMatrix<f64>> {
    let svd = jacobian.clone().svd(false, true);
    let v_t = svd.v_t?;
    let largest = svd.singular_values.iter().copied().fold(0.0, f64::max);
    if largest <= 0.0 || !largest.is_finite() {
        return None;
    }
    let mut result = DMatrix::zeros(jacobian.ncols(), jacobian.ncols());
    for (i, singular) in svd.singular_values.iter().enumerate() {
        let scale = variance / singular.max(1e-9 * largest).powi(2);
        let direction = v_t.row(i);
        result += direction.transpose() * direction * scale;
    }
    Some(result)
}
