//! How well the data determine the parameters.
//!
//! The residuals e of a free run are autocorrelated, and their plain least squares are no likelihood: the
//! covariance of the estimates is `(J'J)^-1 J' S J (J'J)^-1` with S the covariance of the residuals, here
//! that of their AR model (the "sandwich"; White 1982, Econometrica 50, 1-25). The inverse of `J' S^-1 J`,
//! which is that of whitened least squares, would be too small.
//!
//! The measured states start somewhere within the noise of their sensors; what is not known of the `starts`
//! is not known of the parameters either.

pub mod covariance;
#[cfg(test)]
mod covariance_tests;
pub mod ridge;
pub mod sensitivity;
pub mod starts;

use super::fit::CorrelatedPair;
use super::fit::StartEstimate;
use super::fit::covariance::Covariance;
use super::problem::Problem;
use crate::estimate::decompose::{singular, symmetric};
use crate::simulate::Trajectory;
use indexmap::IndexMap;
use nalgebra::{DMatrix, DVector, Dyn, SVD};
use sensitivity::{Block, Sensitivity, places};
use starts::Starts;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Correlations above this are reported.
const CORRELATED: f64 = 0.95;
/// What counts as no singular value, beside the largest.
const LEAST: f64 = 1e-9;
/// Deviation of a coordinate of which a prior knows nothing, in lengths of the cube.
const UNKNOWN: f64 = 1e3;

/// Intervals and correlations of the free parameters.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Uncertainty {
    /// 95 % intervals in physical units, in the order of the space; `None` where the data do not determine
    /// the parameter within its bounds.
    pub ci95: Vec<Option<[f64; 2]>>,
    /// Pairs that the data can hardly tell apart.
    pub correlated: Vec<CorrelatedPair>,
    /// How far all coordinates of the search go along with the first parameter of each pair, for a length of
    /// its own.
    pub leads: Vec<Vec<f64>>,
    /// How they err together; `None` where that is not known.
    pub covariance: Option<Covariance>,
    /// Where the measured states start, by the channels that measure them.
    pub starts: IndexMap<String, StartEstimate>,
    /// Simulations spent.
    pub evaluations: usize,
}

/// Uncertainty at a full parameter vector, from all outputs on the training part, which are taken to err
/// independently. What the outputs answer there may be known.
pub fn uncertainty(problem: &Problem, theta: &[f64], known: Option<Sensitivity>) -> Uncertainty {
    let space = problem.space();
    // Where every parameter is fixed there is nothing to be uncertain about, and no matrix to decompose.
    let evaluations = if known.is_some() { 0 } else { simulations(problem) };
    let none = Uncertainty { ci95: vec![None; space.len()], evaluations, ..Uncertainty::default() };
    let Some(sensitivity) = known.or_else(|| Sensitivity::new(problem, theta)) else { return none };
    let (centre, rows) = (problem.candidate(theta), sensitivity.jacobian.nrows());
    let starts = starts::of(problem, theta, &sensitivity);
    let of_data =
        singular(sensitivity.jacobian.clone()).and_then(|svd| cube(svd, &sensitivity, starts.as_ref()));
    let Some(cube) = of_data.and_then(|cube| with_prior(problem, cube)) else { return none };
    let starts = starts.map(|found| found.as_they_are).unwrap_or_default();
    let freedom = (rows - space.len()) as f64;
    let quantile = StudentsT::new(0.0, 1.0, freedom).map_or(1.96, |t| t.inverse_cdf(0.975));
    let deviation = |i: usize| cube[(i, i)].max(0.0).sqrt();
    let ci95: Vec<Option<[f64; 2]>> = space
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
    let (mut correlated, mut leads) = (Vec::new(), Vec::new());
    for i in 0..space.len() {
        for j in 0..i {
            let correlation = cube[(i, j)] / (deviation(i) * deviation(j));
            if correlation.abs() > CORRELATED {
                let name = |i: usize| space.dimensions()[i].name.clone();
                correlated.push(CorrelatedPair {
                    parameters: [name(j), name(i)],
                    correlation,
                    ridge: Vec::new(),
                });
                leads.push((0..space.len()).map(|other| cube[(other, j)] / cube[(j, j)]).collect());
            }
        }
    }
    let inside: Vec<usize> = (0..space.len()).collect();
    let values: Vec<f64> = problem.free().iter().map(|index| theta[*index]).collect();
    let covariance = covariance::of_estimates(&cube, &inside, space.dimensions(), &values);
    Uncertainty { ci95, correlated, leads, covariance, starts, evaluations }
}

/// How many simulations the sensitivities take.
pub(in crate::estimate) fn simulations(problem: &Problem) -> usize {
    match problem.space().len() {
        0 => 0,
        free => free + 1 + problem.measured_starts().len(),
    }
}

/// The covariance of the estimates, in the coordinates of the search, where a prior knows something of them
/// beside the data: `(C^-1 + D^-1)^-1`, direction by direction, so that nothing is cancelled.
fn with_prior(problem: &Problem, cube: DMatrix<f64>) -> Option<DMatrix<f64>> {
    let (dimensions, free) = (problem.space().dimensions(), problem.free());
    let known =
        |place: usize| Some(problem.known_before(free[place])?.deviation / dimensions[place].length());
    if (0..free.len()).all(|place| known(place).is_none()) {
        return Some(cube);
    }
    let deviations = DVector::from_fn(free.len(), |place, _| known(place).unwrap_or(UNKNOWN));
    let scaled =
        DMatrix::from_fn(free.len(), free.len(), |i, j| cube[(i, j)] / deviations[i] / deviations[j]);
    let found = symmetric(scaled)?;
    let both = found.eigenvalues.map(|value| value.max(0.0) / (1.0 + value.max(0.0)));
    let unit = &found.eigenvectors * DMatrix::from_diagonal(&both) * found.eigenvectors.transpose();
    Some(DMatrix::from_fn(free.len(), free.len(), |i, j| unit[(i, j)] * deviations[i] * deviations[j]))
}

/// How many times as uncertain, as a variance, the errors of a free run leave its parameters as white ones of
/// the same size would: the geometric mean over all directions, which is at least one. `None` where nothing
/// is determined.
pub(in crate::estimate) fn louder_than_white(problem: &Problem, theta: &[f64]) -> Option<f64> {
    let sensitivity = Sensitivity::new(problem, theta)?;
    let errors = |(output, block): (usize, &Block)| block.errors(problem, output, &sensitivity.run);
    let errors: Vec<f64> = sensitivity.blocks.iter().enumerate().flat_map(errors).collect();
    let white = errors.iter().map(|error| error * error).sum::<f64>() / errors.len().max(1) as f64;
    let of_errors = symmetric(middle(&mut singular(sensitivity.jacobian)?.u?, &sensitivity.blocks))?;
    let logarithms = of_errors.eigenvalues.map(|value| (value / white).max(1.0).ln());
    Some(logarithms.mean().exp()).filter(|louder| louder.is_finite())
}

/// The covariance of the estimates in the coordinates of the search: what the errors leave open where the
/// starts are known, and what the starts do.
fn cube(svd: SVD<f64, Dyn, Dyn>, sensitivity: &Sensitivity, starts: Option<&Starts>) -> Option<DMatrix<f64>> {
    let least = LEAST * svd.singular_values.iter().copied().fold(0.0, f64::max);
    let carried = match starts {
        Some(starts) => Some((svd.solve(&sensitivity.to_starts, least).ok()?, &starts.covariance)),
        None => None,
    };
    let cube = sandwich(svd, &sensitivity.blocks)?;
    Some(match carried {
        Some((carried, covariance)) => cube + &carried * covariance * carried.transpose(),
        None => cube,
    })
}

/// How far the estimates move where the outputs of a free run change to those of another one, in their
/// standard deviations, which are not less than sensors of the declared noise would leave: the most that any
/// does. `None` where nothing is determined.
pub fn shift(problem: &Problem, theta: &[f64], sensitivity: &Sensitivity, other: &Trajectory) -> Option<f64> {
    let change = |(output, k, weight): (usize, usize, f64)| {
        (other.outputs[output][k] - sensitivity.run.outputs[output][k]) * weight
    };
    let change = DVector::from_vec(places(&sensitivity.blocks).map(change).collect());
    let svd = singular(sensitivity.jacobian.clone())?;
    let least = LEAST * svd.singular_values.iter().copied().fold(0.0, f64::max);
    let moved = svd.solve(&change, least).ok()?;
    let of_sensors: Vec<Block> = sensitivity
        .blocks
        .iter()
        .zip(problem.model().outputs())
        .map(|(block, output)| block.as_noisy_as(output.noise_sd))
        .collect();
    let white = sandwich(svd.clone(), &of_sensors)?;
    let cube = cube(svd, sensitivity, starts::of(problem, theta, sensitivity).as_ref())?;
    let variance = |i: usize| cube[(i, i)].max(white[(i, i)]).max(f64::MIN_POSITIVE);
    let deviations = |(i, moved): (usize, &f64)| moved.abs() / variance(i).sqrt();
    moved.iter().enumerate().map(deviations).max_by(f64::total_cmp)
}

/// The sandwich by singular values, J = U D V': `V D^-1 (U' S U) D^-1 V'`. Directions that the data do not
/// see get a huge variance instead of none.
fn sandwich(svd: SVD<f64, Dyn, Dyn>, blocks: &[Block]) -> Option<DMatrix<f64>> {
    let (mut u, v_t) = (svd.u?, svd.v_t?);
    let largest = svd.singular_values.iter().copied().fold(0.0, f64::max);
    if largest <= 0.0 || !largest.is_finite() {
        return None;
    }
    let mut middle = middle(&mut u, blocks);
    let scale: Vec<f64> =
        svd.singular_values.iter().map(|singular| 1.0 / singular.max(LEAST * largest)).collect();
    for (i, a) in scale.iter().enumerate() {
        for (j, b) in scale.iter().enumerate() {
            middle[(i, j)] *= a * b;
        }
    }
    Some(v_t.tr_mul(&(middle * &v_t)))
}

/// `U' S U`. The residuals are A^-1 w, with w white and A the filter that whitens them, so that it is the
/// square of A^-T U: a recursion backwards in time, in the place of `u`.
fn middle(u: &mut DMatrix<f64>, blocks: &[Block]) -> DMatrix<f64> {
    let mut middle = DMatrix::zeros(u.ncols(), u.ncols());
    let mut first = 0;
    for Block { samples, stride, ar, .. } in blocks {
        let mut part = u.rows_mut(first, samples.len());
        for mut column in part.column_iter_mut() {
            for row in (0..samples.len()).rev() {
                for (lag, coefficient) in ar.coefficients.iter().enumerate() {
                    let later = row + lag + 1;
                    if later >= samples.len() || samples[later] != samples[row] + (lag + 1) * *stride {
                        break;
                    }
                    column[row] += coefficient * column[later];
                }
            }
        }
        middle += part.tr_mul(&part) * ar.deviation.powi(2);
        first += samples.len();
    }
    middle
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimate::problem::whiten::Ar;
    use rand::{RngExt, SeedableRng};
    use rand_xoshiro::Xoshiro256PlusPlus;

    const AR: f64 = 0.9;

    fn regressors(rows: usize) -> DMatrix<f64> {
        DMatrix::from_fn(rows, 3, |row, column| match column {
            0 => 1.0,
            1 => (row as f64 / 15.0).sin(),
            _ => row as f64 / rows as f64,
        })
    }

    /// Normally distributed by the polar method.
    fn normal(random: &mut Xoshiro256PlusPlus) -> f64 {
        let (u, v): (f64, f64) = (random.random(), random.random());
        (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }

    #[test]
    fn the_sandwich_is_that_of_the_written_out_covariance() {
        let samples: Vec<usize> = (0..60).chain(70..100).collect();
        let jacobian = regressors(samples.len());
        let ar = Ar { coefficients: vec![1.1, -0.3], deviation: 0.4, bic: 0.0, samples: 0 };
        // A by hand: rows behind the gap at 60 know nothing of those before it.
        let filter = DMatrix::from_fn(samples.len(), samples.len(), |row, past| {
            let lag = samples[row].wrapping_sub(samples[past]);
            match lag {
                0 => 1.0,
                1 => -1.1,
                2 => 0.3,
                _ => 0.0,
            }
        });
        let inverse = filter.try_inverse().unwrap();
        let series = &inverse * inverse.transpose() * 0.16;
        let bread = (jacobian.transpose() * &jacobian).try_inverse().unwrap();
        let expected = &bread * jacobian.transpose() * series * &jacobian * &bread;
        let found =
            sandwich(singular(jacobian).unwrap(), &[Block { samples, stride: 1, weight: 1.0, ar }]).unwrap();
        assert!((&found - &expected).norm() < 1e-10 * expected.norm(), "{found} {expected}");
    }

    #[test]
    fn intervals_of_plain_least_squares_hold_the_truth_in_coloured_noise() {
        let rows = 600;
        let jacobian = regressors(rows);
        let bread = (jacobian.transpose() * &jacobian).try_inverse().unwrap();
        let samples: Vec<usize> = (0..rows).collect();
        let mut random = Xoshiro256PlusPlus::seed_from_u64(5);
        let (mut held, mut held_white, mut all) = (0, 0, 0);
        for _ in 0..200 {
            let mut level = 0.0;
            let noise: Vec<f64> = (0..rows)
                .map(|_| {
                    level = AR * level + normal(&mut random);
                    level
                })
                .collect();
            let noise = nalgebra::DVector::from_vec(noise);
            // The truth is nothing at all, so the estimate is the error.
            let estimate = &bread * jacobian.tr_mul(&noise);
            let residual = noise - &jacobian * &estimate;
            let ar = Ar::fit(&residual.iter().copied().map(Some).collect::<Vec<_>>()).unwrap();
            let covariance = sandwich(
                singular(jacobian.clone()).unwrap(),
                &[Block { samples: samples.clone(), stride: 1, weight: 1.0, ar }],
            )
            .unwrap();
            let white = &bread * (residual.norm_squared() / rows as f64);
            for i in 0..3 {
                all += 1;
                held += usize::from(estimate[i].abs() <= 1.96 * covariance[(i, i)].sqrt());
                held_white += usize::from(estimate[i].abs() <= 1.96 * white[(i, i)].sqrt());
            }
        }
        let share = |count: usize| f64::from(count as u32) / f64::from(all as u32);
        assert!((0.88..=0.98).contains(&share(held)), "{}", share(held));
        assert!(share(held_white) < 0.6, "{}", share(held_white));
    }
}
