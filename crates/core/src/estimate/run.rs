//! The loop around an optimiser: ask, simulate, tell, until something says stop; then the fit's report.

use super::fit::{Fit, Searched, Stop};
use super::likelihood;
use super::problem::Problem;
use super::report::report;
use super::uncertainty::sensitivity::Sensitivity;
use super::uncertainty::{louder_than_white, simulations, starts, uncertainty};
use crate::estimate::assess::metrics::ProcessNoise;
use crate::estimate::discretisation::{StepError, step_error};
use crate::estimate::fit::incumbent::Incumbent;
use crate::estimate::problem::bounds::at_bound;
use crate::estimate::problem::predictor::Predictor;
use crate::estimate::problem::prior::Prior;
use crate::estimate::problem::request::{EstimateRequest, SearchExtent, StartFrom};
use crate::estimate::search::control::{Control, EstimateError};
use crate::estimate::search::drive::{
    POLISH_EVALUATIONS, SearchResult, drive, evaluate, polish, polish_further,
};
use crate::estimate::search::near::{Unconvincing, as_promised, near};
use crate::estimate::uncertainty::ridge::follow;
use crate::optimise::Method;
use crate::optimise::{Candidate, Cost, Search};

/// A fit with a parameter fixed may be this much worse on the hold-out before the parameter counts.
const FIXED_MAY_BE_WORSE: f64 = 1.02;
/// Parameters that were fixed because the data did not determine them are free again where so much of the
/// squared error is left then.
const FREED: f64 = 0.98;
/// What a search has found on a coarser grid may cost this much more on the problem's own, which has other
/// noise as well.
const AS_COARSE: f64 = 1.5;
/// How often the starts of the measured states are looked for.
const MOST_STARTS: usize = 5;
/// A start that is farther from its estimate, in deviations of that, is hardly where it was taken to be.
const HARDLY: f64 = 2.0;
/// Starts that move by less, in the same deviations, are where they were.
const SAME_START: f64 = 0.1;

/// What was found, with steps that are short enough and starts that are likely.
struct Refined {
    problem: Problem,
    found: SearchResult,
    /// What half the step changes.
    difference: f64,
    /// What the outputs answer there, where that is known.
    sensitivity: Option<Sensitivity>,
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
        return likelihood::estimate(problem, request, options, &warm, control);
    }
    let watched = request.early_stopping.is_some_and(|rule| rule.validation);
    let known = incumbent.filter(|incumbent| {
        request.search == SearchExtent::Local
            && incumbent.is_of(problem)
            && request.start_from == StartFrom::Current
            && request.early_stopping.is_none()
    });
    let everywhere = || {
        let search = |problem: &Problem| search(problem, request, &warm, control);
        // What ends by least squares is polished with exact steps; any other method finds what it finds.
        let is_loose = !watched && request.method.method.descends();
        let (problem, found) = sought(&problem.with_loose_steps(is_loose), search, control)?;
        let (problem, found) = exactly(problem, found, control)?;
        refined(problem, found, watched, control)
    };
    let refined = match known {
        None => everywhere()?,
        Some(incumbent) => match next_to(problem, incumbent, control) {
            Ok(found) => found,
            Err(Unconvincing::Error(error)) => return Err(error),
            Err(Unconvincing::Because(why, spent)) => {
                let mut refined = everywhere()?;
                refined.found.evaluations += spent;
                refined.found.remarks.push(format!("everywhere was searched: {why}"));
                refined
            }
        },
    };
    let Refined { problem, mut found, difference, sensitivity } = refined;
    let mut remarks: Vec<String> =
        problem.model().dropped().iter().map(|what| format!("left out: {what}")).collect();
    remarks.append(&mut found.remarks);
    if watched {
        remarks.push(
            "the validation part chose between candidates, so its error is not that of unseen data"
                .to_owned(),
        );
    }
    let nearby = known.filter(|_| found.searched == Searched::Local);
    // A search everywhere looks everywhere for the noise as well.
    let noise = nearby.and_then(|known| known.process_noise);
    let noise = noise.map_or(ProcessNoise::Likeliest, ProcessNoise::LikeliestNear);
    let limits = nearby.map(|known| known.limits.as_slice());
    let (problem, mut non_identifiable) =
        fix_unidentifiable(problem, &mut found, limits.unwrap_or_default(), &mut remarks, control)?;
    // With other parameters fixed the outputs answer otherwise.
    let sensitivity = sensitivity.filter(|_| non_identifiable.is_empty());
    if let Some(known) = nearby {
        let fixed = known.still_undetermined(&problem, &non_identifiable);
        if !fixed.is_empty() {
            let names = fixed.join(", ");
            remarks.push(format!(
                "the data have not determined {names} before: fixed at the nominal value as they were"
            ));
        }
        non_identifiable.extend(fixed);
    }
    let mut known = uncertainty(&problem, &found.theta, sensitivity);
    found.evaluations += known.evaluations;
    match problem.predictor() {
        // A likelihood has profiles, which `ctsm` gives.
        Predictor::Filtered => {}
        Predictor::FreeRun => {
            found.evaluations += follow(&problem, &found.theta, found.cost, &mut known, control)?;
        }
    }
    let mut fit = report(&problem, request, found, &known, difference, noise, remarks);
    fit.non_identifiable = non_identifiable;
    Ok(fit)
}

/// The optimum next to what is served, with the parameters fixed that the data have not determined before,
/// unless they clearly do now; as good as what is served has promised.
fn next_to(problem: &Problem, incumbent: &Incumbent, control: &Control) -> Result<Refined, Unconvincing> {
    let near = |problem: &Problem| near(problem, incumbent, control);
    let (mut at, mut found) = sought(&incumbent.as_determined(problem), near, control)?;
    if !incumbent.undetermined.is_empty() {
        let (all_free, free) = sought(problem, near, control)?;
        let evaluations = found.evaluations + free.evaluations;
        if free.cost < FREED * found.cost {
            (at, found) = (all_free, free);
        }
        found.evaluations = evaluations;
    }
    let refined = refined(at, found, false, control)?;
    as_promised(&refined.problem, &refined.found, incumbent)?;
    Ok(refined)
}

/// With steps that are short enough, and starts that are likely, unless the validation part has been watched.
fn refined(
    problem: Problem,
    found: SearchResult,
    watched: bool,
    control: &Control,
) -> Result<Refined, EstimateError> {
    let refined = refine_step(problem, found, watched, control)?;
    Ok(if watched { refined } else { refine_starts(refined) })
}

/// Searches, and draws what was found to what is known beforehand.
fn sought<E: From<EstimateError>>(
    problem: &Problem,
    search: impl Fn(&Problem) -> Result<SearchResult, E>,
    control: &Control,
) -> Result<(Problem, SearchResult), E> {
    Ok(match problem.prior() {
        Prior::None | Prior::Siblings => (problem.clone(), search(problem)?),
        Prior::LogNormal | Prior::Known(_) => drawn(problem, search(&problem.without_prior())?, control)?,
    })
}

/// What was found with loose steps, polished with exact ones, and as it is where its steps were no loose ones
/// or exact ones lead nowhere.
fn exactly(
    loose: Problem,
    mut found: SearchResult,
    control: &Control,
) -> Result<(Problem, SearchResult), EstimateError> {
    let problem = loose.with_loose_steps(false);
    let is_exact = !loose.simulator().has_loose_steps() || polish_further(&problem, &mut found, control)?;
    Ok((if is_exact { problem } else { loose }, found))
}

/// The served parameters where they are wanted and known, and the nominal ones.
fn warm_starts(
    problem: &Problem,
    request: &EstimateRequest,
    incumbent: Option<&Incumbent>,
) -> Vec<Candidate> {
    let mut starts = Vec::new();
    if let (StartFrom::Current, Some(incumbent)) = (request.start_from, incumbent) {
        starts.push(problem.candidate(&incumbent.on(problem)));
    } else {
        starts.push(problem.candidate(problem.nominal()));
    }
    starts
}

/// Runs one optimiser to its end: on a coarser grid where what it finds is polished anyway and means the same
/// on the problem's own.
fn search(
    problem: &Problem,
    request: &EstimateRequest,
    warm: &[Candidate],
    control: &Control,
) -> Result<SearchResult, EstimateError> {
    let on = |problem: &Problem| {
        let search = Search {
            dimensions: problem.space().len(),
            seed: request.method.seed,
            budget: request.budget.evaluations,
            warm: warm.to_vec(),
            residuals: true,
        };
        drive(
            problem,
            &|ask, halt| evaluate(problem, ask, halt),
            &request.method.method,
            search,
            request.early_stopping,
            control,
        )
    };
    let watched = request.early_stopping.is_some_and(|rule| rule.validation);
    let coarser = (request.method.method.descends() && !watched).then(|| problem.coarser()).flatten();
    let Some(coarser) = coarser else { return on(problem) };
    let mut found = on(&coarser)?;
    let promised = found.cost;
    let is_finite = polish_further(problem, &mut found, control)?;
    if is_finite && (found.cost <= AS_COARSE * promised || found.stop == Stop::Deadline) {
        return Ok(found);
    }
    let again = on(problem)?;
    Ok(SearchResult { evaluations: found.evaluations + again.evaluations, ..again })
}

/// Draws what was found without a prior to what is known beforehand, from there and from the middle of what
/// is known. The errors of a free run are alike for hours, and say less than as many that are white: the
/// prior's weight is the variance of white ones that would leave the parameters as uncertain.
fn drawn(
    problem: &Problem,
    free: SearchResult,
    control: &Control,
) -> Result<(Problem, SearchResult), EstimateError> {
    let louder = louder_than_white(problem, &free.theta).unwrap_or(1.0);
    let drawn = problem.with_prior_variance(free.cost * louder);
    let mut known = free.theta.clone();
    for index in problem.free() {
        if let Some(prior) = problem.known_before(*index) {
            let [lower, upper] = problem.bounds()[*index];
            known[*index] = prior.value.clamp(lower, upper);
        }
    }
    let there = drawn.evaluate(&[drawn.candidate(&free.theta)], false);
    let cost = match there.first().map(|evaluation| evaluation.cost) {
        Some(Cost::Finite(cost)) => cost,
        _ => f64::INFINITY,
    };
    let mut evaluations = free.evaluations + simulations(problem) + 1;
    let mut best = SearchResult { cost, ..free };
    for start in [best.theta.clone(), known] {
        let Some(found) = polish(&drawn, &start, POLISH_EVALUATIONS, control)? else { continue };
        evaluations += found.evaluations;
        if found.cost < best.cost {
            best = SearchResult { theta: found.theta, place: found.place, cost: found.cost, ..best };
        }
    }
    Ok((drawn, SearchResult { evaluations, ..best }))
}

/// Compares with half the step; where the difference is too large the step is halved and the fit polished,
/// unless another part than that of training has `chosen` it.
fn refine_step(
    mut problem: Problem,
    mut found: SearchResult,
    chosen: bool,
    control: &Control,
) -> Result<Refined, EstimateError> {
    loop {
        let StepError { finer, difference, fine_enough, sensitivity, evaluations } =
            step_error(&problem, &found.theta);
        found.evaluations += evaluations;
        if fine_enough {
            return Ok(Refined { problem, found, difference, sensitivity });
        }
        if chosen {
            let again = finer.evaluate(&[finer.candidate(&found.theta)], false);
            let Some(Cost::Finite(cost)) = again.first().map(|evaluation| evaluation.cost) else {
                return Ok(Refined { problem, found, difference, sensitivity });
            };
            (problem, found.cost, found.evaluations) = (finer, cost, found.evaluations + 1);
            continue;
        }
        let Some(polished) = polish(&finer, &found.theta, POLISH_EVALUATIONS, control)? else {
            return Ok(Refined { problem, found, difference, sensitivity });
        };
        problem = finer;
        found = SearchResult {
            theta: polished.theta,
            cost: polished.cost,
            evaluations: found.evaluations + polished.evaluations,
            ..found
        };
    }
}

/// Moves the starts of the measured states to where they most likely were, where they are hardly where the
/// first measurements have them, and the parameters along. A start that makes the fit no better is not taken.
fn refine_starts(refined: Refined) -> Refined {
    let Refined { mut problem, mut found, difference, mut sensitivity } = refined;
    let mut least = HARDLY;
    for _ in 0..MOST_STARTS {
        if sensitivity.is_none() {
            sensitivity = Sensitivity::new(&problem, &found.theta);
            found.evaluations += simulations(&problem);
        }
        let starts = sensitivity.as_ref().and_then(|known| starts::of(&problem, &found.theta, known));
        let Some(starts) = starts else { break };
        if starts.moved < least {
            break;
        }
        let moved = problem.with_starts(starts.likely);
        let answer = moved.evaluate(std::slice::from_ref(&starts.parameters), false);
        found.evaluations += 1;
        let cost = answer.first().map_or(Cost::Diverged, |evaluation| evaluation.cost);
        let Cost::Finite(cost) = cost else { break };
        if cost >= found.cost {
            break;
        }
        let theta = moved.theta(&starts.parameters);
        (problem, found, least) = (moved, SearchResult { theta, cost, ..found }, SAME_START);
        sensitivity = None;
    }
    Refined { problem, found, difference, sensitivity }
}

/// Fixes parameters on a bound at their nominal values where the hold-out is no worse for it. Of some it is
/// known to be worse.
fn fix_unidentifiable(
    problem: Problem,
    found: &mut SearchResult,
    limits: &[String],
    remarks: &mut Vec<String>,
    control: &Control,
) -> Result<(Problem, Vec<String>), EstimateError> {
    let on_bound: Vec<usize> =
        problem.free().iter().copied().filter(|index| at_bound(&problem, &found.theta, *index)).collect();
    if on_bound.is_empty() {
        return Ok((problem, Vec::new()));
    }
    let names: Vec<String> =
        on_bound.iter().map(|index| problem.model().parameters()[*index].name.clone()).collect();
    let limit =
        format!("{} sits on a bound of the search: the value is a limit, not an estimate", names.join(", "));
    // Only unseen data can say that a parameter is not needed.
    let unseen = problem.split().validation.clone();
    if unseen.is_empty() || names.iter().all(|name| limits.contains(name)) {
        remarks.push(limit);
        return Ok((problem, Vec::new()));
    }
    let at_nominal: Vec<(usize, f64)> =
        on_bound.iter().map(|index| (*index, problem.nominal()[*index])).collect();
    let fixed = problem.with_fixed(&at_nominal);
    let mut start = found.theta.clone();
    at_nominal.iter().for_each(|(index, value)| start[*index] = *value);
    let error =
        |problem: &Problem, theta: &[f64]| problem.free_run_error(&problem.simulate(theta), unseen.clone());
    // A refit that goes nowhere only means that the parameters matter.
    let loose = fixed.with_loose_steps(true);
    let refit = polish(&loose, &start, POLISH_EVALUATIONS, control)?;
    let spent = refit.as_ref().map_or(0, |refit| refit.evaluations);
    if let Some(refit) = refit
        && let (Some(with), Some(without)) =
            rayon::join(|| error(&problem, &found.theta), || error(&fixed, &refit.theta))
        && without <= FIXED_MAY_BE_WORSE * with
    {
        remarks.push(format!(
            "the data do not determine {}: fixed at the nominal value, the error on unseen data is no worse",
            names.join(", ")
        ));
        let (fixed, refit) = exactly(loose, refit, control)?;
        (found.theta, found.cost) = (refit.theta, refit.cost);
        found.evaluations += refit.evaluations;
        return Ok((fixed, names));
    }
    found.evaluations += spent;
    remarks.push(limit);
    Ok((problem, Vec::new()))
}
