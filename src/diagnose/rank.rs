//! A round: every suspect is refitted, and the gates (`gates`) decide (reference: missing-effects 3, 5 and 7).
//!
//! The null model is restarted from the best suspects' parameters, so that no suspect gains by a better search alone.

use super::candidates::Suspect;
use super::effort::Effort;
use super::fitted::{Fitted, Measured, Null};
use super::gates::{LEAST_BIC, LEAST_FALL, gate, ties};
use super::report::{EffectScore, Gate};
use super::screen::{Blind, Score, Screen};
use super::surrogates::{Heard, heard};
use crate::estimate::Problem;
use crate::estimate::metrics::{day_ahead_mse, filter};
use crate::simulate::trajectory::Halt;
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Fewest families of which a median means anything.
const LEAST_FAMILIES: usize = 5;
/// Members of a family of choices that are refitted.
const CHOICES: usize = 3;
/// Least score of a suspect that is refitted: chi-squared with one degree of freedom exceeds it by chance in a
/// third of all cases.
const LEAST_SCORE: f64 = 1.0;
/// From how many of the best suspects the null model is restarted.
const RESTARTS: usize = 3;
/// The largest cost of the free run to which a scout from the nominal values has come, over the null model's, at which it goes
/// on for as many iterations again: the way from the nominal values is long.
const GOES_ON: f64 = 2.0;
/// The largest cost in the end, over the null model's, at which the refit goes on from it.
const PROMISING: f64 = 0.95;

/// A suspect with its refit.
#[derive(Debug, Clone)]
pub struct Tried {
    /// Its place among the suspects of the round.
    pub suspect: usize,
    /// Its score.
    pub score: Score,
    /// Where its refit ended.
    pub fitted: Fitted,
    /// What is measured there.
    pub measured: Measured,
    /// Parameters of its own that are not where they do nothing.
    pub active: usize,
    /// Gain of the BIC over the null model.
    pub delta_bic: f64,
    /// The same on three-hourly means.
    pub slow_delta_bic: Option<f64>,
    /// Share of the unseen free-run error beyond the noise that it explains.
    pub share: Option<f64>,
    /// The unseen free-run error with it over that without it.
    pub fall: Option<f64>,
    /// Share of the unseen innovations that it explains.
    pub white_share: Option<f64>,
    /// The error of forecasts a day ahead with it over that without it, where it was asked for.
    pub ahead_fall: Option<f64>,
    /// Share of the squared error of forecasts a day ahead beyond the noise, where it was asked for.
    pub ahead_share: Option<f64>,
    /// Share of the days on which the free run errs less with it: training, validation.
    pub better_days: [f64; 2],
    /// What segments of hours show of it.
    pub heard: Heard,
    /// What stopped it, and why.
    pub gate: Option<(Gate, String)>,
}

/// What a round found.
#[derive(Debug, Clone)]
pub struct Round {
    /// Suspects with a refit, the largest gain first.
    pub tried: Vec<Tried>,
    /// Suspects without one: those that physics or the screen ruled out.
    pub skipped: Vec<(usize, Skip)>,
    /// Simulations of all scouts and of all that were tried.
    pub evaluations: usize,
    /// The place of the winner among the tried.
    pub winner: Option<usize>,
    /// Places of those that are named together with it.
    pub tied: Vec<usize>,
    /// What segments of hours show of everybody.
    pub scores: Vec<EffectScore>,
}

/// Why a suspect was not refitted.
#[derive(Debug, Clone, PartialEq)]
pub enum Skip {
    /// These data cannot show it.
    Blind(Blind),
    /// Physics does not allow the sign that the data ask for.
    Sign(Score),
    /// The data hardly ask for it.
    Faint(Score),
    /// A better member of its family stands for it.
    Choice,
}

/// Tries every suspect on the null model, which is restarted on the way. `strict` asks for more of everybody, and `rate` is how often
/// segments of hours may accuse where nothing is missing. What comes of a round that `halt` has cut short means nothing.
pub fn round(null: &mut Null, suspects: &[Suspect], strict: bool, rate: f64, halt: Halt) -> Option<Round> {
    let screened = |theta: &[f64]| -> Option<Vec<Result<Score, Blind>>> {
        let screen = Screen::new(&null.problem, theta, &null.filters.white, halt)?;
        Some(suspects.par_iter().map(|suspect| screen.score(suspect)).collect())
    };
    let here = screened(&null.fitted.white)?;
    let there = null.other.as_ref().and_then(|[_, white]| screened(white));
    let mut heard = heard(&null.problem, &null.fitted.plain, suspects, rate, halt);
    let scores = heard.iter().filter_map(|heard| heard.ranked.clone()).collect();
    let (chosen, skipped) = choose(suspects, here, there, &heard);
    let (chosen, skipped, scouting) = scout(null, suspects, chosen, skipped, halt);
    let found: Vec<Option<Tried>> = chosen.into_par_iter().map(|chosen| refit(null, &suspects[chosen.place], chosen, halt)).collect();
    let mut tried: Vec<Tried> = found.into_iter().flatten().collect();
    tried.iter_mut().for_each(|one| one.heard = std::mem::take(&mut heard[one.suspect]));
    compare(null, &mut tried);
    // The null model goes on from where the best suspects have come to.
    restart(null, suspects, &mut tried, RESTARTS, halt);
    let mut placebo = median_gain(&tried, suspects);
    if placebo > LEAST_BIC {
        // Where most suspects gain, it may be the null model that is not at its optimum.
        let all = tried.len();
        restart(null, suspects, &mut tried, all, halt);
        placebo = median_gain(&tried, suspects);
    }
    day_ahead(null, suspects, &mut tried);
    let rho = null.rho().unwrap_or(f64::INFINITY);
    for one in &mut tried {
        let suspect = &suspects[one.suspect];
        one.gate = gate(suspect, one, strict, rho, placebo);
    }
    let winner = winner(&tried);
    let tied = winner.map_or_else(Vec::new, |winner| ties(&mut tried, suspects, winner));
    let evaluations = scouting + tried.iter().map(|one| one.fitted.evaluations).sum::<usize>();
    Some(Round { tried, skipped, evaluations, winner, tied, scores })
}

/// Whoever passes the gates with the largest gain. Where segments of hours show anybody, who of all that pass explains most of what they
/// leave open.
fn winner(tried: &[Tried]) -> Option<usize> {
    let mut passes = (0..tried.len()).filter(|place| tried[*place].gate.is_none());
    let share = |place: &usize| tried[*place].heard.share().unwrap_or(0.0);
    match tried.iter().any(|one| one.gate.is_none() && one.heard.shown.is_some()) {
        true => passes.max_by(|one, other| share(one).total_cmp(&share(other))),
        false => passes.next(),
    }
}

/// Restarts the null model from the parameters of the best suspects without their effects, and compares again.
fn restart(null: &mut Null, suspects: &[Suspect], tried: &mut [Tried], count: usize, halt: Halt) {
    let bases: Vec<[Vec<f64>; 2]> = tried
        .iter()
        .take(count)
        .map(|one| [&one.fitted.plain, &one.fitted.white].map(|theta| suspects[one.suspect].lower(&null.problem, theta)))
        .collect();
    for [plain, white] in bases {
        null.restart(&plain, &white, halt);
    }
    compare(null, tried);
}

/// The median gain of the families that were tried, each by its best member; minus infinity where they are too few
/// to tell.
fn median_gain(tried: &[Tried], suspects: &[Suspect]) -> f64 {
    let mut families: Vec<&str> = Vec::new();
    let mut gains: Vec<f64> = Vec::new();
    for one in tried {
        let suspect = &suspects[one.suspect];
        if !suspect.is_choice() || !families.contains(&suspect.family()) {
            families.push(suspect.family());
            gains.push(one.delta_bic);
        }
    }
    // The largest gain comes first, so this is the median.
    if gains.len() < LEAST_FAMILIES { f64::NEG_INFINITY } else { gains[gains.len() / 2] }
}

/// A suspect that is refitted.
struct Chosen {
    place: usize,
    score: Score,
    /// The step from the other optimum of the null model, where there is one.
    other: Option<Vec<f64>>,
    /// Where the scout from the nominal values has come to, where it promises something.
    far: Option<Vec<f64>>,
}

/// Who is refitted: whom the data can show with a sign that physics allows, from either optimum of the null model,
/// and of a shape the best choices.
fn choose(
    suspects: &[Suspect],
    here: Vec<Result<Score, Blind>>,
    there: Option<Vec<Result<Score, Blind>>>,
    heard: &[Heard],
) -> (Vec<Chosen>, Vec<(usize, Skip)>) {
    // What the linearised model gives no gain at all the refit gives none either.
    let asks = |score: &Score| score.imitated || (score.sign && score.statistic >= LEAST_SCORE);
    let mut there = there.unwrap_or_default().into_iter();
    let mut chosen: Vec<Chosen> = Vec::new();
    let mut skipped = Vec::new();
    for (place, here) in here.into_iter().enumerate() {
        let there = there.next().and_then(Result::ok).filter(asks);
        match (here, there) {
            (Ok(score), there) if asks(&score) => chosen.push(Chosen { place, score, other: there.map(|score| score.step), far: None }),
            (_, Some(score)) => chosen.push(Chosen { place, other: Some(score.step.clone()), score, far: None }),
            (here, None) if let Some(shown) = &heard[place].shown => {
                let score = Score { step: shown.step.clone(), ..here.unwrap_or_else(|_| Score::nothing()) };
                chosen.push(Chosen { place, score, other: None, far: None });
            }
            (Err(blind), None) => skipped.push((place, Skip::Blind(blind))),
            (Ok(score), None) if !score.sign => skipped.push((place, Skip::Sign(score))),
            (Ok(score), None) => skipped.push((place, Skip::Faint(score))),
        }
    }
    let better = |one: &Chosen| {
        let alike = |other: &&Chosen| suspects[other.place].family() == suspects[one.place].family();
        chosen.iter().filter(alike).filter(|other| other.score.statistic > one.score.statistic).count()
    };
    let keep: Vec<bool> = chosen.iter().map(|one| !suspects[one.place].is_choice() || better(one) < CHOICES).collect();
    let (kept, left): (Vec<_>, Vec<_>) = chosen.into_iter().zip(keep).partition(|(_, keep)| *keep);
    skipped.extend(left.into_iter().map(|(one, _)| (one.place, Skip::Choice)));
    (kept.into_iter().map(|(one, _)| one).collect(), skipped)
}

/// Sends a scout from the nominal values with every suspect, those included for which the data hardly ask at the null
/// model's optimum: without its missing effect a model may err least where it is no room any more, and nothing that is
/// added there helps. Of a family of choices the best by score goes for all. Who is refitted now, who is not, and the
/// simulations of all scouts.
fn scout(
    null: &Null,
    suspects: &[Suspect],
    chosen: Vec<Chosen>,
    skipped: Vec<(usize, Skip)>,
    halt: Halt,
) -> (Vec<Chosen>, Vec<(usize, Skip)>, usize) {
    let score = |skip: &Skip| match skip {
        Skip::Sign(score) | Skip::Faint(score) => Some(score.clone()),
        Skip::Blind(Blind::TooSmall) => Some(Score::nothing()),
        // Where a rate lies on its bound, one state imitates another; from there on it need not.
        Skip::Blind(Blind::Imitated) => Some(Score { imitated: true, ..Score::nothing() }),
        Skip::Blind(Blind::Diverged) | Skip::Choice => None,
    };
    let mut waiting: Vec<(usize, f64)> = chosen.iter().map(|one| (one.place, one.score.statistic)).collect();
    waiting.extend(skipped.iter().filter_map(|(place, skip)| Some((*place, score(skip)?.statistic))));
    waiting.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    let mut families: Vec<&str> = Vec::new();
    waiting.retain(|(place, _)| {
        let suspect = &suspects[*place];
        let first = !suspect.is_choice() || !families.contains(&suspect.family());
        families.push(suspect.family());
        first
    });
    let most = PROMISING * null.fitted.plain_cost;
    let evaluations = AtomicUsize::new(0);
    let mut far: Vec<(usize, Vec<f64>)> = waiting
        .into_par_iter()
        .filter_map(|(place, _)| {
            let problem = &suspects[place].problem;
            let [task, _] = null.filters.tasks(problem, halt);
            let iterations = Effort::of(problem).scout;
            let (mut theta, mut cost, mut spent) = task.polish(&[problem.nominal().to_vec()], iterations);
            evaluations.fetch_add(spent, Ordering::Relaxed);
            if (most..GOES_ON * null.fitted.plain_cost).contains(&cost) {
                (theta, cost, spent) = task.polish(&[theta], iterations);
                evaluations.fetch_add(spent, Ordering::Relaxed);
            }
            (cost < most).then_some((place, theta))
        })
        .collect();
    let mut promising = |place: usize| far.iter().position(|(other, _)| *other == place).map(|found| far.swap_remove(found).1);
    let mut chosen: Vec<Chosen> = chosen.into_iter().map(|one| Chosen { far: promising(one.place), ..one }).collect();
    let mut left = Vec::new();
    for (place, skip) in skipped {
        match score(&skip).zip(promising(place)) {
            Some((score, far)) => chosen.push(Chosen { place, score, other: None, far: Some(far) }),
            None => left.push((place, skip)),
        }
    }
    (chosen, left, evaluations.into_inner())
}

/// The suspect at its optima, from those of the null model and the linearised step.
fn refit(null: &Null, suspect: &Suspect, chosen: Chosen, halt: Halt) -> Option<Tried> {
    let Chosen { place, score, other, far } = chosen;
    let start = |theta: &[f64], steps: &[f64]| {
        let mut start = suspect.lift(&null.problem, theta);
        for ((index, off), step) in suspect.own.iter().zip(steps) {
            let [lower, upper] = suspect.problem.bounds()[*index];
            // Not on the bound, where a rate on a logarithmic scale would never leave it.
            let least = off + 1e-3 * (upper - lower);
            let wanted = off + step;
            start[*index] = if lower >= 0.0 { wanted.clamp(least, upper) } else { wanted.clamp(lower, upper) };
        }
        start
    };
    let mut plain = vec![start(&null.fitted.plain, &score.step)];
    let mut white = vec![start(&null.fitted.white, &score.step)];
    if let Some(([at_plain, at_white], steps)) = null.other.as_ref().zip(other) {
        plain.push(start(at_plain, &steps));
        white.push(start(at_white, &steps));
    }
    if let Some(far) = far {
        plain.push(far.clone());
        white.push(far);
    }
    let fitted = null.filters.fit(&suspect.problem, &plain, &white, Effort::of(&suspect.problem).refit, halt);
    let measured = null.filters.measure(&suspect.problem, &fitted, halt)?;
    let active = suspect.own.iter().filter(|(index, off)| is_active(suspect, *index, *off, fitted.white[*index])).count();
    Some(Tried {
        suspect: place,
        score,
        fitted,
        measured,
        active,
        delta_bic: 0.0,
        slow_delta_bic: None,
        share: None,
        fall: None,
        white_share: None,
        ahead_fall: None,
        ahead_share: None,
        better_days: [0.0; 2],
        heard: Heard::default(),
        gate: None,
    })
}

/// Whether a coefficient has left the value at which it does nothing.
fn is_active(suspect: &Suspect, index: usize, off: f64, value: f64) -> bool {
    let [lower, upper] = suspect.problem.bounds()[index];
    (value - off).abs() > 1e-4 * (upper - lower)
}

/// Gains and shares against the null model as it is now; the largest gain first.
fn compare(null: &Null, tried: &mut [Tried]) {
    for one in tried.iter_mut() {
        let price = one.active.max(1) as f64 * (one.measured.samples as f64).ln();
        one.delta_bic = null.measured.bic - one.measured.bic - price;
        one.slow_delta_bic = null
            .measured
            .slow
            .zip(one.measured.slow)
            .map(|((before, _), (after, n))| before - after - one.active.max(1) as f64 * (n as f64).ln());
        let noise = one.measured.floor.powi(2);
        one.share =
            null.measured.plain[1].zip(one.measured.plain[1]).map(|(before, after)| (before - after) / (before - noise).max(1e-3 * before));
        one.fall = null.measured.plain[1].zip(one.measured.plain[1]).map(|(before, after)| (after / before).sqrt());
        one.white_share = null.measured.white_validation.zip(one.measured.white_validation).map(|(before, after)| 1.0 - after / before);
    }
    for one in tried.iter_mut() {
        for (part, better) in one.better_days.iter_mut().enumerate() {
            let pairs = null.measured.days[part].iter().zip(&one.measured.days[part]);
            let count = pairs.clone().filter(|(before, after)| after < before).count();
            *better = count as f64 / pairs.len().max(1) as f64;
        }
    }
    tried.sort_by(|a, b| b.delta_bic.total_cmp(&a.delta_bic).then(a.suspect.cmp(&b.suspect)));
}

/// Forecasts a day ahead with those suspects that explain slow residuals, or innovations without making the free run
/// better: it can be dominated by what nobody logs, and states re-estimated every day put it right.
fn day_ahead(null: &Null, suspects: &[Suspect], tried: &mut [Tried]) {
    let asked = |one: &Tried| {
        let slow = one.slow_delta_bic.is_some_and(|gain| gain >= LEAST_BIC);
        slow || (one.delta_bic >= LEAST_BIC && one.fall.is_none_or(|fall| fall > LEAST_FALL))
    };
    if !tried.iter().any(asked) {
        return;
    }
    let error = |problem: &Problem, theta: &[f64], noise: Option<f64>| {
        let run = filter(problem, theta, noise);
        (day_ahead_mse(problem, theta, &run, problem.split().validation.clone()), run.process_noise)
    };
    let (before, process_noise) = error(&null.problem, &null.fitted.plain, None);
    tried.par_iter_mut().filter(|one| asked(one)).for_each(|one| {
        let (after, _) = error(&suspects[one.suspect].problem, &one.fitted.plain, Some(process_noise));
        let noise = one.measured.floor.powi(2);
        one.ahead_fall = before.zip(after).map(|(before, after)| (after / before).sqrt());
        one.ahead_share = before.zip(after).map(|(before, after)| (before - after) / (before - noise).max(1e-3 * before));
    });
}
