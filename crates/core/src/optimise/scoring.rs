//! Fisher scoring in a box: the local run where a cost is a likelihood and its slopes are known.
//!
//! The curvature is that which the innovations are expected to have, plus what the gradients seen so far say
//! beyond it (a secant correction; Dennis, Gay and Welsch, ACM Trans. Math. Softw. 7, 1981). A box-shaped
//! trust region keeps the steps where the quadratic holds, and joins with the bounds.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{Candidate, Cost, Evaluation, LocalRun, Origin, Slope};

/// The settings of a run of Fisher scoring.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct ScoringOptions {
    /// Most steps of a run.
    pub steps: usize,
    /// Half width of the first trust region in the unit cube.
    pub radius: f64,
    /// A run ends where the next step promises less than this much of log-likelihood.
    pub tolerance: f64,
    /// Of two runs closer than this in every coordinate only the better one goes on.
    pub merge: f64,
}

impl Default for ScoringOptions {
    fn default() -> Self {
        Self { steps: 300, radius: 0.1, tolerance: 1e-6, merge: 1e-3 }
    }
}

/// A trust region that is smaller than this has nothing left to find.
const SMALLEST: f64 = 1e-10;

/// Why a run is over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum State {
    Running,
    /// The next step promises nothing.
    Settled,
    /// Out of steps, into a corner without slopes, or to the place of a better run.
    Termination,
}

/// One run from one start.
#[derive(Debug, Clone)]
pub struct Scoring {
    options: ScoringOptions,
    place: Candidate,
    cost: Cost,
    /// What the start cost.
    first: Cost,
    slope: Option<Slope>,
    /// The secant correction.
    correction: DMatrix<f64>,
    radius: f64,
    trial: Candidate,
    /// What the trial promises.
    promised: f64,
    steps: usize,
    state: State,
}

impl Scoring {
    /// A run from a start.
    pub fn new(options: &ScoringOptions, start: &Candidate) -> Self {
        let d = start.0.len();
        Self {
            options: options.clone(),
            place: start.clone(),
            cost: Cost::Diverged,
            first: Cost::Diverged,
            slope: None,
            correction: DMatrix::zeros(d, d),
            radius: options.radius,
            trial: start.clone(),
            promised: 0.0,
            steps: 0,
            state: State::Running,
        }
    }

    /// The next candidate; none when the run has ended.
    pub fn propose(&self) -> Option<Candidate> {
        (self.state == State::Running).then(|| self.trial.clone())
    }

    /// Where the run is, and what that costs.
    pub fn place(&self) -> (&[f64], Cost) {
        (&self.place.0, self.cost)
    }

    /// Whether the run has ended.
    pub fn ended(&self) -> bool {
        self.state != State::Running
    }

    /// The whole run, from its start to here.
    pub fn run(&self, origin: Origin) -> LocalRun {
        let settled = self.state == State::Settled;
        LocalRun { origin, start: self.first, end: self.cost, evaluations: self.steps, settled }
    }

    /// Ends the run.
    pub fn end(&mut self) {
        self.state = State::Termination;
    }

    /// Answers it.
    pub fn digest(&mut self, answer: &Evaluation) {
        self.steps += 1;
        match (&self.slope, &answer.slope) {
            (None, None) => self.state = State::Termination,
            (None, Some(first)) => {
                self.slope = Some(first.clone());
                (self.cost, self.first) = (answer.cost, answer.cost);
            }
            (Some(_), None) => self.radius *= 0.25,
            (Some(here), Some(there)) => {
                let gained = here.value - there.value;
                let share = if self.promised > 0.0 { gained / self.promised } else { 0.0 };
                let longest =
                    self.trial.0.iter().zip(&self.place.0).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
                self.learn(there);
                if share < 0.25 {
                    self.radius = 0.35 * longest;
                } else if share > 0.75 && longest > 0.99 * self.radius {
                    self.radius = (2.5 * self.radius).min(1.0);
                }
                if share > 1e-4 {
                    (self.place, self.cost, self.slope) =
                        (self.trial.clone(), answer.cost, Some(there.clone()));
                }
            }
        }
        if self.steps >= self.options.steps {
            self.state = State::Termination;
        }
        self.next_trial();
    }

    /// Adds what the change of the gradient says beyond the expected curvature.
    fn learn(&mut self, there: &Slope) {
        let Some(here) = &self.slope else { return };
        let d = self.place.0.len();
        let step = DVector::from_fn(d, |i, _| self.trial.0[i] - self.place.0[i]);
        let change = DVector::from_fn(d, |i, _| there.gradient[i] - here.gradient[i]);
        let information = DMatrix::from_row_slice(d, d, &there.information);
        let wanted = &change - information * &step;
        // The correction shrinks to what the last step saw of it (sizing), then meets the secant (symmetric
        // rank one).
        let bent = &self.correction * &step;
        let seen = step.dot(&bent);
        if seen.abs() > 0.0 {
            self.correction *= (step.dot(&wanted) / seen).abs().min(1.0);
        }
        let rest = wanted - &self.correction * &step;
        let along = rest.dot(&step);
        if along.abs() > 1e-8 * rest.norm() * step.norm() {
            self.correction += (&rest * rest.transpose()) / along;
        }
    }

    /// Looks for the next trial.
    fn next_trial(&mut self) {
        let Some(slope) = self.slope.as_ref().filter(|_| self.state == State::Running) else { return };
        let d = self.place.0.len();
        let information = DMatrix::from_row_slice(d, d, &slope.information);
        let gradient = DVector::from_column_slice(&slope.gradient);
        let limits: Vec<(f64, f64)> =
            self.place.0.iter().map(|x| ((-x).max(-self.radius), (1.0 - x).min(self.radius))).collect();
        let corrected = &information + &self.correction;
        let (curvature, step) = match minimise(&corrected, &gradient, &limits) {
            Some(step) => (corrected, step),
            // Where the correction bends the wrong way, the expected curvature alone never does.
            None => match minimise(&information, &gradient, &limits) {
                Some(step) => (information, step),
                None => {
                    self.state = State::Termination;
                    return;
                }
            },
        };
        self.promised = -gradient.dot(&step) - 0.5 * step.dot(&(&curvature * &step));
        self.trial =
            Candidate(self.place.0.iter().zip(step.iter()).map(|(x, by)| (x + by).clamp(0.0, 1.0)).collect());
        let bound = step.amax() > 0.99 * self.radius;
        if self.promised <= self.options.tolerance && (!bound || self.radius < 1e-4) {
            self.state = State::Settled;
        } else if self.radius < SMALLEST {
            // No step keeps what the slope promises: whatever this place is, it was not shown to be an
            // optimum.
            self.state = State::Termination;
        }
    }
}

/// The step in a box that minimises a quadratic: an active-set search. `None` where the curvature is not
/// positive.
fn minimise(
    curvature: &DMatrix<f64>,
    gradient: &DVector<f64>,
    limits: &[(f64, f64)],
) -> Option<DVector<f64>> {
    let d = gradient.len();
    // A direction that the data do not see at all must not be infinitely long.
    let floor = 1e-12 * (0..d).map(|i| curvature[(i, i)]).fold(0.0, f64::max) + f64::MIN_POSITIVE;
    let mut step = DVector::<f64>::zeros(d);
    let mut free: Vec<bool> = (0..d)
        .map(|i| {
            let (low, high) = limits[i];
            // On a bound and pushed outwards, a coordinate stays.
            !((low >= 0.0 && gradient[i] > 0.0) || (high <= 0.0 && gradient[i] < 0.0))
        })
        .collect();
    for _ in 0..3 * d + 1 {
        let places: Vec<usize> = (0..d).filter(|i| free[*i]).collect();
        let part = DMatrix::from_fn(places.len(), places.len(), |i, j| {
            curvature[(places[i], places[j])] + if i == j { floor } else { 0.0 }
        });
        let slope = DVector::from_fn(places.len(), |i, _| {
            let fixed: f64 = (0..d).filter(|j| !free[*j]).map(|j| curvature[(places[i], j)] * step[j]).sum();
            -(gradient[places[i]] + fixed)
        });
        let target = part.cholesky()?.solve(&slope);
        // Goes towards the target up to the first limit, which then holds the coordinate.
        let mut share = 1.0;
        let mut held = None;
        for (index, i) in places.iter().enumerate() {
            let (low, high) = limits[*i];
            let by = target[index] - step[*i];
            let room = if by > 0.0 {
                (high - step[*i]) / by
            } else if by < 0.0 {
                (low - step[*i]) / by
            } else {
                f64::INFINITY
            };
            if room < share {
                (share, held) = (room.max(0.0), Some(*i));
            }
        }
        for (index, i) in places.iter().enumerate() {
            step[*i] += share * (target[index] - step[*i]);
        }
        match held {
            Some(i) => {
                free[i] = false;
                step[i] = if step[i] > 0.5 * (limits[i].0 + limits[i].1) { limits[i].1 } else { limits[i].0 };
            }
            None => {
                // A held coordinate that would rather go back inside is let go.
                let total = gradient + curvature * &step;
                let inward = |i: &usize| {
                    let (low, high) = limits[*i];
                    !free[*i]
                        && low < high
                        && ((step[*i] <= low && total[*i] < 0.0) || (step[*i] >= high && total[*i] > 0.0))
                };
                match (0..d).find(inward) {
                    Some(i) => free[i] = true,
                    None => return Some(step),
                }
            }
        }
    }
    Some(step)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rosenbrock's valley on the unit square with its Gauss-Newton curvature; the optimum lies at (0.7,
    /// 0.49).
    fn valley(x: &[f64]) -> Evaluation {
        let (a, b) = (10.0 * (x[1] - x[0] * x[0]), x[0] - 0.7);
        let rows = [[-20.0 * x[0], 10.0], [1.0, 0.0]];
        let value = 100.0 * 0.5 * (a * a + b * b);
        let gradient = (0..2).map(|i| 100.0 * (a * rows[0][i] + b * rows[1][i])).collect();
        let information =
            (0..4).map(|s| 100.0 * (0..2).map(|r| rows[r][s / 2] * rows[r][s % 2]).sum::<f64>()).collect();
        Evaluation {
            cost: Cost::new(value),
            residuals: Vec::new(),
            slope: Some(Slope { value, gradient, information }),
        }
    }

    fn run(start: [f64; 2], f: impl Fn(&[f64]) -> Evaluation) -> (Vec<f64>, usize, bool) {
        let mut scoring = Scoring::new(
            &ScoringOptions { tolerance: 1e-12, ..ScoringOptions::default() },
            &Candidate(start.to_vec()),
        );
        let mut asked = 0;
        while let Some(trial) = scoring.propose() {
            assert!(trial.0.iter().all(|x| (0.0..=1.0).contains(x)));
            scoring.digest(&f(&trial.0));
            asked += 1;
        }
        (scoring.place().0.to_vec(), asked, scoring.state == State::Settled)
    }

    #[test]
    fn a_curved_valley_is_followed_to_its_bottom() {
        for start in [[0.0, 1.0], [1.0, 0.0], [0.1, 0.1]] {
            let (place, asked, settled) = run(start, valley);
            assert!(settled && asked < 60, "{start:?}: {asked}");
            assert!((place[0] - 0.7).abs() < 1e-5 && (place[1] - 0.49).abs() < 1e-5, "{place:?}");
        }
    }

    #[test]
    fn an_optimum_on_a_bound_is_settled_there() {
        // The valley's bottom lies outside once the first coordinate is pushed beyond 1.
        let (place, _, settled) = run([0.3, 0.3], |x| {
            let mut answer = valley(x);
            if let Some(slope) = &mut answer.slope {
                slope.value -= 400.0 * x[0];
                slope.gradient[0] -= 400.0;
            }
            answer
        });
        assert!(settled && place[0] == 1.0 && (place[1] - 1.0).abs() < 1e-5, "{place:?}");
    }

    #[test]
    fn a_start_without_a_likelihood_ends() {
        let nothing = Evaluation { cost: Cost::Diverged, residuals: Vec::new(), slope: None };
        let (_, asked, settled) = run([0.5, 0.5], |_| nothing.clone());
        assert_eq!((asked, settled), (1, false));
        // A region that cannot be computed is walked around.
        let (place, _, settled) = run([0.1, 0.1], |x| if x[0] > 0.75 { nothing.clone() } else { valley(x) });
        assert!(settled && (place[0] - 0.7).abs() < 1e-4, "{place:?}");
    }
}
