//! `lampyris diagnose`: one CSV, one model, and what the model is missing.

use super::fit::progress_bar;
use super::measured::MeasuredArguments;
use super::output::{Failure, faults, print};
use super::report::{self, ReportSubject};
use indicatif::{ProgressBar, ProgressStyle};
use lampyris_core::data::{SplitRequest, Window};
use lampyris_core::diagnose::report::{Considered, Finding};
use lampyris_core::diagnose::{Adequacy, Diagnosis, diagnose};
use lampyris_core::estimate::problem::request::{AccusationRate, SeededMethod};
use lampyris_core::estimate::validate;
use lampyris_core::estimate::{
    Control, EstimateRequest, Fit, Judgement, Past, Problem, Progress, Site, Trials, estimate, prepare,
};
use lampyris_core::model::Catalogue;
use lampyris_core::optimise::Method;
use lampyris_core::pace::Pace;
use lampyris_core::units::error_unit;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    measured: MeasuredArguments,
    /// The seed of the first fit: the same seed gives the same bits.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// How often segments of hours may accuse where nothing is missing
    #[arg(long, default_value = "0.01")]
    accusation_rate: AccusationRate,
    /// Print the diagnosis as JSON.
    #[arg(long)]
    json: bool,
}

/// A fit to start from, and all that it was made of.
pub struct First {
    pub catalogue: Catalogue,
    pub window: Window,
    pub site: Site,
    pub problem: Problem,
    pub fit: Fit,
    pub judgement: Judgement,
}

impl First {
    /// What a report shows of it.
    pub fn found(&self) -> ReportSubject<'_> {
        ReportSubject {
            catalogue: &self.catalogue,
            window: &self.window,
            fit: &self.fit,
            judgement: &self.judgement,
            diagnosis: None,
            ladder: None,
        }
    }
}

/// Reads the measurements and fits the model as it is.
pub fn first_fit(measured: &MeasuredArguments, seed: u64, quiet: bool) -> Result<First, Failure> {
    let window = measured.read()?;
    let (catalogue, model) = measured.model()?;
    let request = EstimateRequest {
        method: SeededMethod { seed, method: Method::default() },
        ..measured.request(&model, SplitRequest::DIAGNOSE)
    };
    let site = measured.site();
    let problem = prepare(&catalogue, &model, &request, &window, &site).map_err(|found| faults(&found))?;
    let bar = progress_bar(request.budget.evaluations as u64, quiet);
    let progress = |progress: &Progress| bar.set_position(progress.evaluations as u64);
    let fit = estimate(&problem, &request, None, &Control { progress: &progress, ..Control::NONE });
    bar.finish_and_clear();
    let fit = fit.map_err(|error| Failure::Error(error.to_string()))?;
    let judgement = validate(&problem, &fit, &Past::default(), &measured.policy());
    Ok(First { catalogue, window, site, problem: fit.simulated(&problem), fit, judgement })
}

/// Does some work under a bar of its trials; the fit before it began at an instant.
pub fn with_trials_bar<T>(hidden: bool, began: Instant, work: impl FnOnce(&Control) -> T) -> T {
    let bar = if hidden { ProgressBar::hidden() } else { ProgressBar::new(100) };
    if let Ok(style) = ProgressStyle::with_template("{bar:30} {pos} %  {msg}") {
        bar.set_style(style);
    }
    let pace = Mutex::<Pace>::default();
    let progress = |progress: &Progress| {
        let Some(trials) = &progress.trials else { return };
        let now = began.elapsed().as_secs_f64();
        let mut pace = pace.lock().unwrap_or_else(PoisonError::into_inner);
        pace.note(now, &trials.plan);
        tell_trials(&bar, trials, pace.share(now));
    };
    let done = work(&Control { progress: &progress, ..Control::NONE });
    bar.finish_and_clear();
    done
}

/// Shows on it how far the trials have come.
fn tell_trials(bar: &ProgressBar, trials: &Trials, share: Option<f64>) {
    bar.set_position((100.0 * share.unwrap_or(0.0)) as u64);
    let leader = trials.leader.as_ref().map_or_else(String::new, |leader| format!(", {leader} leads"));
    bar.set_message(match trials.round {
        0 => "the model without effects comes first".to_owned(),
        round => format!("round {round}: {} of {} effects tried{leader}", trials.tried, trials.of),
    });
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let began = Instant::now();
    let first = first_fit(&arguments.measured, arguments.seed, arguments.json)?;
    let First { catalogue, problem, fit, window, site, .. } = &first;
    let rate = arguments.accusation_rate;
    let work =
        |control: &Control| diagnose(catalogue, problem, &fit.theta(), window, site, rate, &[], control);
    let diagnosis =
        with_trials_bar(arguments.json, began, work).map_err(|error| Failure::Error(error.to_string()))?;
    if arguments.json {
        print(&serde_json::to_string(&diagnosis).map_err(|error| Failure::Error(error.to_string()))?);
    } else {
        print(&text(&diagnosis, &first.problem));
    }
    if let Some(file) = arguments.measured.report() {
        report::write(file, &ReportSubject { diagnosis: Some(&diagnosis), ..first.found() })?;
    }
    if diagnosis.verdict == Adequacy::Named { Ok(()) } else { Err(Failure::Rejected) }
}

/// The diagnosis for people.
fn text(diagnosis: &Diagnosis, problem: &Problem) -> String {
    // Errors are counted over all outputs, and the hours that err most are those of the first.
    let unit = problem.scale_in_words();
    let first = problem.model().outputs().first().map_or("", |output| error_unit(&output.unit));
    let mut lines = vec![format!("{}: {}", diagnosis.model, diagnosis.summary)];
    lines.extend(diagnosis.warnings.iter().map(|warning| format!("warning: {warning}")));
    for finding in &diagnosis.findings {
        lines.extend(one(finding));
    }
    lines.extend(diagnosis.present.iter().map(|one| one.sentence.clone()));
    if let (Some(rho), Some(floor)) = (diagnosis.rho, diagnosis.noise_floor_rmse) {
        lines.push(format!("rho {rho:.2}   noise floor {floor:.3} {unit}"));
    }
    lines.push(format!("{:<32} {:>9} {:>9} {:>9}  {}", "considered", "score", "dBIC", "share", "why"));
    lines.extend(diagnosis.considered.iter().map(considered));
    if !diagnosis.not_testable.is_empty() {
        lines.push("not testable with these data:".to_owned());
        lines.extend(diagnosis.not_testable.iter().map(|one| format!("  {:<30} {}", one.effect, one.reason)));
    }
    if let Some(ask) = &diagnosis.unexplained.ask {
        lines.push(format!("unexplained: {ask}"));
        for episode in &diagnosis.unexplained.episodes {
            lines.push(format!(
                "  {} to {}: {:+.2} {first}, {:.0} % of the squared error",
                episode.from,
                episode.to,
                episode.bias,
                100.0 * episode.share
            ));
        }
    }
    lines.join("\n")
}

fn one(finding: &Finding) -> Vec<String> {
    let mut lines =
        vec![format!("{}. {} ({}) - {}", finding.rank, finding.title, finding.effect, finding.explain)];
    lines.extend(finding.evidence.iter().map(|sentence| format!("   {sentence}")));
    for (name, value) in &finding.parameters {
        let interval = value
            .ci95
            .map_or_else(|| "not determined".to_owned(), |[low, high]| format!("[{low:.4}, {high:.4}]"));
        let bound = if value.at_bound { ", at a bound" } else { "" };
        lines.push(format!("   {name} = {:.4} {} {interval}{bound}", value.value, value.unit));
    }
    if let Some(by) = &finding.separate_by {
        lines.push(format!("   cannot be told from {}: {by}", finding.tied_with.join(", ")));
    }
    lines
}

fn considered(one: &Considered) -> String {
    let number = |value: Option<f64>, scale: f64| {
        value.map_or_else(|| "-".to_owned(), |value| format!("{:.1}", scale * value))
    };
    format!(
        "{:<32} {:>9.1} {:>9} {:>8}%  {}",
        one.effect,
        one.score,
        number(one.delta_bic, 1.0),
        number(one.explained_share, 100.0),
        one.why
    )
}
