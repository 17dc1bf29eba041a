//! The ladder by likelihood: effects are added one after another while a likelihood-ratio test speaks for
//! them, as Bacher and Madsen (Energy and Buildings 43, 2011) select a model.

use super::course::Course;
use super::error::{DiagnoseError, interrupted};
use super::ladder::{Ladder, Step};
use super::library::{CandidateEffect, EffectSource, align};
use crate::data::Window;
use crate::estimate::assess::metrics::{HORIZONS, ahead, filter_with};
use crate::estimate::likelihood::ml_estimate::MlEstimate;
use crate::estimate::likelihood::ratio::{LikelihoodRatio, SIGNIFICANT};
use crate::estimate::{Control, Problem, Site};
use crate::fault::Fault;
use crate::model::Catalogue;
use rayon::prelude::*;
use std::ops::Range;

/// Builds the ladder from a parameter vector: at most `max_steps` effects, each the one for which the test
/// speaks most.
///
/// As the best of many is taken, its probability is multiplied by their number (Bonferroni). The first step
/// for which the test does not speak ends the ladder.
///
/// # Errors
/// [`DiagnoseError`] where the model diverges, the window does not serve, or `control` interrupts.
pub fn ladder_by_likelihood(
    catalogue: &Catalogue,
    problem: &Problem,
    theta: &[f64],
    window: &Window,
    site: &Site,
    max_steps: usize,
    control: &Control,
) -> Result<Ladder, DiagnoseError> {
    let nothing = || DiagnoseError::nothing(control);
    if let Some(detail) = problem.predictor().lacks_filter_for("the ladder by likelihood") {
        return Err(DiagnoseError::Faults(vec![Fault::new("/model", "stepper", detail)]));
    }
    let source = EffectSource::new(catalogue, problem, window, site)
        .map_err(|fault| DiagnoseError::Faults(vec![fault]))?;
    let course = Course::new(control, problem.predictor(), 0, max_steps);
    let mut base = problem.clone();
    let mut optimum: Option<MlEstimate> = None;
    let mut steps: Vec<Step> = Vec::new();
    for _ in 0..max_steps {
        let (mut library, _) = source.candidates(&base);
        base = align(&base, &mut library);
        course.round(library.len(), f64::INFINITY, false);
        // The samples may have changed, so the smaller model is fitted to them again.
        let (from, noise) = optimum
            .as_ref()
            .map_or((theta, None), |optimum| (optimum.theta.as_slice(), Some(optimum.noise.as_slice())));
        let here = MlEstimate::near(&base, &[from.to_vec()], noise).ok_or_else(nothing)?;
        if steps.is_empty() {
            steps.push(step(&base, &here, None, None));
        }
        course.going_on(library.len());
        let rivals: Vec<Option<(MlEstimate, LikelihoodRatio)>> = library
            .par_iter()
            .map(|candidate| {
                if control.halts() {
                    return None;
                }
                let there = MlEstimate::near(
                    &candidate.problem,
                    &starts(candidate, &base, &here.theta),
                    Some(&here.noise),
                )?;
                let test = there.against(
                    &here,
                    library.len(),
                    [&base.model().id().to_string(), &candidate.problem.model().id().to_string()],
                )?;
                let price = test.degrees_of_freedom as f64 * (there.innovations as f64).ln();
                course.tried(&candidate.id, test.statistic - price, None, 0);
                Some((there, test))
            })
            .collect();
        interrupted(control)?;
        // Of two that chance explains equally badly, the larger gain counts.
        let order = |a: &LikelihoodRatio, b: &LikelihoodRatio| {
            a.p.total_cmp(&b.p).then(b.statistic.total_cmp(&a.statistic))
        };
        let best = library
            .iter()
            .zip(rivals)
            .filter_map(|(candidate, rival)| rival.map(|(optimum, test)| (candidate, optimum, test)))
            .min_by(|a, b| order(&a.2, &b.2));
        let Some((candidate, there, test)) = best else { break };
        let kept = test.p < SIGNIFICANT;
        steps.push(step(&candidate.problem, &there, Some(candidate.id.clone()), Some(test)));
        if !kept {
            break;
        }
        base = candidate.problem.clone();
        optimum = Some(there);
    }
    Ok(Ladder { system: None, steps })
}

/// Where a fit with the effect starts: with the effect switched off, and at its nominal strength.
fn starts(candidate: &CandidateEffect, base: &Problem, theta: &[f64]) -> Vec<Vec<f64>> {
    let off = candidate.lift(base, theta);
    let mut nominal = off.clone();
    candidate.own.iter().for_each(|(index, _)| nominal[*index] = candidate.problem.nominal()[*index]);
    vec![off, nominal]
}

fn step(
    problem: &Problem,
    optimum: &MlEstimate,
    added: Option<String>,
    test: Option<LikelihoodRatio>,
) -> Step {
    let trajectory = problem.simulate(&optimum.theta);
    let split = problem.split();
    let part = |range: &Range<usize>| problem.mean_square_error(&trajectory, 0, range.clone()).map(f64::sqrt);
    let run = filter_with(problem, &optimum.theta, &optimum.filter_noise(problem));
    let errors = ahead(problem, &optimum.theta, &run, split.validation.clone(), &HORIZONS);
    let names = problem.model().parameters().iter().map(|parameter| parameter.name.clone());
    Step {
        model: problem.model().id().to_string(),
        added,
        train_rmse: part(&split.train).unwrap_or(f64::NAN),
        validation_rmse: part(&split.validation),
        test_rmse: part(&split.test),
        ahead: errors.into_iter().map(|(name, error)| (name, error.rmse)).collect(),
        bic: optimum.estimated as f64 * (optimum.innovations as f64).ln() - 2.0 * optimum.log_likelihood,
        parameters: names.zip(optimum.theta.iter().copied()).collect(),
        kept: test.as_ref().is_none_or(|test| test.p < SIGNIFICANT),
        why: test.as_ref().map_or_else(|| "the model as it is".to_owned(), |test| test.sentence.clone()),
        likelihood_ratio: test,
    }
}
