//! The vectors of an explicit method in lanes: what a step needs beside the right-hand side, a value per
//! state and lane.
//!
//! Every lane is at a place of its own in its own step, so one pass does for each lane what its [`Moves`]
//! say.

use super::lane::Lane;
use super::lanes::LaneFile;
use crate::cpu::{Cpu, Kernel, dispatch};

/// A value per state and lane.
#[derive(Debug, Clone)]
pub struct Vectors<const W: usize> {
    /// The states at the start of the step.
    pub start: Vec<Lane<W>>,
    /// The slope there.
    slope: Vec<Lane<W>>,
    /// Where the right-hand side is evaluated: the newest stage.
    last: Vec<Lane<W>>,
    /// The stage before that.
    before: Vec<Lane<W>>,
    /// The direction in which the slope changes most.
    mode: Vec<Lane<W>>,
}

/// A mask that is set.
pub const YES: u64 = u64::MAX;
/// A mask that is not.
pub const NO: u64 = 0;

/// What each lane does with an evaluation of its right-hand side.
#[derive(Debug, Clone)]
pub struct Moves<const W: usize> {
    /// The newest stage becomes the start of a step.
    pub accept: [u64; W],
    /// The evaluation becomes the slope at the start.
    pub take: [u64; W],
    /// Its difference from that slope becomes the mode.
    pub keep: [u64; W],
    /// Stages and evaluation are forgotten: the next place depends on the start alone.
    pub fresh: [u64; W],
    /// The factors of the start, the newest stage, the one before, the evaluation, the slope and the mode in
    /// the next place.
    pub factors: [[f64; W]; 6],
}

impl<const W: usize> Moves<W> {
    /// Every lane goes to its start.
    pub fn to_start() -> Self {
        let mut factors = [[0.0; W]; 6];
        factors[0] = [1.0; W];
        Self { accept: [NO; W], take: [NO; W], keep: [NO; W], fresh: [YES; W], factors }
    }

    /// Sets the factors of a lane.
    pub fn set(&mut self, lane: usize, factors: [f64; 6]) {
        for (all, factor) in self.factors.iter_mut().zip(factors) {
            all[lane] = factor;
        }
    }
}

/// Sums of squares over the states, per lane.
#[derive(Debug, Clone)]
pub struct Sums<const W: usize> {
    /// The embedded error estimate over the weights.
    pub error: [f64; W],
    /// The evaluation less the slope at the start.
    pub change: [f64; W],
    /// The start.
    pub start: [f64; W],
    /// The evaluation.
    pub now: [f64; W],
}

impl<const W: usize> Vectors<W> {
    /// Zeros for so many states.
    pub fn new(states: usize) -> Self {
        let zero = || vec![Lane([0.0; W]); states];
        Self { start: zero(), slope: zero(), last: zero(), before: zero(), mode: zero() }
    }

    /// Puts a state of a lane to a value, where a way begins.
    pub fn place(&mut self, lane: usize, state: usize, value: f64) {
        // What the lane's last candidate left behind may be no number.
        self.mode[state].0[lane] = 0.0;
        (self.start[state].0[lane], self.last[state].0[lane]) = (value, value);
    }

    /// Loads the states at which the right-hand side is wanted next.
    pub fn load(&self, file: &mut LaneFile<W>) {
        file.set_states(&self.last);
    }

    /// Measures the newest evaluation for steps of these lengths. A state's error is weighed by its size, and
    /// by `floor` where that is smaller.
    pub fn measure(&self, file: &LaneFile<W>, hours: &[f64; W], floor: f64) -> Sums<W> {
        dispatch(file.cpu(), Measure { vectors: self, file, hours, floor })
    }

    /// Moves every lane, and loads the states at which the right-hand side is wanted next.
    pub fn update(&mut self, file: &mut LaneFile<W>, moves: &Moves<W>) {
        let cpu: Cpu = file.cpu();
        dispatch(cpu, Update { vectors: self, file, moves });
    }
}

struct Measure<'a, 't, const W: usize> {
    vectors: &'a Vectors<W>,
    file: &'a LaneFile<'t, W>,
    hours: &'a [f64; W],
    floor: f64,
}

impl<const W: usize> Kernel for Measure<'_, '_, W> {
    type Output = Sums<W>;

    #[inline(always)]
    fn run(self) -> Sums<W> {
        let Vectors { start, slope, last, .. } = self.vectors;
        let (hours, floor) = (*self.hours, self.floor);
        let mut sums = Sums { error: [0.0; W], change: [0.0; W], start: [0.0; W], now: [0.0; W] };
        for (i, ((start, slope), last)) in start.iter().zip(slope).zip(last).enumerate() {
            // Copies, so that the compiler sees that nothing overlaps.
            let (y, end, first, f) = (start.0, last.0, slope.0, *self.file.root(i));
            for lane in 0..W {
                // The estimate of the method: 12/15 (y0 - y1) + 6/15 h (f0 + f1).
                let error = 0.8 * (y[lane] - end[lane]) + 0.4 * hours[lane] * (first[lane] + f[lane]);
                let ratio = error / y[lane].abs().max(end[lane].abs()).max(floor);
                sums.error[lane] += ratio * ratio;
                let change = f[lane] - first[lane];
                sums.change[lane] += change * change;
                sums.start[lane] += y[lane] * y[lane];
                sums.now[lane] += f[lane] * f[lane];
            }
        }
        sums
    }
}

struct Update<'a, 't, const W: usize> {
    vectors: &'a mut Vectors<W>,
    file: &'a mut LaneFile<'t, W>,
    moves: &'a Moves<W>,
}

impl<const W: usize> Kernel for Update<'_, '_, W> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Vectors { start, slope, last, before, mode } = self.vectors;
        let Moves { accept, take, keep, fresh, factors } = self.moves.clone();
        let places = start.iter_mut().zip(slope).zip(last.iter_mut()).zip(before).zip(mode);
        for (i, ((((start, slope), last), before), mode)) in places.enumerate() {
            // Copies, so that the compiler sees that nothing overlaps.
            let (now, starts, slopes) = (*self.file.root(i), start.0, slope.0);
            let (stages, stages_before, modes) = (last.0, before.0, mode.0);
            let (mut y, mut first, mut next, mut newest, mut way) =
                ([0.0; W], [0.0; W], [0.0; W], [0.0; W], [0.0; W]);
            for lane in 0..W {
                y[lane] = either(accept[lane], stages[lane], starts[lane]);
                first[lane] = either(take[lane], now[lane], slopes[lane]);
                way[lane] = either(keep[lane], now[lane] - first[lane], modes[lane]);
                // What a lane forgets may be no number, and no factor of zero would hide that.
                newest[lane] = either(fresh[lane], y[lane], stages[lane]);
                let older = either(fresh[lane], y[lane], stages_before[lane]);
                let here = either(fresh[lane], first[lane], now[lane]);
                next[lane] = factors[0][lane] * y[lane]
                    + factors[1][lane] * newest[lane]
                    + factors[2][lane] * older
                    + factors[3][lane] * here
                    + factors[4][lane] * first[lane]
                    + factors[5][lane] * way[lane];
            }
            (start.0, slope.0, last.0, before.0, mode.0) = (y, first, next, newest, way);
        }
        // A root may be a state itself, so all are read before one is written.
        self.file.set_states(last);
    }
}

/// The first where the mask is set, else the second; by bits, so that no branch is left.
#[inline(always)]
fn either(mask: u64, first: f64, second: f64) -> f64 {
    f64::from_bits((first.to_bits() & mask) | (second.to_bits() & !mask))
}
