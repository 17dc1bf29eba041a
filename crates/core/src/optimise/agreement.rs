//! When restarts have told enough: the convergence rule of the multi-start searches.

use serde::{Deserialize, Serialize};

use super::{Candidate, Cost, Termination};
use utoipa::ToSchema;

/// Costs closer than this count as equal whatever their ratio: a noise-free fit ends at rounding errors.
const NOTHING: f64 = 1e-10;

/// Places closer than this in every coordinate of the unit cube are one place, whatever the ratio of their
/// costs: at the tip of a cusp the last digits of the place are the first ones of the cost.
const ONE_PLACE: f64 = 1e-6;

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
    last: Option<(Candidate, Cost)>,
    best: Option<(Candidate, Cost)>,
    confirmed: usize,
    fruitless: usize,
}

impl Agreement {
    /// No restart yet.
    pub fn new(options: AgreementOptions) -> Self {
        Self { options, last: None, best: None, confirmed: 0, fruitless: 0 }
    }

    /// Whether an optimum is as good as the best known, or better.
    pub fn rivals(&self, found: &(Candidate, Cost)) -> bool {
        let known = self.best.as_ref();
        found.1 != Cost::Diverged
            && known.is_none_or(|best| found.1 < best.1 || same(found, best, self.options.within))
    }

    /// Takes the optimum of one more restart, or that it found none, and says whether the search is over.
    ///
    /// Converged: this restart and the one before reached the same cost or the same place, that is the best
    /// known, and this one improved on it by next to nothing. Two restarts that share a worse optimum prove
    /// nothing.
    pub fn restart(&mut self, optimum: Option<(Candidate, Cost)>) -> Option<Termination> {
        let found = optimum.filter(|(_, cost)| *cost != Cost::Diverged);
        let improved = match (&found, &self.best) {
            (Some(found), Some(best)) => found.1 < best.1 && !same(found, best, self.options.improvement),
            (found, _) => found.is_some(),
        };
        self.fruitless = if improved { 0 } else { self.fruitless + 1 };
        if found.as_ref().is_some_and(|found| self.best.as_ref().is_none_or(|best| found.1 < best.1)) {
            self.best.clone_from(&found);
        }
        let agrees = |with: &Option<(Candidate, Cost)>| {
            found.as_ref().zip(with.as_ref()).is_some_and(|(a, b)| same(a, b, self.options.within))
        };
        let agree = agrees(&self.last) && agrees(&self.best);
        self.last = found;
        self.confirmed = if agree && !improved { self.confirmed + 1 } else { 0 };
        if self.confirmed >= self.options.confirmations.max(1) {
            Some(Termination::Converged)
        } else if self.fruitless >= self.options.patience.max(1) {
            Some(Termination::Stalled)
        } else {
            None
        }
    }
}

/// Whether two optima are one, up to a share of the larger cost.
fn same(a: &(Candidate, Cost), b: &(Candidate, Cost), within: f64) -> bool {
    let (one, other) = (a.1.value(), b.1.value());
    let near = |(a, b): (&f64, &f64)| (a - b).abs() < ONE_PLACE;
    (one - other).abs() <= within * one.abs().max(other.abs()) + NOTHING || a.0.0.iter().zip(&b.0.0).all(near)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn verdicts(optima: &[f64]) -> Vec<Option<Termination>> {
        let mut agreement = Agreement::new(AgreementOptions { patience: 3, ..AgreementOptions::default() });
        optima
            .iter()
            .enumerate()
            .map(|(index, optimum)| agreement.restart(Some(at(index as f64, *optimum))))
            .collect()
    }

    fn at(place: f64, cost: f64) -> (Candidate, Cost) {
        (Candidate(vec![place, 0.5]), Cost::new(cost))
    }

    #[test]
    fn one_place_is_one_optimum_whatever_its_last_digits_cost() {
        let mut agreement = Agreement::new(AgreementOptions::default());
        assert_eq!(agreement.restart(Some(at(0.5, 9e-8))), None);
        assert_eq!(agreement.restart(Some(at(0.5 + 1e-9, 5e-8))), Some(Termination::Converged));
        let mut agreement = Agreement::new(AgreementOptions::default());
        assert_eq!(agreement.restart(Some(at(0.5, 9e-8))), None);
        assert_eq!(agreement.restart(Some(at(0.5 + 1e-5, 5e-8))), None);
        assert_eq!(agreement.restart(None), None);
    }

    #[test]
    fn two_successive_restarts_at_the_best_cost_converge() {
        assert_eq!(verdicts(&[2.0, 1.0, 1.004]), [None, None, Some(Termination::Converged)]);
        assert_eq!(verdicts(&[1.0, 0.9995]), [None, Some(Termination::Converged)]);
        assert_eq!(verdicts(&[0.0, 1e-12]), [None, Some(Termination::Converged)]);
    }

    #[test]
    fn agreeing_on_something_worse_or_improving_is_not_convergence() {
        assert_eq!(verdicts(&[1.0, 2.0, 2.0]), [None, None, None]);
        assert_eq!(verdicts(&[1.0, 0.997, 0.994]), [None, None, None]);
    }

    #[test]
    fn more_confirmations_can_be_asked_for() {
        let mut agreement =
            Agreement::new(AgreementOptions { confirmations: 2, ..AgreementOptions::default() });
        let verdicts = [1.0, 1.0, 1.5, 1.0, 1.0, 1.0].map(|cost| agreement.restart(Some(at(cost, cost))));
        assert_eq!(verdicts, [None, None, None, None, None, Some(Termination::Converged)]);
    }

    #[test]
    fn restarts_that_bring_nothing_stall() {
        assert_eq!(verdicts(&[1.0, 2.0, 3.0, 4.0]), [None, None, None, Some(Termination::Stalled)]);
        assert_eq!(verdicts(&[f64::NAN, f64::NAN, f64::NAN]), [None, None, Some(Termination::Stalled)]);
    }
}
