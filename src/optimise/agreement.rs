//! When restarts have told enough: the convergence rule of the multi-start searches.

use serde::{Deserialize, Serialize};

use super::{Cost, Ended};
use utoipa::ToSchema;

/// Costs closer than this count as equal whatever their ratio: a noise-free fit ends at rounding errors.
const NOTHING: f64 = 1e-10;

/// The convergence rule over successive restarts.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct AgreementOptions {
    /// Largest relative difference between costs that are called the same optimum.
    pub within: f64,
    /// A restart that lowers the best cost by at least this share has brought something new.
    pub improvement: f64,
    /// How many successive restarts have to confirm the one before them.
    pub confirmations: usize,
    /// The search has stalled after this many successive restarts without anything new.
    pub patience: usize,
}

impl Default for AgreementOptions {
    fn default() -> Self {
        Self { within: 5e-3, improvement: 1e-3, confirmations: 1, patience: 8 }
    }
}

/// The optima of the restarts so far.
#[derive(Debug, Clone)]
pub struct Agreement {
    options: AgreementOptions,
    last: Option<Cost>,
    best: Cost,
    confirmed: usize,
    fruitless: usize,
}

impl Agreement {
    /// No restart yet.
    pub fn new(options: AgreementOptions) -> Self {
        Self { options, last: None, best: Cost::Diverged, confirmed: 0, fruitless: 0 }
    }

    /// Takes the optimum of one more restart and says whether the search is over.
    ///
    /// Converged: this restart and the one before reached the same cost, that cost is the best known, and
    /// this one improved on it by next to nothing. Two restarts that share a worse optimum prove nothing.
    pub fn restart(&mut self, optimum: Cost) -> Option<Ended> {
        let before = self.best;
        self.best = self.best.min(optimum);
        let improved = optimum < before && !self.same(optimum, before, self.options.improvement);
        self.fruitless = if improved { 0 } else { self.fruitless + 1 };
        let last = self.last.replace(optimum);
        let agree =
            last.is_some_and(|last| self.same(last, optimum, self.options.within) && self.same(optimum, self.best, self.options.within));
        self.confirmed = if agree && !improved { self.confirmed + 1 } else { 0 };
        if self.confirmed >= self.options.confirmations.max(1) {
            Some(Ended::Converged)
        } else if self.fruitless >= self.options.patience.max(1) {
            Some(Ended::Stalled)
        } else {
            None
        }
    }

    fn same(&self, a: Cost, b: Cost, within: f64) -> bool {
        match (a, b) {
            (Cost::Finite(a), Cost::Finite(b)) => (a - b).abs() <= within * a.abs().max(b.abs()) + NOTHING,
            // Two diverged restarts agree on nothing.
            _ => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdicts(optima: &[f64]) -> Vec<Option<Ended>> {
        let mut agreement = Agreement::new(AgreementOptions { patience: 3, ..AgreementOptions::default() });
        optima.iter().map(|optimum| agreement.restart(Cost::new(*optimum))).collect()
    }

    #[test]
    fn two_successive_restarts_at_the_best_cost_converge() {
        assert_eq!(verdicts(&[2.0, 1.0, 1.004]), [None, None, Some(Ended::Converged)]);
        assert_eq!(verdicts(&[1.0, 0.9995]), [None, Some(Ended::Converged)]);
        assert_eq!(verdicts(&[0.0, 1e-12]), [None, Some(Ended::Converged)]);
    }

    #[test]
    fn agreeing_on_something_worse_or_improving_is_not_convergence() {
        assert_eq!(verdicts(&[1.0, 2.0, 2.0]), [None, None, None]);
        assert_eq!(verdicts(&[1.0, 0.997, 0.994]), [None, None, None]);
    }

    #[test]
    fn more_confirmations_can_be_asked_for() {
        let mut agreement = Agreement::new(AgreementOptions { confirmations: 2, ..AgreementOptions::default() });
        let verdicts = [1.0, 1.0, 1.5, 1.0, 1.0, 1.0].map(|optimum| agreement.restart(Cost::new(optimum)));
        assert_eq!(verdicts, [None, None, None, None, None, Some(Ended::Converged)]);
    }

    #[test]
    fn restarts_that_bring_nothing_stall() {
        assert_eq!(verdicts(&[1.0, 2.0, 3.0, 4.0]), [None, None, None, Some(Ended::Stalled)]);
        assert_eq!(verdicts(&[f64::NAN, f64::NAN, f64::NAN]), [None, None, Some(Ended::Stalled)]);
    }
}
