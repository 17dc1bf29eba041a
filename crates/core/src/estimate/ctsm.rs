//! Maximum likelihood of the stochastic model: `dx = f dt + diag(sigma) dw`, `y = h(x) + e`.
//!
//! The parameters, a diffusion per state and a standard deviation per output are searched together, each on its scale,
//! by swarms on the likelihood and Fisher scoring on its slopes. The training part alone is filtered; what comes after it
//! judges the fit as it does any other.

use super::curvature::{Curvature, profiles};
use super::fit::{Fit, Stop};
use super::likelihood::{LikelihoodReport, NoiseEstimate, Profile, StartReport};
use super::metrics::{error_unit, filter_fit, metrics};
use super::problem::Problem;
use super::request::{EstimateRequest, Objective, Prior};
use super::run::{AT_BOUND, Control, EstimateError, Found, Interrupt, drive, fine_enough, report, step_error};
use super::uncertainty::Uncertainty;
use crate::model::Scale as ModelScale;
use crate::optimise::ctsm::CtsmOptions;
use crate::optimise::scoring::{Scoring, ScoringOptions};
use crate::optimise::{Ask, Candidate, Cost, Dimension, Evaluation, LocalRun, Origin, Scale, Search, Slope, Space};
use crate::simulate::likelihood::Likelihood;
use crate::simulate::trajectory::Halt;
use indexmap::IndexMap;
use rayon::prelude::*;

/// Bounds and start of a diffusion per square root of an hour, in multiples of the sensor's noise.
const DIFFUSION: [f64; 3] = [1e-3, 1e3, 6.0];
/// Bounds and start of a measurement deviation, in multiples of the sensor's declared noise.
const MEASUREMENT: [f64; 3] = [1e-4, 100.0, 1.0];
/// The logarithm of a cost beyond which it grows along a straight line: an exponential would leave the numbers.
const STEEPEST: f64 = 300.0;
/// How often the search goes on from a better place that a profile has found.
const MOST_RETURNS: usize = 3;

/// A problem with its noise: the coordinates are the free parameters, a diffusion per state, a deviation per output.
pub struct Likely<'a> {
    problem: &'a Problem,
    likelihood: Likelihood<'a>,
    space: Space,
    /// The place of each coordinate in the point of the likelihood.
    places: Vec<usize>,
    /// How many innovations the training part gives.
    innovations: usize,
}

impl<'a> Likely<'a> {
    /// The task of a problem.
    pub fn new(problem: &'a Problem) -> Self {
        let model = problem.model();
        let parameters = model.parameters().len();
        let sensor = model.outputs()[0].noise_sd;
        let mut dimensions = problem.space().dimensions().to_vec();
        let mut noise = |name: String, [lower, upper, _]: [f64; 3], unit: f64| {
            dimensions.push(Dimension { name, lower: lower * unit, upper: upper * unit, scale: Scale::Log });
        };
        model.states().iter().for_each(|state| noise(format!("sigma({})", state.name), DIFFUSION, sensor));
        model.outputs().iter().for_each(|output| noise(format!("sd({})", output.channel), MEASUREMENT, output.noise_sd));
        let noises = model.states().len() + model.outputs().len();
        let measured = problem.measured();
        let likelihood = Likelihood::new(model, problem.simulator(), problem.inputs(), &measured, problem.free());
        let mut task = Self {
            problem,
            likelihood,
            space: Space::new(dimensions),
            places: problem.free().iter().copied().chain(parameters..parameters + noises).collect(),
            innovations: 0,
        };
        task.innovations = task.count();
        task
    }

    /// The number of innovations does not depend on where the filter is, as long as it stays in the numbers.
    fn count(&self) -> usize {
        let split = self.problem.split();
        let known = self.problem.known();
        let starts: Vec<bool> = self.problem.model().outputs().iter().enumerate().map(|(output, _)| self.begins(output)).collect();
        let began = |k: usize| k == 0 || !known[k - 1];
        let counted = |k: usize, output: usize, valid: &[bool]| valid[k] && !(began(k) && starts[output]);
        self.problem
            .measured()
            .iter()
            .enumerate()
            .map(|(output, (_, valid))| (0..split.train.end).filter(|k| counted(*k, output, valid)).count())
            .sum()
    }

    fn begins(&self, output: usize) -> bool {
        self.problem.model().states().iter().any(|state| state.initial == crate::model::Initial::Measured(output))
    }

    /// How many coordinates are parameters of the model; they come first.
    pub fn parameters(&self) -> usize {
        self.problem.space().len()
    }

    /// The coordinates with their bounds.
    pub fn space(&self) -> &Space {
        &self.space
    }

    /// The place of a full parameter vector, with the noise that a search begins with, or this one.
    pub fn place(&self, theta: &[f64], noise: Option<&[f64]>) -> Vec<f64> {
        let mut place = self.start(&self.problem.candidate(theta)).0;
        let own = self.problem.space().len();
        for ((unit, dimension), value) in place[own..].iter_mut().zip(&self.space.dimensions()[own..]).zip(noise.unwrap_or_default()) {
            *unit = dimension.unit(*value);
        }
        place
    }

    /// The parameters and the noise at a place.
    pub fn values(&self, place: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let mut theta = self.point(place);
        let noise = theta.split_off(self.problem.nominal().len());
        (theta, noise)
    }

    /// The log-likelihood at a place, without any prior, and the number of innovations.
    pub fn log_likelihood_at(&self, place: &[f64]) -> Option<(f64, usize)> {
        let (value, innovations) = self.likelihood.value(&self.point(place), self.problem.split().train.end)?;
        Some((-value, innovations))
    }

    /// A candidate of the problem's own space, with the noise that a search begins with.
    pub(super) fn start(&self, warm: &Candidate) -> Candidate {
        let model = self.problem.model();
        let sensor = model.outputs()[0].noise_sd;
        let noise = model.states().iter().map(|_| DIFFUSION[2] * sensor).chain(model.outputs().iter().map(|o| MEASUREMENT[2] * o.noise_sd));
        let own = self.problem.space().len();
        let units = self.space.dimensions()[own..].iter().zip(noise).map(|(dimension, value)| dimension.unit(value));
        Candidate(warm.0.iter().copied().chain(units).collect())
    }

    /// The point of the likelihood at a candidate.
    fn point(&self, candidate: &[f64]) -> Vec<f64> {
        let mut point = self.problem.nominal().to_vec();
        point.resize(point.len() + self.space.len() - self.problem.space().len(), 0.0);
        for ((place, dimension), unit) in self.places.iter().zip(self.space.dimensions()).zip(candidate) {
            point[*place] = dimension.value(*unit);
        }
        point
    }

    /// The pull of the prior at each coordinate: the deviation of a logarithm from its nominal value.
    fn pull(&self, point: &[f64], coordinate: usize) -> Option<f64> {
        let place = self.places[coordinate];
        let parameter = self.problem.model().parameters().get(place)?;
        let (value, nominal) = (point[place], self.problem.nominal()[place]);
        let pulled = self.problem.prior() == Prior::LogNormal && parameter.scale == ModelScale::Log && value > 0.0 && nominal > 0.0;
        pulled.then(|| (value / nominal).ln())
    }

    /// Minus the log-likelihood, and minus the logarithm of the prior where there is one.
    pub fn value(&self, candidate: &[f64]) -> Option<f64> {
        let point = self.point(candidate);
        let (value, _) = self.likelihood.value(&point, self.problem.split().train.end)?;
        let prior: f64 = (0..self.space.len()).filter_map(|i| self.pull(&point, i)).map(|pull| 0.5 * pull * pull).sum();
        Some(value + prior)
    }

    /// The same with its slopes by the coordinates that `moving` names.
    pub fn slope(&self, candidate: &[f64], moving: &[usize]) -> Option<Slope> {
        let point = self.point(candidate);
        let active: Vec<usize> = moving.iter().map(|coordinate| self.places[*coordinate]).collect();
        let slopes = self.likelihood.slopes(&point, &active, self.problem.split().train.end)?;
        // From physical units to the cube.
        let stretch: Vec<f64> = moving
            .iter()
            .map(|coordinate| {
                let dimension = &self.space.dimensions()[*coordinate];
                match dimension.scale {
                    Scale::Linear => dimension.upper - dimension.lower,
                    Scale::Log => point[self.places[*coordinate]] * (dimension.upper / dimension.lower).ln(),
                }
            })
            .collect();
        let d = moving.len();
        let mut slope = Slope {
            value: slopes.value,
            gradient: slopes.gradient.iter().zip(&stretch).map(|(slope, by)| slope * by).collect(),
            information: (0..d * d).map(|place| slopes.information[place] * stretch[place / d] * stretch[place % d]).collect(),
        };
        for (index, coordinate) in moving.iter().enumerate() {
            if let Some(pull) = self.pull(&point, *coordinate) {
                let dimension = &self.space.dimensions()[*coordinate];
                let by = (dimension.upper / dimension.lower).ln();
                slope.value += 0.5 * pull * pull;
                slope.gradient[index] += pull * by;
                slope.information[index * d + index] += by * by;
            }
        }
        // What does not move is pulled all the same.
        let still = (0..self.space.len()).filter(|coordinate| !moving.contains(coordinate));
        slope.value += still.filter_map(|coordinate| self.pull(&point, coordinate)).map(|pull| 0.5 * pull * pull).sum::<f64>();
        Some(slope)
    }

    /// A likelihood as a cost: the variance of white innovations that would be as likely.
    fn cost(&self, value: f64) -> Cost {
        let logarithm = 2.0 * value / self.innovations.max(1) as f64 - 1.0 - std::f64::consts::TAU.ln();
        let beyond = (logarithm - STEEPEST).max(0.0);
        Cost::new(logarithm.min(STEEPEST).exp() * (1.0 + beyond))
    }

    /// The log-likelihood behind a cost.
    fn log_likelihood(&self, cost: Cost) -> Option<f64> {
        let Cost::Finite(cost) = cost else { return None };
        let top = STEEPEST.exp();
        let logarithm = if cost > top { STEEPEST + cost / top - 1.0 } else { cost.ln() };
        Some(-0.5 * self.innovations as f64 * (logarithm + 1.0 + std::f64::consts::TAU.ln()))
    }

    /// The answers to a question; each candidate by itself, so that their order and number change no bit.
    fn answer(&self, ask: &Ask, halt: Halt) -> Vec<Evaluation> {
        let all: Vec<usize> = (0..self.space.len()).collect();
        let nothing = || Evaluation { cost: Cost::Diverged, residuals: Vec::new(), slope: None };
        let one = |candidate: &Candidate| {
            if halt() {
                return nothing();
            }
            match ask {
                Ask::Slopes(_) => {
                    let slope = self.slope(&candidate.0, &all);
                    let cost = slope.as_ref().map_or(Cost::Diverged, |slope| self.cost(slope.value));
                    Evaluation { cost, slope, ..nothing() }
                }
                _ => Evaluation { cost: self.value(&candidate.0).map_or(Cost::Diverged, |value| self.cost(value)), ..nothing() },
            }
        };
        match ask {
            Ask::Costs(batch) | Ask::Residuals(batch) | Ask::Slopes(batch) => batch.par_iter().map(one).collect(),
            Ask::Done(_) => Vec::new(),
        }
    }

    /// Climbs from a candidate while the other coordinates than `moving` stay: the place, its value, and filter passes.
    pub fn climb(&self, start: &[f64], moving: &[usize], options: &ScoringOptions) -> Option<(Vec<f64>, f64, usize)> {
        let whole = |part: &[f64]| {
            let mut whole = start.to_vec();
            moving.iter().zip(part).for_each(|(coordinate, unit)| whole[*coordinate] = *unit);
            whole
        };
        let first = Candidate(moving.iter().map(|coordinate| start[*coordinate]).collect());
        let mut run = Scoring::new(options, &first);
        let mut best = None;
        let mut passes = 0;
        while let Some(trial) = run.propose() {
            passes += 1;
            let place = whole(&trial.0);
            let slope = self.slope(&place, moving);
            let cost = slope.as_ref().map_or(Cost::Diverged, |slope| self.cost(slope.value));
            if let Some(value) = slope.as_ref().map(|slope| slope.value)
                && best.as_ref().is_none_or(|(_, known)| value < *known)
            {
                best = Some((place, value));
            }
            run.digest(&Evaluation { cost, residuals: Vec::new(), slope });
        }
        best.map(|(place, value)| (place, value, passes))
    }
}

/// Estimates by maximum likelihood.
///
/// # Errors
/// [`EstimateError`] where nothing finite was found or somebody stopped it.
pub(super) fn estimate(
    problem: &Problem,
    request: &EstimateRequest,
    options: &CtsmOptions,
    warm: &[Candidate],
    control: &Control,
) -> Result<Fit, EstimateError> {
    let task = Likely::new(problem);
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
    let task = Likely::new(&problem);
    let (curvature, profiles) = peak(&task, &mut found, &mut starts, options, control);
    // A cancelled search has no result, wherever it was.
    if let Some(Interrupt::Cancelled) = (control.interrupt)() {
        return Err(EstimateError::Interrupted(Interrupt::Cancelled));
    }
    let reason = reason(found.stop, &starts);
    let mut remarks: Vec<String> = problem.model().dropped().iter().map(|what| format!("left out: {what}")).collect();
    remarks.append(&mut found.remarks);
    let own = problem.space().len();
    let known = Uncertainty {
        ci95: curvature.intervals[..own].to_vec(),
        correlated: curvature.correlated(&task, own),
        evaluations: curvature.passes,
    };
    let point = task.point(&found.place.0);
    // The prior is no part of the likelihood that is reported.
    let (log_likelihood, innovations) = task.log_likelihood_at(&found.place.0).ok_or(EstimateError::NothingFinite)?;
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
        remarks.push("the validation part chose between candidates, so its error is not that of unseen data".to_owned());
    }
    let mut fit = report(&problem, request, found, &known, discretisation_error, remarks);
    let limits: Vec<&str> = fit.parameters.iter().filter(|(_, estimate)| estimate.at_bound).map(|(name, _)| name.as_str()).collect();
    if !limits.is_empty() {
        fit.remarks.push(format!("{} sits on a bound of the search: the value is a limit, not an estimate", limits.join(", ")));
    }
    fit.objective = Objective::Likelihood.word().to_owned();
    fit.likelihood = Some(likelihood);
    // Forecasts and innovations with the noise that was estimated.
    let run = filter_fit(&problem, &fit);
    fit.process_noise = run.process_noise;
    fit.metrics = metrics(&problem, &fit.theta(), &run);
    Ok(fit)
}

/// The curvature and the profiles of the optimum. A profile that comes to a better place shows that there is another one: the
/// search goes on from there.
fn peak(
    task: &Likely,
    found: &mut Found,
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
fn refine(problem: &Problem, found: &mut Found, options: &CtsmOptions) -> (Problem, f64) {
    let mut problem = problem.clone();
    loop {
        let (finer, difference) = step_error(&problem, &found.theta);
        found.evaluations += 2;
        if fine_enough(&problem, difference) {
            return (problem, difference);
        }
        let task = Likely::new(&finer);
        let all: Vec<usize> = (0..task.space.len()).collect();
        let Some((place, value, passes)) = task.climb(&found.place.0, &all, &options.scoring) else { return (problem, difference) };
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
fn starts(task: &Likely, runs: &[LocalRun]) -> Vec<StartReport> {
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
    let there = starts.iter().filter(|start| start.settled && start.to.is_some_and(|to| to > best - 0.1)).count();
    let others =
        starts.iter().filter(|start| start.origin != Origin::Profile).filter_map(|start| start.to).fold(f64::NEG_INFINITY, f64::max);
    let shared = format!("{there} of {} local runs end at the largest log-likelihood, {best:.1}", starts.len());
    match stop {
        Stop::Converged if best > others + 0.1 => format!("a profile led to a better place than the restarts had agreed on: {shared}"),
        Stop::Converged => format!("restarts agree on the optimum: {shared}"),
        Stop::Stalled => format!("further restarts bring nothing new, although they do not all agree: {shared}"),
        Stop::Budget => format!("the evaluations are used up before restarts agree: {shared}"),
        Stop::Deadline => format!("the wall time is used up before restarts agree: {shared}"),
        Stop::Cancelled | Stop::Target => format!("the search was ended from outside: {shared}"),
    }
}

/// Diffusions by state and deviations by channel.
fn noise(task: &Likely, point: &[f64], curvature: &Curvature) -> (IndexMap<String, NoiseEstimate>, IndexMap<String, NoiseEstimate>) {
    let model = task.problem.model();
    let own = task.problem.space().len();
    let one = |coordinate: usize, unit: String| {
        let dimension = &task.space.dimensions()[coordinate];
        let value = point[task.places[coordinate]];
        let at_bound = !(AT_BOUND..=1.0 - AT_BOUND).contains(&dimension.unit(value));
        NoiseEstimate { value, unit, ci95: curvature.intervals[coordinate], bounds: [dimension.lower, dimension.upper], at_bound }
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
    let still: Vec<&str> = likelihood.diffusion.iter().filter(|(_, sigma)| sigma.at_bound).map(|(name, _)| name.as_str()).collect();
    if !still.is_empty() {
        remarks.push(format!("the data ask for no diffusion of {}", still.join(", ")));
    }
    let sensors: Vec<&str> = likelihood.measurement.iter().filter(|(_, sigma)| sigma.at_bound).map(|(name, _)| name.as_str()).collect();
    if !sensors.is_empty() {
        remarks
            .push(format!("the diffusion explains all the noise of {}: the sensor's own is a limit, not an estimate", sensors.join(", ")));
    }
    remarks
}
