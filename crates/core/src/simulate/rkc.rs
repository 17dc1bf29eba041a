//! One candidate's way through an interval by the stabilised explicit method RKC2 (Sommeijer, Shampine and
//! Verwer, J. Comput. Appl. Math. 88, 1997): stages, error control, and a spectral radius by a nonlinear
//! power method. An evaluation of the right-hand side comes in, and what the lane does next goes out.

use super::chebyshev::{MOST_STAGES, Stage, fewest, reach, stages};
use super::vectors::{Moves, NO, Sums, YES};
use crate::model::math;

/// Tolerance of one step, as a share of a state. The plateaus of a settler flip at the kinks of their fluxes
/// and magnify what a step leaves behind: over 200 random candidates of plants this holds the effluents
/// within 3e-3 of their ranges, and 1e-5 only within 1e-2.
pub const TOLERANCE: f64 = 1e-7;
/// The tolerance of a search, whose steps are more than twice as long.
pub const LOOSE_TOLERANCE: f64 = 1e-5;
/// A state below this, in its own unit, counts as this large.
pub const FLOOR: f64 = 0.1;
/// What the estimate of the spectral radius may be short of.
const SAFETY: f64 = 1.2;
/// The power method has converged when a turn changes its estimate by less than this share.
const SETTLED: f64 = 0.05;
/// Most turns of the power method.
const MOST_TURNS: usize = 50;
/// Accepted steps before the spectral radius is estimated anew under constant inputs.
const STEPS_PER_ESTIMATE: usize = 25;
/// A step below this share of its interval gets nowhere.
const LEAST_STEP: f64 = 1e-9;
/// Most evaluations from one sample to the next: what needs more is followed by no step of a sensible length.
const MOST_EVALUATIONS: usize = 5_000;
/// As many times more over a warm-up.
const WARM_UP_ALLOWANCE: usize = 20;
/// What a lane's evaluation is for.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    /// Nothing: there is no candidate.
    Idle,
    /// The slope at the start, under new inputs.
    Slope,
    /// A turn of the power method.
    Power,
    /// The stage of this number.
    Stage(usize),
    /// The slope at the end of a step, and its error.
    Judge,
}

/// What becomes of a lane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum LaneEvent {
    /// It goes on.
    Nothing,
    /// It is at the end of its interval.
    Arrived,
    /// Its candidate cannot be followed.
    Lost,
}

/// The clockwork of one lane. Times are in hours.
#[derive(Debug, Clone, Copy)]
pub struct LaneClock {
    phase: Phase,
    /// The last sample; `None` in the warm-up.
    pub sample: Option<usize>,
    /// Time since the interval began, and its length.
    time: f64,
    length: f64,
    /// The step that the error allows, and the one that is taken.
    proposed: f64,
    pub step: f64,
    /// Whether the step ends the interval.
    last: bool,
    stages: &'static [Stage],
    /// Error and length of the last accepted step.
    before: Option<(f64, f64)>,
    radius: f64,
    /// The power method: length of its step, of its mode, its estimate and its turns.
    nudge: f64,
    mode: f64,
    sigma: f64,
    turns: usize,
    /// Accepted steps since the spectral radius was estimated.
    age: usize,
    /// Evaluations since the interval began.
    evaluations: usize,
}

impl LaneClock {
    /// A lane without a candidate.
    pub const IDLE: LaneClock = LaneClock {
        phase: Phase::Idle,
        sample: None,
        time: 0.0,
        length: 0.0,
        proposed: 0.0,
        step: 0.0,
        last: false,
        stages: &[],
        before: None,
        radius: 0.0,
        nudge: 0.0,
        mode: 0.0,
        sigma: 0.0,
        turns: 0,
        age: 0,
        evaluations: 0,
    };

    /// Begins an interval at a sample, or the warm-up; `changed` says whether the inputs are others than
    /// before.
    pub fn begin(&mut self, sample: Option<usize>, length: f64, changed: bool) {
        let (before, age) = if changed { (None, STEPS_PER_ESTIMATE) } else { (self.before, self.age) };
        *self = LaneClock {
            phase: Phase::Slope,
            sample,
            time: 0.0,
            length,
            before,
            age,
            evaluations: 0,
            ..*self
        };
    }

    /// Reads an evaluation and says what follows from it.
    pub fn turn<const W: usize>(
        &mut self,
        lane: usize,
        sums: &Sums<W>,
        states: usize,
        tolerance: f64,
        moves: &mut Moves<W>,
    ) -> LaneEvent {
        self.evaluations += 1;
        let allowance = if self.sample.is_none() { WARM_UP_ALLOWANCE } else { 1 };
        if self.evaluations > allowance * MOST_EVALUATIONS {
            return LaneEvent::Lost;
        }
        match self.phase {
            Phase::Idle => LaneEvent::Nothing,
            Phase::Slope => {
                moves.take[lane] = YES;
                self.go_on(lane, sums, moves)
            }
            Phase::Power => {
                let change = sums.change[lane].sqrt();
                let sigma = change / self.nudge;
                if !sigma.is_finite() {
                    return LaneEvent::Lost;
                }
                self.turns += 1;
                let settled = (sigma - self.sigma).abs() <= SETTLED * sigma;
                (self.sigma, self.mode) = (sigma, change);
                moves.keep[lane] = YES;
                if settled || self.turns >= MOST_TURNS || change == 0.0 {
                    (self.radius, self.age) = (SAFETY * sigma, 0);
                    self.launch(lane, moves);
                } else {
                    moves.set(lane, [1.0, 0.0, 0.0, 0.0, 0.0, self.nudge / change]);
                }
                LaneEvent::Nothing
            }
            Phase::Stage(number) => {
                let stage = self.stages[number - 1];
                let h = self.step;
                moves.fresh[lane] = NO;
                moves.set(
                    lane,
                    [1.0 - stage.mu - stage.nu, stage.mu, stage.nu, h * stage.slope, h * stage.start, 0.0],
                );
                self.phase =
                    if number == self.stages.len() { Phase::Judge } else { Phase::Stage(number + 1) };
                LaneEvent::Nothing
            }
            Phase::Judge => {
                self.judge(lane, (sums.error[lane] / states as f64).sqrt() / tolerance, sums, moves)
            }
        }
    }

    /// Begins the power method, from the mode that it found last.
    fn search<const W: usize>(
        &mut self,
        lane: usize,
        start: f64,
        now: f64,
        moves: &mut Moves<W>,
    ) -> LaneEvent {
        if !(start.is_finite() && now.is_finite()) {
            return LaneEvent::Lost;
        }
        let size = start.sqrt();
        self.nudge = f64::EPSILON.sqrt() * if size > 0.0 { size } else { 1.0 };
        self.turns = 0;
        self.phase = Phase::Power;
        if self.mode > 0.0 {
            moves.set(lane, [1.0, 0.0, 0.0, 0.0, 0.0, self.nudge / self.mode]);
        } else if now > 0.0 {
            moves.set(lane, [1.0, 0.0, 0.0, 0.0, self.nudge / now.sqrt(), 0.0]);
        } else {
            moves.set(lane, [1.0 + f64::EPSILON.sqrt(), 0.0, 0.0, 0.0, 0.0, 0.0]);
        }
        LaneEvent::Nothing
    }

    /// Begins a step with as many stages as keep it stable.
    fn launch<const W: usize>(&mut self, lane: usize, moves: &mut Moves<W>) {
        let left = self.length - self.time;
        if self.proposed == 0.0 {
            self.proposed = if self.radius > 0.0 { 1.0 / self.radius } else { left };
        }
        // Two equal steps rather than a long and a very short one.
        self.last = self.proposed >= left;
        self.step = if self.last { left } else { self.proposed.min(0.5 * left) };
        let mut wanted = fewest(self.step * self.radius);
        if wanted > MOST_STAGES {
            (wanted, self.last) = (MOST_STAGES, false);
            self.step = reach(MOST_STAGES) / self.radius;
        }
        self.stages = stages(wanted);
        self.phase = Phase::Stage(2);
        moves.set(lane, [1.0, 0.0, 0.0, 0.0, self.step * self.stages[0].start, 0.0]);
    }

    /// Accepts or rejects a step by its error, in tolerances, and proposes the next.
    fn judge<const W: usize>(
        &mut self,
        lane: usize,
        error: f64,
        sums: &Sums<W>,
        moves: &mut Moves<W>,
    ) -> LaneEvent {
        let root = math::pow(error.max(1e-12), 1.0 / 3.0);
        // What is no number is no small error either.
        if error > 1.0 || error.is_nan() {
            self.proposed = self.step * if root.is_finite() { (0.8 / root).max(0.1) } else { 0.1 };
            self.before = None;
            if self.proposed < LEAST_STEP * self.length {
                return LaneEvent::Lost;
            }
            if self.age == 0 {
                self.launch(lane, moves);
                return LaneEvent::Nothing;
            }
            return self.search(lane, sums.start[lane], 0.0, moves);
        }
        (moves.accept[lane], moves.take[lane]) = (YES, YES);
        // Watts and Shampine's controller looks at two errors, the first step at one.
        let factor = match self.before {
            Some((error_before, step_before)) => {
                0.8 * self.step * math::pow(error_before, 1.0 / 3.0) / (step_before * root * root)
            }
            None => 0.8 / root,
        };
        let grown = self.step * factor.clamp(0.1, 10.0);
        // The end of an interval cuts steps short; the next interval does not begin with the remnant.
        self.proposed = if factor >= 1.0 { grown.max(self.proposed) } else { grown };
        self.before = Some((error.max(1e-12), self.step));
        self.age += 1;
        self.time += self.step;
        if self.last {
            return LaneEvent::Arrived;
        }
        self.go_on(lane, sums, moves)
    }

    /// Begins a step, behind a look at the spectral radius where that is old.
    fn go_on<const W: usize>(&mut self, lane: usize, sums: &Sums<W>, moves: &mut Moves<W>) -> LaneEvent {
        if self.age >= STEPS_PER_ESTIMATE {
            return self.search(lane, sums.start[lane], sums.now[lane], moves);
        }
        self.launch(lane, moves);
        LaneEvent::Nothing
    }
}
