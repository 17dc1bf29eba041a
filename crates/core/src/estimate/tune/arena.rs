//! The searches of a tuning: settings on windows whose best known cost is found on the way.

use super::super::fit::{Span, TracePoint};
use super::super::problem::Problem;
use super::performance::{Performance, TuningJudgement};
use crate::estimate::problem::request::EstimateRequest;
use crate::estimate::search::control::{Control, EstimateError, Progress};
use crate::estimate::search::drive::{drive, evaluate};
use crate::optimise::cfa_options::CfaOptions;
use crate::optimise::multistart::LmOptions;
use crate::optimise::{Method, Search};

/// Searches of each side on the unseen windows, at least.
const UNSEEN: usize = 20;
/// Runs of least squares from random places that the best known cost of a window begins with.
const STARTS: usize = 16;
/// A search has come to the best known cost when it is within this factor.
const WITHIN: f64 = 1.01;
/// A search that does not come there counts as so many budgets.
const PENALTY: f64 = 3.0;

/// A search that was done.
#[derive(Debug, Clone)]
pub(super) struct Run {
    window: usize,
    trace: Vec<TracePoint>,
    evaluations: usize,
}

/// Where settings are compared: windows with their best known costs.
pub(super) struct Arena<'a> {
    problems: &'a [(Span, Problem)],
    best: Vec<f64>,
    budget: usize,
    seed: u64,
    control: &'a Control<'a>,
    pub(super) spent: usize,
    searches: usize,
}

impl<'a> Arena<'a> {
    pub(super) fn new(
        problems: &'a [(Span, Problem)],
        request: &EstimateRequest,
        control: &'a Control<'a>,
        spent: usize,
    ) -> Result<Self, EstimateError> {
        let best = vec![f64::INFINITY; problems.len()];
        let (budget, seed) = (request.budget.evaluations, request.method.seed);
        let mut arena = Self { problems, best, budget, seed, control, spent, searches: 0 };
        let reference =
            Method::LmMultistart(LmOptions { starts: STARTS, converge: false, ..LmOptions::default() });
        for window in 0..problems.len() {
            arena.search(window, &reference, seed, usize::MAX)?;
        }
        Ok(arena)
    }

    /// The numbered search with these settings: the windows take turns, then the seeds.
    pub(super) fn run(&mut self, options: &CfaOptions, number: usize) -> Result<Run, EstimateError> {
        let (window, turn) = (number % self.problems.len(), number / self.problems.len());
        self.search(
            window,
            &Method::Cfa(options.clone()),
            self.seed.wrapping_add(1 + turn as u64),
            self.budget,
        )
    }

    fn search(
        &mut self,
        window: usize,
        method: &Method,
        seed: u64,
        budget: usize,
    ) -> Result<Run, EstimateError> {
        let problem = &self.problems[window].1;
        let search =
            Search { dimensions: problem.space().len(), seed, budget, warm: Vec::new(), residuals: true };
        let (spent, generation) = (self.spent, self.searches);
        let progress = |progress: &Progress| {
            let evaluations = spent + progress.evaluations;
            (self.control.progress)(&Progress { generation, evaluations, ..Progress::default() });
        };
        let control = Control { interrupt: self.control.interrupt, progress: &progress };
        let found = drive(problem, &|ask, halt| evaluate(problem, ask, halt), method, search, None, &control);
        // A search that was cut short says nothing.
        if let Some(interrupt) = (self.control.interrupt)() {
            return Err(EstimateError::Interrupted(interrupt));
        }
        let run = match found {
            Ok(found) => Run { window, trace: found.trace, evaluations: found.evaluations },
            Err(EstimateError::NothingFinite) => {
                Run { window, trace: Vec::new(), evaluations: budget.min(self.budget) }
            }
            Err(stopped) => return Err(stopped),
        };
        self.best[window] =
            run.trace.last().map_or(self.best[window], |last| last.best.min(self.best[window]));
        (self.spent, self.searches) = (self.spent + run.evaluations, self.searches + 1);
        Ok(run)
    }

    /// Evaluations until a run came within 1 % of the best known.
    fn reach(&self, run: &Run) -> Option<f64> {
        let target = WITHIN * self.best[run.window];
        run.trace.iter().find(|point| point.best <= target).map(|point| point.evaluations as f64)
    }

    /// The logarithm of that, with the penalty.
    pub(super) fn score(&self, run: &Run) -> f64 {
        self.reach(run).unwrap_or(PENALTY * self.budget as f64).ln()
    }

    fn performance(&self, runs: &[Run]) -> Performance {
        let mut reached: Vec<f64> = runs.iter().filter_map(|run| self.reach(run)).collect();
        reached.sort_by(f64::total_cmp);
        Performance {
            within: reached.len() as f64 / runs.len() as f64,
            to_reach: reached.get(reached.len() / 2).copied(),
            evaluations: runs.iter().map(|run| run.evaluations as f64).sum::<f64>() / runs.len() as f64,
        }
    }

    /// Both on every window, in pairs of the same window and seed.
    pub(super) fn judge(
        &mut self,
        before: &CfaOptions,
        tuned: &CfaOptions,
    ) -> Result<TuningJudgement, EstimateError> {
        let searches = UNSEEN.next_multiple_of(self.problems.len());
        let (mut old, mut new) = (Vec::new(), Vec::new());
        for number in 0..searches {
            old.push(self.run(before, number)?);
            new.push(self.run(tuned, number)?);
        }
        let pairs: Vec<f64> =
            old.iter().zip(&new).map(|(old, new)| self.score(new) - self.score(old)).collect();
        Ok(TuningJudgement {
            searches,
            before: self.performance(&old),
            tuned: self.performance(&new),
            ratio: mean(&pairs).exp(),
            fewer: pairs.iter().filter(|difference| **difference < 0.0).count(),
            more: pairs.iter().filter(|difference| **difference > 0.0).count(),
        })
    }
}

/// The mean of some numbers.
pub(super) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}
