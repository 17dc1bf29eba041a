//! The bookkeeping that every search needs once: the evaluation budget, the pending question, the best so
//! far.
//!
//! A [`Strategy`] proposes batches of any size and never counts; [`Budgeted`] makes an [`Optimiser`] of it.

use std::borrow::Cow;

use super::{Ask, Candidate, Cost, Evaluation, LocalRun, Optimiser, Termination};

/// A search without bookkeeping.
pub trait Strategy: Send {
    /// The next batch. It is called once per answered batch and never returns an empty one.
    fn propose(&mut self) -> Ask;
    /// The answers to the whole batch, in its order. A batch that the budget has cut short is never answered.
    fn digest(&mut self, candidates: &[Candidate], answers: &[Evaluation]);
    /// Generations, restarts or iterations completed.
    fn generation(&self) -> usize;
    /// The local runs so far.
    fn runs(&self) -> Vec<LocalRun> {
        Vec::new()
    }
}

/// A strategy under an evaluation budget.
#[derive(Debug)]
pub struct Budgeted<S> {
    strategy: S,
    left: usize,
    pending: Option<Ask>,
    /// Whether the pending batch lost candidates to the budget.
    cut: bool,
    best: Option<(Candidate, Cost)>,
}

impl<S: Strategy> Budgeted<S> {
    /// The strategy with at most `budget` evaluations.
    pub fn new(strategy: S, budget: usize) -> Self {
        Self { strategy, left: budget, pending: None, cut: false, best: None }
    }
}

impl<S: Strategy> Optimiser for Budgeted<S> {
    fn ask(&mut self) -> Ask {
        if let Some(ask) = &self.pending {
            return ask.clone();
        }
        let mut ask = if self.left == 0 { Ask::Done(Termination::Budget) } else { self.strategy.propose() };
        if let Ask::Costs(batch) | Ask::Residuals(batch) | Ask::Slopes(batch) = &mut ask {
            self.cut = batch.len() > self.left;
            batch.truncate(self.left);
            self.left -= batch.len();
        }
        self.pending = Some(ask.clone());
        ask
    }

    fn tell(&mut self, answers: &[Evaluation]) {
        let batch = match self.pending.take() {
            Some(Ask::Costs(batch) | Ask::Residuals(batch) | Ask::Slopes(batch)) => batch,
            // There was no question, or the search is over and stays so.
            other => {
                self.pending = other;
                return;
            }
        };
        // A missing answer is a candidate that could not be computed.
        let mut answers = Cow::Borrowed(answers);
        if answers.len() != batch.len() {
            answers
                .to_mut()
                .resize(batch.len(), Evaluation { cost: Cost::Diverged, residuals: Vec::new(), slope: None });
        }
        for (candidate, answer) in batch.iter().zip(answers.iter()) {
            if self.best.as_ref().is_none_or(|(_, cost)| answer.cost < *cost) {
                self.best = Some((candidate.clone(), answer.cost));
            }
        }
        if !self.cut {
            self.strategy.digest(&batch, &answers);
        }
    }

    fn best(&self) -> Option<(&Candidate, Cost)> {
        self.best.as_ref().map(|(candidate, cost)| (candidate, *cost))
    }

    fn generation(&self) -> usize {
        self.strategy.generation()
    }

    fn runs(&self) -> Vec<LocalRun> {
        self.strategy.runs()
    }
}
