//! The main line: rounds until nothing more is found, and the document that says what was.

use super::chosen::Skip;
use super::course::Course;
use super::error::{DiagnoseError, interrupted};
use super::failures::episodes;
use super::ledger::{EffectScore, LedgerEntry, Looked, beside, pooled_with};
use super::library::{CandidateEffect, EffectSource, NotTestable, align};
use super::naming::finding;
use super::null_model::{NullModel, whitening_at};
use super::present::present;
use super::report::{
    Adequacy, Considered, Diagnosis, EffectGate, EffectPreview, Measures, PresentEffect, Unexplained,
};
use super::screen::{Blind, Screen};
use super::selection::{Round, round};
use super::surrogates::span;
use super::unexplained::profile;
use super::ways::other_way;
use crate::data::{Window, rfc3339};
use crate::estimate::assess::metrics::worst_output;
use crate::estimate::problem::request::AccusationRate;
use crate::estimate::problem::whiten::stride;
use crate::estimate::{Control, EstimateError, Problem, Site};
use crate::model::Catalogue;
use rayon::prelude::*;

/// Most effects that one diagnosis names.
const ROUNDS: usize = 3;
/// Above this ratio of free-run error to innovation deviation something is probably missing.
pub const ADEQUATE_RHO: f64 = 2.0;
/// Why an effect that the model can imitate is not testable.
const IMITATED: &str = "the model's own parameters can do the same";
/// Days of training and of unseen data below which nothing can be said, and below which more is asked.
const LEAST_DAYS: (f64, f64) = (3.0, 1.0);
const GOOD_DAYS: (f64, f64) = (7.0, 7.0);

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
    earlier: &[LedgerEntry],
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
    let problem = &problem.in_long_steps(theta);
    let source = EffectSource::new(catalogue, problem, window, site)
        .map_err(|fault| DiagnoseError::Faults(vec![fault]))?;
    let nothing = || DiagnoseError::nothing(control);
    let (mut library, not_testable) = source.candidates(problem);
    let course = Course::new(control, problem.predictor(), library.len(), ROUNDS);
    let halt = || course.halts();
    let mut null = NullModel::settle(align(problem, &mut library), theta, None, &halt).ok_or_else(nothing)?;
    course.settled(null.fitted.evaluations);
    report.not_testable = not_testable;
    let beside_base = beside(earlier, &report.model, problem.model().hash());
    let mut found: Vec<String> = Vec::new();
    let mut before = None;
    for number in 1..=ROUNDS {
        if number > 1 {
            (library, _) = source.candidates(&null.problem);
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
                report.present = present(&source, &null.problem, &null.fitted.plain, earlier, span, &halt);
            }
            interrupted(control)?;
        }
        let Some(winner) = outcome.winner.map(|place| &outcome.tried[place]) else { break };
        course.naming();
        let candidate = &library[winner.refitted.candidate];
        let next = NullModel::settle(
            candidate.problem.clone(),
            &winner.refitted.fitted.plain,
            Some(&winner.refitted.fitted.white),
            &halt,
        )
        .ok_or_else(nothing)?;
        let (way, evaluations) = other_way(&source, &null, &next, candidate, &halt);
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
) -> Result<Vec<EffectPreview>, DiagnoseError> {
    let diverged = DiagnoseError::Estimate(EstimateError::NothingFinite);
    let problem = &problem.in_long_steps(theta);
    let source = EffectSource::new(catalogue, problem, window, site)
        .map_err(|fault| DiagnoseError::Faults(vec![fault]))?;
    let (mut library, _) = source.candidates(problem);
    let problem = &align(problem, &mut library);
    let whitening = whitening_at(problem, theta).ok_or(diverged.clone())?;
    let screen = Screen::new(problem, theta, &whitening, &|| false).ok_or(diverged)?;
    let mut previews: Vec<EffectPreview> = library
        .par_iter()
        .filter_map(|candidate| {
            let score = screen.score(candidate).ok().filter(|score| score.sign && !score.imitated)?;
            let (title, explain) = (candidate.spec.title.clone(), candidate.spec.explain.clone());
            Some(EffectPreview { effect: candidate.id.clone(), title, explain, score: score.net })
        })
        .collect();
    previews.sort_by(|a, b| b.score.total_cmp(&a.score).then_with(|| a.effect.cmp(&b.effect)));
    Ok(previews)
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
pub(super) fn pool_findings(report: &mut Diagnosis, earlier: &[LedgerEntry]) {
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
        if one.refitted.score.imitated && matches!(one.gate, Some((EffectGate::Bic | EffectGate::Bound, _))) {
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
                    Skip::Sign(_) => {
                        (EffectGate::Sign, "the data ask for a sign that physics does not allow")
                    }
                    _ => (EffectGate::Bic, "the data hardly ask for it"),
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
    let output = worst_output(&after.problem, &run);
    let worst = after.problem.residual(output, &run.outputs[output]);
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
        output: after
            .problem
            .model()
            .outputs()
            .get(output)
            .map_or_else(String::new, |one| one.channel.clone()),
        share,
        profile_by_hour,
        episodes: episodes(
            &after.problem,
            after.problem.grid(),
            (output, &worst),
            after.problem.split().train.start..after.problem.split().validation.end,
        ),
        ask: more.then(|| evenings.unwrap_or_else(|| diary.to_owned())),
    };
}
