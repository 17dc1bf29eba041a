//! What the runs say: the limits, and whether the thesis's own claims hold.

use super::super::row::Row;
use super::methods::{CASES, Case, DEFAULT, ENDLESS, GRID, LSHADE, MODIFIED, ORIGINAL, THESIS, name};
use super::outcome::Outcome;
use lampyris_core::optimise::functions::Function;

/// A claim of section 5.4, and whether it holds here.
pub struct Claim {
    pub text: String,
    pub holds: bool,
}

fn of<'a>(outcomes: &'a [Outcome], case: &Case, name: &str) -> impl Iterator<Item = &'a Outcome> {
    let (case, name) = (CASES.iter().find(|known| *known == case), name.to_owned());
    outcomes.iter().filter(move |outcome| Some(outcome.case) == case && outcome.entry.name == name)
}

fn mean(outcomes: &[Outcome], case: &Case, name: &str) -> f64 {
    of(outcomes, case, name).map(|outcome| outcome.figures().mean).next().unwrap_or(f64::NAN)
}

fn median(outcomes: &[Outcome], case: &Case, name: &str) -> f64 {
    of(outcomes, case, name).map(|outcome| outcome.figures().quartiles[1]).next().unwrap_or(f64::NAN)
}

/// Share of the runs of a method that reached the optimum within so many evaluations.
fn success(outcomes: &[Outcome], case: &Case, name: &str, within: usize) -> f64 {
    let share = |outcome: &Outcome| {
        let reached = outcome
            .runs
            .iter()
            .filter(|run| run.reached.is_some_and(|evaluations| evaluations <= within))
            .count();
        reached as f64 / outcome.runs.len() as f64
    };
    of(outcomes, case, name).map(share).next().unwrap_or(f64::NAN)
}

fn short(case: &Case) -> String {
    format!("{} {}", name(case.function), case.dimensions)
}

/// The claims of section 5.4. Where the mean of a hundred runs hangs on one of them (Rosenbrock's function),
/// medians are compared.
pub fn claims(outcomes: &[Outcome]) -> Vec<Claim> {
    let mut claims = Vec::new();
    for case in &CASES {
        let error = |name: &str| {
            if case.function == Function::Rosenbrock {
                median(outcomes, case, name)
            } else {
                mean(outcomes, case, name)
            }
        };
        let (thesis, modified, original, grid) =
            (error(THESIS), error(MODIFIED), error(ORIGINAL), error(GRID));
        let mut claim = |text: String, holds: bool| {
            claims.push(Claim { text: format!("{}: {text}", short(case)), holds })
        };
        claim(
            format!("cFA ({thesis:.2e}) is better than the modified FA ({modified:.2e})"),
            thesis < modified,
        );
        claim(
            format!("the original FA ({original:.2e}) is the worst firefly"),
            original > modified && original > thesis,
        );
        match (case.function, case.dimensions) {
            (Function::Schwefel, _) => {
                claim(
                    format!("every FA is better than the grid ({grid:.2e})"),
                    [thesis, modified, original].iter().all(|error| *error < grid),
                );
            }
            (Function::Ackley, 5) => claim(
                format!("the grid ({grid:.2e}) is the best of all"),
                grid < thesis.min(modified).min(original),
            ),
            _ => claim(format!("cFA is better than the grid ({grid:.2e}) in the end"), thesis < grid),
        }
    }
    claims
}

/// The limits.
pub fn rows(outcomes: &[Outcome]) -> Vec<Row> {
    let [schwefel_5, schwefel_10, rosenbrock_5, rosenbrock_15, ackley_5, ackley_15] = &CASES;
    let mut rows = Vec::new();
    for case in [schwefel_5, schwefel_10] {
        let ratio = mean(outcomes, case, THESIS) / mean(outcomes, case, MODIFIED);
        rows.push(
            Row::new(format!("{}: mean error of cFA over that of the modified FA", short(case)), ratio, "-")
                .at_most(0.5),
        );
    }
    for (case, least) in [(ackley_5, 0.95), (ackley_15, 0.95), (rosenbrock_5, 0.8)] {
        let share = success(outcomes, case, THESIS, case.budget);
        rows.push(
            Row::new(format!("{}: cFA of the thesis, success", short(case)), share, "-").at_least(least),
        );
    }
    let original =
        CASES.iter().map(|case| success(outcomes, case, ORIGINAL, case.budget)).fold(0.0, f64::max);
    rows.push(Row::new("original FA: most successes on any function", original, "-").at_most(0.0));
    let limits = [
        (schwefel_5, 20_000, 0.95),
        (schwefel_10, 40_000, 0.25),
        (rosenbrock_5, 40_000, 0.99),
        (rosenbrock_15, 70_000, 0.99),
        (ackley_5, 40_000, 0.99),
        (ackley_15, 40_000, 0.99),
    ];
    for (case, within, least) in limits {
        let share = success(outcomes, case, DEFAULT, within);
        rows.push(
            Row::new(
                format!("{}: default cfa, success within {within} evaluations", short(case)),
                share,
                "-",
            )
            .at_least(least),
        );
        rows.push(Row::new(
            format!("{}:   L-SHADE, the same", short(case)),
            success(outcomes, case, LSHADE, within),
            "-",
        ));
    }
    let spent = |case: &Case, name: &str| {
        let sum = |outcome: &Outcome| outcome.runs.iter().map(|run| run.evaluations).sum::<usize>() as f64;
        of(outcomes, case, name).map(sum).sum::<f64>()
    };
    let saved = CASES.iter().map(|case| 1.0 - spent(case, DEFAULT) / spent(case, ENDLESS)).sum::<f64>()
        / CASES.len() as f64;
    let lost = CASES.iter().map(|case| {
        success(outcomes, case, ENDLESS, case.budget) - success(outcomes, case, DEFAULT, case.budget)
    });
    rows.push(
        Row::new("early stopping: evaluations saved, mean over the functions", saved, "-").at_least(0.5),
    );
    rows.push(
        Row::new("early stopping: success lost, the most on any function", lost.fold(0.0, f64::max), "-")
            .at_most(0.01),
    );
    rows
}
