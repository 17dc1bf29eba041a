//! How sharply a likelihood is peaked: standard errors, correlations and profiles at its optimum.

use super::objective::LikelihoodObjective;
use crate::estimate::fit::CorrelatedPair;
use crate::estimate::fit::covariance::Covariance;
use crate::estimate::fit::likelihood::Profile;
use crate::estimate::problem::bounds::AT_BOUND;
use crate::estimate::search::control::Control;
use crate::estimate::uncertainty::covariance::{self, WIDTH};
use crate::optimise::ctsm::CtsmOptions;
use crate::optimise::scoring::ScoringOptions;
use indexmap::IndexMap;
use nalgebra::{DMatrix, SymmetricEigen};
use rayon::prelude::*;

/// Length of a difference of gradients, in standard errors of a coordinate whose companions stay.
const DIFFERENCE: f64 = 0.05;
/// Correlations above this are reported.
const CORRELATED: f64 = 0.95;
/// How far a profile goes on either side, in standard errors.
const REACH: f64 = 2.4;
/// Half the 95 % quantile of chi-squared with one degree of freedom.
const FALL: f64 = 1.920_729_410_347_062;

/// The peak of a likelihood.
#[derive(Debug, Clone)]
pub struct Curvature {
    /// The 95 % interval of each coordinate, on its scale; `None` where the data do not determine it within
    /// its bounds.
    pub intervals: Vec<Option<[f64; 2]>>,
    /// The standard error of each, in its unit.
    pub errors: Vec<Option<f64>>,
    /// Correlations by rows; those of a coordinate on its bound are zero.
    pub correlations: Vec<Vec<f64>>,
    /// Standard errors and covariance in the unit cube; a coordinate on its bound has none.
    deviation: Vec<f64>,
    covariance: DMatrix<f64>,
    /// Filter passes.
    pub passes: usize,
}

impl Curvature {
    /// The inverse of the Hessian at an optimum; the Hessian is a central difference of exact gradients.
    /// Coordinates on a bound stay there.
    pub fn at(task: &LikelihoodObjective, place: &[f64]) -> Self {
        let d = place.len();
        let inside: Vec<usize> =
            (0..d).filter(|i| (AT_BOUND..=1.0 - AT_BOUND).contains(&place[*i])).collect();
        let mut curvature = Self {
            intervals: vec![None; d],
            errors: vec![None; d],
            correlations: (0..d).map(|i| (0..d).map(|j| f64::from(i == j)).collect()).collect(),
            deviation: vec![0.0; d],
            covariance: DMatrix::zeros(d, d),
            passes: 0,
        };
        let Some(centre) = task.slope(place, &inside) else { return curvature };
        let n = inside.len();
        let information = DMatrix::from_row_slice(n, n, &centre.information);
        let column = |index: &usize| {
            let step =
                (DIFFERENCE / information[(*index, *index)].max(1e-12).sqrt()).clamp(1e-7, 0.5 * AT_BOUND);
            let moved = |by: f64| {
                let mut moved = place.to_vec();
                moved[inside[*index]] += by;
                task.slope(&moved, &inside).map(|slope| slope.gradient)
            };
            let (up, down) = (moved(step)?, moved(-step)?);
            Some(up.iter().zip(&down).map(|(up, down)| (up - down) / (2.0 * step)).collect::<Vec<f64>>())
        };
        let columns: Option<Vec<Vec<f64>>> = (0..n).collect::<Vec<usize>>().par_iter().map(column).collect();
        curvature.passes = 1 + 2 * n;
        let hessian =
            columns.map(|columns| DMatrix::from_fn(n, n, |i, j| 0.5 * (columns[j][i] + columns[i][j])));
        let Some(covariance) = hessian.and_then(inverse).or_else(|| inverse(information)) else {
            return curvature;
        };
        for (a, i) in inside.iter().enumerate() {
            curvature.deviation[*i] = covariance[(a, a)].max(0.0).sqrt();
            for (b, j) in inside.iter().enumerate() {
                curvature.covariance[(*i, *j)] = covariance[(a, b)];
                let correlation = covariance[(a, b)] / (covariance[(a, a)] * covariance[(b, b)]).sqrt();
                if a != b {
                    curvature.correlations[*i][*j] = if correlation.is_finite() { correlation } else { 0.0 };
                }
            }
        }
        for i in inside {
            let dimension = &task.space().dimensions()[i];
            let (low, high) =
                (place[i] - WIDTH * curvature.deviation[i], place[i] + WIDTH * curvature.deviation[i]);
            // An interval that covers the whole search says nothing about the parameter.
            if high - low < f64::INFINITY && (low > 0.0 || high < 1.0) {
                curvature.intervals[i] =
                    Some([dimension.value(low.max(0.0)), dimension.value(high.min(1.0))]);
                let slope = dimension.slope(dimension.value(place[i]));
                curvature.errors[i] = Some(curvature.deviation[i] * slope);
            }
        }
        curvature
    }

    /// The covariance of the first coordinates, which are parameters, as far as they sit on no bound.
    pub fn of_estimates(
        &self,
        task: &LikelihoodObjective,
        place: &[f64],
        first: usize,
    ) -> Option<Covariance> {
        let inside: Vec<usize> = (0..first).filter(|i| self.deviation[*i] > 0.0).collect();
        let cube = self.covariance.select_rows(&inside).select_columns(&inside);
        let dimensions = &task.space().dimensions()[..first];
        let theta: Vec<f64> = dimensions.iter().zip(place).map(|(one, unit)| one.value(*unit)).collect();
        covariance::of_estimates(&cube, &inside, dimensions, &theta)
    }

    /// The pairs of the first coordinates that the data can hardly tell apart.
    pub fn correlated(&self, task: &LikelihoodObjective, first: usize) -> Vec<CorrelatedPair> {
        let name = |i: usize| task.space().dimensions()[i].name.clone();
        let pairs = (0..first).flat_map(|i| (0..i).map(move |j| (i, j)));
        pairs
            .map(|(i, j)| CorrelatedPair {
                parameters: [name(j), name(i)],
                correlation: self.correlations[i][j],
                ridge: Vec::new(),
            })
            .filter(|pair| pair.correlation.abs() > CORRELATED)
            .collect()
    }
}

/// The inverse of a matrix that ought to be positive: directions that the data do not see get a huge
/// variance. `None` where it bends the wrong way.
fn inverse(matrix: DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = matrix.nrows();
    if n == 0 || matrix.iter().any(|value| !value.is_finite()) {
        return None;
    }
    // On the scale of its diagonal, so that what is small is small because of the data and not because of the
    // units.
    let diagonal = |i: usize| matrix[(i, i)].abs().sqrt();
    let greatest = (0..n).map(diagonal).fold(0.0, f64::max);
    // What nothing depends on has a scale all the same.
    let scale: Vec<f64> = (0..n).map(|i| diagonal(i).max(1e-8 * greatest).max(1e-100)).collect();
    let scaled = DMatrix::from_fn(n, n, |i, j| matrix[(i, j)] / (scale[i] * scale[j]));
    let eigen = SymmetricEigen::try_new(scaled, 1e-14, 10_000)?;
    let largest = eigen.eigenvalues.iter().copied().fold(0.0, f64::max);
    if eigen.eigenvalues.iter().any(|value| *value < -1e-6 * largest) {
        return None;
    }
    let inverse = DMatrix::from_diagonal(&eigen.eigenvalues.map(|value| 1.0 / value.max(1e-10 * largest)));
    let whole = &eigen.eigenvectors * inverse * eigen.eigenvectors.transpose();
    Some(DMatrix::from_fn(n, n, |i, j| whole[(i, j)] / (scale[i] * scale[j])))
}

/// How much better a point of a profile has to be than the optimum to show that it was none.
const BETTER: f64 = 1e-2;

/// The profile likelihoods of the parameters.
pub struct Profiled {
    /// By parameter.
    pub profiles: IndexMap<String, Profile>,
    /// Filter passes.
    pub passes: usize,
    /// The best place on any of them, where it is better than the optimum.
    pub better: Option<Vec<f64>>,
}

/// Profiles a likelihood about its optimum. Each side goes outwards, the others following first the
/// covariance and then their own slopes.
pub fn profiles(
    task: &LikelihoodObjective,
    place: &[f64],
    curvature: &Curvature,
    options: &CtsmOptions,
    control: &Control,
) -> Profiled {
    let own = task.parameters();
    let mut profiled = Profiled { profiles: IndexMap::new(), passes: 0, better: None };
    let Some(best) = task.value(place) else { return profiled };
    let sides: Vec<(usize, f64)> = (0..own)
        .filter(|i| curvature.deviation[*i] > 0.0)
        .flat_map(|i| [(i, -1.0), (i, 1.0)])
        .filter(|_| options.profile > 0)
        .collect();
    let climbing = ScoringOptions { steps: 15, tolerance: 1e-2, radius: 0.1, ..options.scoring.clone() };
    let walk = |(coordinate, sign): &(usize, f64)| {
        let others: Vec<usize> =
            (0..place.len()).filter(|i| i != coordinate && curvature.deviation[*i] > 0.0).collect();
        let step = sign * (REACH * curvature.deviation[*coordinate]).min(0.5) / options.profile as f64;
        let mut here = place.to_vec();
        let mut points: Vec<(f64, f64)> = Vec::new();
        let mut better: Option<(Vec<f64>, f64)> = None;
        let mut passes = 0;
        for _ in 0..options.profile {
            let target = (here[*coordinate] + step).clamp(0.0, 1.0);
            let by = target - here[*coordinate];
            if by == 0.0 || (control.interrupt)().is_some() {
                break;
            }
            for i in &others {
                let along = curvature.covariance[(*i, *coordinate)]
                    / curvature.covariance[(*coordinate, *coordinate)];
                here[*i] = (here[*i] + along * by).clamp(0.0, 1.0);
            }
            here[*coordinate] = target;
            let Some((there, value, more)) = task.climb(&here, &others, &climbing) else { break };
            passes += more;
            here = there;
            points.push((target, value));
            if value < better.as_ref().map_or(best - BETTER, |(_, known)| *known) {
                better = Some((here.clone(), value));
            }
        }
        (points, passes, better)
    };
    let walked: Vec<Walk> = sides.par_iter().map(walk).collect();
    profiled.passes = walked.iter().map(|(_, passes, _)| passes).sum();
    // Of equal ones the first, whoever was ready first.
    let found = walked.iter().filter_map(|(_, _, better)| better.as_ref());
    profiled.better = found.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(place, _)| place.clone());
    for (pair, sides) in walked.chunks(2).zip(sides.chunks(2)) {
        let [(below, ..), (above, ..)] = pair else { continue };
        let coordinate = sides[0].0;
        let dimension = &task.space().dimensions()[coordinate];
        let centre = (place[coordinate], best);
        let crossing = |side: &[(f64, f64)]| crossing(centre, side).map(|unit| dimension.value(unit));
        let ci95 = [crossing(below), crossing(above)];
        let points: Vec<(f64, f64)> =
            below.iter().rev().copied().chain([centre]).chain(above.iter().copied()).collect();
        profiled.profiles.insert(
            dimension.name.clone(),
            Profile {
                values: points.iter().map(|(unit, _)| dimension.value(*unit)).collect(),
                log_likelihood: points.iter().map(|(_, value)| -value).collect(),
                ci95,
            },
        );
    }
    profiled
}

/// One side of a profile: its points with their values, the filter passes, and the best place if it beats the
/// optimum.
type Walk = (Vec<(f64, f64)>, usize, Option<(Vec<f64>, f64)>);

/// Where a profile falls by 1.92 below its peak: between two points, along a straight line of the root of the
/// fall, which is straight where the likelihood is a parabola.
fn crossing(centre: (f64, f64), side: &[(f64, f64)]) -> Option<f64> {
    let root = |value: f64| (value - centre.1).max(0.0).sqrt();
    let mut last = centre;
    for point in side {
        let (before, after) = (root(last.1), root(point.1));
        if after >= FALL.sqrt() {
            return Some(last.0 + (point.0 - last.0) * (FALL.sqrt() - before) / (after - before));
        }
        last = *point;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_nothing_depends_on_has_a_huge_variance_and_a_finite_one() {
        let dead = inverse(DMatrix::from_row_slice(2, 2, &[4.0, 0.0, 0.0, 0.0])).unwrap();
        assert!(dead.iter().all(|value| value.is_finite()), "{dead}");
        assert!((dead[(0, 0)] - 0.25).abs() < 1e-12 && dead[(1, 1)] > 1e12, "{dead}");
        let whole = inverse(DMatrix::from_row_slice(2, 2, &[2.0, 1.0, 1.0, 2.0])).unwrap();
        assert!(
            (whole[(0, 0)] - 2.0 / 3.0).abs() < 1e-12 && (whole[(0, 1)] + 1.0 / 3.0).abs() < 1e-12,
            "{whole}"
        );
        assert!(inverse(DMatrix::from_row_slice(1, 1, &[-1.0])).is_none());
    }
}
