//! A round: every candidate is refitted, and the gates (`acceptance`) decide (reference: missing-effects 3, 5
//! and 7).
//!
//! The null model is restarted from the best candidates' parameters, so that no candidate gains by a better
//! search alone.

use super::acceptance::{Ahead, LEAST_BIC, LEAST_FALL, Refitted, Tried, gate, ties};
use super::chosen::{Chosen, Skip, choose, search_from_nominal};
use super::course::Course;
use super::effort::Effort;
use super::ledger::{EffectScore, LedgerEntry};
use super::library::CandidateEffect;
use super::null_model::{NullModel, Optima};
use super::refit::Refit;
use super::screen::{Blind, Score, Screen};
use super::surrogates::{Heard, Tests};
use crate::estimate::Problem;
use crate::estimate::assess::metrics::{ProcessNoise, day_ahead_mse, filter};
use crate::estimate::problem::predictor::Predictor;
use crate::simulate::trajectory::Halt;
use rayon::prelude::*;

/// Fewest families of which a median means anything.
const LEAST_FAMILIES: usize = 5;
/// Least score of a candidate that is refitted: chi-squared with one degree of freedom exceeds it by chance
/// in a third of all cases. What the linearised model gives no gain at all the refit gives none either.
const LEAST_SCORE: f64 = 1.0;
/// From how many of the best candidates the null model is restarted.
const RESTARTS: usize = 3;
/// A candidate leads clearly whose free run's squared error is this much of the null model's after the first
/// part of its way.
const CLEAR: f64 = 0.5;
/// Ratio of free-run error to innovation deviation from which on every candidate is searched from the nominal
/// values before the first round ends with nothing: below it little is left to explain, and with a finding
/// the model is a room again.
const FAR_RHO: f64 = 1.3;
/// The same below which a large model is right but for noise, and whose simulations are too dear to look far
/// for nothing.
const RIGHT_RHO: f64 = 1.05;

/// What a round found.
#[derive(Debug, Clone)]
pub struct Round {
    /// Candidates with a refit, the largest gain first.
    pub tried: Vec<Tried>,
    /// Candidates without one: those that physics or the screen ruled out.
    pub skipped: Vec<(usize, Skip)>,
    /// Simulations of all restarts and of all that were tried.
    pub evaluations: usize,
    /// The place of the winner among the tried.
    pub winner: Option<usize>,
    /// Places of those that are named together with it.
    pub tied: Vec<usize>,
    /// What segments of hours show of everybody.
    pub scores: Vec<EffectScore>,
}

/// When all candidates are searched from the nominal values, and not only those that the model's own
/// parameters imitate.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Wider {
    /// With a finding the model is near the room, where a score is nearly what the likelihood would gain: its
    /// price is asked at once. A large model may be so right that its simulations are too dear for more.
    Never,
    /// Where nobody of a large model leads clearly after the first part of the way: refits are dear.
    BeforeTheRest,
    /// Where a round ends with nothing although much is left to explain.
    AfterNothing,
}

impl Wider {
    fn of(predictor: Predictor, first: bool, rho: f64) -> Self {
        match predictor {
            Predictor::Filtered if first => Self::AfterNothing,
            Predictor::FreeRun if rho >= RIGHT_RHO => Self::BeforeTheRest,
            Predictor::Filtered | Predictor::FreeRun => Self::Never,
        }
    }
}

/// Tries every candidate on the null model, which is restarted on the way. `strict` asks for more of
/// everybody, and `rate` is how often segments of hours may accuse where nothing is missing, alone or
/// together with what `earlier` windows showed of the same model. What comes of a round that `halt` has cut
/// short means nothing. `first` is the round in which nothing has been added yet.
pub fn round(
    null: &mut NullModel,
    candidates: &[CandidateEffect],
    strict: bool,
    rate: f64,
    earlier: &[LedgerEntry],
    first: bool,
    course: &Course,
) -> Option<Round> {
    let halt: Halt = &|| course.halts();
    let rho = null.worst_rho().unwrap_or(f64::INFINITY);
    let wider = Wider::of(null.problem.predictor(), first, rho);
    course.round(candidates.len(), rho, wider != Wider::Never && rho >= FAR_RHO);
    let screened = |theta: &[f64]| -> Option<Vec<Result<Score, Blind>>> {
        let screen = Screen::new(&null.problem, theta, &null.filters.white, halt)?;
        Some(candidates.par_iter().map(|candidate| screen.score(candidate)).collect())
    };
    let here = screened(&null.fitted.white)?;
    let there = null.other.as_ref().and_then(|[_, white]| screened(white));
    let base = null.problem.clone();
    let tests = Tests::new(&base, &null.fitted.plain, candidates, rate, earlier, halt);
    let hear =
        |candidate: &CandidateEffect| tests.as_ref().map(|tests| tests.hear(candidate)).unwrap_or_default();
    let heard: Vec<Heard> = candidates.par_iter().map(hear).collect();
    let scores = heard.iter().filter_map(|heard| heard.ranked.clone()).collect();
    let far = wider != Wider::Never;
    let asks = |score: &Score| {
        score.imitated || (score.sign && if far { score.statistic >= LEAST_SCORE } else { score.net >= 0.0 })
    };
    let (chosen, skipped) = choose(candidates, here, there, &heard, &asks);
    let faint =
        if far { 0 } else { skipped.iter().filter(|(_, skip)| matches!(skip, Skip::Faint(_))).count() };
    let imitated = |score: &Score| score.imitated;
    let (mut chosen, mut skipped, mut restarting) =
        search_from_nominal(null, candidates, chosen, skipped, &imitated, course);
    let mut begun = begin_all(null, candidates, &chosen, &[], course);
    if wider == Wider::BeforeTheRest && !leads_clearly(null, &begun) && !halt() {
        let known: Vec<(usize, Optima)> = chosen.iter().map(|one| one.place).zip(begun).collect();
        let more;
        course.widening();
        (chosen, skipped, more) =
            search_from_nominal(null, candidates, chosen, skipped, &|score| !imitated(score), course);
        restarting += more;
        begun = begin_all(null, candidates, &chosen, &known, course);
    }
    let refitted = go_on_all(null, candidates, &chosen, begun, course);
    let judge = |null: &mut NullModel, refitted: Vec<Refitted>| {
        let before = null.fitted.evaluations;
        course.judging();
        let judged = judge(null, candidates, &heard, strict, refitted, faint, halt);
        course.judged(null.fitted.evaluations - before, judged.winner.is_some());
        judged
    };
    let mut judged = judge(null, refitted);
    if wider == Wider::AfterNothing
        && judged.winner.is_none()
        && null.worst_rho().is_some_and(|rho| rho >= FAR_RHO)
        && !halt()
    {
        let near = chosen.into_iter().map(|chosen| Chosen { far: None, ..chosen }).collect();
        let (chosen, left, more) =
            search_from_nominal(null, candidates, near, skipped, &|score| !imitated(score), course);
        skipped = left;
        restarting += more;
        let again: Vec<Chosen> = chosen.into_iter().filter(|chosen| chosen.far.is_some()).collect();
        let begun = begin_all(null, candidates, &again, &[], course);
        let mut refitted = go_on_all(null, candidates, &again, begun, course);
        if !refitted.is_empty() {
            let known = |one: &Tried| refitted.iter().any(|other| other.candidate == one.refitted.candidate);
            let kept: Vec<Refitted> =
                judged.tried.iter().filter(|one| !known(one)).map(|one| one.refitted.clone()).collect();
            refitted.extend(kept);
            judged = judge(null, refitted);
        }
    }
    let JudgedRound { mut tried, winner } = judged;
    let tied = winner.map_or_else(Vec::new, |winner| ties(&mut tried, candidates, winner));
    let evaluations = restarting + tried.iter().map(|one| one.refitted.fitted.evaluations).sum::<usize>();
    Some(Round { tried, skipped, evaluations, winner, tied, scores })
}

/// What the gates say of candidates at their optima.
struct JudgedRound {
    tried: Vec<Tried>,
    winner: Option<usize>,
}

/// Compares candidates with a null model that goes on from where the best of them have come to. So many
/// `faint` ones were not tried.
fn judge(
    null: &mut NullModel,
    candidates: &[CandidateEffect],
    heard: &[Heard],
    strict: bool,
    mut refitted: Vec<Refitted>,
    faint: usize,
    halt: Halt,
) -> JudgedRound {
    compare(null, &mut refitted);
    restart(null, candidates, &mut refitted, RESTARTS, halt);
    let mut usual_gain = median_gain(null, &refitted, candidates, faint);
    if usual_gain > LEAST_BIC {
        // Where most candidates gain, it may be the null model that is not at its optimum.
        let all = refitted.len();
        restart(null, candidates, &mut refitted, all, halt);
        usual_gain = median_gain(null, &refitted, candidates, faint);
    }
    let ahead = day_ahead(null, candidates, &refitted);
    let rhos = [null.rho(), null.worst_rho()].map(|rho| rho.unwrap_or(f64::INFINITY));
    let one = |(refitted, ahead): (Refitted, Option<Ahead>)| {
        let candidate = &candidates[refitted.candidate];
        let gain = refitted.gain(null, ahead);
        let heard = heard[refitted.candidate].clone();
        let gate = gate(candidate, &refitted, &gain, &heard, strict, rhos, usual_gain);
        Tried { refitted, gain, heard, gate }
    };
    let tried: Vec<Tried> = refitted.into_iter().zip(ahead).map(one).collect();
    JudgedRound { winner: winner(&tried), tried }
}

/// Whoever passes the gates with the largest gain. Where segments of hours show anybody, who of all that pass
/// explains most of what they leave open.
fn winner(tried: &[Tried]) -> Option<usize> {
    let mut passes = (0..tried.len()).filter(|place| tried[*place].gate.is_none());
    let share = |place: &usize| tried[*place].heard.share().unwrap_or(0.0);
    match tried.iter().any(|one| one.gate.is_none() && one.heard.shown.is_some()) {
        true => passes.max_by(|one, other| share(one).total_cmp(&share(other))),
        false => passes.next(),
    }
}

/// Restarts the null model from the parameters of the best candidates without their effects, and compares
/// again.
fn restart(
    null: &mut NullModel,
    candidates: &[CandidateEffect],
    refitted: &mut [Refitted],
    count: usize,
    halt: Halt,
) {
    let bases: Vec<[Vec<f64>; 2]> = refitted
        .iter()
        .take(count)
        .map(|one| {
            [&one.fitted.plain, &one.fitted.white]
                .map(|theta| candidates[one.candidate].lower(&null.problem, theta))
        })
        .collect();
    null.restart(&bases, halt);
    compare(null, refitted);
}

/// The median gain of the families that were tried, each by its best member; minus infinity where they are
/// too few to tell. So many `faint` ones were not worth a trial.
fn median_gain(null: &NullModel, refitted: &[Refitted], candidates: &[CandidateEffect], faint: usize) -> f64 {
    let mut families: Vec<&str> = Vec::new();
    let mut gains: Vec<f64> = Vec::new();
    for one in refitted {
        let candidate = &candidates[one.candidate];
        if !candidate.is_choice() || !families.contains(&candidate.family()) {
            families.push(candidate.family());
            gains.push(one.delta_bic(null));
        }
    }
    gains.extend(std::iter::repeat_n(f64::NEG_INFINITY, faint));
    // The largest gain comes first, so this is the median.
    if gains.len() < LEAST_FAMILIES { f64::NEG_INFINITY } else { gains[gains.len() / 2] }
}

/// The first part of everybody's way, but of those that are known and have no new start.
fn begin_all(
    null: &NullModel,
    candidates: &[CandidateEffect],
    chosen: &[Chosen],
    known: &[(usize, Optima)],
    course: &Course,
) -> Vec<Optima> {
    course.beginning(chosen.len());
    let one = |one: &Chosen| match known.iter().find(|(place, _)| *place == one.place && one.far.is_none()) {
        Some((_, begun)) => begun.clone(),
        None => {
            let begun = begin(null, &candidates[one.place], one, &|| course.halts());
            course.step(begun.evaluations);
            begun
        }
    };
    chosen.par_iter().map(one).collect()
}

/// Whether somebody has left the null model far behind after the first part of the way.
fn leads_clearly(null: &NullModel, begun: &[Optima]) -> bool {
    begun.iter().any(|begun| begun.plain_cost < CLEAR * null.fitted.plain_cost)
}

/// The rest of the way of all that promise something.
fn go_on_all(
    null: &NullModel,
    candidates: &[CandidateEffect],
    chosen: &[Chosen],
    begun: Vec<Optima>,
    course: &Course,
) -> Vec<Refitted> {
    let clear = leads_clearly(null, &begun);
    course.going_on(chosen.len());
    let one = |(one, begun): (&Chosen, Optima)| {
        let candidate = &candidates[one.place];
        let goes_on = null.is_promising(&begun) || (Effort::of(&candidate.problem).patient && !clear);
        let before = begun.evaluations;
        let refitted = refit(null, candidate, one, begun, goes_on, &|| course.halts())?;
        let spent = refitted.fitted.evaluations - before;
        course.tried(&candidate.id, refitted.delta_bic(null), refitted.gain(null, None).fall, spent);
        Some(refitted)
    };
    let found: Vec<Option<Refitted>> = chosen.par_iter().zip(begun).map(one).collect();
    found.into_iter().flatten().collect()
}

/// The first part of a candidate's way to its optima, from those of the null model and the linearised step.
fn begin(null: &NullModel, candidate: &CandidateEffect, chosen: &Chosen, halt: Halt) -> Optima {
    let Chosen { score, other, far, .. } = chosen;
    let start = |theta: &[f64], steps: &[f64], part: f64| {
        let mut start = candidate.lift(&null.problem, theta);
        for ((index, off), step) in candidate.own.iter().zip(steps) {
            let [lower, upper] = candidate.problem.bounds()[*index];
            // Not on the bound, where a rate on a logarithmic scale would never leave it.
            let least = off + 1e-3 * (upper - lower);
            let wanted = off + part * step;
            start[*index] =
                if lower >= 0.0 { wanted.clamp(least, upper) } else { wanted.clamp(lower, upper) };
        }
        start
    };
    let Effort { parts, refit: iterations, .. } = Effort::of(&candidate.problem);
    let along = |task: &Refit, theta: &[f64], steps: &[f64]| {
        let mut starts: Vec<Vec<f64>> = parts.iter().map(|part| start(theta, steps, *part)).collect();
        let cheapest = task.cheapest(&starts);
        starts.swap_remove(cheapest)
    };
    let [of_plain, of_white] = null.filters.tasks(&candidate.problem, halt);
    let mut plain = vec![along(&of_plain, &null.fitted.plain, &score.step)];
    let mut white = vec![along(&of_white, &null.fitted.white, &score.step)];
    if let Some(([at_plain, at_white], steps)) = null.other.as_ref().zip(other.as_ref()) {
        plain.push(along(&of_plain, at_plain, steps));
        white.push(along(&of_white, at_white, steps));
    }
    if let Some(far) = far {
        plain.push(far.clone());
        white.push(far.clone());
    }
    null.filters.begin(&candidate.problem, [&plain, &white], iterations, halt)
}

/// The candidate where its way ends, whether or not it goes on.
fn refit(
    null: &NullModel,
    candidate: &CandidateEffect,
    chosen: &Chosen,
    begun: Optima,
    goes_on: bool,
    halt: Halt,
) -> Option<Refitted> {
    let iterations = Effort::of(&candidate.problem).refit;
    let fitted =
        if goes_on { null.filters.go_on(&candidate.problem, begun, iterations, halt) } else { begun };
    let measured = null.filters.measure(&candidate.problem, &fitted, halt)?;
    let active = candidate
        .own
        .iter()
        .filter(|(index, off)| is_active(candidate, *index, *off, fitted.white[*index]))
        .count();
    Some(Refitted { candidate: chosen.place, score: chosen.score.clone(), fitted, measured, active })
}

/// Whether a coefficient has left the value at which it does nothing.
fn is_active(candidate: &CandidateEffect, index: usize, off: f64, value: f64) -> bool {
    let [lower, upper] = candidate.problem.bounds()[index];
    (value - off).abs() > 1e-4 * (upper - lower)
}

/// The largest gain over the null model as it is now comes first.
fn compare(null: &NullModel, refitted: &mut [Refitted]) {
    refitted
        .sort_by(|a, b| b.delta_bic(null).total_cmp(&a.delta_bic(null)).then(a.candidate.cmp(&b.candidate)));
}

/// Forecasts a day ahead with those candidates that explain slow residuals, or innovations without making the
/// free run better: it can be dominated by what nobody logs, and states re-estimated every day put it right.
fn day_ahead(null: &NullModel, candidates: &[CandidateEffect], refitted: &[Refitted]) -> Vec<Option<Ahead>> {
    let asked = |one: &Refitted| {
        let gain = one.gain(null, None);
        let slow = gain.slow_delta_bic.is_some_and(|gain| gain >= LEAST_BIC);
        slow || (gain.delta_bic >= LEAST_BIC && gain.fall.is_none_or(|fall| fall > LEAST_FALL))
    };
    let asked: Vec<bool> = refitted.iter().map(asked).collect();
    if !asked.contains(&true) {
        return vec![None; refitted.len()];
    }
    let error = |problem: &Problem, theta: &[f64], noise: ProcessNoise| {
        let run = filter(problem, theta, noise);
        (day_ahead_mse(problem, theta, &run, problem.split().validation.clone()), run.process_noise)
    };
    let (before, process_noise) = error(&null.problem, &null.fitted.plain, ProcessNoise::Likeliest);
    let ahead = |(one, asked): (&Refitted, &bool)| {
        let before = before.filter(|_| *asked)?;
        let known = ProcessNoise::Known(process_noise);
        let after = error(&candidates[one.candidate].problem, &one.fitted.plain, known).0?;
        let noise = one.measured.floor.powi(2);
        Some(Ahead {
            fall: (after / before).sqrt(),
            share: (before - after) / (before - noise).max(1e-3 * before),
        })
    };
    refitted.par_iter().zip(&asked).map(ahead).collect()
}
