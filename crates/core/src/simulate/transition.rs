//! The exact step of a linear stochastic equation: `dx = (A x + b + b' t) dt + diag(s) dw` over a time h.
//!
//! Transition, input and noise integrals are summed as Taylor series over a short time, and doubled until it
//! is h: `Phi(2t) = Phi(t)^2`, `Q(2t) = Q(t) + Phi(t) Q(t) Phi(t)'`, and likewise for the integrals of the
//! inputs. The sums have no differences of large numbers, so a stiff system keeps its accuracy and Q stays
//! positive.

use super::dual::MatrixEntry;
use super::lane::Lane;
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
    power: Vec<T>,
    lyapunov: Vec<T>,
    scratch: Vec<T>,
    /// The Jacobian, without those that no step can follow.
    given: Vec<T>,
    /// A variance of 1 for each state.
    units: Vec<T>,
}

impl<const W: usize> Transition<Lane<W>> {
    /// Becomes another step in each lane. One that no step can follow has no numbers, and takes no other
    /// along.
    #[inline(always)]
    pub fn set_each(&mut self, a: &[Lane<W>], q: &[Lane<W>], hours: f64, exact: bool, brake: &Brake) {
        let n = q.len();
        let mut followed = [true; W];
        for j in 0..n {
            let mut sum = [0.0; W];
            for i in 0..n {
                for lane in 0..W {
                    sum[lane] += a[i * n + j].0[lane].abs();
                }
            }
            for lane in 0..W {
                followed[lane] &= Self::follows(sum[lane] * hours);
            }
        }
        let mut given = std::mem::take(&mut self.given);
        for place in 0..n * n {
            for lane in 0..W {
                given[place].0[lane] = if followed[lane] { a[place].0[lane] } else { 0.0 };
            }
        }
        self.set(&given, q, hours, exact, brake);
        self.given = given;
        for of in [&mut self.phi, &mut self.psi, &mut self.ramp, &mut self.noise] {
            for place in 0..n * n {
                for lane in 0..W {
                    let entry = &mut of[place].0[lane];
                    *entry = if followed[lane] { *entry } else { f64::NAN };
                }
            }
        }
    }

    /// Becomes the step of lanes that have one Jacobian, that of the first, and each one `variance` for all
    /// of its states: `common` is that of a variance of 1.
    #[inline(always)]
    pub fn set_common(
        &mut self,
        common: &mut Transition<f64>,
        a: &[Lane<W>],
        variance: Lane<W>,
        hours: f64,
        brake: &Brake,
    ) {
        let mut given = std::mem::take(&mut common.given);
        for place in 0..given.len() {
            given[place] = a[place].0[0];
        }
        let units = std::mem::take(&mut common.units);
        let follows = common.set_small(&given, &units, hours, false, brake);
        for place in 0..given.len() {
            let (phi, noise) =
                if follows { (common.phi[place], common.noise[place]) } else { (f64::NAN, f64::NAN) };
            self.phi[place] = Lane([phi; W]);
            self.noise[place] = variance.scaled(noise);
        }
        (common.given, common.units) = (given, units);
    }
}

impl Transition<f64> {
    /// The same as [`Transition::set`], compiled for the few states of most models: loops whose length is
    /// known are no loops.
    #[inline(always)]
    pub fn set_small(&mut self, a: &[f64], q: &[f64], hours: f64, exact: bool, brake: &Brake) -> bool {
        match q.len() {
            1 => self.set_of(1, a, q, hours, exact, brake),
            2 => self.set_of(2, a, q, hours, exact, brake),
            3 => self.set_of(3, a, q, hours, exact, brake),
            4 => self.set_of(4, a, q, hours, exact, brake),
            5 => self.set_of(5, a, q, hours, exact, brake),
            6 => self.set_of(6, a, q, hours, exact, brake),
            n => self.set_of(n, a, q, hours, exact, brake),
        }
    }
}

impl<T: MatrixEntry> Transition<T> {
    /// The step over `hours` of a system with Jacobian `a` and noise variances `q` per hour; an `exact` one
    /// has the integrals over the inputs as well. `None` where the Jacobian is not finite, or too large for
    /// any step.
    pub fn new(a: &[T], q: &[T], hours: f64, exact: bool, brake: &Brake) -> Option<Self> {
        let mut step = Self::empty(q.len());
        step.set(a, q, hours, exact, brake).then_some(step)
    }

    /// Nothing yet, for so many states.
    pub fn empty(n: usize) -> Self {
        let zero = || vec![T::constant(0.0); n * n];
        let [phi, psi, ramp, noise, power, lyapunov, scratch, given] = std::array::from_fn(|_| zero());
        Self { phi, psi, ramp, noise, power, lyapunov, scratch, given, units: vec![T::constant(1.0); n] }
    }

    /// Whether a step can follow a Jacobian whose norm is this over it.
    #[inline(always)]
    fn follows(norm: f64) -> bool {
        norm <= NORM * 2f64.powi(DOUBLINGS as i32)
    }

    /// Becomes another step, as [`Transition::new`] makes it. Whether there is one.
    #[inline(always)]
    pub fn set(&mut self, a: &[T], q: &[T], hours: f64, exact: bool, brake: &Brake) -> bool {
        self.set_of(q.len(), a, q, hours, exact, brake)
    }

    /// The same for `n` states.
    #[inline(always)]
    fn set_of(&mut self, n: usize, a: &[T], q: &[T], hours: f64, exact: bool, brake: &Brake) -> bool {
        let mut meter = Meter::new(brake);
        let product = n.pow(3) * (size_of::<T>() / size_of::<f64>());
        let terms = if exact { EXACT } else { LINEARISED };
        let mut norm = 0.0;
        for j in 0..n {
            let mut sum = 0.0;
            for i in 0..n {
                sum += a[i * n + j].magnitude();
            }
            // What is no number stays so.
            norm = if sum <= norm || f64::is_nan(norm) { norm } else { sum };
        }
        norm *= hours;
        if !Self::follows(norm) {
            return false;
        }
        let (mut doublings, mut parts) = (0, 1.0);
        while norm / parts > NORM {
            (doublings, parts) = (doublings + 1, 2.0 * parts);
        }
        let mut time = hours / parts;
        let Self { phi, psi, ramp, noise, power, lyapunov, scratch, .. } = self;
        let nothing = T::constant(0.0);
        for of in [&mut *psi, &mut *ramp, &mut *noise, &mut *lyapunov] {
            of.fill(nothing);
        }
        identity(phi, n);
        identity(power, n);
        for i in 0..n {
            lyapunov[i * n + i] = q[i].scaled(time);
        }
        for term in 1..=terms {
            meter.add(2 * product);
            let k = term as f64;
            add(noise, lyapunov, n);
            if exact {
                // At this place `power` is (A t)^(k-1) / (k-1)!.
                add_scaled(psi, power, time / k, n);
                add_scaled(ramp, power, time * time / (k * (k + 1.0)), n);
            }
            multiply(scratch, a, power, n);
            for place in 0..n * n {
                power[place] = scratch[place].scaled(time / k);
            }
            add(phi, power, n);
            multiply(scratch, a, lyapunov, n);
            for i in 0..n {
                for j in 0..=i {
                    let sum = (scratch[i * n + j] + scratch[j * n + i]).scaled(time / (k + 1.0));
                    (lyapunov[i * n + j], lyapunov[j * n + i]) = (sum, sum);
                }
            }
        }
        for _ in 0..doublings {
            meter.add(if exact { 5 } else { 3 } * product);
            self.double(time, exact, n);
            time *= 2.0;
        }
        true
    }

    #[inline(always)]
    fn double(&mut self, time: f64, exact: bool, n: usize) {
        let Self { phi, psi, ramp, noise, power: before, scratch, .. } = self;
        if exact {
            multiply(scratch, phi, ramp, n);
            add(ramp, scratch, n);
            add_scaled(ramp, psi, time, n);
            multiply(scratch, phi, psi, n);
            add(psi, scratch, n);
        }
        before.copy_from_slice(noise);
        propagate(noise, phi, before, scratch, n);
        multiply(scratch, phi, phi, n);
        phi.copy_from_slice(scratch);
    }
}

#[inline(always)]
fn identity<T: MatrixEntry>(to: &mut [T], n: usize) {
    to.fill(T::constant(0.0));
    for i in 0..n {
        to[i * n + i] = T::constant(1.0);
    }
}

#[inline(always)]
fn add<T: MatrixEntry>(to: &mut [T], what: &[T], n: usize) {
    let (to, what) = (&mut to[..n * n], &what[..n * n]);
    for place in 0..n * n {
        to[place] = to[place] + what[place];
    }
}

#[inline(always)]
fn add_scaled<T: MatrixEntry>(to: &mut [T], what: &[T], factor: f64, n: usize) {
    let (to, what) = (&mut to[..n * n], &what[..n * n]);
    for place in 0..n * n {
        to[place] = to[place] + what[place].scaled(factor);
    }
}

#[inline(always)]
fn multiply<T: MatrixEntry>(to: &mut [T], a: &[T], b: &[T], n: usize) {
    // By rows of b: the same sums in the same order, and neighbours in memory one after the other.
    let (to, a, b) = (&mut to[..n * n], &a[..n * n], &b[..n * n]);
    for i in 0..n {
        let row = &mut to[i * n..(i + 1) * n];
        for j in 0..n {
            row[j] = a[i * n] * b[j];
        }
        for k in 1..n {
            let (factor, others) = (a[i * n + k], &b[k * n..(k + 1) * n]);
            for j in 0..n {
                row[j] = row[j] + factor * others[j];
            }
        }
    }
}

/// The same as [`propagate`], compiled for the few states of most models.
#[inline(always)]
pub fn propagate_small<T: MatrixEntry>(p: &mut [T], phi: &[T], noise: &[T], scratch: &mut [T], n: usize) {
    match n {
        1 => propagate(p, phi, noise, scratch, 1),
        2 => propagate(p, phi, noise, scratch, 2),
        3 => propagate(p, phi, noise, scratch, 3),
        4 => propagate(p, phi, noise, scratch, 4),
        5 => propagate(p, phi, noise, scratch, 5),
        n => propagate(p, phi, noise, scratch, n),
    }
}

/// Replaces the covariance P by `phi P phi' + noise`, symmetric to the last bit.
#[inline(always)]
pub fn propagate<T: MatrixEntry>(p: &mut [T], phi: &[T], noise: &[T], scratch: &mut [T], n: usize) {
    let (p, phi, noise) = (&mut p[..n * n], &phi[..n * n], &noise[..n * n]);
    multiply(scratch, phi, p, n);
    let scratch = &scratch[..n * n];
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
