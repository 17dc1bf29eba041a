//! Which terms are proposed: those that do better than the best of the same search on errors that no channel
//! has to do with, tried beside parameters of their own, with what cannot be told from them.

use super::document::TermWriting;
use super::search::{SearchScores, TermScore, TermSearch, range};
use super::settled::{SettledBeside, Trial, TriedFlows};
use super::term::{Factor, Memory, Schedule, ScheduleDays, Term, TermSubject};
use crate::diagnose::score_test::{Look, SegmentScore};
use crate::estimate::segments::likeness;
use crate::gram::dot;
use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Most proposals.
const MOST: usize = 3;
/// Fewer shifts tell nothing of chance.
pub(super) const LEAST_SHIFTS: usize = 5;
/// Most kinds of terms that are tried beside parameters that are sought anew, and beside those of the best.
const KINDS: usize = 8;
const KINDS_BESIDE: usize = 4;
/// Most that are tried beside the parameters that a free working day leaves.
const KINDS_BY_CLOCK: usize = 2;
/// The best so many walk to the numbers beside whose parameters least is left; they go on while this share
/// of the squares is left at most.
const WALKED: usize = 3;
const GAINS: f64 = 0.99;
/// What leaves so many times as much as the first of them comes nowhere near it by steps.
const FAR: f64 = 3.0;
/// Directions that correlate so much are one thing.
const ALIKE: f64 = 0.9;
/// What explains less than this share of the squared error changes it by a fortieth.
const LEAST_SHARE: f64 = 0.05;
/// What only reads what the model reads already mends a form that is wrong everywhere as well: more is asked.
const LEAST_SHARE_OF_MODEL: f64 = 0.08;
/// And of days that have not been looked at it explains so much; a schedule does as well: stoves that are lit
/// on many evenings have hours.
const LEAST_CONFIRMED_OF_MODEL: f64 = 0.2;
/// Beside its own parameters a term is still as sure as that: some thousands were tried, and with a few dozen
/// days one of ten thousand comes to it by chance.
const LEAST_T: f64 = 4.5;
/// A schedule holds on its days: so large is the square of the usual day as a share of that of all days,
/// beside parameters that are bent by what is missing, and beside its own. A stove that is lit on every other
/// evening comes to a half.
const STEADY: f64 = 0.6;
const STEADY_BESIDE_ITS_OWN: f64 = 0.75;
/// What only reads what the model reads already leaves this share of the squares at most: in rooms with more
/// masses than the model such a term mends a little of that.
const LEFT_OF_MODEL: f64 = 0.8;
/// Of what the hours of the day explain together a schedule explains most.
const MOST_OF_CLOCK: f64 = 0.6;
/// A term has to leave this share less for each choice that it is made of.
const SIMPLER: f64 = 0.03;
/// Time constants that are tried beside the best, in hours: the longer one is, the less of it the room itself
/// may take.
const OTHER_LAGS: [f64; 3] = [0.7, 1.5, 3.0];
/// Lengths of steps towards better numbers of a term, and most of each.
const PARTS: [f64; 3] = [0.5, 0.25, 0.125];
const STEPS: usize = 3;
/// Euler's constant, for Gumbel's mean.
const EULER: f64 = 0.577_215_664_901_532_9;

/// What a search has found.
pub(super) struct FoundTerms {
    /// At most three, best first.
    pub best: Vec<TriedTerm>,
    /// How many terms were scored.
    pub tried: usize,
    /// With how many shifts each was compared.
    pub shifts: usize,
    /// The share that the best of so many explains by chance.
    pub by_chance: Option<f64>,
    /// The squares that the model leaves without any.
    pub left: f64,
}

/// A term with the parameters that the model has beside it.
pub(super) struct TriedTerm {
    pub term: Term,
    pub size: f64,
    pub share: f64,
    pub t: f64,
    pub confirmed: f64,
    pub settled: SettledBeside,
    /// Terms that are the same thing here.
    pub alike: Vec<Term>,
}

/// Seeks the terms that explain most of the error of a model.
pub(super) fn choose(trial: &Trial<'_>, search: &TermSearch<'_>, null: &Look<'_>, rate: f64) -> FoundTerms {
    let scores = search.scores();
    let bar = Bar::new(search, null, &scores, rate);
    let left = null.left();
    let mut found = FoundTerms {
        best: Vec::new(),
        tried: scores.terms.len(),
        shifts: scores.shifts,
        by_chance: bar.by_chance,
        left: dot(left, left),
    };
    let mut leaders = leaders(search, &bar, &scores, KINDS);
    if let Some(late) = leaders.iter().find(|term| term.memory != Memory::None).copied() {
        leaders.extend(OTHER_LAGS.map(|hours| Term { memory: Memory::Lag(hours), ..late }));
    }
    let mut all = tried(trial, search, null, &leaders, true);
    let again = |settled: &SettledBeside, most: usize, by_clock: bool| -> Vec<TriedTerm> {
        beside(trial, search, settled, |search, look| {
            let mut scores = search.scores();
            let bar = Bar::new(search, look, &scores, rate);
            scores.terms.retain(|score| !by_clock || score.term.is_by_clock());
            tried(trial, search, look, &self::leaders(search, &bar, &scores, most), by_clock)
        })
        .unwrap_or_default()
    };
    // Where a schedule has bent the model's own parameters, none of its hours shows in what they leave. They
    // are themselves beside a flow that has each two hours of working days free, and hours show beside them.
    let profile = search.working_day();
    let flows = TriedFlows { series: &profile, into: search.into(), size: 1.0, start: 0.0 };
    let by_clock = if profile.is_empty() { None } else { trial.beside(null.theta(), &flows, true) };
    all.extend(by_clock.iter().flat_map(|settled| again(settled, KINDS_BY_CLOCK, true)));
    let all_ordered = ordered(trial, search, all);
    let Some(best) = all_ordered.first() else { return found };
    // Sought again beside the parameters of the best: where half of it had gone into the model's own, others
    // have looked better.
    let mut all = again(&best.settled, KINDS_BESIDE, false);
    all.extend(all_ordered);
    let mut walked: Vec<TriedTerm> = Vec::new();
    for one in grouped(trial, search, all, WALKED) {
        let worth = walked.first().is_none_or(|best| one.settled.squares <= FAR * best.settled.squares);
        walked.push(if worth { walk(trial, search, one) } else { one });
    }
    walked.retain(|one| {
        let bends = one.term.is_of_the_model(search.stock) && !one.term.is_by_clock();
        !bends || one.settled.squares <= LEFT_OF_MODEL * found.left
    });
    found.best = grouped(trial, search, walked, MOST);
    found
}

/// Walks with the form and the numbers of a term, each step beside parameters of its own: those that belong
/// to wrong numbers speak for them.
fn walk(trial: &Trial<'_>, search: &TermSearch<'_>, mut best: TriedTerm) -> TriedTerm {
    let mut around = forms(search, &best.term);
    for part in PARTS {
        for _ in 0..STEPS {
            around.extend(numbers(search, &best.term, part));
            let terms = std::mem::take(&mut around);
            let better = beside(trial, search, &best.settled, |search, look| {
                tried(trial, search, look, &terms, false)
            });
            let gains = |better: &TriedTerm| better.settled.squares < GAINS * best.settled.squares;
            match better.into_iter().flatten().next().filter(gains) {
                Some(better) => best = TriedTerm { alike: best.alike, ..better },
                None => break,
            }
        }
    }
    best
}

/// The same search beside other parameters.
fn beside<T>(
    trial: &Trial<'_>,
    search: &TermSearch<'_>,
    settled: &SettledBeside,
    work: impl FnOnce(&TermSearch<'_>, &Look<'_>) -> T,
) -> Option<T> {
    let look = trial.at(settled)?;
    let there = TermSearch::new(trial.problem, search.stock, &look, search.into(), trial.halt)?;
    Some(work(&there, &look))
}

/// Terms beside parameters of their own, those that leave least first.
fn tried(
    trial: &Trial<'_>,
    search: &TermSearch<'_>,
    look: &Look<'_>,
    terms: &[Term],
    anew: bool,
) -> Vec<TriedTerm> {
    let one = |term: &Term| {
        let score = scored(search, look, term)?;
        let series = [search.series(term)?];
        let flows = TriedFlows { series: &series, into: term.into, size: *score.size.first()?, start: 1.0 };
        let settled = trial.beside(look.theta(), &flows, anew)?;
        // How large it is, is known beside these parameters alone.
        let (there, days) = beside(trial, search, &settled, |search, look| {
            let score = scored(search, look, term)?;
            let days = search.days(&score.direction);
            Some((score, days))
        })??;
        let (size, share) = (*there.size.first()?, there.share);
        let (t, confirmed) = (there.t, there.confirmed);
        // Where it is the parameters alone that have become better, nothing is left for it.
        let least = if term.is_of_the_model(search.stock) { LEAST_CONFIRMED_OF_MODEL } else { 0.0 };
        let shows = confirmed > least
            && share >= LEAST_SHARE
            && t.abs() >= LEAST_T
            && (!term.is_by_clock() || steadiness(t, days) >= STEADY_BESIDE_ITS_OWN)
            && !is_its_own_cause(term, size);
        shows.then_some(TriedTerm { term: *term, size, share, t, confirmed, settled, alike: Vec::new() })
    };
    ordered(trial, search, terms.par_iter().filter_map(one).collect())
}

/// Whether a term that its own state's warmth switches warms it: then the warmth is what some heat does, and
/// not what drives it.
fn is_its_own_cause(term: &Term, size: f64) -> bool {
    matches!(term.subject, TermSubject::Warm(_))
        && match term.factor {
            Factor::Outdoors => size < 0.0,
            Factor::One | Factor::Sun => size > 0.0,
        }
}

/// The square of the usual day as a share of that of all days, of what has this size over its deviation.
fn steadiness(t: f64, days: usize) -> f64 {
    t * t / (t * t + days as f64)
}

fn scored(search: &TermSearch<'_>, look: &Look<'_>, term: &Term) -> Option<SegmentScore> {
    look.score_changes(vec![search.raw(term)?], &|_| true)
}

/// What leaves least first; of two that leave the same the simpler one. What another room has shown already
/// is as simple as can be.
fn ordered(trial: &Trial<'_>, search: &TermSearch<'_>, tried: Vec<TriedTerm>) -> Vec<TriedTerm> {
    let cost = |one: &TriedTerm| {
        let (catalogue, model) = (trial.catalogue, trial.problem.model());
        let (stock, term, size) = (search.stock, one.term, one.size);
        let writing = TermWriting { stock, catalogue, model, place: "", term, size };
        let choices = if writing.effect(|_| false).1 { 0 } else { term.choices() };
        one.settled.squares * (1.0 + SIMPLER * choices as f64)
    };
    let mut costed: Vec<(f64, TriedTerm)> = tried.into_iter().map(|one| (cost(&one), one)).collect();
    costed.sort_by(|a, b| a.0.total_cmp(&b.0));
    costed.into_iter().map(|(_, one)| one).collect()
}

/// At most so many that are not alike beside the parameters of the best, each with those that are.
fn grouped(trial: &Trial<'_>, search: &TermSearch<'_>, tried: Vec<TriedTerm>, most: usize) -> Vec<TriedTerm> {
    let tried = ordered(trial, search, tried);
    let Some(best) = tried.first() else { return tried };
    let direction = |search: &TermSearch<'_>, look: &Look<'_>, term: &Term| {
        search.raw(term).map(|raw| look.rest(raw)).unwrap_or_default()
    };
    let directions: Vec<Vec<f64>> = beside(trial, search, &best.settled, |search, look| {
        tried.iter().map(|one| direction(search, look, &one.term)).collect()
    })
    .unwrap_or_default();
    let mut groups: Vec<(TriedTerm, Vec<f64>)> = Vec::new();
    for (one, direction) in tried.into_iter().zip(directions) {
        let same = |(_, other): &&mut (TriedTerm, Vec<f64>)| likeness(other, &direction).abs() >= ALIKE;
        match groups.iter_mut().find(same) {
            Some((group, _)) => {
                let others = std::iter::once(one.term).chain(one.alike);
                let new = others.filter(|other| *other != group.term && !group.alike.contains(other));
                let new: Vec<Term> = new.collect();
                group.alike.extend(new);
            }
            None => groups.push((one, direction)),
        }
    }
    groups.truncate(most);
    groups.into_iter().map(|(one, _)| one).collect()
}

/// What the terms of a search are judged by.
struct Bar<'a> {
    search: &'a TermSearch<'a>,
    rate: f64,
    by_chance: Option<f64>,
    /// How many were tried.
    terms: f64,
    /// The share that the hours of the day explain.
    of_clock: f64,
}

impl<'a> Bar<'a> {
    fn new(search: &'a TermSearch<'a>, look: &Look<'_>, scores: &SearchScores, rate: f64) -> Self {
        let by_chance = by_chance(scores, rate);
        Self { search, rate, by_chance, terms: scores.terms.len() as f64, of_clock: look.share_of_clock() }
    }

    fn passes(&self, score: &TermScore) -> bool {
        let days = score.days as f64;
        let seldom = StudentsT::new(0.0, 1.0, days - 1.0)
            .is_ok_and(|t| 2.0 * t.cdf(-score.t.abs()) * self.terms <= self.rate);
        let least = match score.term {
            _ if score.term.is_by_clock() => LEAST_SHARE.max(MOST_OF_CLOCK * self.of_clock),
            _ if score.term.is_of_the_model(self.search.stock) => LEAST_SHARE_OF_MODEL,
            _ => LEAST_SHARE,
        };
        let told_apart = if score.term.is_by_clock() {
            steadiness(score.t, score.days) >= STEADY
        } else {
            self.by_chance.is_some_and(|by_chance| score.share > by_chance)
                && score.shifted.iter().all(|shifted| *shifted < score.share)
        };
        seldom && told_apart && score.share >= least
    }
}

/// The best term of each kind of whatever has passed, with its numbers refined, best first: once a channel
/// has passed, each of its kinds is worth a try.
fn leaders(search: &TermSearch<'_>, bar: &Bar<'_>, scores: &SearchScores, most: usize) -> Vec<Term> {
    let scores = &scores.terms;
    let passing: Vec<&TermScore> = scores.iter().filter(|score| bar.passes(score)).collect();
    let has_passed = |score: &TermScore| passing.iter().any(|one| one.term.reads() == score.term.reads());
    let worth = |score: &TermScore| score.share * (1.0 - SIMPLER * score.term.choices() as f64);
    let mut worthy: Vec<&TermScore> =
        scores.iter().filter(|score| score.share >= LEAST_SHARE && has_passed(score)).collect();
    worthy.sort_by(|a, b| worth(b).total_cmp(&worth(a)));
    let mut leaders: Vec<&TermScore> = Vec::new();
    for score in worthy {
        if leaders.iter().all(|one| one.term.kind() != score.term.kind()) {
            leaders.push(score);
        }
    }
    leaders.truncate(most);
    leaders.par_iter().map(|score| refined(search, score.term)).collect()
}

/// The share that the best of a search explains by chance in a room in which nothing measured has to do with
/// the error, exceeded with this probability: Gumbel's distribution through the best of every shift, by
/// moments (Gumbel 1958). `None` without enough shifts.
fn by_chance(scores: &SearchScores, rate: f64) -> Option<f64> {
    let shifts = scores.shifts;
    if shifts < LEAST_SHIFTS {
        return None;
    }
    let best = |shift: usize| {
        let reached = scores.terms.iter().filter_map(|score| score.shifted.get(shift));
        reached.copied().fold(0.0, f64::max)
    };
    let best: Vec<f64> = (0..shifts).map(best).collect();
    let mean = best.iter().sum::<f64>() / shifts as f64;
    let variance = best.iter().map(|share| (share - mean).powi(2)).sum::<f64>() / (shifts - 1) as f64;
    let scale = (6.0 * variance).sqrt() / std::f64::consts::PI;
    Some(mean - EULER * scale - scale * (-(1.0 - rate).ln()).ln())
}

/// The same term where its threshold, its time constant and its hours explain most: steps along the best of
/// them, then halved ones.
fn refined(search: &TermSearch<'_>, term: Term) -> Term {
    let share = |term: &Term| search.share(term).unwrap_or(0.0);
    let mut best = (term, share(&term));
    for part in PARTS {
        for _ in 0..STEPS {
            let around = numbers(search, &best.0, part);
            let shares = around.par_iter().map(|term| (*term, share(term)));
            match shares.max_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, share)| *share > best.1) {
                Some(better) => best = better,
                None => break,
            }
        }
    }
    best.0
}

/// Other forms of a schedule: at all other hours, on other days, of another flow.
fn forms(search: &TermSearch<'_>, term: &Term) -> Vec<Term> {
    let TermSubject::Hours(schedule) = term.subject else { return Vec::new() };
    let of = |schedule| Term { subject: TermSubject::Hours(schedule), ..*term };
    let days = [ScheduleDays::All, ScheduleDays::Working, ScheduleDays::Weekend];
    let mut forms: Vec<Term> = days.map(|days| of(Schedule { days, ..schedule })).into();
    forms.push(of(Schedule { from: schedule.to, to: schedule.from, ..schedule }));
    forms.extend(search.air().map(|factor| Term { factor, ..*term }));
    forms.retain(|form| form != term);
    forms
}

/// Terms of the same form that differ a little.
fn numbers(search: &TermSearch<'_>, term: &Term, part: f64) -> Vec<Term> {
    let mut near = Vec::new();
    let mut moved = |subject| near.push(Term { subject, ..*term });
    match term.subject {
        TermSubject::Channel(place, form) => {
            if let Some(at) = form.threshold() {
                let (low, high) = range(&search.stock.channels[place].values);
                for step in [-0.15, 0.15] {
                    let there = at + step * part * (high - low);
                    if there > low && there < high {
                        moved(TermSubject::Channel(place, form.at(there)));
                    }
                }
            }
        }
        TermSubject::Warm(at) => {
            [-1.0, 1.0].iter().for_each(|step| moved(TermSubject::Warm(at + step * part)))
        }
        TermSubject::Hours(schedule) => {
            for step in [-part, part] {
                let hour = |hour: f64| (hour + 2.0 * step).rem_euclid(24.0);
                let (from, to) = (hour(schedule.from), hour(schedule.to));
                moved(TermSubject::Hours(Schedule { from, ..schedule }));
                moved(TermSubject::Hours(Schedule { to, ..schedule }));
                moved(TermSubject::Hours(Schedule { from, to, ..schedule }));
            }
        }
        TermSubject::Sun(_) => {}
    }
    let factors = [1.0 + part, 1.0 / (1.0 + part)];
    let remembers = |memory| Term { memory, ..*term };
    match term.memory {
        Memory::None => {}
        Memory::Lag(hours) => near.extend(factors.map(|factor| remembers(Memory::Lag(hours * factor)))),
        Memory::Delay(hours) => near.extend(factors.map(|factor| remembers(Memory::Delay(hours * factor)))),
    }
    near
}
