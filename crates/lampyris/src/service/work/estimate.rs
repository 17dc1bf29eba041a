//! The work of an `estimate` job: from stored blocks to a judged fit. It runs on the CPU pool.

use super::input::JobInput;
use super::parameter_changes::along;
use crate::service::catalogue::system::Mode;
use crate::service::error::ServiceError;
use crate::store::finish::JudgedFit;
use crate::store::fits::PackedFit;
use crate::store::jobs::JobFailure;
use lampyris_core::data::{Window, rfc3339};
use lampyris_core::estimate::assess::degradation::{as_fitted, goes_on};
use lampyris_core::estimate::assess::metrics::current_state;
use lampyris_core::estimate::assess::regimes::with_worst_regime;
use lampyris_core::estimate::fit::parameter_change::ParameterChange;
use lampyris_core::estimate::problem::predictor::Predictor;
use lampyris_core::estimate::problem::request::{SearchExtent, days_before};
use lampyris_core::estimate::validate;
use lampyris_core::estimate::{
    Control, EstimateError, Fit, GatePolicy, Interrupt, Past, Problem, Verdict, estimate,
};
use lampyris_core::fault::Fault;
use lampyris_core::interrupt::Brake;

/// Why there is no finding.
#[derive(Debug)]
pub enum Stopped {
    /// The job failed.
    Failed(JobFailure),
    /// Somebody stopped it.
    Interrupted,
}

/// Estimates, judges and reads the states off.
///
/// # Errors
/// Where the data, the model or the search give no fit, or somebody stopped it.
pub fn run(input: &JobInput, control: &Control<'_>, brake: &Brake) -> Result<JudgedFit, Stopped> {
    fitted(input, control, brake).map(|fitted| fitted.finding)
}

/// A finding with what it was found from, for those who go on from there.
pub struct FirstFit {
    /// The measurements.
    pub window: Window,
    /// What was asked, with the steps that the fit needed.
    pub problem: Problem,
    /// What was found.
    pub finding: JudgedFit,
}

/// Estimates, judges and reads the states off, and keeps what that was done with. `control` ends the search,
/// which keeps what it has found, and `brake` everything.
///
/// # Errors
/// Where the data, the model or the search give no fit, or somebody stopped it.
pub fn fitted(input: &JobInput, control: &Control<'_>, brake: &Brake) -> Result<FirstFit, Stopped> {
    let failed = |error| Stopped::Failed(describe(error));
    let window = input.fitted().map_err(failed)?;
    let unforgotten = input.forgotten.map(|_| input.window()).transpose().map_err(failed)?;
    let whole = unforgotten.as_ref().unwrap_or(&window);
    let problem = input.problem(&window).map_err(failed)?.with_brake(brake);
    let past = Past {
        // They are for comparing with what is served.
        days_before: input.served.as_ref().and_then(|_| {
            days_before(&input.catalogue, &input.request, whole, &input.system.site(), &problem)
        }),
        next_door: input.weather_next_door().map_err(failed)?,
        ..input.past()
    };
    let request = input.resolved();
    let fit =
        estimate(&problem, &request, past.incumbent.as_ref(), control).map_err(|error| stopped(&error))?;
    let fit =
        with_worst_regime(fit, &problem, &window).map_err(|fault| Stopped::Failed(invalid(vec![fault])))?;
    let mut fit = Fit { changed: changed(input, whole, &fit, brake), ..fit };
    fit.remarks.extend(input.forgotten.map(forgets));
    if input.drawn && !input.posted && request.search == SearchExtent::Global {
        fit.remarks.push("everywhere was searched, as on one night in ten".to_owned());
    }
    if !can_be_kept(&fit) {
        let detail = "errors or measures of the fit are no finite numbers: look at the measurements";
        return Err(Stopped::Failed(JobFailure {
            code: "diverged".to_owned(),
            detail: detail.to_owned(),
            errors: Vec::new(),
        }));
    }
    let policy = GatePolicy {
        horizon: input.system.policy.horizon,
        excluded: input.excluded(),
        waived: input.system.policy.checks.clone(),
    };
    let mut judgement = validate(&problem, &fit, &past, &policy);
    if let (Verdict::Accepted(_), true) = (&judgement.verdict, input.is_narrowed()) {
        judgement.summary +=
            "; fitted with bounds or fixed values of its own: it waits for an operator's word";
    }
    let grid = problem.grid();
    let finding = JudgedFit {
        windows: input
            .cited(&window, grid.start(), grid.time(grid.len().saturating_sub(1)))
            .map_err(failed)?,
        state: current_state(&problem, &fit),
        incumbent_state: incumbent_state(input, &problem),
        automatic: input.system.policy.mode == Mode::Auto && !input.is_narrowed(),
        packed: PackedFit::new(&fit, &judgement.checks).map_err(|error| failed(error.into()))?,
        fit,
        judgement,
        report: None,
    };
    Ok(FirstFit { window, problem: finding.fit.simulated(&problem), finding })
}

/// A parameter that has changed within the newest weeks, where the fit is nobody's wish: whoever posts a job
/// can ask. Where nothing can be said of it the fit is as good.
fn changed(input: &JobInput, window: &Window, fit: &Fit, brake: &Brake) -> Option<ParameterChange> {
    if input.posted {
        return None;
    }
    match along(input, window, fit, brake) {
        Ok(found) => found.change,
        Err(error) => {
            tracing::debug!(%error, "whether a parameter has changed cannot be said");
            None
        }
    }
}

/// What a fit says that forgets what was before a change.
fn forgets(since: i64) -> String {
    format!("a parameter has changed: measurements from before {} are forgotten", rfc3339(since))
}

/// Whether the document of a fit can be read again: what is no finite number cannot be written.
fn can_be_kept(fit: &Fit) -> bool {
    serde_json::to_string(fit).is_ok_and(|text| serde_json::from_str::<Fit>(&text).is_ok())
}

/// The states by the parameters that are served now, where they are parameters of this model.
fn incumbent_state(
    input: &JobInput,
    problem: &Problem,
) -> Option<lampyris_core::estimate::assess::metrics::CurrentState> {
    let served = &input.served.as_ref()?.fit;
    let names = problem.model().parameters().iter().map(|parameter| &parameter.name);
    let same = served.model == problem.model().id().to_string() && names.eq(served.parameters.keys());
    if !same {
        return None;
    }
    match problem.predictor() {
        Predictor::Filtered => current_state(problem, served),
        Predictor::FreeRun if goes_on(problem, served) => current_state(&as_fitted(problem, served), served),
        Predictor::FreeRun => None,
    }
}

/// A failure with all faults of what the job was given.
pub fn invalid(errors: Vec<Fault>) -> JobFailure {
    let has = |codes: &[&str]| errors.iter().any(|fault| codes.contains(&fault.code.as_str()));
    let code = match () {
        () if has(&["no-data", "no-data-in-range"]) => "no_data",
        () if has(&["grid-too-long"]) => "too_large",
        () => "invalid",
    };
    let detail = errors.first().map_or_else(|| "the job cannot be done".to_owned(), ToString::to_string);
    JobFailure { code: code.to_owned(), detail, errors }
}

/// The failure behind an error of this layer.
pub fn describe(error: ServiceError) -> JobFailure {
    match error {
        ServiceError::Faults(faults) => invalid(faults),
        ServiceError::Store(error) => {
            tracing::error!(%error, "a job could not read its input");
            JobFailure {
                code: "storage".to_owned(),
                detail: "the stored measurements could not be read".to_owned(),
                errors: Vec::new(),
            }
        }
        other => JobFailure { code: "internal".to_owned(), detail: other.to_string(), errors: Vec::new() },
    }
}

/// What an error of the core means for the job.
pub fn stopped(error: &EstimateError) -> Stopped {
    let code = match error {
        EstimateError::NothingFinite => "diverged",
        EstimateError::Interrupted(Interrupt::Deadline) => "deadline",
        EstimateError::Interrupted(Interrupt::Cancelled) => return Stopped::Interrupted,
    };
    Stopped::Failed(JobFailure { code: code.to_owned(), detail: error.to_string(), errors: Vec::new() })
}
