//! How far a diagnosis has come: which effects have been tried, who leads, and how much of the work is done.
//!
//! Work is counted in simulations, which take nearly all of the time. What is still to come is expected from
//! what the same kind of work has taken so far in this diagnosis.

use super::acceptance::LEAST_BIC;
use crate::estimate::{Control, Progress, Trials};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// What parts of a round take before any of them has been seen, over what it took to bring the null model to
/// its optima: a restart, a refit after its first part, what follows all refits, and a whole round behind one
/// that has found something, with its null model.
const RESTART: f64 = 0.075;
const REFIT: f64 = 0.25;
const JUDGING: f64 = 0.8;
const ROUND: f64 = 1.0;
/// Free-run error over the noise floor above which the first round probably finds something.
const PROMISING_RHO: f64 = 1.1;

/// A diagnosis on its way, in the hands of its caller.
pub struct Course<'a> {
    control: &'a Control<'a>,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    trials: Trials,
    /// What the leader gains in BIC.
    gain: f64,
    /// Simulations so far.
    spent: usize,
    /// Those of the first null model.
    unit: f64,
    restarts: Part,
    refits: Part,
    judged: bool,
    /// Whether another round is expected while nobody leads.
    another: bool,
}

/// Work of one kind in a round.
#[derive(Default)]
struct Part {
    left: usize,
    done: usize,
    simulations: usize,
}

impl Part {
    /// What is left, if one takes so many simulations until the first has been seen.
    fn expected(&self, usual: f64) -> f64 {
        self.left as f64 * (self.simulations as f64 + usual) / (self.done as f64 + 1.0)
    }

    fn step(&mut self, simulations: usize) {
        self.left = self.left.saturating_sub(1);
        self.done += 1;
        self.simulations += simulations;
    }
}

impl State {
    /// The share of all work that is done; nothing is known before the first round begins.
    fn share(&self) -> Option<f64> {
        let judging = if self.judged { 0.0 } else { JUDGING };
        let another = if self.trials.leader.is_some() { self.gain >= LEAST_BIC } else { self.another };
        let fixed = judging + if another { ROUND } else { 0.0 };
        let left = self.restarts.expected(RESTART * self.unit)
            + self.refits.expected(REFIT * self.unit)
            + fixed * self.unit;
        (self.unit > 0.0 && self.trials.round > 0).then(|| self.spent as f64 / (self.spent as f64 + left))
    }
}

impl<'a> Course<'a> {
    /// A diagnosis that begins.
    pub fn new(control: &'a Control<'a>) -> Self {
        let course = Self { control, state: Mutex::default() };
        course.tell(|_| ());
        course
    }

    /// Whether the work is to end now.
    pub fn halts(&self) -> bool {
        self.control.halts()
    }

    /// A null model has come to its optima.
    pub(super) fn settled(&self, simulations: usize) {
        self.tell(|state| {
            state.spent += simulations;
            state.unit = if state.unit > 0.0 { state.unit } else { simulations as f64 };
        });
    }

    /// A round begins with so many effects, at a null model whose free run errs this much over the floor.
    pub(super) fn round(&self, effects: usize, rho: f64) {
        self.tell(|state| {
            let round = state.trials.round + 1;
            state.trials = Trials { round, of: effects, ..Trials::default() };
            (state.restarts, state.refits, state.judged) =
                (Part::default(), Part { left: effects / 2, ..Part::default() }, false);
            (state.gain, state.another) = (0.0, round == 1 && rho >= PROMISING_RHO);
        });
    }

    /// Of the effects so many are still `open`: some are searched from the nominal values, and at least so
    /// many refits follow.
    pub(super) fn open(&self, open: usize, restarts: usize, refits: usize) {
        self.tell(|state| {
            state.trials.tried = state.trials.of.saturating_sub(open);
            (state.restarts.left, state.refits.left) = (restarts, refits);
        });
    }

    /// An effect has gone the first part of its way.
    pub(super) fn begun(&self, simulations: usize) {
        self.tell(|state| state.spent += simulations);
    }

    /// A restart has come to its end.
    pub(super) fn restarted(&self, simulations: usize) {
        self.tell(|state| {
            state.spent += simulations;
            state.restarts.step(simulations);
        });
    }

    /// An effect has been tried, with so many simulations after the first part of its way, and gains so much
    /// in BIC.
    pub(super) fn tried(&self, effect: &str, gain: f64, simulations: usize) {
        self.tell(|state| {
            state.spent += simulations;
            state.refits.step(simulations);
            state.trials.tried = (state.trials.tried + 1).min(state.trials.of);
            if gain > state.gain {
                (state.gain, state.trials.leader) = (gain, Some(effect.to_owned()));
            }
        });
    }

    /// The gates have decided after so many more simulations of the null model.
    pub(super) fn judged(&self, simulations: usize, found: bool) {
        self.tell(|state| {
            state.spent += simulations;
            (state.judged, state.another) = (true, found);
            state.trials.leader = state.trials.leader.take().filter(|_| found);
        });
    }

    fn tell(&self, change: impl FnOnce(&mut State)) {
        let mut state = held(&self.state);
        change(&mut state);
        let trials = Trials { share: state.share(), ..state.trials.clone() };
        // Under the lock, so that nobody hears of less after more.
        (self.control.progress)(&Progress {
            evaluations: state.spent,
            trials: Some(trials),
            ..Progress::default()
        });
    }
}

/// A panic while the lock was held cannot have left the numbers behind it half-changed.
fn held(state: &Mutex<State>) -> MutexGuard<'_, State> {
    state.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_left_is_expected_from_what_was_seen() {
        let told: Mutex<Vec<Trials>> = Mutex::default();
        let note = |progress: &Progress| told.lock().unwrap().extend(progress.trials.clone());
        let control = Control { progress: &note, ..Control::NONE };
        let course = Course::new(&control);
        course.settled(100);
        course.round(4, 1.0);
        course.open(3, 0, 3);
        course.tried("wind", -4.0, 100);
        course.tried("sun", 30.0, 100);
        course.tried("door", 12.0, 100);
        course.judged(100, true);
        course.settled(100);
        course.round(3, 1.0);
        course.open(0, 0, 0);
        course.judged(0, false);
        let mut told = told.into_inner().unwrap();
        assert_eq!(told.remove(0), Trials::default());
        let shares: Vec<f64> = told.iter().filter_map(|trials| trials.share).collect();
        assert_eq!(told[0].share, None, "settled, and no round yet");
        // Two refits and the judging to come.
        assert!((shares[0] - 100.0 / (100.0 + 50.0 + 80.0)).abs() < 1e-9, "{shares:?}");
        // One refit of a hundred and the usual 25 make 62.5 for each of the two left.
        assert!((shares[2] - 200.0 / (200.0 + 125.0 + 80.0)).abs() < 1e-9, "{shares:?}");
        // Who leads clearly promises another round.
        assert!((shares[3] - 300.0 / (300.0 + 225.0 / 3.0 + 80.0 + 100.0)).abs() < 1e-9, "{shares:?}");
        assert_eq!((told[4].tried, told[4].of, told[4].leader.as_deref()), (3, 4, Some("sun")));
        assert_eq!((told[5].tried, told[5].leader.as_deref()), (4, Some("sun")));
        assert_eq!(told.last().map(|trials| (trials.round, trials.share)), Some((2, Some(1.0))));
    }
}
