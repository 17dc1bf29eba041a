//! The error ladder: effects are added one after another while the error on unseen data falls.

use super::acceptance::LEAST_BIC;
use super::course::Course;
use super::error::{DiagnoseError, interrupted};
use super::library::{EffectSource, align};
use super::null_model::NullModel;
use super::selection::round;
use super::ways::other_way;
use crate::data::Window;
use crate::estimate::assess::metrics::{HORIZONS, ProcessNoise, ahead, filter};
use crate::estimate::likelihood::ratio::LikelihoodRatio;
use crate::estimate::problem::request::AccusationRate;
use crate::estimate::{Control, Problem, Site};
use crate::model::Catalogue;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// An error that is not at least this much smaller has not fallen.
const FALL: f64 = 0.97;

/// A ladder: the base, then a step for each effect that was tried in earnest.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct Ladder {
    /// The system, where there is one.
    pub system: Option<String>,
    /// The steps, the base first.
    pub steps: Vec<Step>,
}

/// A model of the ladder with its errors, in the output's unit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = LadderStep)]
pub struct Step {
    /// The model.
    pub model: String,
    /// The effect that this step added; none for the base.
    pub added: Option<String>,
    /// Free run over the training part.
    pub train_rmse: f64,
    /// Free run over the validation part, which decides.
    pub validation_rmse: Option<f64>,
    /// Free run over the test part, which is only reported.
    pub test_rmse: Option<f64>,
    /// Forecast errors from re-estimated states over the validation part, by horizon.
    #[schema(value_type = HashMap<String, f64>)]
    pub ahead: IndexMap<String, f64>,
    /// BIC of the AR likelihood of the training part, the effects' parameters counted; by the criterion `lrt`
    /// that of the likelihood of the stochastic model.
    pub bic: f64,
    /// Estimates by name.
    #[schema(value_type = HashMap<String, f64>)]
    pub parameters: IndexMap<String, f64>,
    /// Whether the next step stands on this one.
    pub kept: bool,
    /// Why, in a sentence.
    pub why: String,
    /// The likelihood-ratio test against the step before, where that decides.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub likelihood_ratio: Option<LikelihoodRatio>,
}

/// Builds the ladder from a fit: at most `max_steps` effects.
///
/// A step is kept where the gates of a diagnosis let its effect through and the error on unseen data falls;
/// the first step that is not ends the ladder.
///
/// # Errors
/// [`DiagnoseError`] where the model diverges, the window does not serve, or `control` interrupts.
pub fn ladder(
    catalogue: &Catalogue,
    problem: &Problem,
    theta: &[f64],
    window: &Window,
    site: &Site,
    max_steps: usize,
    control: &Control,
) -> Result<Ladder, DiagnoseError> {
    let nothing = || DiagnoseError::nothing(control);
    let source = EffectSource::new(catalogue, problem, window, site)
        .map_err(|fault| DiagnoseError::Faults(vec![fault]))?;
    let (mut library, _) = source.candidates(problem);
    let course = Course::new(control, problem.predictor(), library.len(), max_steps);
    let halt = || course.halts();
    let mut null = NullModel::settle(align(problem, &mut library), theta, None, &halt).ok_or_else(nothing)?;
    course.settled(null.fitted.evaluations);
    let noise = filter(problem, &null.fitted.plain, ProcessNoise::Likeliest).process_noise;
    let mut steps = Vec::new();
    let mut price = 0.0;
    for _ in 0..max_steps {
        if !steps.is_empty() {
            (library, _) = source.candidates(&null.problem);
            null.problem = align(&null.problem, &mut library);
        }
        let outcome = round(
            &mut null,
            &library,
            false,
            AccusationRate::default().into(),
            &[],
            steps.is_empty(),
            &course,
        )
        .ok_or_else(nothing)?;
        interrupted(control)?;
        if steps.is_empty() {
            steps.push(step(&null, None, 0.0, noise, true, "the model as it is".to_owned()));
        }
        // The winner of the gates, or else the one that came closest, to show that it does not help.
        let Some(best) = outcome
            .winner
            .or_else(|| (!outcome.tried.is_empty()).then_some(0))
            .map(|place| &outcome.tried[place])
        else {
            break;
        };
        course.naming();
        let candidate = &library[best.refitted.candidate];
        let next = NullModel::settle(
            candidate.problem.clone(),
            &best.refitted.fitted.plain,
            Some(&best.refitted.fitted.white),
            &halt,
        )
        .ok_or_else(nothing)?;
        let (way, evaluations) =
            if best.gate.is_none() { other_way(&source, &null, &next, candidate, &halt) } else { (None, 0) };
        course.settled(next.fitted.evaluations + evaluations);
        let (added, active, next) = match way {
            Some(way) => (way.candidate.id, way.candidate.own.len(), way.model),
            None => (candidate.id.clone(), best.refitted.active, next),
        };
        let cost = active as f64 * (best.refitted.measured.samples as f64).ln();
        let before = steps.last();
        let mut step = step(&next, Some(added), price + cost, noise, true, String::new());
        (step.kept, step.why) = match (&best.gate, before.map(|before| fallen(before, &step))) {
            (Some((_, why)), _) => (false, format!("the best of what is left is not kept: {why}")),
            (None, Some(Some(why))) => (true, why),
            (None, _) => (false, "the likelihood gains, but no error on unseen data falls".to_owned()),
        };
        // Below the gate of the likelihood there is nothing to show.
        if !step.kept && best.gain.delta_bic < LEAST_BIC {
            break;
        }
        let kept = step.kept;
        steps.push(step);
        if !kept {
            break;
        }
        price += cost;
        null = next;
    }
    if steps.is_empty() {
        steps.push(step(&null, None, 0.0, noise, true, "the model as it is".to_owned()));
    }
    Ok(Ladder { system: None, steps })
}

/// Which errors on unseen data really fall, of the free run and of forecasts over six hours and a day, in a
/// sentence that also says where the free run does not; `None` where none falls.
fn fallen(before: &Step, after: &Step) -> Option<String> {
    let ahead = |name: &str| before.ahead.get(name).copied().zip(after.ahead.get(name).copied());
    let free = before.validation_rmse.zip(after.validation_rmse);
    let pairs = [
        ("the free run", free),
        ("forecasts 6 h ahead", ahead("PT6H")),
        ("forecasts a day ahead", ahead("PT24H")),
    ];
    let falls = |pair: Option<(f64, f64)>| pair.filter(|(before, after)| *after <= FALL * before);
    let fallen: Vec<String> = pairs
        .into_iter()
        .filter_map(|(name, pair)| {
            falls(pair).map(|(before, after)| format!("of {name} from {before:.2} to {after:.2}"))
        })
        .collect();
    let rises = free.filter(|(before, after)| after > before);
    let but = rises.map_or_else(String::new, |(before, after)| {
        format!("; the free run's rises from {before:.2} to {after:.2}")
    });
    (!fallen.is_empty()).then(|| format!("the error on unseen data falls: {}{but}", fallen.join(", ")))
}

fn step(null: &NullModel, added: Option<String>, price: f64, noise: f64, kept: bool, why: String) -> Step {
    let problem = &null.problem;
    let theta = &null.fitted.plain;
    let run = filter(problem, theta, ProcessNoise::Known(noise));
    let errors = ahead(problem, theta, &run, problem.split().validation.clone(), &HORIZONS);
    let [train, validation, test] = null.measured.plain.map(|mse| mse.map(f64::sqrt));
    let names = problem.model().parameters().iter().map(|parameter| parameter.name.clone());
    Step {
        model: problem.model().id().to_string(),
        added,
        train_rmse: train.unwrap_or(f64::NAN),
        validation_rmse: validation,
        test_rmse: test,
        ahead: errors.into_iter().map(|(name, error)| (name, error.rmse)).collect(),
        bic: null.measured.bic + price,
        parameters: names.zip(theta.iter().copied()).collect(),
        kept,
        why,
        likelihood_ratio: None,
    }
}
