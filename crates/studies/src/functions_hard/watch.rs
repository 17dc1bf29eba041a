//! Who counts the evaluations of a search and notes when it has come how near.

use super::task::Landscape;

/// Errors that count as ever better.
pub const TARGETS: [f64; 3] = [1e-1, 1e-3, 1e-6];

/// A landscape under observation.
pub struct Watch<'a> {
    landscape: &'a Landscape,
    budget: usize,
    evaluations: usize,
    reached: [Option<usize>; TARGETS.len()],
}

/// What a search came to.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reached {
    /// Evaluations until each target.
    pub at: [Option<usize>; TARGETS.len()],
    /// Evaluations in all; nobody looks on once the last target is met.
    pub evaluations: usize,
}

impl<'a> Watch<'a> {
    pub fn new(landscape: &'a Landscape, budget: usize) -> Self {
        Self { landscape, budget, evaluations: 0, reached: [None; TARGETS.len()] }
    }

    /// The error at a point of the unit cube.
    pub fn error(&mut self, unit: &[f64]) -> f64 {
        let error = self.landscape.error(unit);
        // A batch that goes beyond the budget is answered, and counts no more.
        if self.evaluations < self.budget {
            self.evaluations += 1;
            for (reached, target) in self.reached.iter_mut().zip(TARGETS) {
                if error <= target && reached.is_none() {
                    *reached = Some(self.evaluations);
                }
            }
        }
        error
    }

    /// Whether all targets are met, or nothing is left.
    pub fn over(&self) -> bool {
        self.evaluations >= self.budget || self.reached[TARGETS.len() - 1].is_some()
    }

    pub fn reached(&self) -> Reached {
        Reached { at: self.reached, evaluations: self.evaluations }
    }
}

/// The expected running time to a target: all evaluations that were spent before it, over the runs that met
/// it (N. Hansen et al., COCO: performance assessment, arXiv:1605.03560); none where none did.
pub fn expected_running_time(runs: &[Reached], target: usize) -> Option<f64> {
    let met = runs.iter().filter(|run| run.at[target].is_some()).count();
    let spent: usize = runs.iter().map(|run| run.at[target].unwrap_or(run.evaluations)).sum();
    (met > 0).then(|| spent as f64 / met as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_that_miss_a_target_are_paid_by_those_that_meet_it() {
        let run = |at, evaluations| Reached { at: [at, None, None], evaluations };
        let runs = [run(Some(100), 500), run(None, 1000), run(Some(300), 700)];
        assert_eq!(expected_running_time(&runs, 0), Some(700.0));
        assert_eq!(expected_running_time(&runs, 1), None);
    }
}
