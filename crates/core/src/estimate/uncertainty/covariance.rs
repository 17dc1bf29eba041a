//! From the covariance in the unit cube to that of the estimates, and to what the data leave open.

use crate::estimate::decompose::symmetric;
use crate::estimate::fit::covariance::Covariance;
use crate::optimise::Dimension;
use nalgebra::{DMatrix, SymmetricEigen};

/// Half the width of a 95 % interval, in standard deviations.
pub const WIDTH: f64 = 1.959_963_984_540_054;
/// Share of a direction from which a parameter is named as a part of it.
const PART: f64 = 0.3;
/// Variance of a coordinate of which only the bounds of the search are known: that of a uniform distribution
/// over the cube.
const BOUNDS: f64 = 1.0 / 12.0;

/// The covariance of the estimates `theta` from that of their coordinates in the unit cube; `inside` has the
/// places of those that the matrix is about, in its order.
///
/// The bounds count as knowledge beside the data, as a prior of covariance [`BOUNDS`] in every direction, so
/// that a direction along which the data say nothing is as uncertain as the search was wide, and not without
/// end. A combination of parameters is undetermined where its 95 % interval by the data alone is as wide as
/// the cube.
pub(in crate::estimate) fn of_estimates(
    cube: &DMatrix<f64>,
    inside: &[usize],
    dimensions: &[Dimension],
    theta: &[f64],
) -> Option<Covariance> {
    if inside.is_empty() || cube.iter().any(|value| !value.is_finite()) {
        return None;
    }
    let name = |row: usize| dimensions[inside[row]].name.clone();
    let SymmetricEigen { eigenvalues, eigenvectors } = symmetric(cube.clone())?;
    let variance = eigenvalues.map(|value| value.max(0.0));
    // The harmonic sum of both, direction by direction: nothing is cancelled, however far they are apart.
    let known = variance.map(|value| value * BOUNDS / (value + BOUNDS));
    let both = &eigenvectors * DMatrix::from_diagonal(&known) * eigenvectors.transpose();
    let slope = |row: usize| dimensions[inside[row]].slope(theta[inside[row]]);
    // Symmetric to the last bit.
    let entry = |a: usize, b: usize| {
        let (a, b) = (a.min(b), a.max(b));
        both[(a, b)] * slope(a) * slope(b)
    };
    let rows = 0..inside.len();
    let matrix: Vec<Vec<f64>> = rows.clone().map(|a| rows.clone().map(|b| entry(a, b)).collect()).collect();
    let is_open = |k: &usize| 2.0 * WIDTH * variance[*k].sqrt() >= 1.0;
    let parts = |k: usize| -> Vec<String> {
        let direction = eigenvectors.column(k);
        rows.clone().filter(|row| direction[*row].abs() >= PART).map(name).collect()
    };
    let undetermined: Vec<Vec<String>> = rows.clone().filter(is_open).map(parts).collect();
    let is_finite = matrix.iter().flatten().all(|value| value.is_finite());
    is_finite.then(|| Covariance {
        parameters: rows.clone().map(name).collect(),
        matrix,
        rank: inside.len() - undetermined.len(),
        undetermined,
    })
}
