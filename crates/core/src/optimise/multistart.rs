//! Levenberg-Marquardt from many starts: the plain rival of the swarm, and the better one on smooth problems.

use rand::RngExt;
use serde::{Deserialize, Serialize};

use super::agreement::{Agreement, AgreementOptions};
use super::budget::Strategy;
use super::firefly::stream;
use super::local::{LocalStage, LocalWay};
use super::local_options::LocalOptions;
use super::search::Search;
use super::{Ask, Candidate, Evaluation, Termination};
use utoipa::ToSchema;

/// The hyperparameters of the multi-start search.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LmOptions {
    /// Starts, in a Latin hypercube. Warm starts come before them and are counted.
    pub starts: usize,
    /// Runs that advance side by side; together they are one restart.
    pub lockstep: usize,
    /// Whether the search ends when restarts agree; otherwise it runs from every start.
    pub converge: bool,
    /// The local runs.
    pub local: LocalOptions,
    /// When restarts have told enough.
    pub agreement: AgreementOptions,
}

impl Default for LmOptions {
    fn default() -> Self {
        Self {
            starts: 200,
            lockstep: 4,
            converge: true,
            local: LocalOptions::default(),
            agreement: AgreementOptions::default(),
        }
    }
}

/// The multi-start search between two batches.
#[derive(Debug)]
pub struct LmMultistart {
    options: LmOptions,
    way: LocalWay,
    /// The starts that are left, the next one last.
    starts: Vec<Candidate>,
    stage: LocalStage,
    agreement: Agreement,
    restarts: usize,
    ended: Option<Termination>,
}

impl LmMultistart {
    /// Warm starts first, then the Latin hypercube.
    pub fn new(options: LmOptions, search: &Search) -> Self {
        let mut starts = search.warm_starts();
        let drawn = options.starts.max(1).saturating_sub(starts.len());
        starts.extend(latin_hypercube(drawn, search.dimensions, search.seed));
        starts.reverse();
        let way = LocalWay::on_residuals(&options.local, search.residuals);
        let mut multistart = Self {
            starts,
            stage: LocalStage::new(&way, &[]),
            way,
            agreement: Agreement::new(options.agreement),
            restarts: 0,
            ended: None,
            options,
        };
        multistart.next_group();
        multistart
    }

    fn next_group(&mut self) {
        let keep = self.starts.len().saturating_sub(self.options.lockstep.max(1));
        let mut group = self.starts.split_off(keep);
        group.reverse();
        self.stage = LocalStage::new(&self.way, &group);
    }

    /// A group is at its optima.
    fn restart(&mut self) -> Option<Termination> {
        self.restarts += 1;
        let verdict = self.agreement.restart(self.stage.optimum());
        if self.options.converge && verdict.is_some() {
            verdict
        } else if self.starts.is_empty() {
            // Every start is used up, and the restarts never came to agree.
            Some(Termination::Stalled)
        } else {
            None
        }
    }
}

impl Strategy for LmMultistart {
    fn propose(&mut self) -> Ask {
        loop {
            if let Some(ended) = self.ended {
                return Ask::Done(ended);
            }
            if let Some(ask) = self.stage.propose() {
                return ask;
            }
            self.ended = self.restart();
            if self.ended.is_none() {
                self.next_group();
            }
        }
    }

    fn digest(&mut self, _candidates: &[Candidate], answers: &[Evaluation]) {
        self.stage.digest(answers);
    }

    fn generation(&self) -> usize {
        self.restarts
    }
}

/// `count` points of which each coordinate has one in every `count`-th part of its interval.
pub fn latin_hypercube(count: usize, dimensions: usize, seed: u64) -> Vec<Candidate> {
    let mut stream = stream(seed, 0);
    let mut points = vec![Vec::with_capacity(dimensions); count];
    for _ in 0..dimensions {
        let mut cells: Vec<usize> = (0..count).collect();
        for (drawn, point) in points.iter_mut().enumerate() {
            cells.swap(drawn, stream.random_range(drawn..count));
            point.push((cells[drawn] as f64 + stream.random::<f64>()) / count as f64);
        }
    }
    points.into_iter().map(Candidate).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optimise::Cost;
    use crate::optimise::functions::{DrivenRun, drive, drive_residuals, rosenbrock_residuals};
    use crate::optimise::method::Method;

    fn run(options: &LmOptions, search: Search) -> DrivenRun {
        drive_residuals(
            Method::LmMultistart(options.clone()).optimiser(search).as_mut(),
            rosenbrock_residuals,
        )
    }

    fn search(seed: u64, budget: usize) -> Search {
        Search { dimensions: 5, seed, budget, warm: Vec::new(), residuals: true }
    }

    #[test]
    fn every_part_of_every_interval_has_its_point() {
        let points = latin_hypercube(16, 3, 9);
        for coordinate in 0..3 {
            let mut cells: Vec<usize> =
                points.iter().map(|point| (point.0[coordinate] * 16.0) as usize).collect();
            cells.sort_unstable();
            assert_eq!(cells, (0..16).collect::<Vec<_>>());
        }
    }

    #[test]
    fn restarts_agree_on_rosenbrock_and_the_seed_fixes_the_run() {
        let first = run(&LmOptions::default(), search(4, 50_000));
        assert_eq!(first.ended, Termination::Converged);
        assert!(first.best.value() < 1e-12, "{first:?}");
        assert_eq!(first, run(&LmOptions::default(), search(4, 50_000)));
        assert_eq!((first.evaluations, first.batches), GOLDEN);
    }

    /// Evaluations and batches until the restarts agree.
    const GOLDEN: (usize, usize) = (1917, 189);

    #[test]
    fn without_convergence_every_start_is_used() {
        let all =
            run(&LmOptions { converge: false, starts: 10, ..LmOptions::default() }, search(4, 1_000_000));
        assert_eq!(all.ended, Termination::Stalled);
    }

    #[test]
    fn the_budget_is_never_exceeded_and_divergence_is_survived() {
        for budget in [0, 1, 7, 100, 333] {
            assert_eq!(run(&LmOptions::default(), search(4, budget)).evaluations, budget);
        }
        let mut optimiser = Method::LmMultistart(LmOptions::default()).optimiser(search(4, 1_000_000));
        let run = drive(optimiser.as_mut(), |_| f64::NAN);
        assert_eq!((run.best, run.ended), (Cost::Diverged, Termination::Stalled));
    }
}
