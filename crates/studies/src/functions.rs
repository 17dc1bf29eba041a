//! Chapter 5 of the thesis in public: three functions in two sizes, the thesis's algorithms with its settings, the default search
//! and its rivals at the same budgets.

mod figures;
pub(super) mod methods;
mod page;

use super::options::{Csv, Html, Seeds};
use super::{Row, write};
use lampyris::cli::{Failure, print};
use lampyris_core::optimise::functions::Function;
use lampyris_core::optimise::{Ask, Cost, Evaluation, Method, Search};
use methods::{CASES, Case, Entry, entries};
use rayon::prelude::*;
use std::fmt::Write;

/// Places of a convergence curve, even over the budget.
const PLACES: usize = 200;

/// One run of one method on one function.
pub(super) struct Run {
    pub best: f64,
    pub evaluations: usize,
    /// Evaluations until the function's tolerance was met.
    reached: Option<usize>,
    /// The best cost so far at each place of the curve (eq 5.1).
    curve: Vec<f64>,
}

/// The runs of one method on one function.
struct Outcome {
    case: &'static Case,
    entry: Entry,
    runs: Vec<Run>,
}

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    seeds: Seeds,
    #[command(flatten)]
    html: Html,
    #[command(flatten)]
    csv: Csv,
}

/// Runs every method on every function and prints a table of each; writes the page and the runs where files are named.
pub fn run(asked: &Arguments, as_json: bool) -> Result<Vec<Row>, Failure> {
    let (first, seeds) = (asked.seeds.first.seed, asked.seeds.seeds);
    let mut outcomes = Vec::new();
    for case in &CASES {
        for entry in entries(case) {
            // Chance has no part in a grid.
            let seeds = if matches!(entry.method, Method::Grid(_)) { 1 } else { seeds };
            let runs = (first..first + seeds).into_par_iter().map(|seed| one(case, &entry.method, seed)).collect();
            outcomes.push(Outcome { case, entry, runs });
        }
        if !as_json {
            print(&format!("{}\n", text(case, &outcomes)));
        }
    }
    let claims = figures::claims(&outcomes);
    if !as_json {
        print("What section 5.4 of the thesis says, on these seeds:");
        claims.iter().for_each(|claim| print(&format!("  {} {}", if claim.holds { "holds        " } else { "does not hold" }, claim.text)));
        print("");
    }
    if let Some(file) = &asked.csv.csv {
        write(file, &listed(first, &outcomes))?;
    }
    if let Some(file) = &asked.html.html {
        write(file, &page::document(first, &outcomes, &claims)?)?;
    }
    Ok(figures::rows(&outcomes))
}

pub(super) fn one(case: &Case, method: &Method, seed: u64) -> Run {
    let search = Search { dimensions: case.dimensions, seed, budget: case.budget, warm: Vec::new(), residuals: false };
    let mut optimiser = method.optimiser(search);
    let mut run = Run { best: f64::INFINITY, evaluations: 0, reached: None, curve: Vec::with_capacity(PLACES) };
    while let Ask::Costs(batch) | Ask::Residuals(batch) = optimiser.ask() {
        let mut answers = Vec::with_capacity(batch.len());
        for candidate in &batch {
            let cost = case.function.cost(&candidate.0);
            run.evaluations += 1;
            run.best = run.best.min(cost);
            if run.best <= case.within && run.reached.is_none() {
                run.reached = Some(run.evaluations);
            }
            while run.curve.len() < PLACES && run.evaluations * PLACES >= case.budget * (run.curve.len() + 1) {
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
struct Figures {
    mean: f64,
    quartiles: [f64; 3],
    success: f64,
    evaluations: f64,
    reached: Option<f64>,
}

impl Outcome {
    fn figures(&self) -> Figures {
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

/// Of sorted values, between neighbours.
pub(super) fn quantile(sorted: &[f64], share: f64) -> f64 {
    let place = share * (sorted.len() - 1) as f64;
    let (low, high) = (sorted[place.floor() as usize], sorted[place.ceil() as usize]);
    // Two infinities have no difference.
    if low == high { low } else { low + (high - low) * place.fract() }
}

const HEAD: [&str; 9] = ["method", "mean error", "quartile", "median", "quartile", "success", "evaluations", "to reach it", "what it is"];

fn cells(outcome: &Outcome) -> Vec<String> {
    let figures = outcome.figures();
    let error = |value: f64| if (1e-2..1e5).contains(&value) { format!("{value:.3}") } else { format!("{value:.1e}") };
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

fn text(case: &Case, outcomes: &[Outcome]) -> String {
    let mut text = format!("{}\n{:<22}", case.title(), HEAD[0]);
    HEAD[1..8].iter().for_each(|title| {
        let _ = write!(text, "{title:>12}");
    });
    for outcome in outcomes.iter().filter(|outcome| outcome.case == case) {
        let cells = cells(outcome);
        let _ = write!(text, "\n{:<22}", cells[0]);
        cells[1..8].iter().for_each(|cell| {
            let _ = write!(text, "{cell:>12}");
        });
    }
    text
}

/// Every run, a line each.
fn listed(first: u64, outcomes: &[Outcome]) -> String {
    let mut text = "function,dimensions,budget,within,method,seed,error,evaluations,evaluations_to_reach\n".to_owned();
    for outcome in outcomes {
        let Case { function, dimensions, budget, within } = outcome.case;
        for (seed, run) in (first..).zip(&outcome.runs) {
            let reached = run.reached.map(|n| n.to_string()).unwrap_or_default();
            let function = name(*function);
            let _ = writeln!(
                text,
                "{function},{dimensions},{budget},{within:e},{},{seed},{:e},{},{reached}",
                outcome.entry.name, run.best, run.evaluations
            );
        }
    }
    text
}

pub(super) fn name(function: Function) -> &'static str {
    match function {
        Function::Schwefel => "Schwefel",
        Function::Rosenbrock => "Rosenbrock",
        Function::Ackley => "Ackley",
    }
}
