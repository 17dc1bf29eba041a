//! Two gates, and ties (reference: missing-effects 3, 5 and 7).
//!
//! The likelihood gate asks whether the candidate explains the innovations of the training part, the held-out
//! gate whether the error on unseen data really falls. Who cannot be told from the winner is named together
//! with it.

use super::library::{CandidateEffect, sign_allows};
use super::null_model::{NullModel, Optima, OptimaMeasures};
use super::report::EffectGate;
use super::screen::{Score, correlation};
use super::surrogates::Heard;
use crate::estimate::problem::bounds::at_bound;
use crate::estimate::problem::predictor::Predictor;

/// Least gain of the BIC.
pub const LEAST_BIC: f64 = 10.0;
/// The same of a shape that follows the clock alone, and of one of which a single part of the day stands out:
/// that may be whatever happens at those hours and is in no catalogue, a stove in the evening.
const LEAST_SHAPE_BIC: f64 = 20.0;
const LEAST_LONE_BIC: f64 = 40.0;
/// A part stands out whose size is not shared by any other at least so far.
const ALSO: f64 = 0.5;
/// And least share of the days, seen and unseen, on which the free run errs less with it: a habit shows on
/// most of them.
const HABIT_DAYS: f64 = 0.5;
/// The same of one that the model imitates near its optimum unless it explains much.
const LEAST_IMITATED_BIC: f64 = 20.0;
/// The same of one more conductance: a structure that is a little wrong gains by it, and the cause is
/// another.
const LEAST_CONDUCTANCE_BIC: f64 = 50.0;
/// The same of a large model: many parts can move a little, and what moves them gains. On synthetic plants
/// whose cause was another, effects gained 47 to 78, and 178 and more where they were the cause.
const LEAST_LARGE_BIC: f64 = 100.0;
/// Ratio of free-run error to innovation deviation above which slow effects are let in by slower measures:
/// where a model is right but for little, the likelihood sees what is missing.
const CRUDE_RHO: f64 = 1.5;
/// Below this ratio a modest gain of the BIC needs both measures of unseen data, or nearly all of the error,
/// or slow gains that the free run of most unseen days confirms: a structure that is a little wrong gains a
/// little by almost anything.
const NEAR_RHO: f64 = 3.0;
const MODEST_BIC: f64 = 25.0;
const NEARLY_ALL: f64 = 0.9;
/// Least share of the unseen free-run error beyond the noise.
pub const LEAST_SHARE: f64 = 0.20;
/// Or least share of the unseen innovations.
pub const LEAST_WHITE_SHARE: f64 = 0.03;
/// Least share for what follows from the output itself, and for short records.
pub const STRICT_SHARE: f64 = 0.35;
/// Least share of the innovations, seen and unseen, for what follows from the output: a real opening explains
/// the very drops, any other cooling that begins sharply only their aftermath.
pub const STRICT_INNOVATIONS: f64 = 0.4;
/// A slow effect helps on at least this share of the days.
const MOST_DAYS: f64 = 0.7;
/// An error that falls at least to this share has fallen: what matters to nobody is no finding.
pub const LEAST_FALL: f64 = 0.9;
/// Unless the likelihood gains this much, and either as much of the error beyond the noise is explained as is
/// asked of the strict: near the noise an error cannot fall by a tenth; or the error falls on unseen days a
/// little and on all together so far: one week may be one in which little is missing. With such a gain
/// forecasts a day ahead stand in for the free run.
const PLAIN_BIC: f64 = 40.0;
/// Candidates whose gain is within this much of the winner's, or within this share of it, or that are this
/// much alike, are named together with it.
const TIE_BIC: f64 = 10.0;
const TIE_SHARE: f64 = 0.15;
const TIE_CORRELATION: f64 = 0.9;
/// Where the median candidate gains, a cause gains this many times as much.
const STAND_OUT: f64 = 2.0;

/// A candidate at its own optima.
#[derive(Debug, Clone)]
pub struct Refitted {
    /// Its place among the candidates of the round.
    pub candidate: usize,
    /// Its score.
    pub score: Score,
    /// Where its refit ended.
    pub fitted: Optima,
    /// What is measured there.
    pub measured: OptimaMeasures,
    /// Parameters of its own that are not where they do nothing.
    pub active: usize,
}

/// What is gained with a candidate over the null model.
#[derive(Debug, Clone)]
pub struct Gain {
    /// Of the BIC.
    pub delta_bic: f64,
    /// The same on three-hourly means.
    pub slow_delta_bic: Option<f64>,
    /// Share of the unseen free-run error beyond the noise that it explains.
    pub share: Option<f64>,
    /// The unseen free-run error with it over that without it.
    pub fall: Option<f64>,
    /// Share of the unseen innovations that it explains.
    pub white_share: Option<f64>,
    /// Share of the innovations that it explains, seen and unseen.
    pub innovations: f64,
    /// Of forecasts a day ahead, where they were asked for.
    pub ahead: Option<Ahead>,
    /// The free-run error with it over that without it, on all days, seen and unseen.
    pub overall_fall: f64,
    /// Share of the days on which the free run errs less with it: training, validation.
    pub better_days: [f64; 2],
    /// The same of both together.
    pub most_days: f64,
}

/// Forecasts a day ahead over the validation part with a candidate.
#[derive(Debug, Clone, Copy)]
pub struct Ahead {
    /// Their error over that without it.
    pub fall: f64,
    /// The share of the squared error beyond the noise that it explains.
    pub share: f64,
}

/// A candidate that was tried in earnest.
#[derive(Debug, Clone)]
pub struct Tried {
    /// Where its refit ended.
    pub refitted: Refitted,
    /// What it gains.
    pub gain: Gain,
    /// What segments of hours show of it.
    pub heard: Heard,
    /// What stopped it, and why.
    pub gate: Option<(EffectGate, String)>,
}

impl Refitted {
    /// Gain of the BIC over a null model.
    pub fn delta_bic(&self, null: &NullModel) -> f64 {
        null.measured.bic - self.measured.bic - self.price(self.measured.samples)
    }

    /// What its parameters cost beside so many samples.
    fn price(&self, samples: usize) -> f64 {
        self.active.max(1) as f64 * (samples as f64).ln()
    }

    /// All that it gains over a null model.
    pub fn gain(&self, null: &NullModel, ahead: Option<Ahead>) -> Gain {
        let (before, after) = (&null.measured, &self.measured);
        let noise = after.floor.powi(2);
        let unseen = before.plain[1].zip(after.plain[1]);
        let better = |parts: &[usize]| {
            let pairs = parts.iter().flat_map(|part| before.days[*part].iter().zip(&after.days[*part]));
            let (days, better) = pairs.fold((0, 0), |(days, better), (before, after)| {
                (days + 1, better + usize::from(after < before))
            });
            better as f64 / days.max(1) as f64
        };
        let total = |measured: &OptimaMeasures| measured.days.iter().flatten().sum::<f64>();
        let white_share =
            before.white_validation.zip(after.white_validation).map(|(before, after)| 1.0 - after / before);
        // What the likelihood gains is the logarithm of the variance.
        let seen = 1.0 - ((after.bic - before.bic) / after.samples.max(1) as f64).exp();
        let [train, validation] =
            [&null.problem.split().train, &null.problem.split().validation].map(|part| part.len() as f64);
        let innovations =
            white_share.map_or(seen, |unseen| (train * seen + validation * unseen) / (train + validation));
        Gain {
            innovations,
            delta_bic: self.delta_bic(null),
            slow_delta_bic: before
                .slow
                .zip(after.slow)
                .map(|((before, _), (after, n))| before - after - self.price(n)),
            share: unseen.map(|(before, after)| (before - after) / (before - noise).max(1e-3 * before)),
            fall: unseen.map(|(before, after)| (after / before).sqrt()),
            white_share,
            ahead,
            overall_fall: (total(after) / total(before)).sqrt(),
            better_days: [better(&[0]), better(&[1])],
            most_days: better(&[0, 1]),
        }
    }
}

/// What stops a candidate. The null model's free run errs by so much over its floor on the training part, and
/// on the worse of training and validation.
pub(super) fn gate(
    candidate: &CandidateEffect,
    refitted: &Refitted,
    gain: &Gain,
    heard: &Heard,
    strict: bool,
    [rho, worst_rho]: [f64; 2],
    usual_gain: f64,
) -> Option<(EffectGate, String)> {
    let percent = |share: Option<f64>| {
        share.map_or_else(|| "no unseen data".to_owned(), |share| format!("{:.0} %", 100.0 * share))
    };
    if refitted.active == 0 {
        return Some((EffectGate::Bound, "it fits best where it does nothing".to_owned()));
    }
    let allowed = candidate
        .own
        .iter()
        .any(|(index, off)| sign_allows(candidate.spec.sign, refitted.fitted.white[*index] - off));
    if !allowed {
        return Some((EffectGate::Sign, "the data ask for a sign that physics does not allow".to_owned()));
    }
    // Two places that exchange heat as fast as physics allows are one place, but for what is much warmer, as
    // a radiator's water.
    let at_limit =
        |theta: &[f64]| candidate.own.iter().all(|(index, _)| at_bound(&candidate.problem, theta, *index));
    if candidate.conducts
        && !candidate.spec.heats()
        && (at_limit(&refitted.fitted.white) || at_limit(&refitted.fitted.plain))
    {
        let why = "the room follows it as closely as physics allows, as a second thermometer of the same \
            room would";
        return Some((EffectGate::Bound, why.to_owned()));
    }
    // Days are the judges of what a logged channel drives, whatever the minutes say.
    if heard.shown.is_some() {
        return None;
    }
    // What is no number reaches nothing.
    let reaches = |value: Option<f64>, least: f64| value.is_some_and(|value| value >= least);
    // A cause stands out from what everybody gains.
    if usual_gain > LEAST_BIC && !reaches(Some(gain.delta_bic), STAND_OUT * usual_gain) {
        return Some((
            EffectGate::Bic,
            "most candidates gain alike: the fit without them is not at its optimum".to_owned(),
        ));
    }
    let endogenous = candidate.endogenous;
    let least = least_gain(candidate, refitted, gain);
    // Of whom no more is asked than of everybody, slower measures may speak. More is asked of large models:
    // where nothing moves the states by chance, the likelihood sees the slow as well.
    let slow = least <= LEAST_BIC && worst_rho >= CRUDE_RHO && !endogenous && explains_slowly(gain);
    if !slow && !reaches(Some(gain.delta_bic), least) {
        return Some((
            EffectGate::Bic,
            format!("it gains {:.1} in BIC, and {least} is asked for", gain.delta_bic),
        ));
    }
    if candidate.by_clock && gain.better_days.iter().any(|share| *share < HABIT_DAYS) {
        return Some((
            EffectGate::HeldOut,
            "it follows the clock, and helps on fewer than half of the days".to_owned(),
        ));
    }
    // Whatever the likelihood says: what leaves the unseen error as it is is no cause of it.
    let one_step = gain.white_share.map(|share| (1.0 - share).max(0.0).sqrt());
    let falls = [gain.fall, gain.ahead.map(|ahead| ahead.fall), one_step]
        .into_iter()
        .flatten()
        .any(|fall| fall <= LEAST_FALL);
    let overall = gain.overall_fall <= LEAST_FALL && gain.fall.is_some_and(|fall| fall < 1.0);
    let plain = reaches(Some(gain.delta_bic), PLAIN_BIC) && (reaches(gain.share, STRICT_SHARE) || overall);
    if !falls && !plain {
        let why = "neither the free run nor forecasts a step or a day ahead err a tenth less with it on \
            unseen data";
        return Some((EffectGate::HeldOut, why.to_owned()));
    }
    let both = reaches(gain.share, LEAST_SHARE) && reaches(gain.white_share, LEAST_WHITE_SHARE);
    let nearly_all = reaches(gain.share, NEARLY_ALL) || (slow && free_run_confirms(gain));
    if rho < NEAR_RHO && gain.delta_bic < MODEST_BIC && !both && !nearly_all {
        let why =
            "it gains little, and the free run and the innovations on unseen data do not both confirm it";
        return Some((EffectGate::HeldOut, why.to_owned()));
    }
    if slow {
        return None;
    }
    let ahead = gain.ahead.map(|ahead| ahead.share);
    if endogenous
        && !((reaches(gain.share, STRICT_SHARE) || reaches(ahead, STRICT_SHARE))
            && gain.innovations >= STRICT_INNOVATIONS)
    {
        let why = format!(
            "read off the room temperature itself, it explains {} of the error on unseen data and {:.0} % of \
            the innovations, and {:.0} and {:.0} % is asked for",
            percent(gain.share),
            100.0 * gain.innovations,
            100.0 * STRICT_SHARE,
            100.0 * STRICT_INNOVATIONS
        );
        return Some((EffectGate::HeldOut, why));
    }
    let least = if strict { STRICT_SHARE } else { LEAST_SHARE };
    // States that are re-estimated show what a free run hides behind the chance of one week.
    let a_day_ahead =
        reaches(Some(gain.delta_bic), PLAIN_BIC) && reaches(ahead, STRICT_SHARE) && reaches(gain.share, 0.0);
    let passes = endogenous
        || a_day_ahead
        || reaches(gain.share, least)
        || (!strict && reaches(gain.white_share, LEAST_WHITE_SHARE));
    (!passes).then(|| {
        let why = format!(
            "it explains {} of the error on unseen data, and {:.0} % is asked for",
            percent(gain.share),
            100.0 * least
        );
        (EffectGate::HeldOut, why)
    })
}

/// Least gain of the BIC that is asked of a candidate.
pub fn least_gain(candidate: &CandidateEffect, refitted: &Refitted, gain: &Gain) -> f64 {
    let confirmed = gain.share.is_some_and(|share| share >= STRICT_SHARE);
    match candidate.problem.predictor() {
        _ if candidate.by_clock => least_by_clock(candidate, &refitted.fitted),
        Predictor::FreeRun => LEAST_LARGE_BIC,
        Predictor::Filtered if candidate.conducts => LEAST_CONDUCTANCE_BIC,
        Predictor::Filtered if refitted.score.imitated && !confirmed => LEAST_IMITATED_BIC,
        Predictor::Filtered => LEAST_BIC,
    }
}

fn least_by_clock(candidate: &CandidateEffect, fitted: &Optima) -> f64 {
    let size = |(index, off): &(usize, f64)| {
        let [lower, upper] = candidate.problem.bounds()[*index];
        (fitted.plain[*index] - off).abs() / (upper - lower)
    };
    let mut sizes: Vec<f64> = candidate.own.iter().map(size).collect();
    sizes.sort_by(|a, b| b.total_cmp(a));
    match sizes[..] {
        [largest, next, ..] if next < ALSO * largest => LEAST_LONE_BIC,
        _ => LEAST_SHAPE_BIC,
    }
}

/// The other way in: a slow effect gains on three-hourly means, on most of all days, and on unseen data
/// either in forecasts a day ahead from re-estimated states or in the free run of most days.
fn explains_slowly(gain: &Gain) -> bool {
    let gains = gain.slow_delta_bic.is_some_and(|gain| gain >= LEAST_BIC) && gain.most_days >= MOST_DAYS;
    // States that are re-estimated hide much, but not innovations that grow.
    let ahead = gain.ahead.is_some_and(|ahead| ahead.share >= STRICT_SHARE)
        && gain.white_share.is_none_or(|share| share >= 0.0);
    gains && (ahead || free_run_confirms(gain))
}

/// The free run of most unseen days, and much of its error.
fn free_run_confirms(gain: &Gain) -> bool {
    gain.share.is_some_and(|share| share >= STRICT_SHARE) && gain.better_days[1] >= MOST_DAYS
}

/// Those that cannot be told from the winner, the best member of each family of choices only: what passes the
/// gates and gains as much or does the same, and what gains as much although it lowers the unseen error by
/// too little.
pub(super) fn ties(tried: &mut [Tried], candidates: &[CandidateEffect], winner: usize) -> Vec<usize> {
    let best = tried[winner].clone();
    // Who is let in by the slower measure is compared by it.
    let slowly = best.gain.delta_bic < LEAST_BIC;
    let gain = |one: &Tried| {
        if slowly { one.gain.slow_delta_bic.unwrap_or(f64::NEG_INFINITY) } else { one.gain.delta_bic }
    };
    let least = gain(&best) - TIE_BIC.max(TIE_SHARE * gain(&best));
    let mut tied: Vec<usize> = Vec::new();
    for place in (0..tried.len()).filter(|place| *place != winner) {
        let one = &tried[place];
        let candidate = &candidates[one.refitted.candidate];
        let named = |other: usize| candidate.is_choice() && candidates[other].family() == candidate.family();
        // Whom segments show is told apart by what it adds to them.
        let alike = match (&one.heard.shown, &best.heard.shown) {
            (Some(one), Some(best)) => one.likeness(best) > TIE_CORRELATION,
            (None, Some(_)) => false,
            _ => {
                gain(one) >= least
                    || correlation(&one.refitted.score.direction, &best.refitted.score.direction).abs()
                        > TIE_CORRELATION
            }
        };
        let held_out = matches!(one.gate, Some((EffectGate::HeldOut, _))) && !candidate.endogenous;
        let likely = best.heard.shown.is_none()
            && held_out
            && gain(one) >= least
            && one.gain.fall.is_some_and(|fall| fall < 1.0);
        if !(likely || (one.gate.is_none() && alike)) {
            continue;
        }
        let known = named(best.refitted.candidate)
            || tied.iter().any(|other| named(tried[*other].refitted.candidate));
        let why = format!("these data cannot tell it from {}", candidates[best.refitted.candidate].id);
        tried[place].gate = Some((EffectGate::Tie, why));
        if !known {
            tied.push(place);
        }
    }
    tied
}
