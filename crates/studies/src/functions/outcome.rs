//! The runs of a method on a function, and their figures.

use super::super::quantile::quantile;
use super::methods::{Case, Entry};
use lampyris_core::optimise::{Ask, Cost, Evaluation, Method, Search};

/// Places of a convergence curve, even over the budget.
pub const PLACES: usize = 200;

/// One run of one method on one function.
pub struct Run {
    pub best: f64,
    pub evaluations: usize,
    /// Evaluations until the function's tolerance was met.
    pub reached: Option<usize>,
    /// The best cost so far at each place of the curve (eq 5.1).
    pub curve: Vec<f64>,
}

/// The runs of one method on one function.
pub struct Outcome {
    pub case: &'static Case,
    pub entry: Entry,
    pub runs: Vec<Run>,
}

/// Runs a method on a function.
pub fn one(case: &Case, method: &Method, seed: u64) -> Run {
    let search =
        Search { dimensions: case.dimensions, seed, budget: case.budget, warm: Vec::new(), residuals: false };
    let mut optimiser = method.optimiser(search);
    let mut run =
        Run { best: f64::INFINITY, evaluations: 0, reached: None, curve: Vec::with_capacity(PLACES) };
    while let Ask::Costs(batch) | Ask::Residuals(batch) = optimiser.ask() {
        let mut answers = Vec::with_capacity(batch.len());
        for candidate in &batch {
            let cost = case.function.cost(&candidate.0);
            run.evaluations += 1;
            run.best = run.best.min(cost);
            if run.best <= case.within && run.reached.is_none() {
                run.reached = Some(run.evaluations);
            }
            while run.curve.len() < PLACES && run.evaluations * PLACES >= case.budget * (run.curve.len() + 1)
            {
                run.curve.push(run.best);
            }
            answers.push(Evaluation { cost: Cost::new(cost), residuals: Vec::new(), slope: None });
        }
        optimiser.tell(&answers);
    }
    // A search that has ended keeps what it found.
    run.curve.resize(PLACES, run.best);
    run
}

/// The figures of one method on one function.
pub struct Figures {
    pub mean: f64,
    pub quartiles: [f64; 3],
    pub success: f64,
    pub evaluations: f64,
    pub reached: Option<f64>,
}

impl Outcome {
    pub fn figures(&self) -> Figures {
        let sorted = |mut values: Vec<f64>| {
            values.sort_by(f64::total_cmp);
            values
        };
        let best = sorted(self.runs.iter().map(|run| run.best).collect());
        let reached = sorted(self.runs.iter().filter_map(|run| run.reached).map(|n| n as f64).collect());
        let evaluations = sorted(self.runs.iter().map(|run| run.evaluations as f64).collect());
        Figures {
            mean: best.iter().sum::<f64>() / best.len() as f64,
            quartiles: [0.25, 0.5, 0.75].map(|share| quantile(&best, share)),
            success: reached.len() as f64 / best.len() as f64,
            evaluations: quantile(&evaluations, 0.5),
            reached: (!reached.is_empty()).then(|| quantile(&reached, 0.5)),
        }
    }
}

/// The heads of a table of methods.
pub const HEAD: [&str; 9] = [
    "method",
    "mean error",
    "quartile",
    "median",
    "quartile",
    "success",
    "evaluations",
    "to reach it",
    "what it is",
];

pub fn cells(outcome: &Outcome) -> Vec<String> {
    let figures = outcome.figures();
    let error = |value: f64| {
        if (1e-2..1e5).contains(&value) { format!("{value:.3}") } else { format!("{value:.1e}") }
    };
    vec![
        outcome.entry.name.to_owned(),
        error(figures.mean),
        error(figures.quartiles[0]),
        error(figures.quartiles[1]),
        error(figures.quartiles[2]),
        format!("{:.0} %", 100.0 * figures.success),
        format!("{:.0}", figures.evaluations),
        figures.reached.map_or_else(|| "-".to_owned(), |n| format!("{n:.0}")),
        outcome.entry.reading.to_owned(),
    ]
}
