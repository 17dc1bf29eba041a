//! The loop around an optimiser: ask, simulate, tell, until something says stop; then the fit's report.

use super::channels::levels;
use super::ctsm;
use super::fit::{Estimate, Fit, Parts, Span, Stop, TracePoint};
use super::metrics::{filter, metrics};
use super::problem::Problem;
use super::request::{EstimateRequest, Prior, StartFrom};
use super::ridge::{follow, sentence};
use super::stop::{EarlyStopping, Watch};
use super::uncertainty::{Uncertainty, uncertainty};
use super::validate::Incumbent;
use crate::data::rfc3339;
use crate::model::{Scale, Stepper};
use crate::optimise::Method;
use crate::optimise::multistart::LmOptions;
use crate::optimise::{Ask, Candidate, Cost, Ended, Evaluation, LocalRun, Search};
use crate::simulate::trajectory::Halt;
use indexmap::IndexMap;
use serde::Serialize;
use std::ops::Range;
use std::sync::Arc;
use utoipa::ToSchema;

/// A parameter this close to a bound, as a share of the interval on its scale, sits on it.
pub const AT_BOUND: f64 = 0.01;
/// A fit with a parameter fixed may be this much worse on the hold-out before the parameter counts.
const FIXED_MAY_BE_WORSE: f64 = 1.02;
/// Largest discretisation error in the noise of a sensor before the step is halved: 0.02 K for a thermometer of 0.05 K.
const DISCRETISATION_LIMIT: f64 = 0.4;
/// As fine as the tolerance of a stepper gets that finds its own steps: each doubling divides it by ten.
const FINEST_TOLERANCE: usize = 2;
/// Looks at the validation part that only tell how a search goes: each is one simulation up to its end, and as much as so many of those
/// is done on the training part in between.
const BETWEEN_LOOKS: usize = 100;
/// Evaluations for a polish by least squares from a known point.
const POLISH_EVALUATIONS: usize = 1500;

/// How far the trials of a diagnosis have come.
#[derive(Debug, Clone, PartialEq, Default, Serialize, ToSchema)]
pub struct Trials {
    /// The round, from 1 on; a round looks for one more effect. 0 while the model without any is brought to its optima.
    pub round: usize,
    /// Effects that have been tried in this round, or ruled out.
    pub tried: usize,
    /// Of so many.
    pub of: usize,
    /// The effect that gains most in this round so far.
    pub leader: Option<String>,
    /// The share of the expected work of all rounds that is done.
    pub share: Option<f64>,
}

/// How far a search has come, or the diagnosis behind it.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Progress {
    /// Generations or restarts completed.
    pub generation: usize,
    /// Simulations so far.
    pub evaluations: usize,
    /// Best cost so far.
    pub best_train: Option<f64>,
    /// Free-run RMSE of the best candidate on the validation part, as of the last look at it; of several outputs in the noise of
    /// their sensors.
    pub best_validation: Option<f64>,
    /// The best parameters so far, by name; another one with every improvement.
    pub incumbent: Option<Arc<IndexMap<String, f64>>>,
    /// The trials of a diagnosis, once its search is over.
    pub trials: Option<Trials>,
}

/// Why somebody outside stops a search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Interrupt {
    /// An operator or a shutdown.
    Cancelled,
    /// The wall time is used up.
    Deadline,
}

/// The caller's hands on a running search. The core has no clock, so deadlines come from here.
pub struct Control<'a> {
    /// Asked before every batch, and in the middle of simulations. Whatever it once says it goes on to say.
    pub interrupt: &'a (dyn Fn() -> Option<Interrupt> + Sync),
    /// Told after every batch.
    pub progress: &'a (dyn Fn(&Progress) + Sync),
}

impl Control<'_> {
    /// Never interrupts, tells nobody.
    pub const NONE: Control<'static> = Control { interrupt: &|| None, progress: &|_| () };

    /// Whether the work is to end now.
    pub fn halts(&self) -> bool {
        (self.interrupt)().is_some()
    }
}

/// Why there is no fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EstimateError {
    /// Every candidate diverged.
    NothingFinite,
    /// Stopped before a single candidate was evaluated, or cancelled: a cancelled search has no result.
    Interrupted(Interrupt),
}

impl std::fmt::Display for EstimateError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            EstimateError::NothingFinite => "every candidate diverged: the model cannot follow these data inside its bounds",
            EstimateError::Interrupted(Interrupt::Cancelled) => "the estimation was cancelled",
            EstimateError::Interrupted(Interrupt::Deadline) => "the wall time was used up before anything was found",
        })
    }
}

impl std::error::Error for EstimateError {}

/// What a search found.
pub(super) struct Found {
    pub theta: Vec<f64>,
    /// The same in the unit cube of the search, which may have more coordinates than parameters.
    pub place: Candidate,
    pub cost: f64,
    pub stop: Stop,
    pub evaluations: usize,
    pub trace: Vec<TracePoint>,
    /// The local runs, where the search keeps count of them.
    pub runs: Vec<LocalRun>,
    /// What a reader of the fit should know of the search.
    pub remarks: Vec<String>,
}

/// Estimates the parameters of a problem.
///
/// # Errors
/// [`EstimateError`] where nothing finite was found or somebody stopped it.
pub fn estimate(
    problem: &Problem,
    request: &EstimateRequest,
    incumbent: Option<&Incumbent>,
    control: &Control,
) -> Result<Fit, EstimateError> {
    let warm = warm_starts(problem, request, incumbent);
    if let Method::Ctsm(options) = &request.method.method {
        return ctsm::estimate(problem, request, options, &warm, control);
    }
    // The prior's weight is the residual variance of the fit without it.
    let mut spent = 0;
    let problem = match problem.prior() {
        Prior::None => problem.clone(),
        Prior::LogNormal => {
            let free = search(&problem.without_prior(), request, &warm, control)?;
            spent = free.evaluations;
            problem.with_prior_variance(free.cost)
        }
    };
    let mut found = search(&problem, request, &warm, control)?;
    found.evaluations += spent;
    let watched = request.early_stopping.is_some_and(|rule| rule.validation);
    let (problem, mut found, discretisation_error) = refine_step(problem, found, watched, control)?;
    let mut remarks: Vec<String> = problem.model().dropped().iter().map(|what| format!("left out: {what}")).collect();
    remarks.append(&mut found.remarks);
    if watched {
        remarks.push("the validation part chose between candidates, so its error is not that of unseen data".to_owned());
    }
    let (problem, non_identifiable) = fix_unidentifiable(problem, &mut found, &mut remarks, control)?;
    let mut known = uncertainty(&problem, &found.theta);
    found.evaluations += known.evaluations;
    // A model with a filter has a likelihood, whose profiles `ctsm` gives.
    if !problem.filters() {
        found.evaluations += follow(&problem, &found.theta, found.cost, &mut known, control)?;
    }
    let mut fit = report(&problem, request, found, &known, discretisation_error, remarks);
    fit.non_identifiable = non_identifiable;
    Ok(fit)
}

/// The served parameters where they are wanted and known, and the nominal ones.
fn warm_starts(problem: &Problem, request: &EstimateRequest, incumbent: Option<&Incumbent>) -> Vec<Candidate> {
    let mut starts = Vec::new();
    if let (StartFrom::Current, Some(incumbent)) = (request.start_from, incumbent) {
        let mut theta = problem.nominal().to_vec();
        for (value, parameter) in theta.iter_mut().zip(problem.model().parameters()) {
            *value = incumbent.theta.get(&parameter.name).copied().unwrap_or(*value);
        }
        starts.push(problem.candidate(&theta));
    } else {
        starts.push(problem.candidate(problem.nominal()));
    }
    starts
}

/// Runs one optimiser to its end.
fn search(problem: &Problem, request: &EstimateRequest, warm: &[Candidate], control: &Control) -> Result<Found, EstimateError> {
    let search = Search {
        dimensions: problem.space().len(),
        seed: request.method.seed,
        budget: request.budget.evaluations,
        warm: warm.to_vec(),
        residuals: true,
    };
    drive(problem, &|ask, halt| evaluate(problem, ask, halt), &request.method.method, search, request.early_stopping, control)
}

/// The answers to a question, from free runs.
pub(super) fn evaluate(problem: &Problem, ask: &Ask, halt: Halt) -> Vec<Evaluation> {
    match ask {
        Ask::Costs(candidates) | Ask::Slopes(candidates) => problem.evaluate_unless(candidates, false, halt),
        Ask::Residuals(candidates) => problem.evaluate_unless(candidates, true, halt),
        Ask::Done(_) => Vec::new(),
    }
}

/// Ask, simulate, tell. The first coordinates of a candidate are the free parameters of the problem.
pub(super) fn drive(
    problem: &Problem,
    answer: &dyn Fn(&Ask, Halt) -> Vec<Evaluation>,
    method: &Method,
    search: Search,
    early: Option<EarlyStopping>,
    control: &Control,
) -> Result<Found, EstimateError> {
    if search.dimensions == 0 {
        let cost = problem.evaluate(&[Candidate(Vec::new())], false).first().map_or(Cost::Diverged, |evaluation| evaluation.cost);
        let Cost::Finite(cost) = cost else {
            return Err(EstimateError::NothingFinite);
        };
        let theta = problem.nominal().to_vec();
        let (place, stop) = (Candidate(Vec::new()), Stop::Converged);
        return Ok(Found { theta, place, cost, stop, evaluations: 1, trace: Vec::new(), runs: Vec::new(), remarks: Vec::new() });
    }
    let mut optimiser = method.with_least_step(problem.least_step()).optimiser(search);
    let mut watch = early.map(Watch::new);
    let watches_validation = early.is_some_and(|rule| rule.validation);
    let between_looks = BETWEEN_LOOKS * problem.split().validation.end / problem.split().train.end.max(1);
    let (mut looked, mut next_look) = (true, between_looks);
    let mut remarks = Vec::new();
    let mut progress = Progress::default();
    let mut trace: Vec<TracePoint> = Vec::new();
    let halt = || control.halts();
    let stop = loop {
        if let Some(interrupt) = (control.interrupt)() {
            match interrupt {
                // A deadline keeps what was found; a cancelled search has no result.
                Interrupt::Deadline if progress.best_train.is_some() => break Stop::Deadline,
                other => return Err(EstimateError::Interrupted(other)),
            }
        }
        let answers: Vec<Evaluation> = match optimiser.ask() {
            Ask::Done(ended) => {
                break match ended {
                    Ended::Converged => Stop::Converged,
                    Ended::Stalled => Stop::Stalled,
                    Ended::Budget => Stop::Budget,
                };
            }
            ask => answer(&ask, &halt),
        };
        if halt() {
            // Answers that were cut short are none.
            continue;
        }
        progress.evaluations += answers.len();
        optimiser.tell(&answers);
        progress.generation = optimiser.generation();
        if let Some((best, Cost::Finite(cost))) = optimiser.best() {
            let better = progress.best_train.is_none_or(|known| cost < known);
            if better {
                progress.best_train = Some(cost);
                trace.push(TracePoint { evaluations: progress.evaluations, best: cost });
                let names = problem.model().parameters().iter().map(|parameter| parameter.name.clone());
                progress.incumbent = Some(Arc::new(names.zip(problem.theta(best)).collect()));
                looked = false;
            }
            if !looked && (watches_validation || progress.evaluations >= next_look) {
                progress.best_validation = validation_rmse(problem, &problem.theta(best));
                (looked, next_look) = (true, progress.evaluations + between_looks);
            }
            if let Some(watch) = watch.as_mut().filter(|_| better) {
                watch.best(progress.generation, &best.0, cost, progress.best_validation);
            }
        }
        (control.progress)(&progress);
        if let Some(watch) = watch.as_ref().filter(|watch| watch.is_over(progress.generation)) {
            remarks.push(watch.remark());
            break Stop::Stalled;
        }
    };
    let Some((best, Cost::Finite(cost))) = optimiser.best() else {
        return Err(EstimateError::NothingFinite);
    };
    let (place, cost) = watch.and_then(Watch::kept).map_or_else(|| (best.clone(), cost), |(place, cost)| (Candidate(place), cost));
    let (theta, runs) = (problem.theta(&place), optimiser.runs());
    Ok(Found { theta, place, cost, stop, evaluations: progress.evaluations, trace, runs, remarks })
}

/// Least squares from a known point, with so many evaluations; `None` where it goes nowhere or the wall time is used up: what was
/// found before then stays.
pub(super) fn polish(problem: &Problem, theta: &[f64], budget: usize, control: &Control) -> Result<Option<Found>, EstimateError> {
    let method = Method::LmMultistart(LmOptions { starts: 1, ..LmOptions::default() });
    let search = Search { dimensions: problem.space().len(), seed: 0, budget, warm: vec![problem.candidate(theta)], residuals: true };
    match drive(problem, &|ask, halt| evaluate(problem, ask, halt), &method, search, None, control) {
        Ok(found) => Ok(Some(found)),
        Err(EstimateError::NothingFinite | EstimateError::Interrupted(Interrupt::Deadline)) => Ok(None),
        Err(cancelled) => Err(cancelled),
    }
}

fn validation_rmse(problem: &Problem, theta: &[f64]) -> Option<f64> {
    let range = problem.split().validation.clone();
    if range.is_empty() {
        return None;
    }
    let run = problem.simulator().run(&[theta], range.end).pop()?;
    problem.free_run_error(&run, range)
}

/// Compares with half the step; where the difference is too large the step is halved and the fit polished, unless
/// another part than that of training has `chosen` it.
fn refine_step(mut problem: Problem, mut found: Found, chosen: bool, control: &Control) -> Result<(Problem, Found, f64), EstimateError> {
    loop {
        let (finer, difference) = step_error(&problem, &found.theta);
        found.evaluations += 2;
        if fine_enough(&problem, difference) {
            return Ok((problem, found, difference));
        }
        if chosen {
            let again = finer.evaluate(&[finer.candidate(&found.theta)], false);
            let Some(Cost::Finite(cost)) = again.first().map(|evaluation| evaluation.cost) else { return Ok((problem, found, difference)) };
            (problem, found.cost, found.evaluations) = (finer, cost, found.evaluations + 1);
            continue;
        }
        let Some(polished) = polish(&finer, &found.theta, POLISH_EVALUATIONS, control)? else { return Ok((problem, found, difference)) };
        problem = finer;
        found = Found { theta: polished.theta, cost: polished.cost, evaluations: found.evaluations + polished.evaluations, ..found };
    }
}

/// The same problem with half the step, or a tenth of the tolerance, and the largest difference that it makes, in the unit of the
/// output; of several outputs in the noise of their sensors.
pub(super) fn step_error(problem: &Problem, theta: &[f64]) -> (Problem, f64) {
    let finer = problem.with_substeps(2 * problem.simulator().substeps());
    let (coarse, fine) = (problem.simulate(theta), finer.simulate(theta));
    // A difference that is not a number is as large as can be.
    let largest = |worst: f64, d: f64| if d.is_nan() { f64::INFINITY } else { worst.max(d) };
    let of_output = |(output, (coarse, fine)): (usize, (&Vec<f64>, &Vec<f64>))| {
        coarse.iter().zip(fine).map(|(a, b)| (a - b).abs()).fold(0.0, largest) / problem.scale(output)
    };
    let difference = coarse.outputs.iter().zip(&fine.outputs).enumerate().map(of_output).fold(0.0, largest);
    (finer, difference)
}

/// Whether a step is short enough, or as short as a step gets.
pub(super) fn fine_enough(problem: &Problem, difference: f64) -> bool {
    let finest = if problem.model().stepper() == Stepper::Rkc { FINEST_TOLERANCE } else { 64 };
    difference <= DISCRETISATION_LIMIT * problem.scaled_noise() || problem.simulator().substeps() >= finest
}

/// Fixes parameters on a bound at their nominal values where the hold-out is no worse for it.
fn fix_unidentifiable(
    problem: Problem,
    found: &mut Found,
    remarks: &mut Vec<String>,
    control: &Control,
) -> Result<(Problem, Vec<String>), EstimateError> {
    let on_bound: Vec<usize> = problem.free().iter().copied().filter(|index| at_bound(&problem, &found.theta, *index)).collect();
    if on_bound.is_empty() {
        return Ok((problem, Vec::new()));
    }
    let names: Vec<String> = on_bound.iter().map(|index| problem.model().parameters()[*index].name.clone()).collect();
    let limit = format!("{} sits on a bound of the search: the value is a limit, not an estimate", names.join(", "));
    // Only unseen data can say that a parameter is not needed.
    let unseen = problem.split().validation.clone();
    if unseen.is_empty() {
        remarks.push(limit);
        return Ok((problem, Vec::new()));
    }
    let at_nominal: Vec<(usize, f64)> = on_bound.iter().map(|index| (*index, problem.nominal()[*index])).collect();
    let fixed = problem.with_fixed(&at_nominal);
    let mut start = found.theta.clone();
    at_nominal.iter().for_each(|(index, value)| start[*index] = *value);
    let error = |problem: &Problem, theta: &[f64]| problem.free_run_error(&problem.simulate(theta), unseen.clone());
    // A refit that goes nowhere only means that the parameters matter.
    let refit = polish(&fixed, &start, POLISH_EVALUATIONS, control)?;
    found.evaluations += refit.as_ref().map_or(0, |refit| refit.evaluations);
    if let Some(refit) = refit
        && let (Some(with), Some(without)) = (error(&problem, &found.theta), error(&fixed, &refit.theta))
        && without <= FIXED_MAY_BE_WORSE * with
    {
        remarks.push(format!(
            "the data do not determine {}: fixed at the nominal value, the error on unseen data is no worse",
            names.join(", ")
        ));
        (found.theta, found.cost) = (refit.theta, refit.cost);
        return Ok((fixed, names));
    }
    remarks.push(limit);
    Ok((problem, Vec::new()))
}

/// Whether a parameter lies within one per cent of a bound, on its scale.
pub fn at_bound(problem: &Problem, theta: &[f64], index: usize) -> bool {
    let [lower, upper] = problem.bounds()[index];
    let unit = match problem.model().parameters()[index].scale {
        Scale::Linear => (theta[index] - lower) / (upper - lower),
        Scale::Log => (theta[index] / lower).ln() / (upper / lower).ln(),
    };
    !(AT_BOUND..=1.0 - AT_BOUND).contains(&unit)
}

/// The document of a fit, with the noise that makes free-run residuals likely.
pub(super) fn report(
    problem: &Problem,
    request: &EstimateRequest,
    found: Found,
    uncertainty: &Uncertainty,
    discretisation_error: f64,
    mut remarks: Vec<String>,
) -> Fit {
    let run = filter(problem, &found.theta, None);
    let mut parameters = IndexMap::new();
    for (index, parameter) in problem.model().parameters().iter().enumerate() {
        let place = problem.free().iter().position(|free| *free == index);
        parameters.insert(
            parameter.name.clone(),
            Estimate {
                value: found.theta[index],
                unit: parameter.unit.clone(),
                ci95: place.and_then(|place| uncertainty.ci95[place]),
                bounds: problem.bounds()[index],
                at_bound: place.is_some() && at_bound(problem, &found.theta, index),
                fixed: place.is_none(),
            },
        );
    }
    remarks.extend(problem.split().shortfall(problem.grid().step(), &request.split));
    remarks.extend(uncertainty.correlated.iter().map(|pair| sentence(pair, problem.model())));
    if !problem.filters() {
        remarks.push("the model is stepped explicitly and has no filter: errors are those of free runs, none is of a forecast".to_owned());
    }
    if found.stop != Stop::Converged {
        remarks.push("the search ended before two of its restarts agreed".to_owned());
    }
    Fit {
        model: problem.model().id().to_string(),
        model_hash: problem.model().hash().to_owned(),
        dropped: problem.model().dropped().to_vec(),
        parameters,
        correlated: uncertainty.correlated.clone(),
        method: request.method.method.name().to_owned(),
        objective: problem.objective().word().to_owned(),
        cost: found.cost,
        stopped_by: found.stop,
        seed: request.method.seed,
        evaluations: found.evaluations,
        trace: found.trace,
        metrics: metrics(problem, &found.theta, &run),
        sample_s: problem.grid().step(),
        substeps: problem.simulator().substeps(),
        // A document has no word for infinity, and one that held it could not be read again.
        discretisation_error: Some(discretisation_error).filter(|error| error.is_finite()),
        process_noise: run.process_noise,
        parts: parts(problem),
        input_hash: problem.input_hash().to_owned(),
        basis: Some(problem.basis().clone()),
        worst_regime: None,
        remarks,
        non_identifiable: Vec::new(),
        levels: levels(problem),
        likelihood: None,
    }
}

fn parts(problem: &Problem) -> Parts {
    let span = |range: &Range<usize>| {
        (!range.is_empty())
            .then(|| Span { from: rfc3339(problem.grid().time(range.start)), to: rfc3339(problem.grid().time(range.end - 1)) })
    };
    let split = problem.split();
    Parts {
        train: span(&split.train).unwrap_or(Span { from: String::new(), to: String::new() }),
        validation: span(&split.validation),
        test: span(&split.test),
    }
}
