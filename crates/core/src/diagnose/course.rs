//! How far a diagnosis has come: which effects have been tried, who leads, and what is still to be done.
//!
//! What is still to be done is counted in stages, from which a caller with a clock says how long it will
//! take.

use super::acceptance::LEAST_BIC;
use crate::estimate::problem::predictor::Predictor;
use crate::estimate::{Control, Progress, Trials};
use crate::pace::{Plan, WorkStage};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Free-run error over the noise floor above which the first round probably finds something.
const PROMISING_RHO: f64 = 1.1;
/// How probably a round finds something: of which nothing is known, which promises something, and which does
/// not.
const CHANCE: f64 = 0.5;
const LIKELY: f64 = 0.9;
const UNLIKELY: f64 = 0.1;
/// The same below which a later round is the last one.
const EXPLAINED_RHO: f64 = 1.5;
/// The share of the effects that is usually refitted in the first round, and in a later one.
const REFITTED: [f64; 2] = [0.3, 0.05];
/// The share that is searched from the nominal values where nothing is found without that.
const WIDER: f64 = 0.5;
/// Rounds that usually follow a finding, where more than one may follow and much is left to explain.
const ROUNDS_BEHIND: f64 = 1.3;
/// Restarts of the null model before the gates decide: where nobody was refitted, and most.
const JUDGED: [f64; 2] = [0.3, 3.0];
/// How much more judging and naming take of a model whose ways are cut short, beside its settling: a restart
/// is as far from its end as everything else.
const CUT_SHORT: [f64; 2] = [4.0, 2.0];

/// A diagnosis on its way, in the hands of its caller.
pub struct Course<'a> {
    control: &'a Control<'a>,
    /// Most rounds.
    rounds: usize,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    trials: Trials,
    /// Simulations so far.
    spent: usize,
    /// Refits of this round.
    refits: f64,
    /// How probably somebody passes the gates, while nobody leads.
    chance: f64,
    /// The free-run error of the null model over the noise floor.
    rho: f64,
    /// How probably all effects are searched from the nominal values where nobody passes.
    wider: f64,
    /// What judging after a restart takes, and naming a finding, in units of their stages.
    dear: [f64; 2],
}

impl State {
    /// What judging so many takes.
    fn judging(&self, refits: f64) -> f64 {
        self.dear[0] * refits.clamp(JUDGED[0], JUDGED[1])
    }

    /// So many refits are expected in this round, and what follows them.
    fn expect(&mut self, refits: f64) {
        self.refits = refits;
        self.trials.plan.expect(WorkStage::Begin, refits);
        self.trials.plan.expect(WorkStage::Refit, refits);
        self.trials.plan.expect(WorkStage::Judge, self.judging(refits));
    }

    /// What is left of this round, and what rounds behind it are expected to take.
    fn plan(&self, rounds: usize) -> Plan {
        let chance = match self.trials.gain {
            Some(gain) if gain >= LEAST_BIC => LIKELY,
            Some(_) => UNLIKELY,
            None => self.chance,
        };
        // What the leader leaves to explain decides what comes behind it.
        let rho = self.rho * self.trials.fall.unwrap_or(1.0);
        let behind = match rounds.saturating_sub(self.trials.round.max(1)) {
            0 => 0.0,
            1 => 1.0,
            _ if rho < EXPLAINED_RHO => 1.0,
            _ => ROUNDS_BEHIND,
        };
        let (chance, named) = match self.trials.plan.stage() {
            WorkStage::Name => (1.0, 0.0),
            _ => (chance, chance),
        };
        let refits = REFITTED[1] * self.trials.of as f64;
        let wider = (1.0 - chance) * self.wider;
        let rounds = chance * behind;
        self.trials.plan.and(&[
            (WorkStage::Name, self.dear[1] * (named + chance * (behind - behind.min(1.0)))),
            (WorkStage::Screen, rounds),
            (WorkStage::Begin, rounds * refits),
            (WorkStage::Refit, rounds * refits),
            (WorkStage::Judge, rounds * self.judging(refits)),
            (WorkStage::Restart, wider * WIDER * self.trials.of as f64),
            (WorkStage::Begin, wider * refits),
            (WorkStage::Refit, wider * refits),
            (WorkStage::Judge, wider * self.judging(JUDGED[1])),
        ])
    }
}

impl<'a> Course<'a> {
    /// A diagnosis that begins with so many effects, of so many rounds at most.
    pub fn new(control: &'a Control<'a>, predictor: Predictor, effects: usize, rounds: usize) -> Self {
        let course = Self { control, rounds, state: Mutex::default() };
        course.tell(|state| {
            state.dear = match predictor {
                Predictor::Filtered => [1.0, 1.0],
                Predictor::FreeRun => CUT_SHORT,
            };
            (state.trials.of, state.chance) = (effects, CHANCE);
            state.trials.plan.expect(WorkStage::Fit, 1.0);
            state.trials.plan.enter(WorkStage::Settle, 1.0);
            (state.rho, state.wider) = (f64::INFINITY, CHANCE);
            state.expect(REFITTED[0] * effects as f64);
            state.trials.plan.expect(WorkStage::Screen, 1.0);
        });
        course
    }

    /// Whether the work is to end now.
    pub fn halts(&self) -> bool {
        self.control.halts()
    }

    /// A null model has come to its optima, or another one that was found has.
    pub(super) fn settled(&self, simulations: usize) {
        self.tell(|state| state.spent += simulations);
    }

    /// A round begins with so many effects, at a null model whose free run errs this much over the floor. It
    /// may widen, where it finds nothing, to all of them.
    pub(super) fn round(&self, effects: usize, rho: f64, widens: bool) {
        self.tell(|state| {
            let Trials { round, plan, .. } = std::mem::take(&mut state.trials);
            state.trials = Trials { round: round + 1, of: effects, plan, ..Trials::default() };
            state.chance = if round == 0 && rho >= PROMISING_RHO { LIKELY } else { UNLIKELY };
            state.trials.plan.enter(WorkStage::Screen, 1.0);
            state.rho = rho;
            state.wider = if widens { 1.0 } else { 0.0 };
            state.expect(REFITTED[usize::from(round > 0)] * effects as f64);
        });
    }

    /// All effects are searched now, so that nothing wider follows.
    pub(super) fn widening(&self) {
        self.tell(|state| state.wider = 0.0);
    }

    /// Of the effects so many are still `open`: some are searched from the nominal values, and at least so
    /// many refits follow.
    pub(super) fn restarting(&self, open: usize, restarts: usize, refits: usize) {
        self.enter(WorkStage::Restart, restarts, open, refits);
    }

    /// So many effects are `open`, and go the first part of their way.
    pub(super) fn beginning(&self, open: usize) {
        self.enter(WorkStage::Begin, open, open, open);
    }

    /// They go the rest of it.
    pub(super) fn going_on(&self, open: usize) {
        self.enter(WorkStage::Refit, open, open, open);
    }

    fn enter(&self, stage: WorkStage, units: usize, open: usize, refits: usize) {
        self.tell(|state| {
            state.trials.tried = state.trials.of.saturating_sub(open);
            // The stage before is over with what was expected of it, and not of what begins.
            state.trials.plan.enter(stage, units as f64);
            state.expect(refits as f64);
            if stage == WorkStage::Refit {
                state.trials.plan.expect(WorkStage::Begin, 0.0);
            }
        });
    }

    /// An effect has gone the first part of its way, or a restart has come to its end.
    pub(super) fn step(&self, simulations: usize) {
        self.tell(|state| {
            state.spent += simulations;
            state.trials.plan.step();
        });
    }

    /// An effect has been tried, with so many simulations after the first part of its way, and gains so much
    /// in BIC; `fall` is its error on unseen data over that of the null model.
    pub(super) fn tried(&self, effect: &str, gain: f64, fall: Option<f64>, simulations: usize) {
        self.tell(|state| {
            state.spent += simulations;
            let trials = &mut state.trials;
            trials.plan.step();
            trials.tried = (trials.tried + 1).min(trials.of);
            if gain > trials.gain.unwrap_or(0.0) {
                (trials.gain, trials.fall, trials.leader) = (Some(gain), fall, Some(effect.to_owned()));
            }
        });
    }

    /// The null model goes on from where the best have come to, and the gates decide.
    pub(super) fn judging(&self) {
        self.tell(|state| {
            let judged = state.judging(state.refits);
            state.trials.plan.enter(WorkStage::Judge, judged);
        });
    }

    /// The gates have decided after so many more simulations of the null model.
    pub(super) fn judged(&self, simulations: usize, found: bool) {
        self.tell(|state| {
            state.spent += simulations;
            (state.chance, state.wider) = (f64::from(u8::from(found)), 0.0);
            if !found {
                (state.trials.leader, state.trials.gain, state.trials.fall) = (None, None, None);
            }
        });
    }

    /// What was found is taken in and described.
    pub(super) fn naming(&self) {
        self.tell(|state| {
            let named = state.dear[1];
            state.trials.plan.enter(WorkStage::Name, named);
        });
    }

    fn tell(&self, change: impl FnOnce(&mut State)) {
        let mut state = held(&self.state);
        change(&mut state);
        let trials = Trials { plan: state.plan(self.rounds), ..state.trials.clone() };
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
    use crate::pace::Pace;

    #[test]
    fn a_stage_is_over_with_what_was_expected_of_it() {
        let course = Course::new(&Control::NONE, Predictor::Filtered, 9, 1);
        course.round(9, 1.0, true);
        course.beginning(3);
        (0..3).for_each(|_| course.step(20));
        course.going_on(3);
        (0..3).for_each(|_| course.tried("wind", -4.0, None, 100));
        let mut plan = held(&course.state).trials.plan.clone();
        course.restarting(6, 2, 6);
        // All three refits are done: the six that follow are none of theirs.
        plan.enter(WorkStage::Restart, 2.0);
        let judged = held(&course.state).judging(6.0);
        for (stage, units) in [(WorkStage::Begin, 6.0), (WorkStage::Refit, 6.0), (WorkStage::Judge, judged)] {
            plan.expect(stage, units);
        }
        assert_eq!(held(&course.state).trials.plan, plan);
    }

    #[test]
    fn what_is_left_shrinks_with_what_is_tried_and_grows_with_a_leader() {
        let told: Mutex<Vec<Trials>> = Mutex::default();
        let note = |progress: &Progress| told.lock().unwrap().extend(progress.trials.clone());
        let control = Control { progress: &note, ..Control::NONE };
        let course = Course::new(&control, Predictor::Filtered, 4, 3);
        course.settled(100);
        course.round(4, 1.0, false);
        course.beginning(3);
        (0..3).for_each(|_| course.step(20));
        course.going_on(3);
        course.tried("wind", -4.0, None, 100);
        course.tried("sun", 30.0, Some(0.8), 100);
        course.tried("door", 12.0, Some(0.9), 100);
        course.judging();
        course.judged(100, true);
        course.naming();
        course.settled(100);
        course.round(3, 1.0, false);
        course.beginning(0);
        course.going_on(0);
        course.judging();
        course.judged(0, false);
        let told = told.into_inner().unwrap();
        // A clock that goes on by a second with every event.
        let mut pace = Pace::default();
        let left: Vec<f64> = (1..)
            .zip(&told)
            .map(|(second, trials)| {
                pace.note(f64::from(second), &trials.plan);
                pace.left(f64::from(second)).unwrap()
            })
            .collect();
        let at = |tried: usize| told.iter().rposition(|one| one.round == 1 && one.tried == tried).unwrap();
        let sun = told.iter().position(|one| one.leader.as_deref() == Some("sun")).unwrap();
        assert!(left[sun] > left[sun - 1], "who leads clearly promises another round: {left:?}");
        assert_eq!((told[sun].gain, told[sun].fall, told[sun].tried), (Some(30.0), Some(0.8), 3));
        let last = &told[at(4)];
        assert_eq!((last.of, last.leader.as_deref(), last.gain), (4, Some("sun"), Some(30.0)));
        let end = told.last().unwrap();
        assert_eq!((end.round, end.leader.as_deref(), end.gain), (2, None, None));
        assert!(left.last().unwrap() < &left[sun], "{left:?}");
    }
}
