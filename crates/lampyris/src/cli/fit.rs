//! `lampyris fit`: one CSV, one model, one report.

use super::measured::MeasuredArguments;
use super::output::{Failure, faults, print};
use super::report::{self, ReportSubject};
use indicatif::{ProgressBar, ProgressStyle};
use lampyris_core::data::SplitRequest;
use lampyris_core::estimate::fit::likelihood::LikelihoodReport;
use lampyris_core::estimate::gate::check::{CheckResult, Severity};
use lampyris_core::estimate::problem::objective::Objective;
use lampyris_core::estimate::problem::prior::Prior;
use lampyris_core::estimate::problem::request::{Budget, SeededMethod, agreed};
use lampyris_core::estimate::validate;
use lampyris_core::estimate::{Control, EstimateRequest, Fit, Past, Progress, estimate, prepare};
use lampyris_core::optimise::Method;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    measured: MeasuredArguments,
    /// The optimiser: cfa (the default), ctsm for the largest likelihood, cfa_thesis, cfa_hierarchical, fa,
    /// fa_modified, grid, lm_multistart, lshade, pso or ga.
    #[arg(long, value_parser = method)]
    method: Option<Method>,
    /// What is minimised: mse (the default), swmse, nmse, or the likelihood, which goes with ctsm.
    #[arg(long, value_parser = word::<Objective>)]
    objective: Option<Objective>,
    /// What is known beforehand: none or log_normal.
    #[arg(long, default_value = "none", value_parser = word::<Prior>)]
    prior: Prior,
    /// The seed: the same seed gives the same bits.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Most simulations.
    #[arg(long, default_value_t = 20_000)]
    evaluations: usize,
    /// Other bounds for a parameter: alpha_h=0.001:15.
    #[arg(long, value_name = "NAME=LOW:HIGH", value_parser = bounds)]
    bounds: Vec<(String, [f64; 2])>,
    /// Print the fit as JSON.
    #[arg(long)]
    json: bool,
}

fn bounds(text: &str) -> Result<(String, [f64; 2]), String> {
    let parse = || {
        let (name, interval) = text.split_once('=')?;
        let (low, high) = interval.split_once(':')?;
        Some((name.to_owned(), [low.parse().ok()?, high.parse().ok()?]))
    };
    parse().ok_or_else(|| "write NAME=LOW:HIGH".to_owned())
}

/// A word of the API, such as `swmse`.
pub fn word<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, String> {
    serde_json::from_value(serde_json::Value::String(text.to_owned())).map_err(|error| error.to_string())
}

fn method(text: &str) -> Result<Method, String> {
    serde_json::from_value(serde_json::json!({ text: {} })).map_err(|error| error.to_string())
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let window = arguments.measured.read()?;
    let (catalogue, model) = arguments.measured.model()?;
    let (objective, method) =
        agreed(arguments.objective, arguments.method.clone()).map_err(|fault| faults(&[fault]))?;
    let request = EstimateRequest {
        objective,
        prior: arguments.prior.clone(),
        method: SeededMethod { seed: arguments.seed, method },
        budget: Budget { evaluations: arguments.evaluations, wall: None },
        bounds: arguments.bounds.iter().cloned().collect(),
        ..arguments.measured.request(&model, SplitRequest::ESTIMATE)
    };
    let site = arguments.measured.site();
    let problem = prepare(&catalogue, &model, &request, &window, &site).map_err(|found| faults(&found))?;
    let bar = progress_bar(arguments.evaluations as u64, arguments.json);
    let progress = |progress: &Progress| {
        bar.set_position(progress.evaluations as u64);
        bar.set_message(progress.best_train.map_or_else(String::new, |best| format!("best {best:.5}")));
    };
    let fit = estimate(&problem, &request, None, &Control { progress: &progress, ..Control::NONE });
    bar.finish_and_clear();
    let fit = fit.map_err(|error| Failure::Error(error.to_string()))?;
    let judgement = validate(&problem, &fit, &Past::default(), &arguments.measured.policy());
    if arguments.json {
        let document =
            report::fit_document(report::ID, &fit, &judgement, &jiff::Timestamp::now().to_string())?;
        print(&document.to_string());
    } else {
        print(&table(&fit));
        if !problem.split().validation.is_empty() {
            print(&checks(&judgement.checks));
            print(&format!("verdict: {}", judgement.summary));
        }
    }
    if let Some(file) = arguments.measured.report() {
        report::write(
            file,
            &ReportSubject {
                catalogue: &catalogue,
                window: &window,
                fit: &fit,
                judgement: &judgement,
                diagnosis: None,
                ladder: None,
            },
        )?;
    }
    // Without unseen data for the gate, the fit is a study and not a candidate for a controller.
    if problem.split().validation.is_empty() || judgement.failed().is_empty() {
        Ok(())
    } else {
        Err(Failure::Rejected)
    }
}

/// A bar on standard error where somebody watches.
pub fn progress_bar(length: u64, hidden: bool) -> ProgressBar {
    let bar = if hidden { ProgressBar::hidden() } else { ProgressBar::new(length) };
    if let Ok(style) = ProgressStyle::with_template("{bar:30} {pos}/{len} evaluations  {msg}") {
        bar.set_style(style);
    }
    bar
}

/// The report of a fit for people.
pub fn table(fit: &Fit) -> String {
    let mut lines = vec![format!(
        "{}  {} {}  {} evaluations, {:?}",
        fit.model, fit.method, fit.objective, fit.evaluations, fit.stopped_by
    )];
    lines.push(format!("{:<18} {:>12} {:<12} {:>26}", "parameter", "value", "unit", "95 % interval"));
    for (name, estimate) in &fit.parameters {
        let interval = match (estimate.fixed, estimate.ci95) {
            (true, _) => "fixed".to_owned(),
            (false, Some([low, high])) => format!("[{low:.4}, {high:.4}]"),
            (false, None) => "not determined".to_owned(),
        };
        let bound = if estimate.at_bound { "  at a bound" } else { "" };
        lines
            .push(format!("{name:<18} {:>12.5} {:<12} {interval:>26}{bound}", estimate.value, estimate.unit));
    }
    for (channel, metrics) in &fit.metrics {
        let unit = &metrics.unit;
        let error = |value: Option<f64>| {
            value.map_or_else(
                || "-".to_owned(),
                |value| format!("{value:.4} {unit} (MSE {:.4})", value * value),
            )
        };
        lines.push(format!(
            "{channel} free run   train {}   validation {}   test {}",
            error(Some(metrics.train_rmse)),
            error(metrics.validation_rmse),
            error(metrics.test_rmse)
        ));
        for (horizon, ahead) in &metrics.ahead {
            lines.push(format!(
                "{channel} {horizon:>6} ahead  {:.4} {unit}   persistence {:.4} {unit}   n {}",
                ahead.rmse, ahead.persistence, ahead.n
            ));
        }
        if let (Some(floor), Some(rho)) = (metrics.noise_floor, metrics.rho) {
            lines.push(format!("{channel} noise floor {floor:.4} {unit}   rho {rho:.2}"));
        }
    }
    lines.extend(fit.likelihood.iter().flat_map(likelihood));
    let step_error =
        fit.discretisation_error.map_or_else(|| "without limit".to_owned(), |error| format!("{error:.5}"));
    lines.push(format!("step error {step_error}  ({} steps per sample)", fit.substeps));
    lines.extend(fit.remarks.iter().map(|remark| format!("note: {remark}")));
    lines.join("\n")
}

/// What the likelihood says, for people.
fn likelihood(found: &LikelihoodReport) -> Vec<String> {
    let kind = if found.exact { "exact steps" } else { "extended filter" };
    let mut lines = vec![format!(
        "log-likelihood {:.3}   {} innovations, {} estimated ({kind})   AIC {:.1}   BIC {:.1}",
        found.log_likelihood, found.innovations, found.estimated, found.aic, found.bic
    )];
    let groups = [("diffusion", &found.diffusion), ("sensor", &found.measurement)];
    for (group, (name, noise)) in
        groups.into_iter().flat_map(|(group, noises)| noises.iter().map(move |noise| (group, noise)))
    {
        let interval = noise
            .ci95
            .map_or_else(|| "not determined".to_owned(), |[low, high]| format!("[{low:.4}, {high:.4}]"));
        let bound = if noise.at_bound { "  at a bound" } else { "" };
        lines.push(format!(
            "{:<18} {:>12.5} {:<12} {interval:>26}{bound}",
            format!("{group} {name}"),
            noise.value,
            noise.unit
        ));
    }
    for (name, profile) in &found.profiles {
        let side = |side: Option<f64>| side.map_or_else(|| "open".to_owned(), |value| format!("{value:.4}"));
        lines.push(format!(
            "{:<44} {:>26}",
            format!("profile {name}"),
            format!("[{}, {}]", side(profile.ci95[0]), side(profile.ci95[1]))
        ));
    }
    lines.push(found.reason.clone());
    lines
}

/// The checks of the gate for people.
pub fn checks(checks: &[CheckResult]) -> String {
    let line = |check: &CheckResult| {
        let number = |value: Option<f64>| value.map_or_else(String::new, |value| format!("{value:.4}"));
        let mark = match (check.pass, check.severity) {
            (true, _) => "pass",
            (false, Severity::Flag) => "flag",
            (false, _) => "FAIL",
        };
        format!(
            "{mark} {:<28} {:>10} {:<2} {:<8} {}",
            check.name,
            number(check.statistic),
            check.operator,
            number(check.threshold),
            check.comment
        )
    };
    checks.iter().map(line).collect::<Vec<_>>().join("\n")
}
