//! Where the measured states started: what their sensors say of it, and what the outputs do afterwards.
//!
//! Starts and free parameters are estimated together by one Gauss-Newton step of whitened least squares, in
//! which the first measurements are a prior of the starts: a sensor with little noise keeps a start in its
//! place where the model errs for other reasons, and a state that is faster than its sensor is precise gets
//! its start from what follows. The parameters then follow the starts by a step of plain least squares, which
//! is what the search minimises, and stay where they are along directions that the data do not see.

use super::sensitivity::{Block, Sensitivity};
use crate::estimate::fit::StartEstimate;
use crate::estimate::problem::Problem;
use crate::optimise::Candidate;
use indexmap::IndexMap;
use nalgebra::{DMatrix, DVector};

/// Precision of a free parameter in the unit cube by the bounds of its search alone.
const BOUNDS: f64 = 12.0;

/// The most likely starts.
pub(in crate::estimate) struct Starts {
    /// Where the problem starts now, with the deviation of the estimate, by channel.
    pub as_they_are: IndexMap<String, StartEstimate>,
    /// Where it should start, by channel.
    pub likely: IndexMap<String, f64>,
    /// The largest distance between the two, in deviations of the estimate.
    pub moved: f64,
    /// Where the free parameters go with the likely ones, in the coordinates of the search.
    pub parameters: Candidate,
    /// Covariance of the estimates, each counted in its deviation by the first measurements.
    pub(super) covariance: DMatrix<f64>,
}

/// The starts at a fit; `None` of a problem in which nothing starts from a measurement.
pub(in crate::estimate) fn of(problem: &Problem, theta: &[f64], sensitivity: &Sensitivity) -> Option<Starts> {
    let Sensitivity { jacobian, to_starts, starts, blocks, run } = sensitivity;
    if starts.is_empty() {
        return None;
    }
    let (free, all) = (jacobian.ncols(), jacobian.ncols() + starts.len());
    let mut precision = DMatrix::zeros(all, all);
    let mut pull = DVector::zeros(all);
    let mut residuals = Vec::with_capacity(jacobian.nrows());
    let mut first = 0;
    for (output, block) in blocks.iter().enumerate() {
        let n = block.samples.len();
        let mut columns = DMatrix::zeros(n, all);
        columns.columns_mut(0, free).copy_from(&jacobian.rows(first, n));
        columns.columns_mut(free, starts.len()).copy_from(&to_starts.rows(first, n));
        residuals.extend(block.errors(problem, output, run));
        let errors = DMatrix::from_column_slice(n, 1, &residuals[first..]);
        let spread = (errors.norm_squared() / n as f64).sqrt();
        let [columns, errors] = [columns, errors].map(|matrix| white(&matrix, block, spread));
        precision += columns.tr_mul(&columns);
        pull -= columns.tr_mul(&errors);
        first += n;
    }
    let now: Vec<f64> =
        starts.iter().map(|start| problem.simulator().measured_start(start.output)).collect::<Option<_>>()?;
    (0..free).for_each(|i| precision[(i, i)] += BOUNDS);
    for (i, (start, now)) in starts.iter().zip(&now).enumerate() {
        precision[(free + i, free + i)] += 1.0;
        pull[free + i] -= (now - start.mean) / start.deviation;
    }
    let cholesky = precision.cholesky()?;
    let step = cholesky.solve(&pull);
    let covariance = cholesky.inverse().view((free, free), (starts.len(), starts.len())).into_owned();
    let (mut as_they_are, mut likely, mut moved) = (IndexMap::new(), IndexMap::new(), 0.0_f64);
    for (i, (start, now)) in starts.iter().zip(&now).enumerate() {
        let channel = &problem.model().outputs()[start.output].channel;
        let known = covariance[(i, i)].sqrt();
        as_they_are
            .insert(channel.clone(), StartEstimate { value: *now, deviation: known * start.deviation });
        likely.insert(channel.clone(), now + step[free + i] * start.deviation);
        moved = moved.max(step[free + i].abs() / known);
    }
    // Where the starts go, the outputs go along: the parameters answer what is left then.
    let left = DVector::from_vec(residuals) + to_starts * step.rows(free, starts.len());
    let mut normal = jacobian.tr_mul(jacobian);
    let variance = left.norm_squared() / left.len() as f64;
    (0..free).for_each(|i| normal[(i, i)] += BOUNDS * variance);
    let answer = normal.cholesky()?.solve(&jacobian.tr_mul(&left));
    let place = problem.candidate(theta).0;
    let parameters =
        Candidate(place.iter().zip(answer.iter()).map(|(at, step)| (at - step).clamp(0.0, 1.0)).collect());
    Some(Starts { as_they_are, likely, parameters, moved, covariance })
}

/// The rows of an output without what their past explains, in deviations of what is left. Behind a gap there
/// is no past: those rows count together as one draw of the errors themselves.
fn white(matrix: &DMatrix<f64>, block: &Block, spread: f64) -> DMatrix<f64> {
    let order = block.ar.coefficients.len();
    let alone = (spread.max(f64::MIN_POSITIVE) * (order as f64).sqrt()).recip();
    let left = block.ar.deviation.max(f64::MIN_POSITIVE).recip();
    let mut white = matrix.clone();
    for row in 0..matrix.nrows() {
        let past: Vec<(usize, f64)> = block.past(row).collect();
        if past.len() < order {
            white.row_mut(row).scale_mut(alone);
            continue;
        }
        for column in 0..matrix.ncols() {
            let explained: f64 = past.iter().map(|(past, by)| by * matrix[(*past, column)]).sum();
            white[(row, column)] = (matrix[(row, column)] - explained) * left;
        }
    }
    white
}
