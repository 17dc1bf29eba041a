//! Chapter 5 of the thesis in public: three functions in two sizes, the thesis's algorithms with its
//! settings, the default search and its rivals at the same budgets.

mod figures;
pub(super) mod methods;
pub(super) mod outcome;
mod page;

use super::file::write;
use super::options::{Csv, Html, Seeds};
use super::row::Row;
use lampyris::cli::{Failure, print};
use lampyris_core::optimise::Method;
use methods::{CASES, Case, entries, name};
use outcome::{HEAD, Outcome, cells, one};
use rayon::prelude::*;
use std::fmt::Write;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    pub seeds: Seeds,
    #[command(flatten)]
    html: Html,
    #[command(flatten)]
    csv: Csv,
}

/// Runs every method on every function and prints a table of each; writes the page and the runs where files
/// are named.
pub fn run(asked: &Arguments, as_json: bool) -> Result<Vec<Row>, Failure> {
    let (first, seeds) = (asked.seeds.first.seed, asked.seeds.seeds);
    let mut outcomes = Vec::new();
    for case in &CASES {
        for entry in entries(case) {
            // Chance has no part in a grid.
            let seeds = if matches!(entry.method, Method::Grid(_)) { 1 } else { seeds };
            let runs =
                (first..first + seeds).into_par_iter().map(|seed| one(case, &entry.method, seed)).collect();
            outcomes.push(Outcome { case, entry, runs });
        }
        if !as_json {
            print(&format!("{}\n", text(case, &outcomes)));
        }
    }
    let claims = figures::claims(&outcomes);
    if !as_json {
        print("What section 5.4 of the thesis says, on these seeds:");
        claims.iter().for_each(|claim| {
            print(&format!(
                "  {} {}",
                if claim.holds { "holds        " } else { "does not hold" },
                claim.text
            ))
        });
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
    let mut text =
        "function,dimensions,budget,within,method,seed,error,evaluations,evaluations_to_reach\n".to_owned();
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
