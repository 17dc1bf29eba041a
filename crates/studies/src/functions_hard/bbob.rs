//! Functions of the noiseless BBOB suite on \[-5, 5\], with their instances: shifted, and most of them
//! rotated and bent.
//!
//! N. Hansen, S. Finck, R. Ros, A. Auger, "Real-parameter black-box optimization benchmarking 2009: noiseless
//! functions definitions", INRIA RR-6829. The random numbers behind shifts and rotations are those of the
//! suite's own generator, so that the numbers are those that COCO computes.

use nalgebra::{DMatrix, DVector};
use std::f64::consts::{PI, TAU};

/// Half the width of the box.
pub const HALF_WIDTH: f64 = 5.0;

/// A function of the suite.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shape {
    Sphere,
    SeparableEllipsoid,
    Rastrigin,
    RotatedRosenbrock,
    RotatedEllipsoid,
    Discus,
    BentCigar,
    DifferentPowers,
    RotatedRastrigin,
    Weierstrass,
    Schaffer,
    GriewankRosenbrock,
    Gallagher,
}

impl Shape {
    /// All of them, by number.
    pub const ALL: [Self; 13] = [
        Self::Sphere,
        Self::SeparableEllipsoid,
        Self::Rastrigin,
        Self::RotatedRosenbrock,
        Self::RotatedEllipsoid,
        Self::Discus,
        Self::BentCigar,
        Self::DifferentPowers,
        Self::RotatedRastrigin,
        Self::Weierstrass,
        Self::Schaffer,
        Self::GriewankRosenbrock,
        Self::Gallagher,
    ];

    /// Its number in the suite.
    pub fn number(self) -> i64 {
        match self {
            Self::Sphere => 1,
            Self::SeparableEllipsoid => 2,
            Self::Rastrigin => 3,
            Self::RotatedRosenbrock => 9,
            Self::RotatedEllipsoid => 10,
            Self::Discus => 11,
            Self::BentCigar => 12,
            Self::DifferentPowers => 14,
            Self::RotatedRastrigin => 15,
            Self::Weierstrass => 16,
            Self::Schaffer => 17,
            Self::GriewankRosenbrock => 19,
            Self::Gallagher => 21,
        }
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Sphere => "sphere",
            Self::SeparableEllipsoid => "separable ellipsoid",
            Self::Rastrigin => "Rastrigin",
            Self::RotatedRosenbrock => "rotated Rosenbrock",
            Self::RotatedEllipsoid => "rotated ellipsoid",
            Self::Discus => "discus",
            Self::BentCigar => "bent cigar",
            Self::DifferentPowers => "different powers",
            Self::RotatedRastrigin => "rotated Rastrigin",
            Self::Weierstrass => "Weierstrass",
            Self::Schaffer => "Schaffer F7",
            Self::GriewankRosenbrock => "Griewank-Rosenbrock",
            Self::Gallagher => "Gallagher",
        }
    }

    /// Whether its axes are not those of the box.
    pub fn rotated(self) -> bool {
        !matches!(self, Self::Sphere | Self::SeparableEllipsoid | Self::Rastrigin)
    }
}

/// An instance of a function in a number of dimensions, which are at least two.
#[derive(Debug, Clone)]
pub struct Bbob {
    shape: Shape,
    /// Where the optimum is.
    optimum: DVector<f64>,
    /// The outer rotation, and the whole inner map with its scales.
    outer: DMatrix<f64>,
    inner: DMatrix<f64>,
    peaks: Vec<Peak>,
}

/// A peak of Gallagher's function, in rotated coordinates.
#[derive(Debug, Clone)]
struct Peak {
    height: f64,
    at: DVector<f64>,
    scales: Vec<f64>,
}

impl Bbob {
    pub fn new(shape: Shape, dimensions: usize, instance: i64) -> Self {
        let n = dimensions;
        let seed = shape.number() + 10_000 * instance;
        let (first, second) = (rotation(seed + 1_000_000, n), rotation(seed, n));
        let unit = DMatrix::identity(n, n);
        let stretched = |ratio: f64| DMatrix::from_diagonal(&powers(ratio.sqrt(), n));
        let bend = (n as f64).sqrt() / 8.0;
        let (outer, inner) = match shape {
            Shape::Sphere | Shape::SeparableEllipsoid | Shape::Rastrigin => (unit.clone(), unit),
            Shape::RotatedRosenbrock | Shape::GriewankRosenbrock => (second * bend.max(1.0), unit),
            Shape::Gallagher => (second, unit),
            Shape::RotatedEllipsoid | Shape::Discus | Shape::DifferentPowers => (first, unit),
            Shape::BentCigar => (first.clone(), first),
            Shape::RotatedRastrigin => (first.clone(), first * stretched(10.0) * second),
            Shape::Weierstrass => (first.clone(), first * stretched(0.01) * second),
            Shape::Schaffer => (first, stretched(10.0) * second),
        };
        let peaks = if shape == Shape::Gallagher { peaks(&outer, seed) } else { Vec::new() };
        let optimum = match shape {
            Shape::RotatedRosenbrock | Shape::GriewankRosenbrock => {
                outer.transpose() * DVector::from_element(n, 0.5) / bend.max(1.0).powi(2)
            }
            Shape::Gallagher => outer.transpose() * &peaks[0].at,
            Shape::BentCigar => place(seed + 1_000_000, n),
            _ => place(seed, n),
        };
        Self { shape, optimum, outer, inner, peaks }
    }

    /// What the instance adds to every value; the study looks at what is above it.
    #[cfg(test)]
    fn offset(&self, instance: i64) -> f64 {
        let seed = self.shape.number() + 10_000 * instance;
        let (over, under) = (gauss(1, seed)[0], gauss(1, seed + 1)[0]);
        ((10_000.0 * over / under + 0.5).floor() / 100.0).clamp(-1000.0, 1000.0)
    }

    /// The value above the optimum's, anywhere.
    pub fn error(&self, x: &[f64]) -> f64 {
        let x = DVector::from_column_slice(x);
        let n = x.len() as f64;
        let outside: f64 = x.iter().map(|x| (x.abs() - HALF_WIDTH).max(0.0).powi(2)).sum();
        let shifted = || &x - &self.optimum;
        match self.shape {
            Shape::Sphere => shifted().norm_squared(),
            Shape::SeparableEllipsoid => ellipsoid(&shifted().map(oscillated)),
            Shape::Rastrigin => {
                let bent = asymmetric(&shifted().map(oscillated), 0.2);
                rastrigin(&bent.component_mul(&powers(10f64.sqrt(), x.len())))
            }
            Shape::RotatedRosenbrock => valley(&self.straight(&x)).into_iter().sum(),
            Shape::RotatedEllipsoid => ellipsoid(&(&self.outer * shifted()).map(oscillated)),
            Shape::Discus => {
                let z = (&self.outer * shifted()).map(oscillated);
                z.norm_squared() + (1e6 - 1.0) * z[0] * z[0]
            }
            Shape::BentCigar => {
                let z = &self.inner * asymmetric(&(&self.outer * shifted()), 0.5);
                1e6 * z.norm_squared() - (1e6 - 1.0) * z[0] * z[0]
            }
            Shape::DifferentPowers => {
                let z = &self.outer * shifted();
                let power = |i: usize| 2.0 + 4.0 * i as f64 / (n - 1.0);
                z.iter().enumerate().map(|(i, z)| z.abs().powf(power(i))).sum::<f64>().sqrt()
            }
            Shape::RotatedRastrigin => {
                rastrigin(&(&self.inner * asymmetric(&(&self.outer * shifted()).map(oscillated), 0.2)))
            }
            Shape::Weierstrass => {
                let z = &self.inner * (&self.outer * shifted()).map(oscillated);
                weierstrass(&z) + 10.0 / n * outside
            }
            Shape::Schaffer => {
                let z = &self.inner * asymmetric(&(&self.outer * shifted()), 0.5);
                schaffer(&z) + 10.0 * outside
            }
            Shape::GriewankRosenbrock => {
                let parts = valley(&self.straight(&x));
                10.0 + 10.0 * parts.into_iter().map(|v| v / 4000.0 - v.cos()).sum::<f64>() / (n - 1.0)
            }
            Shape::Gallagher => self.gallagher(&x) + outside,
        }
    }

    fn straight(&self, x: &DVector<f64>) -> DVector<f64> {
        (&self.outer * x).add_scalar(0.5)
    }

    fn gallagher(&self, x: &DVector<f64>) -> f64 {
        let rotated = &self.outer * x;
        let height = |peak: &Peak| {
            let far: f64 = (&rotated - &peak.at).iter().zip(&peak.scales).map(|(d, s)| s * d * d).sum();
            peak.height * (-0.5 / x.len() as f64 * far).exp()
        };
        oscillated(10.0 - self.peaks.iter().map(height).fold(0.0, f64::max)).powi(2)
    }
}

/// The terms of Rosenbrock's sum.
fn valley(z: &DVector<f64>) -> Vec<f64> {
    z.as_slice().windows(2).map(|z| 100.0 * (z[0] * z[0] - z[1]).powi(2) + (z[0] - 1.0).powi(2)).collect()
}

fn ellipsoid(z: &DVector<f64>) -> f64 {
    z.iter().zip(powers(1e6, z.len()).iter()).map(|(z, scale)| scale * z * z).sum()
}

fn rastrigin(z: &DVector<f64>) -> f64 {
    10.0 * (z.len() as f64 - z.iter().map(|z| (TAU * z).cos()).sum::<f64>()) + z.norm_squared()
}

fn weierstrass(z: &DVector<f64>) -> f64 {
    let waves = |x: f64| -> f64 {
        (0..12).map(|k| 0.5f64.powi(k) * (2.0 * PI * (x + 0.5) * 3f64.powi(k)).cos()).sum()
    };
    let rest: f64 = (0..12).map(|k| 0.5f64.powi(k) * (2.0 * PI * 3f64.powi(k) * 0.5).cos()).sum();
    10.0 * (z.iter().map(|z| waves(*z)).sum::<f64>() / z.len() as f64 - rest).powi(3)
}

fn schaffer(z: &DVector<f64>) -> f64 {
    let part = |z: &[f64]| {
        let square = z[0] * z[0] + z[1] * z[1];
        square.powf(0.25) * (1.0 + (50.0 * square.powf(0.1)).sin().powi(2))
    };
    (z.as_slice().windows(2).map(part).sum::<f64>() / (z.len() as f64 - 1.0)).powi(2)
}

/// T_osz of the definitions: smooth local irregularities.
fn oscillated(x: f64) -> f64 {
    if x == 0.0 {
        return 0.0;
    }
    let log = x.abs().ln() / 0.1;
    let (one, other) = if x > 0.0 { (1.0, 0.79) } else { (0.55, 0.31) };
    x.signum() * (log + 0.49 * ((one * log).sin() + (other * log).sin())).exp().powf(0.1)
}

/// T_asy of the definitions.
fn asymmetric(x: &DVector<f64>, beta: f64) -> DVector<f64> {
    let n = x.len() as f64;
    DVector::from_fn(x.len(), |i, _| {
        if x[i] > 0.0 { x[i].powf(1.0 + beta * i as f64 / (n - 1.0) * x[i].sqrt()) } else { x[i] }
    })
}

/// The powers of a base from 0 to 1, even over the coordinates.
fn powers(base: f64, n: usize) -> DVector<f64> {
    DVector::from_fn(n, |i, _| base.powf(i as f64 / (n as f64 - 1.0)))
}

/// The 101 peaks: where they are, how high, and how wide along which axis.
fn peaks(rotation: &DMatrix<f64>, seed: i64) -> Vec<Peak> {
    const COUNT: usize = 101;
    let n = rotation.nrows();
    let order = |numbers: Vec<f64>| {
        let mut order: Vec<usize> = (0..numbers.len()).collect();
        order.sort_by(|a, b| numbers[*a].total_cmp(&numbers[*b]));
        order
    };
    let conditions = order(uniform(COUNT - 1, seed));
    let places = uniform(n * COUNT, seed);
    (0..COUNT)
        .map(|peak| {
            let share = |i: usize| i as f64 / (COUNT as f64 - 2.0);
            let (height, condition) = match peak.checked_sub(1) {
                None => (10.0, 1000f64.sqrt()),
                Some(i) => (1.1 + 8.0 * share(i), 1000f64.powf(share(conditions[i]))),
            };
            let axes = order(uniform(n, seed + 1000 * peak as i64));
            let nearer = if peak == 0 { 0.8 } else { 1.0 };
            let at = DVector::from_fn(n, |j, _| nearer * (10.0 * places[peak * n + j] - 5.0));
            Peak {
                height,
                at: rotation * at,
                scales: axes
                    .into_iter()
                    .map(|axis| f64::powf(condition, axis as f64 / (n as f64 - 1.0) - 0.5))
                    .collect(),
            }
        })
        .collect()
}

/// Numbers from 0 to 1 of the suite's generator: Park and Miller's, shuffled.
fn uniform(count: usize, seed: i64) -> Vec<f64> {
    let next = |state: i64| {
        let state = 16_807 * (state % 127_773) - 2836 * (state / 127_773);
        if state < 0 { state + 2_147_483_647 } else { state }
    };
    let mut state = seed.abs().max(1);
    let mut table = [0i64; 32];
    for i in (0..40).rev() {
        state = next(state);
        if let Some(entry) = table.get_mut(i) {
            *entry = state;
        }
    }
    let mut drawn = table[0];
    let mut numbers = Vec::with_capacity(count);
    for _ in 0..count {
        state = next(state);
        let entry = (drawn / 67_108_865) as usize;
        drawn = table[entry];
        table[entry] = state;
        numbers.push((drawn as f64 / 2.147_483_647e9).max(1e-99));
    }
    numbers
}

fn gauss(count: usize, seed: i64) -> Vec<f64> {
    let drawn = uniform(2 * count, seed);
    let (radius, angle) = drawn.split_at(count);
    radius.iter().zip(angle).map(|(r, a)| (-2.0 * r.ln()).sqrt() * (TAU * a).cos()).collect()
}

/// A rotation of the suite: normal numbers by columns, made orthonormal one column after another.
pub fn rotation(seed: i64, n: usize) -> DMatrix<f64> {
    let mut matrix = DMatrix::from_column_slice(n, n, &gauss(n * n, seed));
    for i in 0..n {
        let mut column = matrix.column(i).clone_owned();
        for j in 0..i {
            let overlap = column.dot(&matrix.column(j));
            column.axpy(-overlap, &matrix.column(j), 1.0);
        }
        matrix.set_column(i, &column.normalize());
    }
    matrix
}

/// A place for an optimum in \[-4, 4\].
pub fn place(seed: i64, n: usize) -> DVector<f64> {
    let at = |drawn: f64| 8.0 * (1e4 * drawn).floor() / 1e4 - 4.0;
    DVector::from_iterator(n, uniform(n, seed).into_iter().map(|x| if at(x) == 0.0 { -1e-5 } else { at(x) }))
}

#[cfg(test)]
mod tests {
    use super::super::oracle::COCO;
    use super::*;

    /// Where the oracle looked: the same places for every function.
    fn looked_at(place: usize, n: usize) -> Vec<f64> {
        (0..n).map(|i| 4.5 * (1.0 + 2.3 * place as f64 + 1.7 * i as f64).sin()).collect()
    }

    #[test]
    fn the_values_are_those_of_coco() {
        for (number, instance, n, values) in COCO {
            let shape = Shape::ALL.into_iter().find(|shape| shape.number() == number).unwrap();
            let function = Bbob::new(shape, n, instance);
            for (place, value) in values.into_iter().enumerate() {
                let own = function.error(&looked_at(place, n)) + function.offset(instance);
                assert!(
                    (own - value).abs() <= 1e-9 * value.abs().max(1.0),
                    "{shape:?} {instance} {n} {place}: {own} {value}"
                );
            }
        }
    }

    #[test]
    fn nothing_is_below_the_optimum() {
        for shape in Shape::ALL {
            for (n, instance) in [(5, 1), (10, 7)] {
                let function = Bbob::new(shape, n, instance);
                let at = function.optimum.as_slice();
                assert!(function.error(at).abs() < 1e-10, "{shape:?}: {}", function.error(at));
                for i in 0..n {
                    let mut near = at.to_vec();
                    near[i] += 1e-3;
                    assert!(function.error(&near) > 0.0, "{shape:?}");
                }
            }
        }
    }
}
