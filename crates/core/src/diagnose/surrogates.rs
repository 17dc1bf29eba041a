//! Is it this channel? A candidate is tried with its channels shifted by whole days, and must do better as
//! they were logged than with any shift: the daily rhythm of a channel and the memory of the residual stay,
//! and only what is claimed is broken (Theiler et al. 1992, Physica D 58, 77-94). Every room has its own true
//! negatives this way.

use super::ledger::{EffectScore, LedgerEntry, LookedSpan, pooled_with};
use super::library::CandidateEffect;
use super::report::SegmentEvidence;
use super::score_test::{LENGTHS, Look, RANKING_HOURS, SegmentScore, logged};
use crate::data::DAY;
use crate::estimate::Problem;
use crate::estimate::segments::likeness;
use crate::model::spec::Sign;
use crate::simulate::trajectory::Halt;
use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Most shifts of one channel; more days are thinned evenly.
const SHIFTS: usize = 60;

/// The t from which on it is asked whether shifted channels do as well.
const ASKED: f64 = 1.5;

/// An effect that explains less than this share of the squared error changes a fortieth of the error: that is
/// practically nothing, however sure it is.
const LEAST_SHARE: f64 = 0.05;
/// Several windows together are to do better than shifted channels as surely as one of twenty days can.
const SHIFTED_TOGETHER: f64 = 0.05;

/// A candidate that the segments show.
#[derive(Debug, Clone, PartialEq)]
pub struct Shown {
    /// Over the length that shows it best.
    pub evidence: SegmentEvidence,
    /// Change of its own parameters there.
    pub step: Vec<f64>,
    /// What it adds over the length at which candidates are ranked, row by row.
    direction: Vec<f64>,
}

impl Shown {
    /// How much two candidates are the same thing: the correlation of what they add.
    pub fn likeness(&self, other: &Self) -> f64 {
        likeness(&self.direction, &other.direction)
    }
}

impl SegmentEvidence {
    /// What it says, for people.
    pub fn sentences(&self, candidate: &CandidateEffect) -> Vec<String> {
        let chance = format!(
            "by chance something looks like that in {} rooms in which nothing is missing",
            seldom(self.p)
        );
        let [t, clock, share] = [self.t, self.beyond_clock, 100.0 * self.share];
        if self.windows > 1 {
            return vec![
                format!(
                    "This window alone does not prove it; {} windows together explain {share:.0} % of what \
                    the model errs by over stretches of {:.0} h (pooled t {t:.1}, and {clock:.1} beyond what \
                    happens every day at the same hours); {chance}.",
                    self.windows, self.hours,
                ),
                format!(
                    "Shifted by whole days, {} does worse in all of them together (p {:.3}).",
                    candidate.id, self.shift_p
                ),
            ];
        }
        let half = format!(
            "its size from one half of the days explains {:.0} % in the other",
            100.0 * self.confirmed_share
        );
        let shown = format!(
            "Over stretches of {:.0} h it explains {share:.0} % of what the model errs by, steadily over {} \
            days (t {t:.1}, and {clock:.1} beyond what happens every day at the same hours); {chance}.",
            self.hours, self.days,
        );
        let shifted = format!(
            "Shifted by whole days, {} does worse with every one of {} shifts (p {:.2}), and {half}.",
            candidate.id, self.shifts, self.shift_p
        );
        vec![shown, shifted]
    }
}

/// How seldom a chance is, for people.
fn seldom(p: f64) -> String {
    let one_in = 1.0 / p.max(1e-9);
    if one_in >= 1e6 { "fewer than one in a million".to_owned() } else { format!("one in {one_in:.0}") }
}

/// Whether a logged channel drives a candidate, which does not follow from the room itself.
pub fn is_driven(candidate: &CandidateEffect, base: &Problem) -> bool {
    !candidate.endogenous && !logged(candidate, base).is_empty()
}

/// What the segments show of a candidate.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Heard {
    /// Over the length at which candidates are ranked, for the ledger.
    pub ranked: Option<EffectScore>,
    /// Where a logged channel drives it and the days are sure of it.
    pub shown: Option<Shown>,
}

impl Heard {
    /// The share that it explains over the length at which candidates are ranked, with a sign that physics
    /// allows.
    pub fn share(&self) -> Option<f64> {
        self.ranked.as_ref().filter(|ranked| ranked.t > 0.0).map(|ranked| ranked.share)
    }
}

/// The score tests of a round.
pub struct Tests<'a> {
    base: &'a Problem,
    /// By length.
    looks: Vec<Look<'a>>,
    /// The place of the length at which candidates are ranked.
    ranking: usize,
    /// How many candidates a logged channel drives: one of them looks good by chance so many times as easily.
    candidates: f64,
    /// How often they may accuse where nothing is missing.
    rate: f64,
    /// What other windows showed of the same model.
    earlier: &'a [LedgerEntry],
    halt: Halt<'a>,
}

impl<'a> Tests<'a> {
    /// The null model along segments of every length, up to the end of the validation part; `None` where it
    /// has no states that could be filtered, or leaves the numbers. `rate` and `earlier` are those of
    /// [`Tests::hear`].
    pub fn new(
        base: &'a Problem,
        theta: &[f64],
        candidates: &[CandidateEffect],
        rate: f64,
        earlier: &'a [LedgerEntry],
        halt: Halt<'a>,
    ) -> Option<Self> {
        Self::over(&LENGTHS, base, theta, candidates, rate, earlier, halt)
    }

    /// The same along segments of some lengths.
    pub(super) fn over(
        lengths: &[f64],
        base: &'a Problem,
        theta: &[f64],
        candidates: &[CandidateEffect],
        rate: f64,
        earlier: &'a [LedgerEntry],
        halt: Halt<'a>,
    ) -> Option<Self> {
        let samples = base.split().train.start..base.split().validation.end;
        let look = |hours: &f64| Look::new(base, theta, samples.clone(), *hours, halt);
        let looks: Vec<Look> = lengths.par_iter().filter_map(look).collect();
        let nearest = |one: &usize, other: &usize| {
            let distance = |place: usize| (looks[place].hours - RANKING_HOURS).abs();
            distance(*one).total_cmp(&distance(*other))
        };
        let ranking = (0..looks.len()).min_by(nearest)?;
        let candidates = candidates.iter().filter(|candidate| is_driven(candidate, base)).count() as f64;
        Some(Self { base, looks, ranking, candidates, rate, earlier, halt })
    }

    /// What the segments show of a candidate. Shown is one that a logged channel drives, whose chance of
    /// being accused wrongly, over all such candidates and lengths, is at most the rate, that does better
    /// than with every shift of its channels, and whose size from each half of the days explains the other
    /// half; or one that is as sure together with earlier windows of the same model.
    pub fn hear(&self, candidate: &CandidateEffect) -> Heard {
        self.heard(candidate).unwrap_or_default()
    }

    fn heard(&self, candidate: &CandidateEffect) -> Option<Heard> {
        let look = &self.looks[self.ranking];
        let score = look.score(candidate, candidate.problem.simulator())?;
        let channels =
            Some(logged(candidate, self.base)).filter(|_| is_driven(candidate, self.base) && !(self.halt)());
        let asked = channels.as_ref().filter(|_| score.t.abs() >= ASKED);
        let shifts = asked.map(|channels| self.shifted(look, candidate, channels));
        let size = *score.size.first()?;
        let ranked = EffectScore {
            effect: candidate.id.clone(),
            size,
            deviation: size.abs() / score.t.abs().max(f64::MIN_POSITIVE),
            unit: candidate.problem.model().parameters()[candidate.own.first()?.0].unit.clone(),
            share: score.share,
            t: score.t,
            beyond_clock: score.beyond_clock,
            days: score.days,
            shift_p: shifts.as_ref().map(|shifts| as_well(&score, shifts).0),
        };
        let shown = channels.and_then(|channels| {
            self.alone(candidate, &channels, &score, shifts.as_deref())
                .or_else(|| self.together(candidate, &ranked, &score))
        });
        Some(Heard { shown, ranked: Some(ranked) })
    }

    /// What this window shows by itself, over the length that shows it best. `ranked` and `ranked_shifts` are
    /// the scores over the length at which candidates are ranked.
    fn alone(
        &self,
        candidate: &CandidateEffect,
        channels: &[usize],
        ranked: &SegmentScore,
        ranked_shifts: Option<&[Option<SegmentScore>]>,
    ) -> Option<Shown> {
        let score = |place: usize| match place == self.ranking {
            true => Some((place, ranked.clone())),
            false => Some((place, self.looks[place].score(candidate, candidate.problem.simulator())?)),
        };
        let mut scores: Vec<(usize, SegmentScore)> = (0..self.looks.len()).filter_map(score).collect();
        let chance = |score: &SegmentScore| chance(candidate, score.t.min(score.beyond_clock), score.days);
        let p = (self.candidates
            * combined(&scores.iter().map(|(_, score)| chance(score)).collect::<Vec<_>>()))
        .min(1.0);
        if p > self.rate {
            return None;
        }
        scores.retain(|(_, score)| {
            score.share >= LEAST_SHARE
                && score.confirmed > 0.0
                && self.candidates * chance(score) <= self.rate
        });
        scores.sort_by(|one, other| chance(&one.1).total_cmp(&chance(&other.1)));
        scores.into_iter().find_map(|(place, score)| {
            let known = ranked_shifts.filter(|_| place == self.ranking).map(<[_]>::to_vec);
            let shifts = known.unwrap_or_else(|| self.shifted(&self.looks[place], candidate, channels));
            let (shift_p, as_good) = as_well(&score, &shifts);
            let evidence = SegmentEvidence {
                hours: self.looks[place].hours,
                size: *score.size.first()?,
                share: score.share,
                t: score.t,
                beyond_clock: score.beyond_clock,
                days: score.days,
                confirmed_share: score.confirmed,
                shifts: shifts.len(),
                shift_p,
                p,
                windows: 1,
            };
            let shown = Shown { evidence, step: score.size, direction: ranked.direction.clone() };
            (as_good == 0 && !shifts.is_empty()).then_some(shown)
        })
    }

    /// What it shows together with the windows before, where it does not speak against them. Each of them
    /// confirms the others.
    fn together(
        &self,
        candidate: &CandidateEffect,
        ranked: &EffectScore,
        score: &SegmentScore,
    ) -> Option<Shown> {
        let pooled = pooled_with(self.earlier, ranked, span(self.base)?)
            .filter(|pooled| pooled.windows > 1 && pooled.taken_back.is_none())?;
        let p = (self.candidates
            * chance(candidate, pooled.t.min(pooled.beyond_clock), pooled.windows * score.days))
        .min(1.0);
        let shift_p = pooled.shift_p?;
        let evidence = SegmentEvidence {
            hours: RANKING_HOURS,
            size: pooled.size,
            share: pooled.share,
            t: pooled.t,
            beyond_clock: pooled.beyond_clock,
            days: pooled.windows * score.days,
            confirmed_share: score.confirmed,
            shifts: 0,
            shift_p,
            p,
            windows: pooled.windows,
        };
        let sure =
            p <= self.rate && shift_p <= SHIFTED_TOGETHER && score.t > 0.0 && pooled.share >= LEAST_SHARE;
        sure.then(|| Shown { evidence, step: score.size.clone(), direction: score.direction.clone() })
    }

    /// The scores of a candidate with its channels shifted by whole days, circularly over the samples that
    /// are looked at.
    fn shifted(
        &self,
        look: &Look,
        candidate: &CandidateEffect,
        channels: &[usize],
    ) -> Vec<Option<SegmentScore>> {
        let inputs = candidate.problem.inputs();
        let per_day = (DAY / candidate.problem.grid().step()) as usize;
        let days = self.base.split().validation.end / per_day.max(1);
        let all = 1..days;
        let stride = all.len().div_ceil(SHIFTS).max(1);
        let one = |day: usize| {
            if (self.halt)() {
                return None;
            }
            let length = days * per_day;
            let moved = channels.iter().fold(inputs.clone(), |moved, channel| {
                let values = inputs.values(*channel);
                let shifted = (0..values.len())
                    .map(|k| if k < length { values[(k + day * per_day) % length] } else { values[k] });
                moved.with_values(*channel, shifted.collect())
            });
            look.score(candidate, &candidate.problem.simulator().with_inputs(&moved))
        };
        all.step_by(stride).map(one).collect()
    }
}

/// The stretch of time that segments look at: training and validation part. `None` where both are empty.
pub fn span(problem: &Problem) -> Option<LookedSpan> {
    let (grid, split) = (problem.grid(), problem.split());
    let last = split.validation.end.checked_sub(1)?;
    Some(LookedSpan {
        from: grid.time(split.train.start),
        to: grid.time(last) + grid.step(),
        hours: RANKING_HOURS,
    })
}

/// The share of shifted candidates, the true one counted, that do as well as that, and how many they are.
fn as_well(score: &SegmentScore, shifts: &[Option<SegmentScore>]) -> (f64, usize) {
    let does = |one: &&SegmentScore| {
        one.t > 0.0 && (one.share >= score.share || one.beyond_clock >= score.beyond_clock)
    };
    let count = shifts.iter().flatten().filter(does).count();
    ((1 + count) as f64 / (1 + shifts.len()) as f64, count)
}

/// The chance of so large a t of so many days where nothing is there: twice that of one side where physics
/// allows both.
fn chance(candidate: &CandidateEffect, t: f64, days: usize) -> f64 {
    let sides = if candidate.spec.sign == Sign::Any { 2.0 } else { 1.0 };
    StudentsT::new(0.0, 1.0, (days.max(2) - 1) as f64).map_or(1.0, |student| sides * student.sf(t)).min(1.0)
}

/// One chance for several tests of the same thing, however they lean on each other: Cauchy's combination (Liu
/// and Xie 2020, J. Am. Stat. Assoc. 115, 393-402).
fn combined(chances: &[f64]) -> f64 {
    if chances.is_empty() {
        return 1.0;
    }
    // Near nothing the tangent is the inverse, which keeps its digits.
    let pi = std::f64::consts::PI;
    let tangent = |p: &f64| if *p < 1e-9 { 1.0 / (p.max(1e-300) * pi) } else { ((0.5 - p) * pi).tan() };
    let mean = chances.iter().map(tangent).sum::<f64>() / chances.len() as f64;
    if mean > 1e9 { 1.0 / (mean * pi) } else { 0.5 - mean.atan() / pi }
}

#[cfg(test)]
mod tests {
    use super::super::library::EffectSource;
    use super::super::tests::{fitted, site, small_world};
    use super::*;
    use crate::data::Window;
    use crate::estimate::segments::Segments;
    use crate::estimate::{EstimateRequest, prepare};
    use crate::gram::dot;
    use crate::model::Catalogue;

    #[test]
    fn one_chance_of_several_is_that_of_the_closed_form() {
        for p in [0.3, 0.01, 1e-12] {
            let same = combined(&[p; 4]);
            assert!((same / p - 1.0).abs() < 1e-6, "{same} for four times {p}");
        }
        // One small chance among four is four times as large; what is likely adds nothing to it.
        let one = combined(&[1e-7, 0.5, 0.5, 0.5]);
        assert!((one / 4e-7 - 1.0).abs() < 1e-3, "{one}");
        assert_eq!(combined(&[]), 1.0);
        assert!(combined(&[0.0, 1.0]) < 1e-9);
    }

    /// Heat at every hour of the day together is the constant gain that the catalogue has.
    #[test]
    fn the_hours_of_the_clock_add_up_to_a_constant_gain() {
        let (_, window) = small_world(&[]);
        let catalogue = Catalogue::builtin().unwrap();
        // A model whose answer to heat is the same at all times.
        let problem =
            prepare(&catalogue, &"rc2".parse().unwrap(), &EstimateRequest::default(), &window, &site())
                .unwrap();
        let library = library(&problem, &window);
        let gain = library.iter().find(|candidate| candidate.id == "constant_gain").unwrap();
        let theta = problem.nominal().to_vec();
        let segments = Segments::new(&problem, 0..problem.grid().len(), 12.0).unwrap();
        let starts = segments.starts(&problem, &theta);
        let linear = segments.linearise(&problem, problem.simulator(), &theta, &starts).unwrap();
        let hours = segments
            .by_clock(&linear, problem.grid().step_hours(), |k| crate::data::hour_of_day(problem.grid(), k));
        let off = gain.lift(&problem, &theta);
        let mut on = off.clone();
        on[gain.own[0].0] += 1.0;
        let outputs = segments.outputs(&gain.problem, gain.problem.simulator(), &[&off, &on], &starts);
        let warmed = outputs[1].iter().zip(&outputs[0]).map(|(on, off)| on - off).collect();
        let warmed = segments.without_starts(&linear, warmed);
        let sum = |row: usize| hours.iter().map(|hour| hour[row]).sum::<f64>();
        let apart: f64 = warmed.iter().enumerate().map(|(row, value)| (value - sum(row)).powi(2)).sum();
        // What is left is how a pulse lies within a step of half an hour.
        assert!(apart < 1e-4 * dot(&warmed, &warmed), "{apart} of {}", dot(&warmed, &warmed));
    }

    fn library(problem: &Problem, window: &Window) -> Vec<CandidateEffect> {
        let (catalogue, site) = (Catalogue::builtin().unwrap(), site());
        EffectSource::new(&catalogue, problem, window, &site).unwrap().candidates(problem).0
    }

    fn heard(
        base: &Problem,
        theta: &[f64],
        library: &[CandidateEffect],
        rate: f64,
        earlier: &[LedgerEntry],
    ) -> Vec<Heard> {
        let tests = Tests::new(base, theta, library, rate, earlier, &|| false).unwrap();
        library.iter().map(|candidate| tests.hear(candidate)).collect()
    }

    #[test]
    fn a_meter_is_shown_and_the_wind_that_does_nothing_is_not() {
        let (problem, window) = small_world(&["metered_gain"]);
        let library = library(&problem, &window);
        let theta = fitted(&problem).theta();
        let found = heard(&problem, &theta, &library, 0.01, &[]);
        let named: Vec<&str> = library
            .iter()
            .zip(&found)
            .filter(|(_, heard)| heard.shown.is_some())
            .map(|(candidate, _)| candidate.id.as_str())
            .collect();
        assert_eq!(named, ["metered_gain:P_appliances"]);
        let evidence = &found.iter().find_map(|heard| heard.shown.as_ref()).unwrap().evidence;
        assert!(
            evidence.share > 0.2 && evidence.t > 5.0 && evidence.days == 21 && evidence.shifts == 20,
            "{evidence:?}"
        );
        let never = heard(&problem, &theta, &library, 1e-30, &[]);
        assert!(
            never.iter().all(|heard| heard.shown.is_none())
                && never.iter().any(|heard| heard.ranked.is_some()),
            "nothing is so sure"
        );
    }
    /// What one window cannot prove several can, and a newest one that contradicts takes it back.
    #[test]
    fn windows_before_add_up_to_what_one_cannot_show() {
        let (problem, window) = small_world(&["metered_gain"]);
        let library = library(&problem, &window);
        let theta = fitted(&problem).theta();
        let rate = 1e-30;
        let alone = heard(&problem, &theta, &library, rate, &[]);
        let now = alone
            .iter()
            .filter_map(|heard| heard.ranked.clone())
            .find(|score| score.effect == "metered_gain:P_appliances")
            .unwrap();
        let before = |factor: f64| -> Vec<LedgerEntry> {
            let start = problem.grid().start();
            let span = |weeks: i64| LookedSpan {
                from: start - (weeks + 3) * 604_800,
                to: start - weeks * 604_800,
                hours: RANKING_HOURS,
            };
            let score = EffectScore {
                size: factor * now.size,
                t: factor * now.t,
                beyond_clock: factor * now.beyond_clock,
                ..now.clone()
            };
            let entry = |weeks: i64| LedgerEntry {
                diagnosis: String::new(),
                model: problem.model().id().to_string(),
                model_hash: None,
                span: span(weeks),
                score: score.clone(),
            };
            [0, 3, 6, 9].map(entry).to_vec()
        };
        let named = |earlier: &[LedgerEntry]| {
            let found = heard(&problem, &theta, &library, rate, earlier);
            let shown = library
                .iter()
                .zip(found)
                .filter_map(|(candidate, heard)| Some((candidate.id.clone(), heard.shown?.evidence)));
            shown.collect::<Vec<_>>()
        };
        let together = named(&before(1.0));
        let [(effect, evidence)] = together.as_slice() else { panic!("{together:?}") };
        assert_eq!((effect.as_str(), evidence.windows), ("metered_gain:P_appliances", 5));
        assert!(
            (evidence.size / now.size - 1.0).abs() < 1e-9 && evidence.t > 2.0 * now.t,
            "{evidence:?} {now:?}"
        );
        assert_eq!(named(&before(-1.0)), []);
    }
}
