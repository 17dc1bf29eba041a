//! Local searches on costs alone as coroutines: BOBYQA, Powell's trust-region method without derivatives, and
//! those of `descent`.
//!
//! A solver calls the objective from deep inside, whereas a search here is asked and told. It therefore runs
//! on a thread of its own behind two rendezvous channels: of the two threads one always waits for the other,
//! so nothing runs at the same time and the result does not depend on any scheduling.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use bobyqa::{Bobyqa, Config};

use super::descent::{self, DescentLimits};
use super::local_options::{LocalMethod, LocalOptions};
use super::{Candidate, Cost};

/// Told to the solver when nobody listens any more: it is below its target cost, so that it returns at once.
const ABANDON: f64 = f64::NEG_INFINITY;
/// No cost of interest is as low as this.
const TARGET: f64 = -1e300;

/// One run from one start.
#[derive(Debug)]
pub struct TrustRegion {
    best: (Candidate, Cost),
    /// The question that waits for its answer; none when the run has ended.
    pending: Option<Candidate>,
    /// The worst finite cost so far, which stands for diverged candidates: a huge number would ruin the
    /// quadratic model that the solver interpolates.
    worst: f64,
    solver: Option<Solver>,
}

/// The other thread and the channels to it.
#[derive(Debug)]
struct Solver {
    questions: Receiver<Vec<f64>>,
    answers: SyncSender<f64>,
    thread: JoinHandle<()>,
}

impl TrustRegion {
    /// A run from `start`. Should the solver refuse to work, the run has ended before its first question.
    pub fn new(options: &LocalOptions, start: &Candidate) -> Self {
        let mut run = Self {
            best: (start.clone(), Cost::Diverged),
            pending: None,
            worst: f64::NEG_INFINITY,
            solver: Solver::start(options, start.0.clone()),
        };
        run.receive();
        run
    }

    /// The best place so far, and what it costs.
    pub fn place(&self) -> (&[f64], Cost) {
        (&self.best.0.0, self.best.1)
    }

    /// Whether the run has ended.
    pub fn ended(&self) -> bool {
        self.pending.is_none()
    }

    /// The next question; none when the run has ended.
    pub fn propose(&self) -> Option<Candidate> {
        self.pending.clone()
    }

    /// Answers it.
    pub fn digest(&mut self, cost: Cost) {
        let Some(candidate) = self.pending.take() else {
            return;
        };
        if cost < self.best.1 {
            self.best = (candidate, cost);
        }
        let told = match cost {
            Cost::Finite(value) => {
                self.worst = self.worst.max(value);
                value
            }
            Cost::Diverged if self.worst.is_finite() => self.worst,
            // The solver itself moderates this one.
            Cost::Diverged => f64::INFINITY,
        };
        let heard = self.solver.as_ref().is_some_and(|solver| solver.answers.send(told).is_ok());
        if heard {
            self.receive();
        }
    }

    /// Waits for the next question; a closed channel means that the solver has returned.
    fn receive(&mut self) {
        self.pending = self.solver.as_ref().and_then(|solver| solver.questions.recv().ok()).map(Candidate);
        if self.pending.is_none() {
            self.stop();
        }
    }

    fn stop(&mut self) {
        if let Some(Solver { questions, answers, thread }) = self.solver.take() {
            // With both channels closed the solver abandons its search at its next evaluation.
            drop(questions);
            drop(answers);
            // A panic over there would end the run like a normal return.
            let _ = thread.join();
        }
    }
}

impl Drop for TrustRegion {
    fn drop(&mut self) {
        self.stop();
    }
}

impl Solver {
    fn start(options: &LocalOptions, mut x: Vec<f64>) -> Option<Self> {
        let d = x.len();
        // The cube is one wide and the solver needs two radii of room.
        let radius = options.radius.clamp(1e-12, 0.5);
        let limits = DescentLimits {
            radius,
            radius_end: options.radius_end.clamp(1e-14, radius),
            evaluations: options.evaluations,
        };
        let bobyqa = match options.on_costs {
            LocalMethod::Bobyqa => Some(bobyqa(d, limits)?),
            // There is nothing to search, which the others would find out by dividing by it.
            _ if d == 0 => return None,
            _ => None,
        };
        // Capacity 0: each side waits until the other has taken what it hands over.
        let (ask, questions) = sync_channel::<Vec<f64>>(0);
        let (answers, told) = sync_channel::<f64>(0);
        let method = options.on_costs;
        let work = move || {
            let objective = |point: &[f64]| match ask.send(point.to_vec()) {
                Ok(()) => told.recv().unwrap_or(ABANDON),
                Err(_) => ABANDON,
            };
            match (bobyqa, method) {
                (Some(mut solver), _) => {
                    let (lower, upper) = (vec![0.0; d], vec![1.0; d]);
                    solver.minimize(objective, &mut x, &lower, &upper);
                }
                (None, LocalMethod::Pattern) => descent::pattern(objective, &x, limits),
                (None, _) => descent::nelder_mead(objective, &x, limits),
            }
        };
        let thread = std::thread::Builder::new().name("local search".into()).spawn(work).ok()?;
        Some(Self { questions, answers, thread })
    }
}

fn bobyqa(d: usize, limits: DescentLimits) -> Option<Bobyqa> {
    let mut config = Config::new(d);
    config.rho_begin = limits.radius;
    config.rho_end = limits.radius_end;
    config.f_target = TARGET;
    config.max_fun = limits.evaluations.max(config.npt + 1);
    Bobyqa::new(d, config).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(start: Vec<f64>, cost: impl Fn(&[f64]) -> f64) -> (TrustRegion, usize) {
        let mut run = TrustRegion::new(&LocalOptions::default(), &Candidate(start));
        let mut evaluations = 0;
        while let Some(candidate) = run.propose() {
            evaluations += 1;
            run.digest(Cost::new(cost(&candidate.0)));
        }
        (run, evaluations)
    }

    #[test]
    fn a_quadratic_with_an_active_bound_is_solved() {
        let (run, evaluations) = run(vec![0.5, 0.5, 0.5], |x| {
            (x[0] - 0.3).powi(2) + (x[1] + 0.4).powi(2) + 2.0 * (x[2] - x[0]).powi(2)
        });
        let (at, cost) = run.place();
        assert!((cost.value() - 0.16).abs() < 1e-12 && at[1] == 0.0 && (at[0] - 0.3).abs() < 1e-6, "{at:?}");
        assert!(evaluations < 200, "{evaluations}");
    }

    #[test]
    fn one_dimension_and_divergence_are_survived() {
        let (one, _) = run(vec![0.9], |x| (x[0] - 0.2).powi(2));
        assert!(one.place().1.value() < 1e-12);
        let (diverged, _) = run(vec![0.9, 0.1], |_| f64::NAN);
        assert_eq!(diverged.place().1, Cost::Diverged);
    }

    #[test]
    fn dropping_a_run_in_the_middle_ends_its_thread() {
        for answered in 0..20 {
            let mut run = TrustRegion::new(&LocalOptions::default(), &Candidate(vec![0.4; 4]));
            for _ in 0..answered {
                run.digest(Cost::new(1.0));
            }
            // A thread that did not end would hang the join in here.
            drop(run);
        }
    }
}
