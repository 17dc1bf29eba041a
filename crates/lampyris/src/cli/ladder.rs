//! `lampyris ladder`: one CSV, and the error after each effect that is added.

use super::diagnose::{First, first_fit, with_trials_bar};
use super::fit::word;
use super::measured::MeasuredArguments;
use super::output::{Failure, print};
use super::report::{self, ReportSubject};
use lampyris_core::diagnose::ladder::{Ladder, ladder};
use lampyris_core::diagnose::nested::ladder_by_likelihood;
use lampyris_core::estimate::Control;
use lampyris_core::estimate::problem::request::Criterion;
use std::time::Instant;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    measured: MeasuredArguments,
    /// Most effects that are added.
    #[arg(long, default_value_t = 3)]
    max_steps: usize,
    /// What keeps a step: held_out (an error on unseen data falls) or lrt (a likelihood-ratio test on the
    /// training part).
    #[arg(long, default_value = "held_out", value_parser = word::<Criterion>)]
    criterion: Criterion,
    /// The seed of the first fit: the same seed gives the same bits.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Print the ladder as JSON.
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let began = Instant::now();
    let first = first_fit(&arguments.measured, arguments.seed, arguments.json)?;
    let by = match arguments.criterion {
        Criterion::HeldOut => ladder,
        Criterion::Lrt => ladder_by_likelihood,
    };
    let First { catalogue, problem, fit, window, site, .. } = &first;
    let work =
        |control: &Control| by(catalogue, problem, &fit.theta(), window, site, arguments.max_steps, control);
    let found =
        with_trials_bar(arguments.json, began, work).map_err(|error| Failure::Error(error.to_string()))?;
    if arguments.json {
        print(&serde_json::to_string(&found).map_err(|error| Failure::Error(error.to_string()))?);
    } else {
        print(&text(&found));
    }
    if let Some(file) = arguments.measured.report() {
        report::write(file, &ReportSubject { ladder: Some(&found), ..first.found() })?;
    }
    if found.steps.iter().skip(1).any(|step| step.kept) { Ok(()) } else { Err(Failure::Rejected) }
}

/// The ladder for people: a line per step.
pub fn text(ladder: &Ladder) -> String {
    let number = |value: Option<f64>| {
        value.filter(|value| value.is_finite()).map_or_else(|| "-".to_owned(), |value| format!("{value:.3}"))
    };
    let mut lines = vec![format!(
        "{:<36} {:>8} {:>10} {:>8} {:>8} {:>8} {:>10}",
        "step", "train", "validation", "test", "6 h", "24 h", "BIC"
    )];
    for step in &ladder.steps {
        let added = step.added.as_ref().map_or_else(|| step.model.clone(), |added| format!("+ {added}"));
        lines.push(format!(
            "{added:<36} {:>8} {:>10} {:>8} {:>8} {:>8} {:>10.0}  {}",
            number(Some(step.train_rmse)),
            number(step.validation_rmse),
            number(step.test_rmse),
            number(step.ahead.get("PT6H").copied()),
            number(step.ahead.get("PT24H").copied()),
            step.bic,
            if step.kept { "kept" } else { "not kept" }
        ));
    }
    lines.extend(
        ladder
            .steps
            .iter()
            .skip(1)
            .map(|step| format!("{}: {}", step.added.as_deref().unwrap_or_default(), step.why)),
    );
    lines.join("\n")
}
