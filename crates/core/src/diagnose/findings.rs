//! The main line: rounds until nothing more is found, and the document that says what was.

use super::acceptance::{LEAST_BIC, LEAST_SHARE, STRICT_INNOVATIONS, STRICT_SHARE, Tried, least_gain};
use super::course::Course;
use super::evidence::shape;
use super::failures::episodes;
use super::ledger::{EffectScore, Entry, Looked, beside, pooled_with};
use super::library::{CandidateEffect, NotTestable, align, candidates};
use super::null_model::{NullModel, whitening_at};
use super::present::present;
use super::report::{
    Adequacy, Coefficient, Considered, Diagnosis, EffectSize, Finding, FindingKind, Gate, Measures,
    PresentEffect, Preview, RmsePairs, Unexplained,
};
use super::screen::{Blind, Screen};
use super::selection::{Round, Skip, round};
use super::size::{AHEAD_HOURS, Size, Sizes, sizes};
use super::surrogates::span;
use super::unexplained::profile;
use super::ways::{Way, other_way};
use crate::data::{Window, rfc3339};
use crate::estimate::assess::metrics::{HORIZONS, ahead, filter};
use crate::estimate::problem::bounds::at_bound;
use crate::estimate::problem::request::AccusationRate;
use crate::estimate::problem::whiten::stride;
use crate::estimate::problem::widen::widen;
use crate::estimate::{Control, EstimateError, Problem, Site};
use crate::fault::Fault;
use crate::model::Catalogue;
use crate::simulate::trajectory::Halt;
use crate::units::error_unit;
use indexmap::IndexMap;
use rayon::prelude::*;

/// Most effects that one diagnosis names.
const ROUNDS: usize = 3;
/// Above this ratio of free-run error to innovation deviation something is probably missing.
pub const ADEQUATE_RHO: f64 = 2.0;
/// A later finding that explains less than this repairs, and is no cause.
const CAUSE_SHARE: f64 = 0.3;
/// Why an effect that the model can imitate is not testable.
const IMITATED: &str = "the model's own parameters can do the same";
/// Days of training and of unseen data below which nothing can be said, and below which more is asked.
const LEAST_DAYS: (f64, f64) = (3.0, 1.0);
const GOOD_DAYS: (f64, f64) = (7.0, 7.0);

/// Why there is no diagnosis.
#[derive(Debug, Clone, PartialEq)]
pub enum DiagnoseError {
    /// The window or the catalogue does not serve.
    Faults(Vec<Fault>),
    /// The model diverges, or somebody stopped the work.
    Estimate(EstimateError),
}

impl std::fmt::Display for DiagnoseError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            DiagnoseError::Faults(faults) => {
                let lines: Vec<String> = faults.iter().map(ToString::to_string).collect();
                f.write_str(&lines.join("; "))
            }
            DiagnoseError::Estimate(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for DiagnoseError {}

impl DiagnoseError {
    /// Why a model has no optimum: somebody has stopped the search, or it diverges.
    pub(super) fn nothing(control: &Control) -> Self {
        DiagnoseError::Estimate(
            (control.interrupt)().map_or(EstimateError::NothingFinite, EstimateError::Interrupted),
        )
    }
}

/// Which effects the model is missing. `theta` is the fit to start from; it is polished first. `rate` is how
/// often segments of hours may accuse where nothing is missing; `earlier` is what other windows of the system
/// showed, of any model.
///
/// # Errors
/// [`DiagnoseError`] where the model diverges, the window does not serve, or `control` interrupts.
#[allow(clippy::too_many_arguments)]
pub fn diagnose(
    catalogue: &Catalogue,
    problem: &Problem,
    theta: &[f64],
    window: &Window,
    site: &Site,
    rate: AccusationRate,
    earlier: &[Entry],
    control: &Control,
) -> Result<Diagnosis, DiagnoseError> {
    let days = |range: &std::ops::Range<usize>| {
        let usable = problem.usable(0, range.clone());
        (usable.len() * stride(&usable)) as f64 * problem.grid().step_hours() / 24.0
    };
    let (train, unseen) = (days(&problem.split().train), days(&problem.split().validation));
    let mut report = empty(problem);
    if train < LEAST_DAYS.0 || unseen < LEAST_DAYS.1 {
        report.summary = format!(
            "{train:.1} days of training and {unseen:.1} unseen days are too little to say what is missing"
        );
        return Ok(report);
    }
    let strict = train < GOOD_DAYS.0 || unseen < GOOD_DAYS.1 * 0.9;
    if strict {
        report.warnings.push(format!(
            "only {train:.1} days of training and {unseen:.1} unseen days: more is asked of every effect"
        ));
    }
    let (grid, holes) = widen(problem, window, site).map_err(|fault| DiagnoseError::Faults(vec![fault]))?;
    let nothing = || DiagnoseError::nothing(control);
    let course = Course::new(control);
    let halt = || course.halts();
    let (mut library, not_testable) = candidates(catalogue, problem, &grid, &holes, site);
    let mut null = NullModel::settle(align(problem, &mut library), theta, None, &halt).ok_or_else(nothing)?;
    course.settled(null.fitted.evaluations);
    report.not_testable = not_testable;
    let beside_base = beside(earlier, &report.model, problem.model().hash());
    let mut found: Vec<String> = Vec::new();
    let mut before = None;
    for number in 1..=ROUNDS {
        if number > 1 {
            (library, _) = candidates(catalogue, &null.problem, &grid, &holes, site);
            null.problem = align(&null.problem, &mut library);
        }
        // The openings that a drop detector marks are off by up to half an hour, which a lag then repairs.
        library.retain(|candidate| {
            !(candidate.id == "sensor_lag" && found.iter().any(|name| name == "window_opening"))
        });
        // What could not be told from a finding is named with it already.
        library.retain(|candidate| !found.contains(&candidate.id));
        // With a finding it is another model, of which no window has told.
        let told = if number == 1 { beside_base.as_slice() } else { &[] };
        let outcome = round(&mut null, &library, strict, rate.into(), told, number == 1, &course)
            .ok_or_else(nothing)?;
        interrupted(control)?;
        report.evaluations.push(null.fitted.evaluations + outcome.evaluations);
        if number == 1 {
            before = Some(null.clone());
            tell_round(&mut report, &library, &outcome);
            report.looked = looked(problem, outcome.scores.clone());
            if let Some(span) = span(problem) {
                report.present = present(
                    catalogue,
                    &null.problem,
                    &null.fitted.plain,
                    (&grid, site),
                    earlier,
                    span,
                    &halt,
                );
            }
            interrupted(control)?;
        }
        let Some(winner) = outcome.winner.map(|place| &outcome.tried[place]) else { break };
        let candidate = &library[winner.refitted.candidate];
        let next = NullModel::settle(
            candidate.problem.clone(),
            &winner.refitted.fitted.plain,
            Some(&winner.refitted.fitted.white),
            &halt,
        )
        .ok_or_else(nothing)?;
        let (way, evaluations) = other_way(catalogue, &null, &next, candidate, &grid, site, &halt);
        course.settled(next.fitted.evaluations + evaluations);
        interrupted(control)?;
        let finding = finding(&null, &next, way.as_ref(), &library, &outcome, winner, number, &halt);
        found.push(candidate.id.clone());
        found.extend(finding.tied_with.iter().cloned());
        report.findings.push(finding);
        null = way.map_or(next, |way| way.model);
    }
    conclude(&mut report, before.as_ref().unwrap_or(&null), &null);
    pool_findings(&mut report, &beside_base);
    Ok(report)
}

/// The instant preview: candidates by their score alone, the most suspicious first.
///
/// # Errors
/// [`DiagnoseError`] where the model diverges or the window does not serve.
pub fn preview(
    catalogue: &Catalogue,
    problem: &Problem,
    theta: &[f64],
    window: &Window,
    site: &Site,
) -> Result<Vec<Preview>, DiagnoseError> {
    let diverged = DiagnoseError::Estimate(EstimateError::NothingFinite);
    let (grid, holes) = widen(problem, window, site).map_err(|fault| DiagnoseError::Faults(vec![fault]))?;
    let (mut library, _) = candidates(catalogue, problem, &grid, &holes, site);
    let problem = &align(problem, &mut library);
    let whitening = whitening_at(problem, theta).ok_or(diverged.clone())?;
    let screen = Screen::new(problem, theta, &whitening, &|| false).ok_or(diverged)?;
    let mut previews: Vec<Preview> = library
        .par_iter()
        .filter_map(|candidate| {
            let score = screen.score(candidate).ok().filter(|score| score.sign && !score.imitated)?;
            let (title, explain) = (candidate.spec.title.clone(), candidate.spec.explain.clone());
            Some(Preview { effect: candidate.id.clone(), title, explain, score: score.net })
        })
        .collect();
    previews.sort_by(|a, b| b.score.total_cmp(&a.score).then_with(|| a.effect.cmp(&b.effect)));
    Ok(previews)
}

/// Nothing where the work goes on.
///
/// # Errors
/// [`EstimateError::Interrupted`] where somebody has stopped it.
pub(super) fn interrupted(control: &Control) -> Result<(), DiagnoseError> {
    match (control.interrupt)() {
        Some(interrupt) => Err(DiagnoseError::Estimate(EstimateError::Interrupted(interrupt))),
        None => Ok(()),
    }
}

fn empty(problem: &Problem) -> Diagnosis {
    Diagnosis {
        system: None,
        model: problem.model().id().to_string(),
        fit: None,
        verdict: Adequacy::NotEnoughData,
        summary: String::new(),
        rho: None,
        noise_floor_rmse: None,
        findings: Vec::new(),
        considered: Vec::new(),
        not_testable: Vec::new(),
        unexplained: Unexplained::default(),
        looked: None,
        present: Vec::new(),
        warnings: Vec::new(),
        evaluations: Vec::new(),
    }
}

/// What a round has seen in segments, and when; `None` where there were none.
fn looked(problem: &Problem, effects: Vec<EffectScore>) -> Option<Looked> {
    let span = span(problem).filter(|_| !effects.is_empty())?;
    Some(Looked { from: rfc3339(span.from), to: rfc3339(span.to), hours: span.hours, effects })
}

/// Tells every finding of a diagnosis what its window shows of it together with earlier ones of the same base
/// model, and takes back, with a warning, what those have shown clearly and this one contradicts.
pub(super) fn pool_findings(report: &mut Diagnosis, earlier: &[Entry]) {
    let Some(span) = report.looked.as_ref().and_then(Looked::span) else { return };
    for score in report.looked.iter().flat_map(|looked| &looked.effects) {
        let Some(pooled) = pooled_with(earlier, score, span) else { continue };
        if let Some(taken_back) = &pooled.taken_back {
            report.warnings.push(format!("{}: {}", score.effect, taken_back.sentence));
        }
        if let Some(finding) = report.findings.iter_mut().find(|finding| finding.named() == score.effect) {
            finding.pooled = Some(pooled);
        }
    }
    let taken_back =
        |one: &&PresentEffect| one.pooled.as_ref().is_some_and(|pooled| pooled.taken_back.is_some());
    report.warnings.extend(report.present.iter().filter(taken_back).map(|one| one.sentence.clone()));
}

/// The first round into the report: what was tried, and what cannot be tested.
fn tell_round(report: &mut Diagnosis, library: &[CandidateEffect], outcome: &Round) {
    for one in &outcome.tried {
        if one.refitted.score.imitated && matches!(one.gate, Some((Gate::Bic | Gate::Bound, _))) {
            report.not_testable.push(NotTestable {
                effect: library[one.refitted.candidate].id.clone(),
                reason: IMITATED.to_owned(),
            });
            continue;
        }
        let why = match (&one.gate, one.heard.shown.as_ref().map(|shown| &shown.evidence)) {
            (None, Some(evidence)) => {
                format!(
                    "over {:.0} h it explains {:.0} % of the error, t {:.1}",
                    evidence.hours,
                    100.0 * evidence.share,
                    evidence.t
                )
            }
            (None, None) => format!("it gains {:.0} in BIC", one.gain.delta_bic),
            (Some((_, why)), _) => why.clone(),
        };
        report.considered.push(Considered {
            effect: library[one.refitted.candidate].id.clone(),
            score: one.refitted.score.net,
            delta_bic: Some(one.gain.delta_bic),
            explained_share: one.gain.share,
            gate: one.gate.as_ref().map(|(gate, _)| *gate),
            why,
            measures: Some(Measures {
                fall: one.gain.fall,
                white_share: one.gain.white_share,
                slow_delta_bic: one.gain.slow_delta_bic,
                ahead_share: one.gain.ahead.map(|ahead| ahead.share),
                better_days: one.gain.better_days,
                evaluations: one.refitted.fitted.evaluations,
                rho: one.refitted.measured.plain[0].unwrap_or(f64::NAN).sqrt() / one.refitted.measured.floor,
            }),
        });
    }
    for (place, skip) in &outcome.skipped {
        let effect = library[*place].id.clone();
        match skip {
            Skip::Sign(score) | Skip::Faint(score) => {
                let (gate, why) = match skip {
                    Skip::Sign(_) => (Gate::Sign, "the data ask for a sign that physics does not allow"),
                    _ => (Gate::Bic, "the data hardly ask for it"),
                };
                report.considered.push(Considered {
                    effect,
                    score: score.net,
                    delta_bic: None,
                    explained_share: None,
                    gate: Some(gate),
                    why: why.to_owned(),
                    measures: None,
                });
            }
            Skip::Blind(blind) => {
                let reason = match blind {
                    Blind::TooSmall => {
                        "even at its physical limit it hardly moves the room in these data".to_owned()
                    }
                    Blind::Imitated => IMITATED.to_owned(),
                    Blind::Diverged => "the simulation with it diverges".to_owned(),
                };
                report.not_testable.push(NotTestable { effect, reason });
            }
            Skip::Choice => {}
        }
    }
}

/// A winner as a finding, by another way where that is better.
#[allow(clippy::too_many_arguments)]
fn finding(
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
        let run = filter(&null.problem, &null.fitted.plain, None);
        ahead(&null.problem, &null.fitted.plain, &run, range.clone(), &HORIZONS)
    };
    let (before, after) = rayon::join(|| errors(null), || errors(next));
    before
        .into_iter()
        .filter_map(|(name, before)| Some((name.clone(), [before.rmse, after.get(&name)?.rmse])))
        .collect()
}

/// Verdict, summary and the shape of what is left.
fn conclude(report: &mut Diagnosis, before: &NullModel, after: &NullModel) {
    report.rho = after.rho();
    report.noise_floor_rmse = Some(after.measured.floor);
    let noise = after.measured.floor.powi(2);
    let beyond = |mse: Option<f64>| mse.map(|mse| (mse - noise).max(0.0));
    let share = beyond(after.measured.plain[0])
        .zip(beyond(before.measured.plain[0]))
        .map(|(left, all)| left / all.max(f64::MIN_POSITIVE));
    let more = report.rho.is_some_and(|rho| rho >= ADEQUATE_RHO);
    let run = after.problem.simulate(&after.fitted.plain);
    let error = after.problem.residual(0, &run.outputs[0]);
    let (profile_by_hour, evenings) = profile(after, &run.states, &error);
    let diary = if profile_by_hour.iter().any(Option::is_some) {
        "keep a diary of what happens in the room in the hours listed"
    } else {
        "note what happens at the hours listed"
    };
    let names: Vec<&str> = report.findings.iter().map(|finding| finding.title.as_str()).collect();
    (report.verdict, report.summary) = match (names.is_empty(), more) {
        (false, false) => (
            Adequacy::Named,
            format!(
                "missing: {}; with it the model explains the data down to their noise",
                names.join(", then ")
            ),
        ),
        (false, true) => {
            (Adequacy::Named, format!("missing: {}; probably something else as well", names.join(", then ")))
        }
        (true, false) => (Adequacy::Adequate, "the model explains the data down to their noise".to_owned()),
        (true, true) => {
            (Adequacy::Unknown, "something is missing that none of the known effects explains".to_owned())
        }
    };
    report.unexplained = Unexplained {
        share,
        profile_by_hour,
        episodes: episodes(
            &after.problem,
            after.problem.grid(),
            &error,
            after.problem.split().train.start..after.problem.split().validation.end,
        ),
        ask: more.then(|| evenings.unwrap_or_else(|| diary.to_owned())),
    };
}
