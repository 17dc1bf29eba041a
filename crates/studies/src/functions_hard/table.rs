//! What the runs say: a line for each search on each function, and the ratios that count.

use super::super::quantile::quantile;
use super::super::row::Row;
use super::rivals::{BIPOP, DEFAULT, LSHADE, SWARMS, THESIS};
use super::task::Task;
use super::watch::{Reached, TARGETS, expected_running_time};
use serde_json::{Value, json};
use std::fmt::Write;

/// The runs of one search on one function.
pub struct Outcome {
    pub task: Task,
    pub rival: &'static str,
    pub runs: Vec<Reached>,
}

impl Outcome {
    /// The expected running time to a target; none where no run met it.
    pub fn time(&self, target: usize) -> Option<f64> {
        expected_running_time(&self.runs, target)
    }

    fn met(&self, target: usize) -> usize {
        self.runs.iter().filter(|run| run.at[target].is_some()).count()
    }

    pub fn document(&self) -> Value {
        let each = 0..TARGETS.len();
        json!({
            "function": self.task.name(),
            "rotated": self.task.rotated(),
            "search": self.rival,
            "runs": self.runs.len(),
            "targets": TARGETS,
            "met": each.clone().map(|target| self.met(target)).collect::<Vec<_>>(),
            "expected_running_time": each.map(|target| self.time(target)).collect::<Vec<_>>(),
        })
    }
}

/// A block of lines: expected evaluations to each target, and how many runs met it.
pub fn text(task: &Task, outcomes: &[Outcome]) -> String {
    let mut text = format!("{:<30}", task.name());
    TARGETS.iter().for_each(|target| {
        let _ = write!(text, "{:>20}", format!("{target:.0e}"));
    });
    for outcome in outcomes {
        let _ = write!(text, "\n  {:<28}", outcome.rival);
        for target in 0..TARGETS.len() {
            let time = outcome.time(target).map_or_else(|| "-".to_owned(), |time| format!("{time:.0}"));
            let cell = format!("{time} ({}/{})", outcome.met(target), outcome.runs.len());
            let _ = write!(text, "{cell:>20}");
        }
    }
    text + "\n"
}

/// The ratios of expected running times, and how many pairs of function and target each search meets at all.
pub fn rows(outcomes: &[Outcome]) -> Vec<Row> {
    let of = |task: &Task, name: &str| {
        outcomes.iter().find(|outcome| outcome.task == *task && outcome.rival == name)
    };
    let mut ratios: Vec<(Task, usize, f64)> = Vec::new();
    for own in outcomes.iter().filter(|outcome| outcome.rival == DEFAULT) {
        for target in 0..TARGETS.len() {
            // Where the rival never arrives there is nothing to be slower than.
            let Some(rival) = of(&own.task, BIPOP).and_then(|rival| rival.time(target)) else { continue };
            ratios.push((own.task, target, own.time(target).unwrap_or(f64::INFINITY) / rival));
        }
    }
    let mut rows = Vec::new();
    for (rotated, kind) in [(true, "rotated"), (false, "separable")] {
        let mut own: Vec<f64> =
            ratios.iter().filter(|(task, ..)| task.rotated() == rotated).map(|(.., ratio)| *ratio).collect();
        if own.is_empty() {
            continue;
        }
        own.sort_by(f64::total_cmp);
        let within = own.iter().filter(|ratio| **ratio <= 2.0).count() as f64 / own.len() as f64;
        let median = Row::new(
            format!("{kind} functions: running time over that of BIPOP-CMA, median"),
            quantile(&own, 0.5),
            "x",
        );
        rows.push(if rotated { median.at_most(2.0) } else { median });
        rows.push(Row::new("  share of functions and targets within twice", within, "-"));
    }
    for (task, target, ratio) in ratios.iter().filter(|(.., ratio)| *ratio > 2.0) {
        let what = format!("  beyond: {} to {:.0e}", task.name(), TARGETS[*target]);
        // A document has no word for infinity.
        rows.push(Row::new(what, if ratio.is_finite() { *ratio } else { f64::NAN }, "x"));
    }
    let all = TARGETS.len() * outcomes.iter().filter(|outcome| outcome.rival == DEFAULT).count();
    for name in [DEFAULT, SWARMS, LSHADE, BIPOP, THESIS] {
        let own = outcomes.iter().filter(|outcome| outcome.rival == name);
        let met: usize =
            own.map(|own| (0..TARGETS.len()).filter(|target| own.time(*target).is_some()).count()).sum();
        rows.push(Row::new(format!("{name}: functions and targets met, of {all}"), met as f64, ""));
    }
    rows
}
