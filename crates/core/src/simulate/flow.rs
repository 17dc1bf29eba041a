//! What an interval does to states and to small changes of states and inputs, for several samples side by
//! side: the equations are linearised in the middle of each stretch of it, which is stepped exactly.

use super::drive::Drive;
use super::lane::Lane;
use super::lanes::LaneFile;
use super::transition::{Transition, propagate};
use super::walk::Noise;
use crate::cpu::{Kernel, dispatch};
use crate::interrupt::Brake;
use crate::model::tape::Tape;

/// Where the matrices of two divisions agree, relative to the largest entry.
const AGREED: f64 = 1e-9;

/// The equations of a model, ready to be linearised.
#[derive(Debug)]
pub(super) struct FlowModel {
    /// Equations, their explicit derivatives by time, and their derivatives by states and by what enters.
    pub field: Tape,
    /// The length of the interval.
    pub hours: f64,
    /// Which of what enters is held over it; the others go along straight lines.
    pub held: Vec<bool>,
}

/// What an interval does; matrices by rows.
#[derive(Debug, Clone)]
pub(super) struct Flow<const W: usize> {
    x: Vec<Lane<W>>,
    a: Vec<Lane<W>>,
    b: Vec<Lane<W>>,
    e: Vec<Lane<W>>,
    g: Vec<Lane<W>>,
    q: Vec<Lane<W>>,
}

/// The same of one lane: the states at its end, and what becomes of small changes of those at its start, of
/// what enters at its start and at its end, and of a steady rate; then the covariance that is added.
#[derive(Debug)]
pub(super) struct LaneFlow {
    pub x: Vec<f64>,
    pub a: Vec<f64>,
    pub b: Vec<f64>,
    pub e: Vec<f64>,
    pub g: Vec<f64>,
    pub q: Vec<f64>,
}

impl FlowModel {
    /// What becomes of states and small changes over the intervals behind these samples, each divided into so
    /// many stretches, with a steady rate on top of each state's own.
    pub fn divided<const W: usize>(
        &self,
        theta: &[f64],
        noise: &Noise,
        (drive, at): (&Drive, [usize; W]),
        parts: usize,
        (start, on_top): (&[Lane<W>], &[Lane<W>]),
        brake: &Brake,
    ) -> Flow<W> {
        let (n, m) = (start.len(), self.held.len());
        let hours = self.hours / parts as f64;
        let zeros = |count: usize| vec![Lane([0.0; W]); count];
        let mut flow = Flow {
            x: start.to_vec(),
            a: (0..n * n).map(|place| Lane([f64::from(place / n == place % n); W])).collect(),
            b: zeros(n * m),
            e: zeros(n * m),
            g: zeros(n * n),
            q: zeros(n * n),
        };
        let mut file = LaneFile::<W>::new(&self.field);
        file.load(&[theta], hours / 2.0);
        let q: Vec<Lane<W>> = noise.process.iter().map(|sigma| Lane([sigma * sigma; W])).collect();
        let mut work = Work {
            slope: zeros(n * n),
            step: Transition::empty(n),
            middle: zeros(n),
            rate: zeros(n),
            scratch: zeros(n * n.max(m)),
        };
        let load = |file: &mut LaneFile<W>, step: usize, states: &[Lane<W>]| {
            for (lane, k) in at.iter().enumerate() {
                drive.load_lane(file, lane, *k, step);
            }
            file.set_states(states);
            file.step();
        };
        for part in 0..parts {
            load(&mut file, 2 * part, &flow.x);
            let cpu = file.cpu();
            dispatch(
                cpu,
                Half { file: &file, x: &flow.x, on_top, q: &q, hours: hours / 2.0, work: &mut work, brake },
            );
            load(&mut file, 2 * part + 1, &work.middle);
            let passed = part as f64 / parts as f64;
            let (model, flow, work) = (self, &mut flow, &mut work);
            dispatch(cpu, Stretch { model, file: &file, flow, on_top, q: &q, hours, passed, work, brake });
        }
        flow
    }
}

/// What a stretch is computed in.
struct Work<const W: usize> {
    slope: Vec<Lane<W>>,
    step: Transition<Lane<W>>,
    middle: Vec<Lane<W>>,
    rate: Vec<Lane<W>>,
    scratch: Vec<Lane<W>>,
}

impl<const W: usize> Work<W> {
    /// Takes the Jacobian where the equations were evaluated, and its exact step.
    #[inline(always)]
    fn step_by(&mut self, file: &LaneFile<W>, q: &[Lane<W>], hours: f64, brake: &Brake) {
        let n = q.len();
        for place in 0..n * n {
            self.slope[place] = Lane(*file.root(2 * n + place));
        }
        self.step.set_each(&self.slope, q, hours, true, brake);
    }
}

/// The states in the middle of a stretch, by what is linearised at its start.
struct Half<'a, 't, const W: usize> {
    file: &'a LaneFile<'t, W>,
    x: &'a [Lane<W>],
    on_top: &'a [Lane<W>],
    q: &'a [Lane<W>],
    hours: f64,
    work: &'a mut Work<W>,
    brake: &'a Brake,
}

impl<const W: usize> Kernel for Half<'_, '_, W> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { file, x, on_top, q, hours, work, brake } = self;
        work.step_by(file, q, hours, brake);
        let Work { step, middle, .. } = work;
        let n = x.len();
        for i in 0..n {
            let mut moved = x[i];
            for j in 0..n {
                let (rate, change) = (file.root(j), file.root(n + j));
                for lane in 0..W {
                    moved.0[lane] += step.psi[i * n + j].0[lane] * (rate[lane] + on_top[j].0[lane])
                        + step.ramp[i * n + j].0[lane] * change[lane];
                }
            }
            middle[i] = moved;
        }
    }
}

/// A stretch behind those before it, by what is linearised in its middle.
struct Stretch<'a, 't, const W: usize> {
    model: &'a FlowModel,
    file: &'a LaneFile<'t, W>,
    flow: &'a mut Flow<W>,
    on_top: &'a [Lane<W>],
    q: &'a [Lane<W>],
    hours: f64,
    /// The share of the interval that lies behind.
    passed: f64,
    work: &'a mut Work<W>,
    brake: &'a Brake,
}

impl<const W: usize> Kernel for Stretch<'_, '_, W> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { model, file, flow, on_top, q, hours, passed, work, brake } = self;
        let Flow { x, a, b, e, g, q: covariance } = flow;
        work.step_by(file, q, hours, brake);
        let Work { slope, step, middle, rate, scratch } = work;
        let (n, m) = (x.len(), model.held.len());
        let Transition { phi, psi, ramp, noise, .. } = &*step;
        // The rate at the start of the stretch.
        for i in 0..n {
            let (now, change) = (file.root(i), file.root(n + i));
            let mut sum = Lane([0.0; W]);
            for lane in 0..W {
                sum.0[lane] = now[lane] + on_top[i].0[lane] - change[lane] * (hours / 2.0);
            }
            for j in 0..n {
                for lane in 0..W {
                    sum.0[lane] += slope[i * n + j].0[lane] * (x[j].0[lane] - middle[j].0[lane]);
                }
            }
            rate[i] = sum;
        }
        for i in 0..n {
            for j in 0..n {
                let change = file.root(n + j);
                for lane in 0..W {
                    x[i].0[lane] +=
                        psi[i * n + j].0[lane] * rate[j].0[lane] + ramp[i * n + j].0[lane] * change[lane];
                }
            }
        }
        product(scratch, phi, b, n, m);
        product(scratch, phi, e, n, m);
        for i in 0..n {
            for entrance in 0..m {
                let (mut held, mut growing) = (Lane([0.0; W]), Lane([0.0; W]));
                for j in 0..n {
                    let by = file.root(2 * n + n * n + j * m + entrance);
                    for lane in 0..W {
                        held.0[lane] += psi[i * n + j].0[lane] * by[lane];
                        growing.0[lane] += ramp[i * n + j].0[lane] * by[lane];
                    }
                }
                let place = i * m + entrance;
                let is_held = model.held[entrance];
                for lane in 0..W {
                    let (held, growing) = (held.0[lane], growing.0[lane] / model.hours);
                    if is_held {
                        b[place].0[lane] += held;
                    } else {
                        b[place].0[lane] += held * (1.0 - passed) - growing;
                        e[place].0[lane] += held * passed + growing;
                    }
                }
            }
        }
        product(scratch, phi, a, n, n);
        product(scratch, phi, g, n, n);
        for place in 0..n * n {
            for lane in 0..W {
                g[place].0[lane] += psi[place].0[lane];
            }
        }
        propagate(covariance, phi, noise, scratch, n);
    }
}

/// Replaces a matrix of `m` columns by its product with a square one before it.
#[inline(always)]
fn product<const W: usize>(scratch: &mut [Lane<W>], a: &[Lane<W>], b: &mut [Lane<W>], n: usize, m: usize) {
    for i in 0..n {
        for j in 0..m {
            let mut sum = Lane([0.0; W]);
            for k in 0..n {
                for lane in 0..W {
                    sum.0[lane] += a[i * n + k].0[lane] * b[k * m + j].0[lane];
                }
            }
            scratch[i * m + j] = sum;
        }
    }
    b[..n * m].copy_from_slice(&scratch[..n * m]);
}

impl<const W: usize> Flow<W> {
    fn parts(&self) -> [&Vec<Lane<W>>; 6] {
        [&self.x, &self.a, &self.b, &self.e, &self.g, &self.q]
    }

    /// Which lanes are numbers.
    pub fn is_finite(&self) -> [bool; W] {
        let mut finite = [true; W];
        for entry in self.parts().into_iter().flatten() {
            for (finite, value) in finite.iter_mut().zip(entry.0) {
                *finite &= value.is_finite();
            }
        }
        finite
    }

    /// Richardson's extrapolation of a method of order two, from half as many stretches to endlessly many.
    pub fn extrapolated(&self, coarse: &Self) -> Self {
        let both = |fine: &[Lane<W>], coarse: &[Lane<W>]| -> Vec<Lane<W>> {
            let one = |fine: &Lane<W>, coarse: &Lane<W>| {
                let mut to = *fine;
                for lane in 0..W {
                    to.0[lane] += (fine.0[lane] - coarse.0[lane]) / 3.0;
                }
                to
            };
            fine.iter().zip(coarse).map(|(fine, coarse)| one(fine, coarse)).collect()
        };
        Self {
            x: both(&self.x, &coarse.x),
            a: both(&self.a, &coarse.a),
            b: both(&self.b, &coarse.b),
            e: both(&self.e, &coarse.e),
            g: both(&self.g, &coarse.g),
            q: both(&self.q, &coarse.q),
        }
    }

    /// Which lanes agree with those of another division.
    pub fn is_near(&self, other: &Self) -> [bool; W] {
        let mut near = [true; W];
        for (ours, theirs) in self.parts().into_iter().zip(other.parts()) {
            for (lane, near) in near.iter_mut().enumerate() {
                let largest = theirs.iter().fold(0.0, |largest: f64, value| largest.max(value.0[lane].abs()));
                *near &=
                    ours.iter().zip(theirs).all(|(a, b)| (a.0[lane] - b.0[lane]).abs() <= AGREED * largest);
            }
        }
        near
    }

    /// One lane alone.
    pub fn lane(&self, lane: usize) -> LaneFlow {
        let alone = |of: &[Lane<W>]| of.iter().map(|entry| entry.0[lane]).collect();
        LaneFlow {
            x: alone(&self.x),
            a: alone(&self.a),
            b: alone(&self.b),
            e: alone(&self.e),
            g: alone(&self.g),
            q: alone(&self.q),
        }
    }
}
