//! The document of a fit from what a search has found.

use super::fit::covariance::Covariance;
use super::fit::{Estimate, Fit, Parts, Span, Stop};
use super::problem::Problem;
use super::uncertainty::Uncertainty;
use crate::data::Seconds;
use crate::data::rfc3339;
use crate::estimate::assess::metrics::{ProcessNoise, filtered_and_free, metrics};
use crate::estimate::fit::levels::levels;
use crate::estimate::problem::bounds::at_bound;
use crate::estimate::problem::prior::{KnownParameter, KnownPrior, Prior};
use crate::estimate::problem::request::EstimateRequest;
use crate::estimate::search::drive::SearchResult;
use crate::estimate::uncertainty::ridge::sentence;
use indexmap::IndexMap;
use std::ops::Range;

/// The document of a fit, the process noise of whose filter is sought so.
pub(super) fn report(
    problem: &Problem,
    request: &EstimateRequest,
    found: SearchResult,
    uncertainty: &Uncertainty,
    discretisation_error: f64,
    noise: ProcessNoise,
    mut remarks: Vec<String>,
) -> Fit {
    let (run, free) = filtered_and_free(problem, &found.theta, noise);
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
    remarks.extend(coarse(problem));
    remarks.extend(uncertainty.correlated.iter().map(|pair| sentence(pair, problem.model())));
    remarks.extend(uncertainty.covariance.as_ref().and_then(Covariance::sentence));
    remarks.extend(problem.predictor().remark());
    remarks.extend(problem.prior().remark());
    if found.stop != Stop::Converged {
        remarks.push("the search ended before two of its restarts agreed".to_owned());
    }
    Fit {
        model: problem.model().id().to_string(),
        model_hash: problem.model().hash().to_owned(),
        dropped: problem.model().dropped().to_vec(),
        parameters,
        correlated: uncertainty.correlated.clone(),
        covariance: uncertainty.covariance.clone(),
        method: request.method.method.name().to_owned(),
        objective: problem.objective().as_str().to_owned(),
        cost: found.cost,
        stopped_by: found.stop,
        searched: Some(found.searched),
        seed: request.method.seed,
        evaluations: found.evaluations,
        trace: found.trace,
        metrics: metrics(problem, &found.theta, &run, &free),
        sample_s: Seconds::of_millis(problem.grid().step()),
        substeps: problem.simulator().substeps(),
        starts: uncertainty.starts.clone(),
        // A document has no word for infinity, and one that held it could not be read again.
        discretisation_error: Some(discretisation_error).filter(|error| error.is_finite()),
        process_noise: run.process_noise,
        parts: parts(problem),
        input_hash: problem.input_hash().to_owned(),
        basis: Some(problem.basis().clone()),
        worst_regime: None,
        changed: None,
        prior: known_of(problem),
        remarks,
        non_identifiable: Vec::new(),
        levels: levels(problem),
        likelihood: None,
    }
}

/// What the prior knows of the free parameters.
fn known_of(problem: &Problem) -> Option<KnownPrior> {
    let known = |index: &usize| {
        Some((problem.model().parameters()[*index].name.clone(), problem.known_before(*index)?))
    };
    let parameters: IndexMap<String, KnownParameter> = problem.free().iter().filter_map(known).collect();
    let from = match problem.prior() {
        Prior::Known(known) => known.from.clone(),
        _ => Vec::new(),
    };
    (!parameters.is_empty()).then_some(KnownPrior { from, parameters })
}

fn parts(problem: &Problem) -> Parts {
    let span = |range: &Range<usize>| {
        (!range.is_empty()).then(|| Span {
            from: rfc3339(problem.grid().time(range.start)),
            to: rfc3339(problem.grid().time(range.end - 1)),
        })
    };
    let split = problem.split();
    Parts {
        train: span(&split.train).unwrap_or(Span { from: String::new(), to: String::new() }),
        validation: span(&split.validation),
        test: span(&split.test),
    }
}

/// That most samples of the output are left out, where the fit goes by a longer step than they come by.
fn coarse(problem: &Problem) -> Option<String> {
    let (own, step) = (problem.source().step?, problem.grid().step());
    (2 * own <= step).then(|| {
        format!(
            "the output comes every {}, and the fit goes by steps of {}: ask for `step` to use all of it",
            Seconds::of_millis(own),
            Seconds::of_millis(step)
        )
    })
}
