//! Is it this channel? A candidate is tried with its channels shifted by whole days, and must do better as they were logged than with any
//! shift: the daily rhythm of a channel and the memory of the residual stay, and only what is claimed is broken (Theiler et al. 1992,
//! Physica D 58, 77-94). Every room has its own true negatives this way.

use super::candidates::Suspect;
use super::report::{EffectScore, SegmentEvidence};
use super::score_test::{LENGTHS, Look, Score, logged};
use crate::estimate::Problem;
use crate::estimate::metrics::filter;
use crate::estimate::segments::dot;
use crate::model::spec::Sign;
use crate::simulate::trajectory::Halt;
use rayon::prelude::*;
use statrs::distribution::{ContinuousCDF, StudentsT};

/// Most shifts of one channel; more days are thinned evenly.
const SHIFTS: usize = 60;

/// The length at which candidates are ranked and told apart, in hours: between the minutes that sensors blur and the days in which all
/// that was not logged adds up.
pub const RANKING_HOURS: f64 = 12.0;

/// The t from which on it is asked whether shifted channels do as well.
const ASKED: f64 = 1.5;

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
        let norm = |direction: &[f64]| dot(direction, direction).sqrt().max(f64::MIN_POSITIVE);
        dot(&self.direction, &other.direction) / norm(&self.direction) / norm(&other.direction)
    }
}

impl SegmentEvidence {
    /// What it says, for people.
    pub fn sentences(&self, suspect: &Suspect) -> [String; 2] {
        [
            format!(
                "Over stretches of {:.0} h it explains {:.0} % of what the model errs by, steadily over {} days (t {:.1}, and {:.1} beyond what happens every day at the same hours); by chance something looks like that in {} rooms in which nothing is missing.",
                self.hours,
                100.0 * self.share,
                self.days,
                self.t,
                self.beyond_clock,
                seldom(self.p)
            ),
            format!(
                "Shifted by whole days, {} does worse with every one of {} shifts (p {:.2}), and its size from one half of the days explains {:.0} % in the other.",
                suspect.id,
                self.shifts,
                self.shift_p,
                100.0 * self.confirmed_share
            ),
        ]
    }
}

/// How seldom a chance is, for people.
fn seldom(p: f64) -> String {
    let one_in = 1.0 / p.max(1e-9);
    if one_in >= 1e6 { "fewer than one in a million".to_owned() } else { format!("one in {one_in:.0}") }
}

/// Whether a logged channel drives a candidate, which does not follow from the room itself.
pub fn is_driven(suspect: &Suspect, base: &Problem) -> bool {
    !suspect.endogenous && !logged(suspect, base).is_empty()
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
    /// The share that it explains over the length at which candidates are ranked, with a sign that physics allows.
    pub fn share(&self) -> Option<f64> {
        self.ranked.as_ref().filter(|ranked| ranked.t > 0.0).map(|ranked| ranked.share)
    }
}

/// What the segments show of every candidate, up to the end of the validation part. Shown are those that a logged channel drives, whose
/// chance of being accused wrongly, over all such candidates and lengths, is at most `rate`, that do better than with every shift of
/// their channels, and whose size from each half of the days explains the other half.
pub fn heard(base: &Problem, theta: &[f64], suspects: &[Suspect], rate: f64, halt: Halt) -> Vec<Heard> {
    if !base.filters() {
        return vec![Heard::default(); suspects.len()];
    }
    let count = suspects.iter().filter(|suspect| is_driven(suspect, base)).count() as f64;
    let samples = base.split().train.start..base.split().validation.end;
    let states = filter(base, theta, None).filtered.states;
    let look = |hours: &f64| Look::new(base, theta, &states, samples.clone(), *hours, halt);
    let looks: Vec<Look> = LENGTHS.par_iter().filter_map(look).collect();
    let nearest = |look: &Look| (look.hours - RANKING_HOURS).abs();
    let ranking = looks.iter().min_by(|one, other| nearest(one).total_cmp(&nearest(other)));
    let one = |suspect: &Suspect, ranked: &Score| {
        let channels = Some(logged(suspect, base)).filter(|_| is_driven(suspect, base) && !halt())?;
        let score = |look| Some((look, Look::score(look, suspect, suspect.problem.simulator())?));
        let mut scores: Vec<(&Look, Score)> = looks.iter().filter_map(score).collect();
        let p = (count * combined(&scores.iter().map(|(_, score)| chance(suspect, score)).collect::<Vec<_>>())).min(1.0);
        if p > rate {
            return None;
        }
        scores.retain(|(_, score)| score.confirmed > 0.0 && count * chance(suspect, score) <= rate);
        scores.sort_by(|one, other| chance(suspect, &one.1).total_cmp(&chance(suspect, &other.1)));
        scores.into_iter().find_map(|(look, score)| {
            let shifts = shifted(look, suspect, &channels, samples.end, halt);
            let (shift_p, as_good) = as_well(&score, &shifts);
            let evidence = SegmentEvidence {
                hours: look.hours,
                size: *score.size.first()?,
                share: score.share,
                t: score.t,
                beyond_clock: score.beyond_clock,
                days: score.days,
                confirmed_share: score.confirmed,
                shifts: shifts.len(),
                shift_p,
                p,
            };
            let shown = Shown { evidence, step: score.size, direction: ranked.direction.clone() };
            (as_good == 0 && !shifts.is_empty()).then_some(shown)
        })
    };
    let hear = |suspect: &Suspect| {
        let look = ranking?;
        let score = look.score(suspect, suspect.problem.simulator())?;
        let channels = Some(logged(suspect, base)).filter(|_| is_driven(suspect, base) && score.t.abs() >= ASKED);
        let shift_p = channels.map(|channels| as_well(&score, &shifted(look, suspect, &channels, samples.end, halt)).0);
        let ranked = EffectScore {
            effect: suspect.id.clone(),
            size: *score.size.first()?,
            deviation: score.size.first()?.abs() / score.t.abs().max(f64::MIN_POSITIVE),
            unit: suspect.problem.model().parameters()[suspect.own.first()?.0].unit.clone(),
            share: score.share,
            t: score.t,
            beyond_clock: score.beyond_clock,
            days: score.days,
            shift_p,
        };
        Some(Heard { shown: one(suspect, &score), ranked: Some(ranked) })
    };
    suspects.par_iter().map(|suspect| hear(suspect).unwrap_or_default()).collect()
}

/// The share of shifted candidates, the true one counted, that do as well as that, and how many they are.
fn as_well(score: &Score, shifts: &[Option<Score>]) -> (f64, usize) {
    let does = |one: &&Score| one.t > 0.0 && (one.share >= score.share || one.beyond_clock >= score.beyond_clock);
    let count = shifts.iter().flatten().filter(does).count();
    ((1 + count) as f64 / (1 + shifts.len()) as f64, count)
}

/// The chance of so large a t, of the smaller one of the two, where nothing is there: twice that of one side where physics allows both.
fn chance(suspect: &Suspect, score: &Score) -> f64 {
    let sides = if suspect.spec.sign == Sign::Any { 2.0 } else { 1.0 };
    let t = score.t.min(score.beyond_clock);
    StudentsT::new(0.0, 1.0, (score.days.max(2) - 1) as f64).map_or(1.0, |student| sides * student.sf(t)).min(1.0)
}

/// One chance for several tests of the same thing, however they lean on each other: Cauchy's combination (Liu and Xie 2020, J. Am. Stat.
/// Assoc. 115, 393-402).
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

/// The scores of a candidate with its channels shifted by whole days, circularly over the samples up to `end`.
fn shifted(look: &Look, suspect: &Suspect, channels: &[usize], end: usize, halt: Halt) -> Vec<Option<Score>> {
    let inputs = suspect.problem.inputs();
    let per_day = (86_400 / suspect.problem.grid().step()) as usize;
    let days = end / per_day.max(1);
    let all = 1..days;
    let stride = all.len().div_ceil(SHIFTS).max(1);
    let one = |day: usize| {
        if halt() {
            return None;
        }
        let length = days * per_day;
        let moved = channels.iter().fold(inputs.clone(), |moved, channel| {
            let values = inputs.values(*channel);
            let shifted = (0..values.len()).map(|k| if k < length { values[(k + day * per_day) % length] } else { values[k] });
            moved.with_values(*channel, shifted.collect())
        });
        look.score(suspect, &suspect.problem.simulator().with_inputs(&moved))
    };
    all.step_by(stride).map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::super::candidates::{suspects, widen};
    use super::super::tests::{fitted, site, small_world};
    use super::*;
    use crate::estimate::segments::Segments;
    use crate::estimate::{EstimateRequest, prepare};
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
        let problem = prepare(&catalogue, &"rc2".parse().unwrap(), &EstimateRequest::default(), &window, &site()).unwrap();
        let (grid, holes) = widen(&problem, &window, &site()).unwrap();
        let (library, _) = suspects(&catalogue, &problem, &grid, &holes, &site());
        let gain = library.iter().find(|suspect| suspect.id == "constant_gain").unwrap();
        let theta = problem.nominal().to_vec();
        let segments = Segments::new(&problem, 0..problem.grid().len(), 12.0);
        let states = filter(&problem, &theta, None).filtered.states;
        let starts: Vec<Vec<f64>> = segments.first_samples().map(|k| states[k].clone()).collect();
        let linear = segments.linearise(&problem, problem.simulator(), &theta, &starts).unwrap();
        let hours = segments.by_clock(&linear, problem.grid().step_hours(), |k| crate::data::hour_of_day(problem.grid(), k));
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

    #[test]
    fn a_meter_is_shown_and_the_wind_that_does_nothing_is_not() {
        let (problem, window) = small_world(&["metered_gain"]);
        let (grid, holes) = widen(&problem, &window, &site()).unwrap();
        let (library, _) = suspects(&Catalogue::builtin().unwrap(), &problem, &grid, &holes, &site());
        let theta = fitted(&problem).theta();
        let found = heard(&problem, &theta, &library, 0.01, &|| false);
        let named: Vec<&str> =
            library.iter().zip(&found).filter(|(_, heard)| heard.shown.is_some()).map(|(suspect, _)| suspect.id.as_str()).collect();
        assert_eq!(named, ["metered_gain:P_appliances"]);
        let evidence = &found.iter().find_map(|heard| heard.shown.as_ref()).unwrap().evidence;
        assert!(evidence.share > 0.2 && evidence.t > 5.0 && evidence.days == 21 && evidence.shifts == 20, "{evidence:?}");
        let never = heard(&problem, &theta, &library, 1e-30, &|| false);
        assert!(never.iter().all(|heard| heard.shown.is_none()) && never.iter().any(|heard| heard.ranked.is_some()), "nothing is so sure");
    }
}
