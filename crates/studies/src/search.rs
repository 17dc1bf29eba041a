//! One search by itself on an estimation problem: what it found, and after how many simulations.

use lampyris_core::estimate::Problem;
use lampyris_core::optimise::{Ask, Candidate, Cost, Method, Search, Space};
use std::time::Instant;

/// Cost and evaluations at each improvement of a search, where it ended, and its wall time.
#[derive(Debug)]
pub struct Path {
    pub improvements: Vec<(usize, f64)>,
    /// The best parameters in the model's order; none where every candidate diverged.
    pub best: Option<Vec<f64>>,
    /// Single-candidate simulations of the whole search.
    pub evaluations: usize,
    pub seconds: f64,
}

impl Path {
    pub fn cost(&self) -> f64 {
        self.improvements.last().map_or(f64::INFINITY, |(_, cost)| *cost)
    }

    /// Evaluations until the target was met.
    pub fn reach(&self, target: f64) -> Option<usize> {
        self.improvements.iter().find(|(_, cost)| *cost <= target).map(|(evaluations, _)| *evaluations)
    }

    /// The best cost after so many evaluations.
    pub fn after(&self, evaluations: usize) -> f64 {
        let before = self.improvements.partition_point(|(at, _)| *at <= evaluations);
        before.checked_sub(1).map_or(f64::INFINITY, |last| self.improvements[last].1)
    }
}

/// A method by itself, without what an estimation adds: no start at nominal values, no polish, no finer
/// steps.
pub fn path(problem: &Problem, method: &Method, seed: u64, budget: usize) -> Path {
    path_in(problem, problem.space(), method, true, seed, budget)
}

/// The same in another box of the same parameters, and from costs alone where there are to be no residuals.
pub fn path_in(
    problem: &Problem,
    space: &Space,
    method: &Method,
    residuals: bool,
    seed: u64,
    budget: usize,
) -> Path {
    let start = Instant::now();
    // No warm start: a first fit has none but the nominal values, and those are not the question here.
    let search = Search { dimensions: space.len(), seed, budget, warm: Vec::new(), residuals };
    let mut optimiser = method.optimiser(search);
    let here = |candidate: &Candidate| {
        if space == problem.space() {
            candidate.clone()
        } else {
            problem.space().candidate(&space.theta(candidate))
        }
    };
    let answer = |candidates: &[Candidate], wanted| {
        problem.evaluate(&candidates.iter().map(here).collect::<Vec<_>>(), wanted)
    };
    let (mut evaluations, mut improvements) = (0, Vec::new());
    loop {
        let answers = match optimiser.ask() {
            Ask::Costs(candidates) | Ask::Slopes(candidates) => answer(&candidates, false),
            Ask::Residuals(candidates) => answer(&candidates, true),
            Ask::Done(_) => break,
        };
        evaluations += answers.len();
        optimiser.tell(&answers);
        if let Some((_, Cost::Finite(cost))) = optimiser.best()
            && improvements.last().is_none_or(|(_, best)| cost < *best)
        {
            improvements.push((evaluations, cost));
        }
    }
    let best = optimiser
        .best()
        .filter(|(_, cost)| *cost != Cost::Diverged)
        .map(|(best, _)| problem.theta(&here(best)));
    Path { improvements, best, evaluations, seconds: start.elapsed().as_secs_f64() }
}
