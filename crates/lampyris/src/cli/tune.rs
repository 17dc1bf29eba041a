//! `lampyris tune`: settings of the search that suit these measurements, chosen on their older part and
//! judged on the newer one.

use super::fit::progress_bar;
use super::measured::MeasuredArguments;
use super::output::{Failure, faults, print};
use lampyris_core::estimate::problem::request::{Budget, SeededMethod};
use lampyris_core::estimate::tune::Performance;
use lampyris_core::estimate::tune::{SPLIT, TuneError, Tuning, tune};
use lampyris_core::estimate::{Control, EstimateRequest, Progress};
use lampyris_core::optimise::Method;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    measured: MeasuredArguments,
    /// The seed: the same seed gives the same bits.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Most simulations of one search; a tuning makes more than a hundred.
    #[arg(long, default_value_t = 20_000)]
    evaluations: usize,
    /// Print the tuning as JSON.
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let window = arguments.measured.read()?;
    let (catalogue, model) = arguments.measured.model()?;
    let request = EstimateRequest {
        method: SeededMethod { seed: arguments.seed, method: Method::default() },
        budget: Budget { evaluations: arguments.evaluations, wall: None },
        ..arguments.measured.request(&model, SPLIT)
    };
    let bar = progress_bar(0, arguments.json);
    let progress = |progress: &Progress| {
        bar.set_position(progress.evaluations as u64);
        bar.set_message(format!("{} searches", progress.generation));
    };
    let control = Control { progress: &progress, ..Control::NONE };
    let found = tune(&catalogue, &model, &request, &window, &arguments.measured.site(), &control);
    bar.finish_and_clear();
    let tuning = found.map_err(|error| match error {
        TuneError::Faults(found) => faults(&found),
        TuneError::Estimate(error) => Failure::Error(error.to_string()),
    })?;
    if arguments.json {
        print(&serde_json::to_string(&tuning).map_err(|error| Failure::Error(error.to_string()))?);
    } else {
        print(&text(&tuning));
    }
    if tuning.better { Ok(()) } else { Err(Failure::Rejected) }
}

/// The tuning for people.
fn text(tuning: &Tuning) -> String {
    let mut lines = vec![format!(
        "{}  chosen on {} windows, judged on {}  {} evaluations",
        tuning.model,
        tuning.windows.len(),
        tuning.unseen.len(),
        tuning.evaluations
    )];
    lines.push(format!("{:<12} {:>14} {:>16} {:>16}", "candidates", "searches each", "best", "in use"));
    for round in &tuning.rounds {
        let before = round.before.map_or_else(|| "out".to_owned(), |before| format!("{before:.0}"));
        lines.push(format!(
            "{:<12} {:>14} {:>16.0} {before:>16}",
            round.candidates, round.searches, round.best
        ));
    }
    if let Some(judged) = &tuning.judged {
        lines.push(format!(
            "{:<12} {:>14} {:>16} {:>16}",
            "unseen", "within 1 %", "to reach it", "evaluations"
        ));
        lines.extend(
            [("in use", &judged.before), ("tuned", &judged.tuned)].map(|(name, side)| line(name, side)),
        );
    }
    lines.extend(
        tuning.changes.iter().map(|(name, values)| format!("{name}: {} -> {}", values[0], values[1])),
    );
    lines.push(tuning.summary.clone());
    lines.join("\n")
}

fn line(name: &str, side: &Performance) -> String {
    let reach = side.to_reach.map_or_else(|| "never".to_owned(), |n| format!("{n:.0}"));
    format!("{name:<12} {:>12.0} % {reach:>16} {:>16.0}", 100.0 * side.within, side.evaluations)
}
