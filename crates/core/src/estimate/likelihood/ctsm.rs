//! Maximum likelihood of the stochastic model: `dx = f dt + diag(sigma) dw`, `y = h(x) + e`.
//!
//! The parameters, a diffusion per state and a standard deviation per output are searched together, each on
//! its scale, by swarms on the likelihood and Fisher scoring on its slopes. The training part alone is
//! filtered; what comes after it judges the fit as it does any other.

use super::curvature::{Curvature, profiles};
use super::objective::LikelihoodObjective;
use crate::estimate::assess::metrics::{ProcessNoise, filter_fit, metrics};
use crate::estimate::discretisation::{StepError, step_error};
use crate::estimate::fit::likelihood::{LikelihoodReport, NoiseEstimate, Profile, StartReport};
use crate::estimate::fit::{Fit, Stop};
use crate::estimate::problem::Problem;
use crate::estimate::problem::bounds::AT_BOUND;
use crate::estimate::problem::objective::Objective;
use crate::estimate::problem::request::EstimateRequest;
use crate::estimate::report::report;
use crate::estimate::search::control::{Control, EstimateError};
use crate::estimate::search::drive::{SearchResult, drive};
use crate::estimate::uncertainty::Uncertainty;
use crate::interrupt::Interrupt;
use crate::optimise::ctsm::CtsmOptions;
use crate::optimise::{Ask, Candidate, Cost, LocalRun, Origin, Search};
use crate::simulate::trajectory::Halt;
use crate::units::error_unit;
use indexmap::IndexMap;

/// How often the search goes on from a better place that a profile has found.
const MOST_RETURNS: usize = 3;

/// Estimates by maximum likelihood.
///
/// # Errors
/// [`EstimateError`] where nothing finite was found or somebody stopped it.
pub(in crate::estimate) fn estimate(
    problem: &Problem,
    request: &EstimateRequest,
    options: &CtsmOptions,
    warm: &[Candidate],
    control: &Control,
) -> Result<Fit, EstimateError> {
    let task = LikelihoodObjective::new(problem);
    let search = Search {
        dimensions: task.space.len(),
        seed: request.method.seed,
        budget: request.budget.evaluations,
        warm: warm.iter().map(|start| task.start(start)).collect(),
        residuals: false,
    };
    let answer = |ask: &Ask, halt: Halt| task.answer(ask, halt);
    let mut found = drive(problem, &answer, &request.method.method, search, request.early_stopping, control)?;
    let mut starts = starts(&task, &found.runs);
    let (problem, discretisation_error) = refine(problem, &mut found, options);
    let task = LikelihoodObjective::new(&problem);
    let (curvature, profiles) = peak(&task, &mut found, &mut starts, options, control);
    // A cancelled search has no result, wherever it was.
    if let Some(Interrupt::Cancelled) = (control.interrupt)() {
        return Err(EstimateError::Interrupted(Interrupt::Cancelled));
    }
    let reason = reason(found.stop, &starts);
    let mut remarks: Vec<String> =
        problem.model().dropped().iter().map(|what| format!("left out: {what}")).collect();
    remarks.append(&mut found.remarks);
    let own = problem.space().len();
    let known = Uncertainty {
        ci95: curvature.intervals[..own].to_vec(),
        correlated: curvature.correlated(&task, own),
        // A likelihood has profiles instead.
        leads: Vec::new(),
        covariance: curvature.of_estimates(&task, &found.place.0, own),
        // The filter starts at the first measurement, with the variance of its noise.
        starts: IndexMap::new(),
        evaluations: curvature.passes,
    };
    let point = task.point(&found.place.0);
    // The prior is no part of the likelihood that is reported.
    let (log_likelihood, innovations) =
        task.log_likelihood_at(&found.place.0).ok_or(EstimateError::NothingFinite)?;
    let exact = task.likelihood.is_linear();
    let report_of = noise(&task, &point, &curvature);
    let names = task.space.dimensions().iter().map(|dimension| dimension.name.clone());
    let likelihood = LikelihoodReport {
        log_likelihood,
        innovations,
        estimated: task.space.len(),
        aic: 2.0 * task.space.len() as f64 - 2.0 * log_likelihood,
        bic: task.space.len() as f64 * (innovations as f64).ln() - 2.0 * log_likelihood,
        exact,
        diffusion: report_of.0,
        measurement: report_of.1,
        standard_errors: names.zip(curvature.errors.iter().copied()).collect(),
        correlations: curvature.correlations.clone(),
        profiles,
        starts,
        reason,
    };
    remarks.extend(noted(&likelihood));
    let early = request.early_stopping.is_some_and(|rule| rule.validation);
    if early {
        remarks.push(
            "the validation part chose between candidates, so its error is not that of unseen data"
                .to_owned(),
        );
    }
    let mut fit =
        report(&problem, request, found, &known, discretisation_error, ProcessNoise::Likeliest, remarks);
    let limits: Vec<&str> = fit
        .parameters
        .iter()
        .filter(|(_, estimate)| estimate.at_bound)
        .map(|(name, _)| name.as_str())
        .collect();
    if !limits.is_empty() {
        fit.remarks.push(format!(
            "{} sits on a bound of the search: the value is a limit, not an estimate",
            limits.join(", ")
        ));
    }
    fit.objective = Objective::Likelihood.as_str().to_owned();
    fit.likelihood = Some(likelihood);
    // Forecasts and innovations with the noise that was estimated.
    let run = filter_fit(&problem, &fit);
    fit.process_noise = run.process_noise;
    fit.metrics = metrics(&problem, &fit.theta(), &run, &problem.simulate(&fit.theta()));
    Ok(fit)
}

/// The curvature and the profiles of the optimum. A profile that comes to a better place shows that there is
/// another one: the search goes on from there.
fn peak(
    task: &LikelihoodObjective,
    found: &mut SearchResult,
    starts: &mut Vec<StartReport>,
    options: &CtsmOptions,
    control: &Control,
) -> (Curvature, IndexMap<String, Profile>) {
    let all: Vec<usize> = (0..task.space.len()).collect();
    let mut left = MOST_RETURNS;
    loop {
        let curvature = Curvature::at(task, &found.place.0);
        let profiled = profiles(task, &found.place.0, &curvature, options, control);
        found.evaluations += curvature.passes + profiled.passes;
        let Some(better) = profiled.better.filter(|_| left > 0 && (control.interrupt)().is_none()) else {
            return (curvature, profiled.profiles);
        };
        let Some((place, value, passes)) = task.climb(&better, &all, &options.scoring) else {
            return (curvature, profiled.profiles);
        };
        left -= 1;
        found.evaluations += passes;
        let settled = passes < options.scoring.steps;
        starts.push(StartReport {
            origin: Origin::Profile,
            from: task.value(&better).map(|value| -value),
            to: Some(-value),
            passes,
            settled,
        });
        if let Cost::Finite(cost) = task.cost(value) {
            found.cost = cost;
        }
        found.place = Candidate(place);
        found.theta = task.problem.theta(&found.place);
    }
}

/// Halves the step of the free run while it is too long, and climbs again where the likelihood depends on it.
fn refine(problem: &Problem, found: &mut SearchResult, options: &CtsmOptions) -> (Problem, f64) {
    let mut problem = problem.clone();
    loop {
        let StepError { finer, difference, fine_enough, evaluations, .. } =
            step_error(&problem, &found.theta);
        found.evaluations += evaluations;
        if fine_enough {
            return (problem, difference);
        }
        let task = LikelihoodObjective::new(&finer);
        let all: Vec<usize> = (0..task.space.len()).collect();
        let Some((place, value, passes)) = task.climb(&found.place.0, &all, &options.scoring) else {
            return (problem, difference);
        };
        found.evaluations += passes;
        if let Cost::Finite(cost) = task.cost(value) {
            found.cost = cost;
        }
        found.place = Candidate(place);
        found.theta = finer.theta(&found.place);
        problem = finer;
    }
}

/// The local runs as documents.
fn starts(task: &LikelihoodObjective, runs: &[LocalRun]) -> Vec<StartReport> {
    let one = |run: &LocalRun| StartReport {
        origin: run.origin,
        from: task.log_likelihood(run.start),
        to: task.log_likelihood(run.end),
        passes: run.evaluations,
        settled: run.settled,
    };
    runs.iter().filter(|run| run.evaluations > 0).map(one).collect()
}

/// Why the search ended, in a sentence.
fn reason(stop: Stop, starts: &[StartReport]) -> String {
    let best = starts.iter().filter_map(|start| start.to).fold(f64::NEG_INFINITY, f64::max);
    let there =
        starts.iter().filter(|start| start.settled && start.to.is_some_and(|to| to > best - 0.1)).count();
    let others = starts
        .iter()
        .filter(|start| start.origin != Origin::Profile)
        .filter_map(|start| start.to)
        .fold(f64::NEG_INFINITY, f64::max);
    let shared =
        format!("{there} of {} local runs end at the largest log-likelihood, {best:.1}", starts.len());
    match stop {
        Stop::Converged if best > others + 0.1 => {
            format!("a profile led to a better place than the restarts had agreed on: {shared}")
        }
        Stop::Converged => format!("restarts agree on the optimum: {shared}"),
        Stop::Stalled => {
            format!("further restarts bring nothing new, although they do not all agree: {shared}")
        }
        Stop::Budget => format!("the evaluations are used up before restarts agree: {shared}"),
        Stop::Deadline => format!("the wall time is used up before restarts agree: {shared}"),
        Stop::Cancelled | Stop::Target => format!("the search was ended from outside: {shared}"),
    }
}

/// Diffusions by state and deviations by channel.
fn noise(
    task: &LikelihoodObjective,
    point: &[f64],
    curvature: &Curvature,
) -> (IndexMap<String, NoiseEstimate>, IndexMap<String, NoiseEstimate>) {
    let model = task.problem.model();
    let own = task.problem.space().len();
    let one = |coordinate: usize, unit: String| {
        let dimension = &task.space.dimensions()[coordinate];
        let value = point[task.places[coordinate]];
        let at_bound = !(AT_BOUND..=1.0 - AT_BOUND).contains(&dimension.unit(value));
        NoiseEstimate {
            value,
            unit,
            ci95: curvature.intervals[coordinate],
            bounds: [dimension.lower, dimension.upper],
            at_bound,
        }
    };
    let states = model.states().iter().enumerate().map(|(i, state)| {
        let unit = format!("{}/h^0.5", error_unit(&state.unit));
        (state.name.clone(), one(own + i, unit))
    });
    let first = own + model.states().len();
    let outputs = model.outputs().iter().enumerate().map(|(i, output)| {
        let unit = error_unit(&output.unit).to_owned();
        (output.channel.clone(), one(first + i, unit))
    });
    (states.collect(), outputs.collect())
}

/// What a reader should know of the noise.
fn noted(likelihood: &LikelihoodReport) -> Vec<String> {
    let mut remarks = Vec::new();
    let still: Vec<&str> = likelihood
        .diffusion
        .iter()
        .filter(|(_, sigma)| sigma.at_bound)
        .map(|(name, _)| name.as_str())
        .collect();
    if !still.is_empty() {
        remarks.push(format!("the data ask for no diffusion of {}", still.join(", ")));
    }
    let sensors: Vec<&str> = likelihood
        .measurement
        .iter()
        .filter(|(_, sigma)| sigma.at_bound)
        .map(|(name, _)| name.as_str())
        .collect();
    if !sensors.is_empty() {
        remarks.push(format!(
            "the diffusion explains all the noise of {}: the sensor's own is a limit, not an estimate",
            sensors.join(", ")
        ));
    }
    remarks
}
