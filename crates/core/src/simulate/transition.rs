//! The exact step of a linear stochastic equation: `dx = (A x + b + b' t) dt + diag(s) dw` over a time h.
//!
//! Transition, input and noise integrals are summed as Taylor series over a short time, and doubled until it
//! is h: `Phi(2t) = Phi(t)^2`, `Q(2t) = Q(t) + Phi(t) Q(t) Phi(t)'`, and likewise for the integrals of the
//! inputs. The sums have no differences of large numbers, so a stiff system keeps its accuracy and Q stays
//! positive.

use super::dual::Scalar;
use crate::interrupt::{Brake, Meter};

/// Terms of the series where the step is exact and kept.
const EXACT: usize = 10;
/// Terms where the system is linearised anew at every step: an error of 1e-10 of the covariance is far below
/// that of the linearisation, and small enough for slopes to agree with differences.
const LINEARISED: usize = 7;
/// Largest norm of `A t` that the series is summed at.
const NORM: f64 = 0.125;
/// Most doublings: more stand for a system that no step can follow.
const DOUBLINGS: usize = 40;

/// What a step does to mean and covariance; matrices by rows.
#[derive(Debug, Clone)]
pub struct Transition<T> {
    /// `exp(A h)`.
    pub phi: Vec<T>,
    /// The integral of `exp(A t)` over the step: what a constant drive does.
    pub psi: Vec<T>,
    /// The double integral of `exp(A t)`: what a drive that grows by 1 per hour does.
    pub ramp: Vec<T>,
    /// The covariance that the noise adds.
    pub noise: Vec<T>,
}

impl<T: Scalar> Transition<T> {
    /// The step over `hours` of a system with Jacobian `a` and noise variances `q` per hour; an `exact` one
    /// has the integrals over the inputs as well. `None` where the Jacobian is not finite, or too large for
    /// any step.
    pub fn new(a: &[T], q: &[T], hours: f64, exact: bool, brake: &Brake) -> Option<Self> {
        let n = q.len();
        let mut meter = Meter::new(brake);
        let product = n.pow(3) * (size_of::<T>() / size_of::<f64>());
        let terms = if exact { EXACT } else { LINEARISED };
        if a.iter().any(|slope| !slope.value().is_finite()) {
            return None;
        }
        let norm =
            (0..n).map(|j| (0..n).map(|i| a[i * n + j].value().abs()).sum::<f64>()).fold(0.0, f64::max)
                * hours;
        let doublings = (0..=DOUBLINGS).find(|doublings| norm / 2f64.powi(*doublings as i32) <= NORM)?;
        let mut time = hours / 2f64.powi(doublings as i32);
        let zero = vec![T::constant(0.0); n * n];
        let mut step = Self { phi: identity(n), psi: zero.clone(), ramp: zero.clone(), noise: zero.clone() };
        let mut power = identity(n);
        let mut lyapunov = zero.clone();
        (0..n).for_each(|i| lyapunov[i * n + i] = q[i].scaled(time));
        let mut scratch = zero;
        for term in 1..=terms {
            meter.add(2 * product);
            let k = term as f64;
            add(&mut step.noise, &lyapunov);
            if exact {
                // At this place `power` is (A t)^(k-1) / (k-1)!.
                add_scaled(&mut step.psi, &power, time / k);
                add_scaled(&mut step.ramp, &power, time * time / (k * (k + 1.0)));
            }
            multiply(&mut scratch, a, &power, n);
            power.iter_mut().zip(&scratch).for_each(|(power, product)| *power = product.scaled(time / k));
            add(&mut step.phi, &power);
            multiply(&mut scratch, a, &lyapunov, n);
            for i in 0..n {
                for j in 0..=i {
                    let sum = (scratch[i * n + j] + scratch[j * n + i]).scaled(time / (k + 1.0));
                    (lyapunov[i * n + j], lyapunov[j * n + i]) = (sum, sum);
                }
            }
        }
        for _ in 0..doublings {
            meter.add(if exact { 5 } else { 3 } * product);
            step.double(&mut scratch, time, exact, n);
            time *= 2.0;
        }
        Some(step)
    }

    fn double(&mut self, scratch: &mut [T], time: f64, exact: bool, n: usize) {
        if exact {
            multiply(scratch, &self.phi, &self.ramp, n);
            add(&mut self.ramp, scratch);
            add_scaled(&mut self.ramp, &self.psi, time);
            multiply(scratch, &self.phi, &self.psi, n);
            add(&mut self.psi, scratch);
        }
        let before = self.noise.clone();
        propagate(&mut self.noise, &self.phi, &before, scratch, n);
        multiply(scratch, &self.phi, &self.phi, n);
        self.phi.copy_from_slice(scratch);
    }
}

fn identity<T: Scalar>(n: usize) -> Vec<T> {
    (0..n * n).map(|place| T::constant(f64::from(place / n == place % n))).collect()
}

fn add<T: Scalar>(to: &mut [T], what: &[T]) {
    to.iter_mut().zip(what).for_each(|(to, what)| *to = *to + *what);
}

fn add_scaled<T: Scalar>(to: &mut [T], what: &[T], factor: f64) {
    to.iter_mut().zip(what).for_each(|(to, what)| *to = *to + what.scaled(factor));
}

fn multiply<T: Scalar>(to: &mut [T], a: &[T], b: &[T], n: usize) {
    // By rows of b: the same sums in the same order, and neighbours in memory one after the other.
    for i in 0..n {
        let row = &mut to[i * n..(i + 1) * n];
        row.iter_mut().zip(b).for_each(|(to, b)| *to = a[i * n] * *b);
        for k in 1..n {
            let factor = a[i * n + k];
            row.iter_mut().zip(&b[k * n..(k + 1) * n]).for_each(|(to, b)| *to = *to + factor * *b);
        }
    }
}

/// Replaces the covariance P by `phi P phi' + noise`, symmetric to the last bit.
pub fn propagate<T: Scalar>(p: &mut [T], phi: &[T], noise: &[T], scratch: &mut [T], n: usize) {
    multiply(scratch, phi, p, n);
    for i in 0..n {
        for j in 0..=i {
            let mut sum = noise[i * n + j];
            for k in 0..n {
                sum = sum + scratch[i * n + k] * phi[j * n + k];
            }
            (p[i * n + j], p[j * n + i]) = (sum, sum);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scalar_step_is_its_closed_form() {
        for (a, h, tolerance) in
            [(-0.6, 0.5, 1e-14), (-300.0, 2.0, 1e-11), (0.3, 1.0, 1e-14), (-1e-9, 1.0, 1e-14)]
        {
            let step = Transition::new(&[a], &[0.04], h, true, &Brake::NONE).unwrap();
            let z: f64 = a * h;
            let near = |ours: f64, closed: f64| {
                assert!((ours - closed).abs() <= tolerance * closed.abs(), "{a}: {ours} {closed}")
            };
            near(step.phi[0].max(1e-200), z.exp().max(1e-200));
            near(step.psi[0], z.exp_m1() / a);
            near(step.noise[0], 0.04 * (2.0 * z).exp_m1() / (2.0 * a));
            if z.abs() > 1e-3 {
                near(step.ramp[0], (z.exp_m1() - z) / (a * a));
            }
        }
    }

    #[test]
    fn a_coupled_step_is_that_of_many_small_ones() {
        let a = [-2.0, 1.5, 0.0, 0.4, -0.9, 0.3, 0.1, 0.7, -6.0];
        let (n, h) = (3, 0.8);
        let whole = Transition::new(&a, &[0.1, 0.2, 0.3], h, true, &Brake::NONE).unwrap();
        // The mean under a drive b + b' t by classical Runge-Kutta steps, the covariance by its own equation.
        let (b, slope) = ([1.0, -2.0, 0.5], [0.3, 0.2, -1.0]);
        let rate = |x: &[f64], t: f64| {
            (0..n)
                .map(|i| (0..n).map(|j| a[i * n + j] * x[j]).sum::<f64>() + b[i] + slope[i] * t)
                .collect::<Vec<_>>()
        };
        let lyapunov = |p: &[f64]| {
            let one = |i: usize, j: usize| (0..n).map(|k| a[i * n + k] * p[k * n + j]).sum::<f64>();
            (0..9)
                .map(|s| {
                    one(s / n, s % n)
                        + one(s % n, s / n)
                        + if s / n == s % n { [0.1, 0.2, 0.3][s / n] } else { 0.0 }
                })
                .collect::<Vec<f64>>()
        };
        let (mut x, mut p) = (vec![3.0, -1.0, 2.0], vec![0.0; 9]);
        let steps = 2000;
        let d = h / f64::from(steps);
        let shifted =
            |x: &[f64], k: &[f64], by: f64| x.iter().zip(k).map(|(x, k)| x + by * k).collect::<Vec<f64>>();
        for step in 0..steps {
            let t = f64::from(step) * d;
            let k1 = rate(&x, t);
            let k2 = rate(&shifted(&x, &k1, d / 2.0), t + d / 2.0);
            let k3 = rate(&shifted(&x, &k2, d / 2.0), t + d / 2.0);
            let k4 = rate(&shifted(&x, &k3, d), t + d);
            x = (0..n).map(|i| x[i] + d / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])).collect();
            let k1 = lyapunov(&p);
            let k2 = lyapunov(&shifted(&p, &k1, d / 2.0));
            let k3 = lyapunov(&shifted(&p, &k2, d / 2.0));
            let k4 = lyapunov(&shifted(&p, &k3, d));
            p = (0..9).map(|i| p[i] + d / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i])).collect();
        }
        let start = [3.0, -1.0, 2.0];
        let ours = |i: usize| {
            (0..n)
                .map(|j| {
                    whole.phi[i * n + j] * start[j]
                        + whole.psi[i * n + j] * b[j]
                        + whole.ramp[i * n + j] * slope[j]
                })
                .sum::<f64>()
        };
        (0..n).for_each(|i| assert!((ours(i) - x[i]).abs() < 1e-11, "{} {}", ours(i), x[i]));
        (0..9).for_each(|i| assert!((whole.noise[i] - p[i]).abs() < 1e-12, "{} {}", whole.noise[i], p[i]));
    }

    #[test]
    fn what_is_not_finite_has_no_step() {
        assert!(Transition::new(&[f64::NAN], &[1.0], 1.0, false, &Brake::NONE).is_none());
        assert!(Transition::new(&[-1e300], &[1.0], 1.0, false, &Brake::NONE).is_none());
    }
}
