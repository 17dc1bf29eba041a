//! A round: every suspect is refitted, and two gates decide (reference: missing-effects 3, 5 and 7).
//!
//! The likelihood gate asks whether the suspect explains the innovations of the training part, the held-out gate
//! whether the error on unseen data really falls. The null model is restarted from the best suspects' parameters,
//! so that no suspect gains by a better search alone.

use super::candidates::{Suspect, sign_allows};
use super::fitted::{Fitted, Measured, Null};
use super::report::Gate;
use super::screen::{Blind, Score, Screen, correlation};
use crate::estimate::Problem;
use crate::estimate::metrics::{day_ahead_mse, filter};
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Least gain of the BIC.
pub const LEAST_BIC: f64 = 10.0;
/// The same of a shape that follows the clock alone: whatever else happens at some hours, and is in no catalogue, follows it too.
pub const LEAST_SHAPE_BIC: f64 = 40.0;
/// And least share of the days, seen and unseen, on which the free run errs less with it: a habit shows on most of them.
const HABIT_DAYS: f64 = 0.5;
/// The same of one that the model imitates near its optimum unless it explains much.
const LEAST_IMITATED_BIC: f64 = 20.0;
/// Ratio of free-run error to innovation deviation above which slow effects are let in by slower measures: where a
/// model is right but for little, the likelihood sees what is missing.
const CRUDE_RHO: f64 = 1.5;
/// Below this ratio a modest gain of the BIC needs both measures of unseen data, or nearly all of the error: a structure
/// that is a little wrong gains a little by almost anything.
const NEAR_RHO: f64 = 3.0;
const MODEST_BIC: f64 = 25.0;
const NEARLY_ALL: f64 = 0.9;
/// Least share of the unseen free-run error beyond the noise.
pub const LEAST_SHARE: f64 = 0.20;
/// Or least share of the unseen innovations.
pub const LEAST_WHITE_SHARE: f64 = 0.03;
/// Least share for what follows from the output itself, and for short records.
pub const STRICT_SHARE: f64 = 0.35;
/// Least share of the unseen innovations for what follows from the output: a real opening explains the very drops,
/// any other cooling that begins sharply only their aftermath.
const STRICT_WHITE_SHARE: f64 = 0.35;
/// A slow effect helps on at least this share of the days.
const MOST_DAYS: f64 = 0.7;
/// An error that falls at least to this share has fallen: what matters to nobody is no finding.
const LEAST_FALL: f64 = 0.9;
/// Unless the likelihood gains this much, and as much of the error beyond the noise is explained as is asked of the strict:
/// near the noise an error cannot fall by a tenth. With such a gain forecasts a day ahead stand in for the free run.
const PLAIN_BIC: f64 = 40.0;
/// Suspects whose gain is within this much of the winner's, or within this share of it, or that are this much alike, are
/// named together with it.
const TIE_BIC: f64 = 10.0;
const TIE_SHARE: f64 = 0.15;
const TIE_CORRELATION: f64 = 0.9;
/// Where the median suspect gains, a cause gains this many times as much.
const STAND_OUT: f64 = 2.0;
/// Fewest families of which a median means anything.
const LEAST_FAMILIES: usize = 5;
/// Iterations of a suspect.
const ITERATIONS: usize = 30;
/// Members of a family of choices that are refitted.
const CHOICES: usize = 3;
/// Least score of a suspect that is refitted: chi-squared with one degree of freedom exceeds it by chance in a
/// third of all cases.
const LEAST_SCORE: f64 = 1.0;
/// From how many of the best suspects the null model is restarted.
const RESTARTS: usize = 3;
/// Iterations of a suspect's scout from its nominal values, and the largest cost of the free run there, over the null
/// model's, at which it goes on for as many again: the way from the nominal values is long.
const SCOUT: usize = 15;
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

/// Tries every suspect on the null model, which is restarted on the way. `strict` asks for more of everybody.
pub fn round(null: &mut Null, suspects: &[Suspect], strict: bool) -> Option<Round> {
    let screened = |theta: &[f64]| -> Option<Vec<Result<Score, Blind>>> {
        let screen = Screen::new(&null.problem, theta, &null.filters.white)?;
        Some(suspects.par_iter().map(|suspect| screen.score(suspect)).collect())
    };
    let here = screened(&null.fitted.white)?;
    let there = null.other.as_ref().and_then(|[_, white]| screened(white));
    let (chosen, skipped) = choose(suspects, here, there);
    let (chosen, skipped, scouting) = scout(null, suspects, chosen, skipped);
    let found: Vec<Option<Tried>> = chosen.into_par_iter().map(|chosen| refit(null, &suspects[chosen.place], chosen)).collect();
    let mut tried: Vec<Tried> = found.into_iter().flatten().collect();
    compare(null, &mut tried);
    // The null model goes on from where the best suspects have come to.
    restart(null, suspects, &mut tried, RESTARTS);
    let mut placebo = median_gain(&tried, suspects);
    if placebo > LEAST_BIC {
        // Where most suspects gain, it may be the null model that is not at its optimum.
        let all = tried.len();
        restart(null, suspects, &mut tried, all);
        placebo = median_gain(&tried, suspects);
    }
    day_ahead(null, suspects, &mut tried);
    let rho = null.rho().unwrap_or(f64::INFINITY);
    for one in &mut tried {
        let suspect = &suspects[one.suspect];
        one.gate = gate(suspect, one, strict, rho, placebo);
    }
    let winner = tried.iter().position(|one| one.gate.is_none());
    let tied = winner.map_or_else(Vec::new, |winner| ties(&mut tried, suspects, winner));
    let evaluations = scouting + tried.iter().map(|one| one.fitted.evaluations).sum::<usize>();
    Some(Round { tried, skipped, evaluations, winner, tied })
}

/// Restarts the null model from the parameters of the best suspects without their effects, and compares again.
fn restart(null: &mut Null, suspects: &[Suspect], tried: &mut [Tried], count: usize) {
    let bases: Vec<[Vec<f64>; 2]> = tried
        .iter()
        .take(count)
        .map(|one| [&one.fitted.plain, &one.fitted.white].map(|theta| suspects[one.suspect].lower(&null.problem, theta)))
        .collect();
    for [plain, white] in bases {
        null.restart(&plain, &white);
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
fn scout(null: &Null, suspects: &[Suspect], chosen: Vec<Chosen>, skipped: Vec<(usize, Skip)>) -> (Vec<Chosen>, Vec<(usize, Skip)>, usize) {
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
            let [task, _] = null.filters.tasks(problem);
            let (mut theta, mut cost, mut spent) = task.polish(&[problem.nominal().to_vec()], SCOUT);
            evaluations.fetch_add(spent, Ordering::Relaxed);
            if (most..GOES_ON * null.fitted.plain_cost).contains(&cost) {
                (theta, cost, spent) = task.polish(&[theta], SCOUT);
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
fn refit(null: &Null, suspect: &Suspect, chosen: Chosen) -> Option<Tried> {
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
    let fitted = null.filters.fit(&suspect.problem, &plain, &white, ITERATIONS);
    let measured = null.filters.measure(&suspect.problem, &fitted)?;
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

/// What stops a suspect.
fn gate(suspect: &Suspect, one: &Tried, strict: bool, rho: f64, placebo: f64) -> Option<(Gate, String)> {
    let percent = |share: Option<f64>| share.map_or_else(|| "no unseen data".to_owned(), |share| format!("{:.0} %", 100.0 * share));
    if one.active == 0 {
        return Some((Gate::Bound, "it fits best where it does nothing".to_owned()));
    }
    let allowed = suspect.own.iter().any(|(index, off)| sign_allows(suspect.spec.sign, one.fitted.white[*index] - off));
    if !allowed {
        return Some((Gate::Sign, "the data ask for a sign that physics does not allow".to_owned()));
    }
    // What is no number reaches nothing.
    let reaches = |value: Option<f64>, least: f64| value.is_some_and(|value| value >= least);
    // A cause stands out from what everybody gains.
    if placebo > LEAST_BIC && !reaches(Some(one.delta_bic), STAND_OUT * placebo) {
        return Some((Gate::Bic, "most suspects gain alike: the fit without them is not at its optimum".to_owned()));
    }
    let endogenous = suspect.endogenous;
    let imitated = one.score.imitated && !reaches(one.share, STRICT_SHARE);
    let (slow, least) = match (suspect.by_clock, imitated) {
        (true, _) => (false, LEAST_SHAPE_BIC),
        (false, true) => (false, LEAST_IMITATED_BIC),
        (false, false) => (rho >= CRUDE_RHO && !endogenous && explains_slowly(one), LEAST_BIC),
    };
    if !slow && !reaches(Some(one.delta_bic), least) {
        return Some((Gate::Bic, format!("it gains {:.1} in BIC, and {least} is asked for", one.delta_bic)));
    }
    if suspect.by_clock && one.better_days.iter().any(|share| *share < HABIT_DAYS) {
        return Some((Gate::HeldOut, "it follows the clock, and helps on fewer than half of the days".to_owned()));
    }
    // Whatever the likelihood says: what leaves the unseen error as it is is no cause of it.
    let one_step = one.white_share.map(|share| (1.0 - share).max(0.0).sqrt());
    let falls = [one.fall, one.ahead_fall, one_step].into_iter().flatten().any(|fall| fall <= LEAST_FALL);
    let plain = reaches(Some(one.delta_bic), PLAIN_BIC) && reaches(one.share, STRICT_SHARE);
    if !falls && !plain {
        let why = "neither the free run nor forecasts a step or a day ahead err a tenth less with it on unseen data";
        return Some((Gate::HeldOut, why.to_owned()));
    }
    let both = reaches(one.share, LEAST_SHARE) && reaches(one.white_share, LEAST_WHITE_SHARE);
    if rho < NEAR_RHO && one.delta_bic < MODEST_BIC && !both && !reaches(one.share, NEARLY_ALL) {
        let why = "it gains little, and the free run and the innovations on unseen data do not both confirm it";
        return Some((Gate::HeldOut, why.to_owned()));
    }
    if slow {
        return None;
    }
    if endogenous && !(reaches(one.share, STRICT_SHARE) && reaches(one.white_share, STRICT_WHITE_SHARE)) {
        let why = format!(
            "read off the room temperature itself, it explains {} of the error and {} of the innovations on unseen data, and {:.0} % of both is asked for",
            percent(one.share),
            percent(one.white_share),
            100.0 * STRICT_SHARE
        );
        return Some((Gate::HeldOut, why));
    }
    let least = if strict { STRICT_SHARE } else { LEAST_SHARE };
    // States that are re-estimated show what a free run hides behind the chance of one week.
    let ahead = reaches(Some(one.delta_bic), PLAIN_BIC) && reaches(one.ahead_share, STRICT_SHARE) && reaches(one.share, 0.0);
    let passes = reaches(one.share, least) || (!strict && (ahead || reaches(one.white_share, LEAST_WHITE_SHARE)));
    (!passes).then(|| {
        let why = format!("it explains {} of the error on unseen data, and {:.0} % is asked for", percent(one.share), 100.0 * least);
        (Gate::HeldOut, why)
    })
}

/// The other way in: a slow effect gains on three-hourly means, on most days, and on unseen data either in
/// forecasts a day ahead from re-estimated states or in the free run of most days.
fn explains_slowly(one: &Tried) -> bool {
    let gains = one.slow_delta_bic.is_some_and(|gain| gain >= LEAST_BIC) && one.better_days[0] >= MOST_DAYS;
    // States that are re-estimated hide much, but not innovations that grow.
    let ahead = one.ahead_share.is_some_and(|share| share >= STRICT_SHARE) && one.white_share.is_none_or(|share| share >= 0.0);
    let free = one.share.is_some_and(|share| share >= STRICT_SHARE) && one.better_days[1] >= MOST_DAYS;
    gains && (ahead || free)
}

/// Those that cannot be told from the winner, the best member of each family of choices only: what passes the gates and
/// gains as much or does the same, and what gains as much although it lowers the unseen error by too little.
fn ties(tried: &mut [Tried], suspects: &[Suspect], winner: usize) -> Vec<usize> {
    let best = tried[winner].clone();
    // Who is let in by the slower measure is compared by it.
    let slowly = best.delta_bic < LEAST_BIC;
    let gain = |one: &Tried| if slowly { one.slow_delta_bic.unwrap_or(f64::NEG_INFINITY) } else { one.delta_bic };
    let least = gain(&best) - TIE_BIC.max(TIE_SHARE * gain(&best));
    let mut tied: Vec<usize> = Vec::new();
    for place in (0..tried.len()).filter(|place| *place != winner) {
        let one = &tried[place];
        let suspect = &suspects[one.suspect];
        let named = |other: usize| suspect.is_choice() && suspects[other].family() == suspect.family();
        let alike = gain(one) >= least || correlation(&one.score.direction, &best.score.direction).abs() > TIE_CORRELATION;
        let held_out = matches!(one.gate, Some((Gate::HeldOut, _))) && !suspect.endogenous;
        let likely = held_out && gain(one) >= least && one.fall.is_some_and(|fall| fall < 1.0);
        if !(likely || (one.gate.is_none() && alike)) {
            continue;
        }
        let known = named(best.suspect) || tied.iter().any(|other| named(tried[*other].suspect));
        let why = format!("these data cannot tell it from {}", suspects[best.suspect].id);
        tried[place].gate = Some((Gate::Tie, why));
        if !known {
            tied.push(place);
        }
    }
    tied
}
