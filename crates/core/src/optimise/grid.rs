//! The zooming grid of thesis section 5.2: the baseline that knows no chance.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::budget::Strategy;
use super::search::Search;
use super::{Ask, Candidate, Cost, Evaluation, Termination};

/// Points that are asked for together: a grid in many dimensions does not fit into memory.
const BATCH: usize = 512;

/// The hyperparameters of the zooming grid; the defaults are those of Tables 5.2 and 5.3 in 5 dimensions.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields, default)]
pub struct GridOptions {
    /// Points per dimension, ends included.
    pub points: usize,
    /// How often the grid is laid out.
    pub iterations: usize,
    /// Most of the width of a grid that the next one keeps. Two steps of the grid are kept where that is
    /// less.
    pub shrink: f64,
}

impl Default for GridOptions {
    fn default() -> Self {
        Self { points: 7, iterations: 6, shrink: 0.5 }
    }
}

/// The grid between two batches.
#[derive(Debug)]
pub struct GridSearch {
    options: GridOptions,
    /// The lowest corner of the grid, and its width.
    corner: Vec<f64>,
    width: f64,
    /// The place of the next point on the grid, along each dimension; none when the grid is done.
    next: Option<Vec<usize>>,
    best: Option<(Candidate, Cost)>,
    iteration: usize,
    /// Known places, which are asked for first.
    warm: Vec<Candidate>,
}

impl GridSearch {
    /// The first grid spans the cube.
    pub fn new(options: GridOptions, search: &Search) -> Self {
        Self {
            corner: vec![0.0; search.dimensions],
            width: 1.0,
            next: Some(vec![0; search.dimensions]),
            best: None,
            iteration: 0,
            warm: search.warm_starts(),
            options,
        }
    }

    fn points(&self) -> usize {
        self.options.points.max(2)
    }

    fn at(&self, places: &[usize]) -> Candidate {
        let step = self.width / (self.points() - 1) as f64;
        // What lies outside of the cube is brought to its edge.
        let along = |(place, corner): (&usize, &f64)| (corner + step * *place as f64).clamp(0.0, 1.0);
        Candidate(places.iter().zip(&self.corner).map(along).collect())
    }

    /// Counts up by one, the first dimension fastest.
    fn advance(&self, mut places: Vec<usize>) -> Option<Vec<usize>> {
        for place in &mut places {
            *place += 1;
            if *place < self.points() {
                return Some(places);
            }
            *place = 0;
        }
        None
    }

    /// A smaller grid around the best point.
    fn zoom(&mut self) {
        self.iteration += 1;
        let two_steps = 2.0 / (self.points() - 1) as f64;
        self.width *= two_steps.min(self.options.shrink);
        if let Some((best, _)) = &self.best {
            let width = self.width;
            self.corner = best.0.iter().map(|x| x - width / 2.0).collect();
        }
        self.next = Some(vec![0; self.corner.len()]);
    }
}

impl Strategy for GridSearch {
    fn propose(&mut self) -> Ask {
        if !self.warm.is_empty() {
            return Ask::Costs(std::mem::take(&mut self.warm));
        }
        if self.next.is_none() {
            self.zoom();
        }
        if self.iteration >= self.options.iterations.max(1) {
            return Ask::Done(Termination::Budget);
        }
        let mut batch = Vec::new();
        while let Some(places) = self.next.take() {
            batch.push(self.at(&places));
            self.next = self.advance(places);
            if batch.len() == BATCH {
                break;
            }
        }
        Ask::Costs(batch)
    }

    fn digest(&mut self, candidates: &[Candidate], answers: &[Evaluation]) {
        for (candidate, answer) in candidates.iter().zip(answers) {
            if self.best.as_ref().is_none_or(|(_, cost)| answer.cost < *cost) {
                self.best = Some((candidate.clone(), answer.cost));
            }
        }
    }

    fn generation(&self) -> usize {
        self.iteration
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::optimise::functions::{Function, drive};
    use crate::optimise::method::Method;

    fn run(function: Function, dimensions: usize, options: GridOptions) -> (f64, usize) {
        let search = Search { dimensions, seed: 1, budget: 200_000, warm: Vec::new(), residuals: false };
        let run = drive(Method::Grid(options).optimiser(search).as_mut(), |x| function.cost(x));
        (run.best.value(), run.evaluations)
    }

    #[test]
    fn every_point_is_asked_once_and_the_box_shrinks_around_the_best() {
        let options = GridOptions { points: 3, iterations: 1, shrink: 0.5 };
        let search = Search { dimensions: 2, seed: 1, budget: 100, warm: Vec::new(), residuals: false };
        let mut seen = Vec::new();
        let mut grid = GridSearch::new(options, &search);
        if let Ask::Costs(batch) = grid.propose() {
            seen = batch.into_iter().map(|candidate| candidate.0).collect();
        }
        let expected: Vec<Vec<f64>> =
            [0.0, 0.5, 1.0].iter().flat_map(|y| [0.0, 0.5, 1.0].map(|x| vec![x, *y])).collect();
        assert_eq!(seen, expected);
        let (error, evaluations) =
            run(Function::Rosenbrock, 2, GridOptions { points: 5, iterations: 12, shrink: 0.5 });
        assert_eq!(evaluations, 12 * 25);
        assert!(error < 1.0, "{error}");
    }

    /// The errors are those of an independent implementation. Section 5.4.3: a point at the centre wins on
    /// Ackley's function, and zooming into a wrong basin loses on Schwefel's.
    #[test]
    fn the_grid_does_what_the_thesis_says_of_it() {
        let (ackley, evaluations) = run(Function::Ackley, 5, GridOptions::default());
        assert!(ackley < 1e-14, "{ackley:e}");
        assert_eq!(evaluations, 6 * 7usize.pow(5));
        let (schwefel, _) =
            run(Function::Schwefel, 5, GridOptions { points: 5, iterations: 10, shrink: 0.5 });
        assert_eq!(schwefel.round(), 1192.0);
        let (wide, evaluations) =
            run(Function::Schwefel, 10, GridOptions { points: 2, iterations: 40, shrink: 0.5 });
        assert_eq!(evaluations, 40 * 1024);
        assert_eq!(wide.round(), 2384.0);
    }
}
