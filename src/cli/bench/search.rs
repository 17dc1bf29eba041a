//! How well and how fast the default search fits a week of a room, beside many multi-start runs.

use super::super::Failure;
use super::Row;
use super::engine::week;
use lampyris::estimate::Problem;
use lampyris::optimise::multistart::LmOptions;
use lampyris::optimise::{Ask, Cost, Method, Search};
use std::time::Instant;

/// Seeds of the search per room.
const SEEDS: u64 = 5;
/// Multi-start runs that define the best known cost.
const STARTS: usize = 64;
/// A fit counts when its cost is within this factor of the best known.
const WITHIN: f64 = 1.01;
const BUDGET: usize = 20_000;

/// Cost and evaluations at each improvement of a search, where it ended, and its wall time.
pub struct Path {
    improvements: Vec<(usize, f64)>,
    /// The best parameters in the model's order; none where every candidate diverged.
    pub best: Option<Vec<f64>>,
    /// Single-candidate simulations of the whole search.
    pub evaluations: usize,
    pub seconds: f64,
}

impl Path {
    fn cost(&self) -> f64 {
        self.improvements.last().map_or(f64::INFINITY, |(_, cost)| *cost)
    }

    /// Evaluations until the target was met.
    fn reach(&self, target: f64) -> Option<usize> {
        self.improvements.iter().find(|(_, cost)| *cost <= target).map(|(evaluations, _)| *evaluations)
    }
}

/// A method by itself, without what an estimation adds: no start at nominal values, no polish, no finer steps.
pub fn path(problem: &Problem, method: &Method, seed: u64, budget: usize) -> Path {
    let start = Instant::now();
    // No warm start: a first fit has none but the nominal values, and those are not the question here.
    let search = Search { dimensions: problem.space().len(), seed, budget, warm: Vec::new(), residuals: true };
    let mut optimiser = method.optimiser(search);
    let (mut evaluations, mut improvements) = (0, Vec::new());
    loop {
        let answers = match optimiser.ask() {
            Ask::Costs(candidates) | Ask::Slopes(candidates) => problem.evaluate(&candidates, false),
            Ask::Residuals(candidates) => problem.evaluate(&candidates, true),
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
    let best = optimiser.best().filter(|(_, cost)| *cost != Cost::Diverged).map(|(best, _)| problem.theta(best));
    Path { improvements, best, evaluations, seconds: start.elapsed().as_secs_f64() }
}

pub fn run(first: u64, rooms: u64) -> Result<Vec<Row>, Failure> {
    let (mut reached, mut walls) = (Vec::new(), Vec::new());
    for room in first..first + rooms {
        let (_, problem) = week(room, 30)?;
        let multistart = Method::LmMultistart(LmOptions { starts: STARTS, converge: false, ..LmOptions::default() });
        let mut best = path(&problem, &multistart, 1000 + room, 1_000_000).cost();
        let paths: Vec<Path> = (0..SEEDS).map(|seed| path(&problem, &Method::default(), 100 * room + seed, BUDGET)).collect();
        best = paths.iter().map(Path::cost).fold(best, f64::min);
        reached.extend(paths.iter().map(|path| path.reach(WITHIN * best)));
        walls.extend(paths.iter().map(|path| path.seconds));
    }
    let share = reached.iter().flatten().count() as f64 / reached.len() as f64;
    let mut evaluations: Vec<f64> = reached.iter().map(|reached| reached.map_or(f64::INFINITY, |n| n as f64)).collect();
    let median = |values: &mut Vec<f64>| {
        values.sort_by(f64::total_cmp);
        values[values.len() / 2]
    };
    Ok(vec![
        Row::new(format!("one room-week, {rooms} rooms x {SEEDS} seeds: share within 1 % of the best known"), share, "-").at_least(0.9),
        Row::new("  median evaluations to reach it", median(&mut evaluations), "").at_most(5000.0),
        Row::new("  median wall time of a whole search", median(&mut walls), "s"),
    ])
}
