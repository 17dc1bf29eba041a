//! A winner of a round as a finding: how large it is, what it makes of the errors, and what speaks for it.

use super::acceptance::{LEAST_BIC, LEAST_SHARE, STRICT_INNOVATIONS, STRICT_SHARE, Tried, least_gain};
use super::evidence::shape;
use super::library::CandidateEffect;
use super::null_model::NullModel;
use super::report::{Coefficient, EffectSize, Finding, FindingKind, RmsePairs};
use super::selection::Round;
use super::size::{AHEAD_HOURS, Size, Sizes, sizes};
use super::ways::Way;
use crate::estimate::assess::metrics::{HORIZONS, ProcessNoise, ahead, filter};
use crate::estimate::problem::bounds::at_bound;
use crate::simulate::trajectory::Halt;
use crate::units::error_unit;
use indexmap::IndexMap;

/// A later finding that explains less than this repairs, and is no cause.
const CAUSE_SHARE: f64 = 0.3;

/// A winner as a finding, by another way where that is better.
#[allow(clippy::too_many_arguments)]
pub(super) fn finding(
    null: &NullModel,
    direct: &NullModel,
    way: Option<&Way>,
    library: &[CandidateEffect],
    outcome: &Round,
    winner: &Tried,
    rank: usize,
    halt: Halt,
) -> Finding {
    let named = &library[winner.refitted.candidate];
    let (candidate, next) = way.map_or((named, direct), |way| (&way.candidate, &way.model));
    let tied_with: Vec<String> = outcome
        .tied
        .iter()
        .map(|place| library[outcome.tried[*place].refitted.candidate].id.clone())
        .collect();
    let separate_by = (!tied_with.is_empty()).then(|| {
        let mut needed: Vec<&str> = vec![&named.spec.measure];
        needed.extend(
            outcome
                .tied
                .iter()
                .map(|place| library[outcome.tried[*place].refitted.candidate].spec.measure.as_str()),
        );
        needed.retain(|text| !text.is_empty());
        needed.dedup();
        format!("measure {}", needed.join(", or "))
    });
    let pair = |part: usize| {
        null.measured.plain[part].zip(next.measured.plain[part]).map(|(a, b)| [a.sqrt(), b.sqrt()])
    };
    let mut sized = next.fitted.plain.clone();
    let mut parameters = IndexMap::new();
    let Sizes { coefficients, ahead } = sizes(next, candidate, winner.heard.shown.is_some(), halt);
    let size = ahead.zip(next.problem.model().outputs().first()).map(|(Size { value, ci95 }, output)| {
        EffectSize { hours: AHEAD_HOURS, value, ci95, unit: error_unit(&output.unit).to_owned() }
    });
    for ((index, _), Size { value, ci95 }) in candidate.own.iter().zip(coefficients) {
        sized[*index] = value;
        let parameter = &next.problem.model().parameters()[*index];
        let at_bound =
            at_bound(&next.problem, &sized, *index) && !leaves_bounds(ci95, next.problem.bounds()[*index]);
        parameters.insert(
            parameter.name.clone(),
            Coefficient { value, ci95, unit: parameter.unit.clone(), at_bound },
        );
    }
    let rmse = RmsePairs {
        train: pair(0).unwrap_or([f64::NAN; 2]),
        validation: pair(1),
        test: pair(2),
        validation_ahead: ahead_pairs(null, next),
    };
    let refinement = rank > 1 && winner.gain.share.is_none_or(|share| share < CAUSE_SHARE);
    let mut evidence = evidence(named, winner, &rmse);
    evidence.extend(way.map(Way::sentence));
    evidence.extend(size.as_ref().map(EffectSize::sentence));
    Finding {
        rank,
        effect: candidate.id.clone(),
        way_of: candidate.spec.way_of.clone(),
        title: candidate.spec.title.clone(),
        explain: candidate.spec.explain.clone(),
        delta_bic: winner.gain.delta_bic + way.map_or(0.0, |way| way.delta_bic),
        explained_share: winner.gain.share,
        rmse,
        size,
        parameters,
        tied_with,
        separate_by,
        kind: if refinement { FindingKind::Refinement } else { FindingKind::Cause },
        evidence,
        segments: winner.heard.shown.as_ref().map(|shown| shown.evidence.clone()),
        pooled: None,
        shape: Some(shape(null, next, candidate, &sized)),
    }
}

/// Whether an interval stays clear of both bounds: a small coefficient of a channel with large numbers is
/// near its bound on the scale of the search, and well determined all the same.
fn leaves_bounds(ci95: Option<[f64; 2]>, bounds: [f64; 2]) -> bool {
    ci95.is_some_and(|[low, high]| low > bounds[0] && high < bounds[1])
}

/// What speaks for it, in sentences.
fn evidence(candidate: &CandidateEffect, winner: &Tried, rmse: &RmsePairs) -> Vec<String> {
    let mut sentences = vec![candidate.spec.signature.clone()];
    let unit = match candidate.problem.model().outputs() {
        [one] => error_unit(&one.unit),
        _ => "times the noise of the sensors",
    };
    if let Some([before, after]) = rmse.validation {
        sentences.push(format!(
            "With it the free run on unseen data errs by {after:.2} instead of {before:.2} {unit}."
        ));
    }
    if let Some([before, after]) = rmse.validation_ahead.get("PT24H") {
        sentences.push(format!("Forecasts a day ahead err by {after:.2} instead of {before:.2} {unit}."));
    }
    if let Some(shown) = &winner.heard.shown {
        sentences.extend(shown.evidence.sentences(candidate));
        return sentences;
    }
    let least = least_gain(candidate, &winner.refitted, &winner.gain);
    match winner.gain.slow_delta_bic {
        Some(slow) if winner.gain.delta_bic < least => {
            sentences.push(format!(
                "The likelihood of three-hourly means gains {slow:.0} in BIC after its price; {LEAST_BIC:.0} \
                would be enough."
            ));
        }
        _ => sentences.push(format!(
            "The likelihood gains {:.0} in BIC after its price; {least:.0} would be enough.",
            winner.gain.delta_bic
        )),
    }
    if let Some(share) = winner.gain.share.filter(|share| *share >= LEAST_SHARE) {
        sentences.push(format!(
            "It explains {:.0} % of the unseen squared error beyond the noise.",
            100.0 * share
        ));
    } else if let Some(ahead) =
        winner.gain.ahead.map(|ahead| ahead.share).filter(|share| *share >= STRICT_SHARE)
    {
        sentences.push(format!(
            "It explains {:.0} % of the squared error a day ahead beyond the noise.",
            100.0 * ahead
        ));
    } else if let Some(white) = winner.gain.white_share {
        sentences.push(format!(
            "It explains {:.1} % of the unseen innovations; the free run is dominated by something else.",
            100.0 * white
        ));
    }
    if candidate.endogenous {
        sentences.push(format!(
            "It is read off the room temperature itself, so more was asked of it: {:.0} % of the error or of \
            forecasts a day ahead, and {:.0} % of the innovations, of which it explains {:.0} %. Its size \
            has no interval.",
            100.0 * STRICT_SHARE,
            100.0 * STRICT_INNOVATIONS,
            100.0 * winner.gain.innovations
        ));
    }
    sentences
}

/// Forecast errors without and with the effect over the validation part, each from states filtered with its
/// own likeliest process noise.
fn ahead_pairs(null: &NullModel, next: &NullModel) -> IndexMap<String, [f64; 2]> {
    let range = null.problem.split().validation.clone();
    let errors = |null: &NullModel| {
        let run = filter(&null.problem, &null.fitted.plain, ProcessNoise::Likeliest);
        ahead(&null.problem, &null.fitted.plain, &run, range.clone(), &HORIZONS)
    };
    let (before, after) = rayon::join(|| errors(null), || errors(next));
    before
        .into_iter()
        .filter_map(|(name, before)| Some((name.clone(), [before.rmse, after.get(&name)?.rmse])))
        .collect()
}
