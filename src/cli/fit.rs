//! `lampyris fit`: one CSV, one model, one report.

use super::{Failure, faults, print};
use indicatif::{ProgressBar, ProgressStyle};
use lampyris::data::{Bindings, Duration, SplitRequest, Window};
use lampyris::estimate::request::{Budget, Objective, Prior, SeededMethod, WindowRange};
use lampyris::estimate::validate::{CheckResult, Severity};
use lampyris::estimate::{Control, EstimateRequest, Fit, Policy, Progress, Site, estimate, prepare, validate};
use lampyris::model::{Catalogue, ModelId};
use lampyris::optimise::Method;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The measurements: a CSV with a `time` column (RFC 3339).
    window: PathBuf,
    /// The model, such as room3, room2 or tite.
    #[arg(long, default_value = "room3")]
    model: ModelId,
    /// An effect to add; may be given several times.
    #[arg(long, value_name = "EFFECT")]
    with: Vec<String>,
    /// An effect to leave out; may be given several times.
    #[arg(long, value_name = "EFFECT")]
    without: Vec<String>,
    /// Take a channel from a column: T_room=T_indoor_degC.
    #[arg(long, value_name = "CHANNEL=COLUMN")]
    bind: Vec<String>,
    /// Members of the set of neighbours: 1,2,5 for the columns T_room_1, T_room_2 and T_room_5.
    #[arg(long, value_delimiter = ',')]
    neighbours: Vec<String>,
    /// Members of another set of the model: zones=north,south.
    #[arg(long, value_name = "SET=MEMBERS", value_parser = set)]
    set: Vec<(String, Vec<String>)>,
    /// Use measurements from this instant on.
    #[arg(long)]
    from: Option<String>,
    /// Use measurements up to this instant.
    #[arg(long)]
    to: Option<String>,
    /// Length of the training part, such as P14D or PT500H.
    #[arg(long)]
    train: Option<Duration>,
    /// Length of the validation part.
    #[arg(long)]
    validation: Option<Duration>,
    /// Length of the test part.
    #[arg(long)]
    test: Option<Duration>,
    /// The optimiser: cfa, cfa_thesis or lm_multistart.
    #[arg(long, default_value = "cfa", value_parser = method)]
    method: Method,
    /// What is minimised: mse, swmse or nmse.
    #[arg(long, default_value = "mse", value_parser = word::<Objective>)]
    objective: Objective,
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
    /// Latitude in degrees, for the position of the sun.
    #[arg(long, requires = "lon", allow_hyphen_values = true)]
    lat: Option<f64>,
    /// Longitude in degrees.
    #[arg(long, requires = "lat", allow_hyphen_values = true)]
    lon: Option<f64>,
    /// IANA time zone, for models that read the clock on the wall; UTC by default.
    #[arg(long)]
    zone: Option<String>,
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

fn set(text: &str) -> Result<(String, Vec<String>), String> {
    let (name, members) = text.split_once('=').ok_or("write SET=MEMBER,MEMBER")?;
    Ok((name.to_owned(), members.split(',').map(str::to_owned).collect()))
}

/// A word of the API, such as `swmse`.
fn word<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, String> {
    serde_json::from_value(serde_json::Value::String(text.to_owned())).map_err(|error| error.to_string())
}

fn method(text: &str) -> Result<Method, String> {
    serde_json::from_value(serde_json::json!({ "name": text })).map_err(|error| error.to_string())
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let path = arguments.window.display();
    let text = std::fs::read_to_string(&arguments.window).map_err(|error| Failure::NotFound(format!("{path}: {error}")))?;
    let bindings = Bindings::parse(arguments.bind.iter().map(String::as_str)).map_err(|found| faults(&found))?;
    let (window, report) = Window::parse_csv(&text, &bindings).map_err(|found| faults(&found))?;
    for warning in &report.warnings {
        eprintln!("warning: {warning}");
    }
    for row in &report.rejected_rows {
        eprintln!("warning: line {} rejected: {}", row.line, row.reason);
    }
    let mut model = arguments.model.clone();
    arguments.with.iter().for_each(|effect| model = model.plus(effect));
    arguments.without.iter().for_each(|effect| model = model.minus(effect));
    let request = EstimateRequest {
        model: Some(model.clone()),
        window: Some(WindowRange { last: None, from: arguments.from.clone(), to: arguments.to.clone() }),
        split: SplitRequest {
            train: arguments.train.unwrap_or(SplitRequest::ESTIMATE.train),
            validation: arguments.validation.unwrap_or(SplitRequest::ESTIMATE.validation),
            test: arguments.test,
        },
        objective: arguments.objective,
        prior: arguments.prior,
        method: SeededMethod { seed: arguments.seed, method: arguments.method.clone() },
        budget: Budget { evaluations: arguments.evaluations, wall: None },
        bounds: arguments.bounds.iter().cloned().collect(),
        ..EstimateRequest::default()
    };
    let site = Site {
        location: arguments.lat.zip(arguments.lon),
        zone: arguments.zone.clone(),
        sets: arguments.set.iter().cloned().chain([("neighbours".to_owned(), arguments.neighbours.clone())]).collect(),
    };
    let catalogue = Catalogue::builtin().map_err(|found| faults(&found))?;
    let problem = prepare(&catalogue, &model, &request, &window, &site).map_err(|found| faults(&found))?;
    let bar = progress_bar(arguments.evaluations as u64, arguments.json);
    let progress = |progress: &Progress| {
        bar.set_position(progress.evaluations as u64);
        bar.set_message(progress.best_train.map_or_else(String::new, |best| format!("best {best:.5}")));
    };
    let fit = estimate(&problem, &request, None, &Control { progress: &progress, ..Control::NONE });
    bar.finish_and_clear();
    let fit = fit.map_err(|error| Failure::Error(error.to_string()))?;
    let judgement = validate(&problem, &fit, None, &Policy::default());
    if arguments.json {
        let document = serde_json::json!({
            "fit": fit, "verdict": judgement.verdict.word(), "summary": judgement.summary, "checks": judgement.checks,
        });
        print(&document.to_string());
    } else {
        print(&table(&fit));
        if !problem.split().validation.is_empty() {
            print(&checks(&judgement.checks));
            print(&format!("verdict: {}", judgement.summary));
        }
    }
    // Without unseen data for the gate, the fit is a study and not a candidate for a controller.
    if problem.split().validation.is_empty() || judgement.failed().is_empty() { Ok(()) } else { Err(Failure::Rejected) }
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
fn table(fit: &Fit) -> String {
    let mut lines = vec![format!("{}  {} {}  {} evaluations, {:?}", fit.model, fit.method, fit.objective, fit.evaluations, fit.stopped_by)];
    lines.push(format!("{:<18} {:>12} {:<12} {:>26}", "parameter", "value", "unit", "95 % interval"));
    for (name, estimate) in &fit.parameters {
        let interval = match (estimate.fixed, estimate.ci95) {
            (true, _) => "fixed".to_owned(),
            (false, Some([low, high])) => format!("[{low:.4}, {high:.4}]"),
            (false, None) => "not determined".to_owned(),
        };
        let bound = if estimate.at_bound { "  at a bound" } else { "" };
        lines.push(format!("{name:<18} {:>12.5} {:<12} {interval:>26}{bound}", estimate.value, estimate.unit));
    }
    for (channel, metrics) in &fit.metrics {
        let unit = &metrics.unit;
        let error =
            |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.4} {unit} (MSE {:.4})", value * value));
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
    lines.push(format!("step error {:.5}  ({} steps per sample)", fit.discretisation_error, fit.substeps));
    lines.extend(fit.remarks.iter().map(|remark| format!("note: {remark}")));
    lines.join("\n")
}

fn checks(checks: &[CheckResult]) -> String {
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
