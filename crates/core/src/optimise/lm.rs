//! Levenberg-Marquardt in the unit cube, as a state machine: it proposes batches, the caller computes
//! residuals.
//!
//! An iteration is two batches. The first one holds a forward difference per coordinate; the second one holds
//! the steps of several damping values at once, because candidates side by side in the lanes cost hardly more
//! than one. Bounds are kept by an active set: coordinates that press against their bound are fixed, and a
//! step that would cross a bound ends on it while the others are solved again.

use nalgebra::{DMatrix, DVector};

use super::local_options::LocalOptions;
use super::{Candidate, Cost, Evaluation};
use crate::gram::{dot, gram};

/// Damping beyond which a step no longer differs from standing still.
const DAMPING_MAX: f64 = 1e10;
/// Damping below which a step no longer differs from Gauss-Newton.
const DAMPING_MIN: f64 = 1e-14;
/// The lowest damping of an iteration lies this power of the spread below the last one that helped.
const BOLD: i32 = 4;
/// Where stronger dampings than those that have failed promise to lower the cost by less than so much of the
/// tolerance, the run ends.
const PROMISE: f64 = 1e-3;
/// Steps shorter than this in every coordinate end the run.
const SHORT: f64 = 1e-11;

/// One run from one start.
#[derive(Debug)]
pub struct LevenbergMarquardt {
    options: LocalOptions,
    position: Vec<f64>,
    cost: Cost,
    /// Residuals at the position; empty until the first batch is answered.
    residuals: Vec<f64>,
    damping: f64,
    phase: Phase,
    iterations: usize,
    /// Successive iterations that changed the cost by less than the tolerance.
    flat: usize,
}

#[derive(Debug)]
enum Phase {
    /// Asks for the residuals at the start, where they are not known, and one step along each coordinate.
    Slopes,
    /// Asks for a step per damping value.
    Trials(Vec<Trial>, Normal),
    Ended,
}

#[derive(Debug)]
struct Trial {
    damping: f64,
    position: Vec<f64>,
}

/// The normal equations at the position. They are kept for another round of damping values after a failure.
#[derive(Debug, Clone)]
struct Normal {
    /// J'J.
    matrix: DMatrix<f64>,
    /// J'r.
    gradient: DVector<f64>,
}

impl LevenbergMarquardt {
    /// A run from `start`, whose residuals are not known yet.
    pub fn new(options: LocalOptions, start: &Candidate) -> Self {
        Self {
            damping: options.damping,
            position: start.0.clone(),
            cost: Cost::Diverged,
            residuals: Vec::new(),
            phase: Phase::Slopes,
            iterations: 0,
            flat: 0,
            options,
        }
    }

    /// Where the run is, and what that costs.
    pub fn place(&self) -> (&[f64], Cost) {
        (&self.position, self.cost)
    }

    /// Whether the run has ended.
    pub fn ended(&self) -> bool {
        matches!(self.phase, Phase::Ended)
    }

    /// Ends the run where it is.
    pub fn end(&mut self) {
        self.phase = Phase::Ended;
    }

    /// Iterations completed.
    pub fn iterations(&self) -> usize {
        self.iterations
    }

    /// The next batch; empty when the run has ended.
    pub fn propose(&self) -> Vec<Candidate> {
        match &self.phase {
            Phase::Slopes => {
                let base = self.residuals.is_empty().then(|| Candidate(self.position.clone()));
                base.into_iter().chain((0..self.position.len()).map(|along| self.probe(along))).collect()
            }
            Phase::Trials(trials, _) => {
                trials.iter().map(|trial| Candidate(trial.position.clone())).collect()
            }
            Phase::Ended => Vec::new(),
        }
    }

    /// Answers the last batch.
    pub fn digest(&mut self, answers: &[Evaluation]) {
        match std::mem::replace(&mut self.phase, Phase::Ended) {
            Phase::Slopes => self.digest_slopes(answers),
            Phase::Trials(trials, normal) => self.digest_trials(&trials, normal, answers),
            Phase::Ended => {}
        }
    }

    /// The position with a small step along one coordinate, backwards where forwards would leave the cube.
    fn probe(&self, along: usize) -> Candidate {
        let mut position = self.position.clone();
        position[along] += self.step(along);
        Candidate(position)
    }

    fn step(&self, along: usize) -> f64 {
        if self.position[along] + self.options.step > 1.0 { -self.options.step } else { self.options.step }
    }

    fn digest_slopes(&mut self, mut answers: &[Evaluation]) {
        if self.residuals.is_empty() {
            let Some((base, slopes)) = answers.split_first() else {
                return;
            };
            // Without residuals at the start there is nothing to descend from, and the run stays ended.
            if base.residuals.is_empty() || base.cost == Cost::Diverged {
                return;
            }
            self.cost = base.cost;
            self.residuals.clone_from(&base.residuals);
            answers = slopes;
        }
        let columns: Vec<Vec<f64>> =
            answers.iter().enumerate().map(|(along, answer)| self.column(along, answer)).collect();
        let normal = self.normal(&columns);
        self.search(normal);
    }

    /// The derivative of the residuals along one coordinate. Where the step diverged it is taken as zero,
    /// which holds the coordinate still for one iteration.
    fn column(&self, along: usize, answer: &Evaluation) -> Vec<f64> {
        if answer.cost == Cost::Diverged || answer.residuals.len() != self.residuals.len() {
            return vec![0.0; self.residuals.len()];
        }
        // The step that was really taken, after rounding.
        let step = (self.position[along] + self.step(along)) - self.position[along];
        answer.residuals.iter().zip(&self.residuals).map(|(moved, here)| (moved - here) / step).collect()
    }

    fn normal(&self, columns: &[Vec<f64>]) -> Normal {
        let d = columns.len();
        let series: Vec<&[f64]> = columns.iter().chain([&self.residuals]).map(Vec::as_slice).collect();
        let products = gram(&series);
        Normal {
            matrix: DMatrix::from_fn(d, d, |i, j| products[i * (d + 1) + j]),
            gradient: DVector::from_fn(d, |i, _| products[i * (d + 1) + d]),
        }
    }

    /// Prepares a step for each of several damping values.
    fn search(&mut self, normal: Normal) {
        let mut trials: Vec<Trial> = Vec::with_capacity(self.options.trials.max(1));
        for power in 0..self.options.trials.max(1) {
            // Around the last damping, and a bold one far below it: near an optimum without residuals only
            // ever smaller dampings converge faster than linearly.
            let power = if power == 0 { -BOLD } else { power as i32 - 2 };
            let damping = (self.damping * self.options.spread.powi(power)).clamp(DAMPING_MIN, DAMPING_MAX);
            let Some(position) = self.stepped(&normal, damping) else {
                continue;
            };
            let moves = position.iter().zip(&self.position).any(|(to, from)| (to - from).abs() > SHORT);
            if moves && trials.iter().all(|trial| trial.position != position) {
                trials.push(Trial { damping, position });
            }
        }
        self.phase = if trials.is_empty() { Phase::Ended } else { Phase::Trials(trials, normal) };
    }

    /// Ends the run where none of its trials promises anything: near an optimum of simulations that are not
    /// exact no damping helps.
    fn give_up_on_little(&mut self) {
        let Phase::Trials(trials, normal) = &self.phase else { return };
        let promised = trials.iter().map(|trial| self.promise(normal, &trial.position)).fold(0.0, f64::max);
        if promised < PROMISE * self.options.tolerance * dot(&self.residuals, &self.residuals) {
            self.phase = Phase::Ended;
        }
    }

    /// By how much a step to a position lowers the sum of squares, as far as the normal equations go.
    fn promise(&self, normal: &Normal, position: &[f64]) -> f64 {
        let step = DVector::from_fn(position.len(), |i, _| position[i] - self.position[i]);
        -(2.0 * normal.gradient.dot(&step) + step.dot(&(&normal.matrix * &step)))
    }

    /// Minimises the damped quadratic model within the cube; none where it cannot be solved.
    fn stepped(&self, normal: &Normal, damping: f64) -> Option<Vec<f64>> {
        let d = self.position.len();
        let mut step = vec![0.0; d];
        // The damping is the same for every coordinate (Levenberg's), because the cube is the natural scale:
        // with a damping in proportion to each column (Marquardt's) a coordinate that has little effect here
        // runs to its bound at once. On rooms of 15 parameters this halves the evaluations.
        let scale = normal.matrix.diagonal().max();
        // A coordinate without any effect, or one that presses against its bound, stays.
        let mut free: Vec<usize> = (0..d)
            .filter(|i| {
                let downhill = -normal.gradient[*i];
                let pressed = (self.position[*i] <= 0.0 && downhill <= 0.0)
                    || (self.position[*i] >= 1.0 && downhill >= 0.0);
                !pressed && normal.matrix[(*i, *i)] > 0.0
            })
            .collect();
        while !free.is_empty() {
            let matrix = DMatrix::from_fn(free.len(), free.len(), |row, column| {
                let (i, j) = (free[row], free[column]);
                let damped = if row == column { damping } else { 0.0 };
                normal.matrix[(i, j)] / scale + damped
            });
            let right = DVector::from_fn(free.len(), |row, _| {
                let i = free[row];
                let pinned: f64 =
                    (0..d).filter(|j| !free.contains(j)).map(|j| normal.matrix[(i, j)] * step[j]).sum();
                -(normal.gradient[i] + pinned) / scale
            });
            let solved = matrix.cholesky()?.solve(&right);
            let crossing = |row: usize| {
                let to = self.position[free[row]] + solved[row];
                !(0.0..=1.0).contains(&to)
            };
            let inside: Vec<usize> = (0..free.len()).filter(|row| !crossing(*row)).collect();
            for (row, i) in free.iter().enumerate() {
                step[*i] = solved[row];
            }
            if inside.len() == free.len() {
                break;
            }
            for row in (0..free.len()).filter(|row| crossing(*row)) {
                let i = free[row];
                step[i] = if step[i] > 0.0 { 1.0 } else { 0.0 } - self.position[i];
            }
            free = inside.into_iter().map(|row| free[row]).collect();
        }
        let position: Vec<f64> =
            self.position.iter().zip(&step).map(|(x, step)| (x + step).clamp(0.0, 1.0)).collect();
        position.iter().all(|x| x.is_finite()).then_some(position)
    }

    fn digest_trials(&mut self, trials: &[Trial], normal: Normal, answers: &[Evaluation]) {
        self.iterations += 1;
        let best = trials
            .iter()
            .zip(answers)
            .filter(|(_, answer)| answer.residuals.len() == self.residuals.len())
            .min_by_key(|(_, answer)| answer.cost);
        let (old, exhausted) = (self.cost, self.iterations >= self.options.iterations);
        match best {
            Some((trial, answer)) if answer.cost < old => {
                self.position.clone_from(&trial.position);
                self.cost = answer.cost;
                self.residuals.clone_from(&answer.residuals);
                self.damping = trial.damping;
                let gained = (old.value() - self.cost.value()) / old.value().abs().max(f64::MIN_POSITIVE);
                self.flat = if gained < self.options.tolerance { self.flat + 1 } else { 0 };
                if self.flat < 2 && !exhausted {
                    self.phase = Phase::Slopes;
                }
            }
            // All rejected, diverged ones included: the same slopes with the next, stronger damping values.
            _ => {
                self.damping *= self.options.spread.powi(BOLD + self.options.trials as i32 - 2);
                if self.damping < DAMPING_MAX && !exhausted {
                    self.search(normal);
                    self.give_up_on_little();
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optimise::functions::rosenbrock_residuals;

    fn run(start: Vec<f64>, residuals: impl Fn(&[f64]) -> Vec<f64>) -> (LevenbergMarquardt, usize) {
        let mut run = LevenbergMarquardt::new(LocalOptions::default(), &Candidate(start));
        let mut evaluations = 0;
        while !run.ended() {
            let answers: Vec<Evaluation> = run
                .propose()
                .iter()
                .map(|candidate| {
                    let residuals = residuals(&candidate.0);
                    let cost =
                        Cost::new(residuals.iter().map(|r| r * r).sum::<f64>() / residuals.len() as f64);
                    Evaluation { cost, residuals, slope: None }
                })
                .collect();
            evaluations += answers.len();
            run.digest(&answers);
        }
        (run, evaluations)
    }

    #[test]
    fn linear_least_squares_with_active_bounds_is_solved_exactly() {
        // min (x - 2)^2 + (x + y - 1.8)^2 + (z + 0.5)^2 over the cube: x = 1, y = 0.8, z = 0.
        let (run, evaluations) =
            run(vec![0.3, 0.9, 0.6], |x| vec![x[0] - 2.0, x[0] + x[1] - 1.8, x[2] + 0.5]);
        assert_eq!((run.position[0], run.position[2]), (1.0, 0.0));
        assert!((run.position[1] - 0.8).abs() < 1e-8, "{:?}", run.position);
        assert!(evaluations < 60, "{evaluations}");
    }

    #[test]
    fn a_wrongly_pinned_coordinate_is_released() {
        // The unconstrained step from the corner crosses both bounds, the solution lies on one of them.
        let (run, _) =
            run(vec![1.0, 1.0], |x| vec![3.0 * x[0] + x[1] - 0.5, x[0] - x[1] + 0.9, 0.1 * x[1] - 0.02]);
        let expected = (0.5 + 0.9 + 0.002) / (1.0 + 1.0 + 0.01);
        assert_eq!(run.position[0], 0.0);
        assert!((run.position[1] - expected).abs() < 1e-8, "{:?} {expected}", run.position);
    }

    #[test]
    fn rosenbrock_in_the_box_reaches_its_optimum() {
        let (run, evaluations) = run(vec![0.45, 0.55], rosenbrock_residuals);
        assert!(run.cost.value() < 1e-18, "{:?}", run.cost);
        assert!(evaluations < 200, "{evaluations}");
    }

    #[test]
    fn diverged_trials_and_slopes_are_survived() {
        // Beyond 0.6 nothing can be computed; the optimum is on the edge of that.
        let edge = |x: &[f64]| {
            if x[0] > 0.6 { vec![f64::NAN; 2] } else { vec![x[0] - 0.59, x[1] - 0.2] }
        };
        let (run, _) = run(vec![0.1, 0.9], edge);
        assert!(run.cost.value() < 1e-12);
        let (run, evaluations) = super::tests::run(vec![0.5; 2], |_| vec![f64::NAN; 2]);
        assert_eq!((run.cost, evaluations), (Cost::Diverged, 3));
    }

    #[test]
    fn a_coordinate_without_effect_stays() {
        let (run, _) = run(vec![0.2, 0.7], |x| vec![x[0] - 0.5, 1.0]);
        assert_eq!(run.position[1], 0.7);
        assert!((run.position[0] - 0.5).abs() < 1e-8);
    }
}
