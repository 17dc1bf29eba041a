//! The loop around an optimiser: ask, simulate, tell, until something says stop.

use super::control::{Control, EstimateError, Progress};
use crate::estimate::fit::{Searched, Stop, TracePoint};
use crate::estimate::problem::Problem;
use crate::estimate::problem::stop::{EarlyStopping, Watch};
use crate::interrupt::Interrupt;
use crate::optimise::local_options::LocalOptions;
use crate::optimise::multistart::LmOptions;
use crate::optimise::{Ask, Candidate, Cost, Evaluation, LocalRun, Method, Search, Termination};
use crate::simulate::trajectory::Halt;
use std::sync::Arc;

/// What a search found.
pub(in crate::estimate) struct SearchResult {
    pub theta: Vec<f64>,
    /// The same in the unit cube of the search, which may have more coordinates than parameters.
    pub place: Candidate,
    pub cost: f64,
    pub stop: Stop,
    pub searched: Searched,
    pub evaluations: usize,
    pub trace: Vec<TracePoint>,
    /// The local runs, where the search keeps count of them.
    pub runs: Vec<LocalRun>,
    /// What a reader of the fit should know of the search.
    pub remarks: Vec<String>,
}

/// Evaluations for a polish by least squares from a known point.
pub(in crate::estimate) const POLISH_EVALUATIONS: usize = 1500;
/// Iterations from what loose steps or a coarser grid have found to the optimum of exact ones.
const FURTHER_ITERATIONS: usize = 3;

/// Looks at the validation part that only tell how a search goes: each is one simulation up to its end, and
/// as much as so many of those is done on the training part in between.
const BETWEEN_LOOKS: usize = 100;

/// Ask, simulate, tell. The first coordinates of a candidate are the free parameters of the problem.
pub(in crate::estimate) fn drive(
    problem: &Problem,
    answer: &dyn Fn(&Ask, Halt) -> Vec<Evaluation>,
    method: &Method,
    search: Search,
    early: Option<EarlyStopping>,
    control: &Control,
) -> Result<SearchResult, EstimateError> {
    if search.dimensions == 0 {
        let cost = problem
            .evaluate(&[Candidate(Vec::new())], false)
            .first()
            .map_or(Cost::Diverged, |evaluation| evaluation.cost);
        let Cost::Finite(cost) = cost else {
            return Err(EstimateError::NothingFinite);
        };
        let theta = problem.nominal().to_vec();
        let (place, stop) = (Candidate(Vec::new()), Stop::Converged);
        return Ok(SearchResult {
            theta,
            place,
            cost,
            stop,
            searched: Searched::Global,
            evaluations: 1,
            trace: Vec::new(),
            runs: Vec::new(),
            remarks: Vec::new(),
        });
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
                    Termination::Converged => Stop::Converged,
                    Termination::Stalled => Stop::Stalled,
                    Termination::Budget => Stop::Budget,
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
    let (place, cost) = watch
        .and_then(Watch::kept)
        .map_or_else(|| (best.clone(), cost), |(place, cost)| (Candidate(place), cost));
    let (theta, runs) = (problem.theta(&place), optimiser.runs());
    let (searched, evaluations) = (Searched::Global, progress.evaluations);
    Ok(SearchResult { theta, place, cost, stop, searched, evaluations, trace, runs, remarks })
}

/// The answers to a question, from free runs.
pub(in crate::estimate) fn evaluate(problem: &Problem, ask: &Ask, halt: Halt) -> Vec<Evaluation> {
    match ask {
        Ask::Costs(candidates) | Ask::Slopes(candidates) => problem.evaluate_unless(candidates, false, halt),
        Ask::Residuals(candidates) => problem.evaluate_unless(candidates, true, halt),
        Ask::Done(_) => Vec::new(),
    }
}

/// Least squares from a known point, with so many evaluations; `None` where it goes nowhere or the wall time
/// is used up: what was found before then stays.
pub(in crate::estimate) fn polish(
    problem: &Problem,
    theta: &[f64],
    budget: usize,
    control: &Control,
) -> Result<Option<SearchResult>, EstimateError> {
    let method = Method::LmMultistart(LmOptions { starts: 1, ..LmOptions::default() });
    let search = Search {
        dimensions: problem.space().len(),
        seed: 0,
        budget,
        warm: vec![problem.candidate(theta)],
        residuals: true,
    };
    match drive(problem, &|ask, halt| evaluate(problem, ask, halt), &method, search, None, control) {
        Ok(found) => Ok(Some(found)),
        Err(EstimateError::NothingFinite | EstimateError::Interrupted(Interrupt::Deadline)) => Ok(None),
        Err(cancelled) => Err(cancelled),
    }
}

/// Some iterations of least squares on a problem, from what was found on a rougher one; as it was found, with
/// the cost that it has here, where there is no time for that. Says whether it has a cost here.
pub(in crate::estimate) fn polish_further(
    problem: &Problem,
    found: &mut SearchResult,
    control: &Control,
) -> Result<bool, EstimateError> {
    let budget = FURTHER_ITERATIONS * (problem.space().len() + LocalOptions::default().trials) + 1;
    if let Some(polished) = polish(problem, &found.theta, budget, control)? {
        (found.theta, found.place, found.cost) = (polished.theta, polished.place, polished.cost);
        found.evaluations += polished.evaluations;
        return Ok(true);
    }
    let answer = problem.evaluate(&[problem.candidate(&found.theta)], false);
    let cost = answer.first().map_or(Cost::Diverged, |evaluation| evaluation.cost);
    if let Cost::Finite(cost) = cost {
        found.cost = cost;
    }
    Ok(cost != Cost::Diverged)
}

fn validation_rmse(problem: &Problem, theta: &[f64]) -> Option<f64> {
    let range = problem.split().validation.clone();
    if range.is_empty() {
        return None;
    }
    let run = problem.simulator().run(&[theta], range.end).pop()?;
    problem.free_run_error(&run, range)
}
