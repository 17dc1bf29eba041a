//! Who is refitted in a round, who is not, and why: by the screen, by segments of hours, and by a search from
//! the nominal values.

use super::course::Course;
use super::effort::Effort;
use super::library::CandidateEffect;
use super::null_model::NullModel;
use super::screen::{Blind, Score};
use super::surrogates::Heard;
use crate::simulate::trajectory::Halt;
use rayon::prelude::*;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Members of a family of choices that are refitted.
const CHOICES: usize = 3;
/// The largest cost in the end, over the null model's, at which the refit goes on from it.
const PROMISING: f64 = 0.95;

/// Why a candidate was not refitted.
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

/// A candidate that is refitted.
#[derive(Clone)]
pub(super) struct Chosen {
    /// Its place among the candidates.
    pub place: usize,
    /// What the screen says of it.
    pub score: Score,
    /// The step from the other optimum of the null model, where there is one.
    pub other: Option<Vec<f64>>,
    /// Where the restart from the nominal values has come to, where it promises something.
    pub far: Option<Vec<f64>>,
}

/// Who is refitted: whom the data can show with a sign that physics allows, from either optimum of the null
/// model, and of a shape the best choices.
pub(super) fn choose(
    candidates: &[CandidateEffect],
    here: Vec<Result<Score, Blind>>,
    there: Option<Vec<Result<Score, Blind>>>,
    heard: &[Heard],
    asks: &dyn Fn(&Score) -> bool,
) -> (Vec<Chosen>, Vec<(usize, Skip)>) {
    let mut there = there.unwrap_or_default().into_iter();
    let mut chosen: Vec<Chosen> = Vec::new();
    let mut skipped = Vec::new();
    for (place, here) in here.into_iter().enumerate() {
        let there = there.next().and_then(Result::ok).filter(asks);
        match (here, there) {
            (Ok(score), there) if asks(&score) => {
                chosen.push(Chosen { place, score, other: there.map(|score| score.step), far: None })
            }
            (_, Some(score)) => {
                chosen.push(Chosen { place, other: Some(score.step.clone()), score, far: None })
            }
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
        let alike = |other: &&Chosen| candidates[other.place].family() == candidates[one.place].family();
        chosen.iter().filter(alike).filter(|other| other.score.statistic > one.score.statistic).count()
    };
    let keep: Vec<bool> =
        chosen.iter().map(|one| !candidates[one.place].is_choice() || better(one) < CHOICES).collect();
    let (kept, left): (Vec<_>, Vec<_>) = chosen.into_iter().zip(keep).partition(|(_, keep)| *keep);
    skipped.extend(left.into_iter().map(|(one, _)| (one.place, Skip::Choice)));
    (kept.into_iter().map(|(one, _)| one).collect(), skipped)
}

/// Searches from the nominal values with every candidate that `goes`: without its missing effect a model may
/// err least where it is none of its kind any more, and nothing that is added there helps. Of a family of
/// choices the best by score goes for all. Who is refitted now, who is not, and the simulations of all
/// restarts. First go those that the model's own parameters imitate at the null model's optimum; the others
/// where too little is found without them.
pub(super) fn search_from_nominal(
    null: &NullModel,
    candidates: &[CandidateEffect],
    chosen: Vec<Chosen>,
    skipped: Vec<(usize, Skip)>,
    goes: &dyn Fn(&Score) -> bool,
    course: &Course,
) -> (Vec<Chosen>, Vec<(usize, Skip)>, usize) {
    let score = |skip: &Skip| match skip {
        Skip::Sign(score) | Skip::Faint(score) => Some(score.clone()),
        Skip::Blind(Blind::TooSmall) => Some(Score::nothing()),
        // Where a rate lies on its bound, one state imitates another; from there on it need not.
        Skip::Blind(Blind::Imitated) => Some(Score { imitated: true, ..Score::nothing() }),
        Skip::Blind(Blind::Diverged) | Skip::Choice => None,
    };
    let asked = |place: usize, score: &Score| goes(score).then_some((place, score.statistic));
    let mut waiting: Vec<(usize, f64)> =
        chosen.iter().filter_map(|one| asked(one.place, &one.score)).collect();
    waiting.extend(skipped.iter().filter_map(|(place, skip)| asked(*place, &score(skip)?)));
    waiting.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    let mut families: Vec<&str> = Vec::new();
    waiting.retain(|(place, _)| {
        let candidate = &candidates[*place];
        let first = !candidate.is_choice() || !families.contains(&candidate.family());
        families.push(candidate.family());
        first
    });
    let halt: Halt = &|| course.halts();
    let alone = waiting.iter().filter(|(place, _)| !chosen.iter().any(|one| one.place == *place)).count();
    course.restarting(chosen.len() + alone, waiting.len(), chosen.len());
    let most = PROMISING * null.fitted.plain_cost;
    let evaluations = AtomicUsize::new(0);
    let mut far: Vec<(usize, Vec<f64>)> = waiting
        .into_par_iter()
        .filter_map(|(place, _)| {
            let problem = &candidates[place].problem;
            let [task, _] = null.filters.tasks(problem, halt);
            let Effort { restart: iterations, goes_on, .. } = Effort::of(problem);
            let (mut theta, mut cost, mut spent) = task.polish(&[problem.nominal().to_vec()], iterations);
            if (most..goes_on * null.fitted.plain_cost).contains(&cost) {
                let more;
                (theta, cost, more) = task.polish(&[theta], iterations);
                spent += more;
            }
            evaluations.fetch_add(spent, Ordering::Relaxed);
            course.step(spent);
            (cost < most).then_some((place, theta))
        })
        .collect();
    let mut promising = |place: usize| {
        far.iter().position(|(other, _)| *other == place).map(|found| far.swap_remove(found).1)
    };
    let mut chosen: Vec<Chosen> =
        chosen.into_iter().map(|one| Chosen { far: promising(one.place), ..one }).collect();
    let mut left = Vec::new();
    for (place, skip) in skipped {
        match score(&skip).zip(promising(place)) {
            Some((score, far)) => chosen.push(Chosen { place, score, other: None, far: Some(far) }),
            None => left.push((place, skip)),
        }
    }
    (chosen, left, evaluations.into_inner())
}
