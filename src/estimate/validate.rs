//! The gate: a table of checks between a fit and the controller.
//!
//! [`validate`] is the only maker of an [`Acceptance`], and only an acceptance can be served, or a [`Holding`]
//! with an operator's word. Rules G1 to G8
//! each have a severity: a failed `reject` is final, a `hold` waits for an operator, a `flag` is published
//! with the parameters. Incumbent and fit are judged on the same unseen data.

use super::fit::{Fit, Stop};
use super::metrics::{FilterRun, ahead, filter, horizon_name};
use super::physics;
use super::problem::{Problem, mean_square};
use crate::data::Duration;
use crate::model::ModelId;
use crate::simulate::Trajectory;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use utoipa::ToSchema;

/// The parameters that are served now.
#[derive(Debug, Clone, PartialEq)]
pub struct Incumbent {
    /// The model that they belong to.
    pub model: ModelId,
    /// Values by name.
    pub theta: IndexMap<String, f64>,
}

/// What a system demands of its parameters.
#[derive(Debug, Clone, PartialEq)]
pub struct Policy {
    /// The forecast horizon that the controller lives on.
    pub horizon: Duration,
    /// Stretches of time, both ends included, that an operator has taken out: they are not missing.
    pub excluded: Vec<(i64, i64)>,
}

impl Default for Policy {
    fn default() -> Self {
        Self { horizon: Duration::from_seconds(21_600), excluded: Vec::new() }
    }
}

/// What a failed check does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    /// The fit is refused for good.
    Reject,
    /// The fit waits for an operator.
    Hold,
    /// The fit is published with a flag.
    Flag,
}

/// One check of the gate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct CheckResult {
    /// The rule, `G4 beats persistence`.
    pub name: String,
    /// What was measured; `None` where it could not be.
    pub statistic: Option<f64>,
    /// How it is compared with the threshold.
    pub operator: String,
    /// The limit.
    pub threshold: Option<f64>,
    /// Unit of both.
    pub unit: String,
    /// Whether the fit passes.
    pub pass: bool,
    /// What a failure does.
    pub severity: Severity,
    /// A sentence that an operator understands.
    pub comment: String,
}

/// Leave to serve a fit. Its fields are private: only [`validate`] makes one.
#[derive(Debug, Clone, PartialEq)]
pub struct Acceptance {
    flags: Vec<String>,
}

impl Acceptance {
    /// What the controller should know about the parameters.
    pub fn flags(&self) -> &[String] {
        &self.flags
    }
}

/// Leave to serve a fit as soon as an operator says so, and not before. Only [`validate`] makes one.
#[derive(Debug, Clone, PartialEq)]
pub struct Holding {
    flags: Vec<String>,
}

impl Holding {
    /// What the controller should know about the parameters, if they are ever served.
    pub fn flags(&self) -> &[String] {
        &self.flags
    }
}

/// What the gate says.
#[derive(Debug, Clone, PartialEq)]
pub enum Verdict {
    /// It may be served.
    Accepted(Acceptance),
    /// It passes, but the incumbent is better: the incumbent stays.
    Unchanged,
    /// It waits for an operator.
    Held(Holding),
    /// It is refused.
    Rejected,
}

impl Verdict {
    /// The word for documents.
    pub fn word(&self) -> &'static str {
        match self {
            Verdict::Accepted(_) => "accepted",
            Verdict::Unchanged => "unchanged",
            Verdict::Held(_) => "held",
            Verdict::Rejected => "rejected",
        }
    }
}

/// A verdict with its reasons.
#[derive(Debug, Clone, PartialEq)]
pub struct Judgement {
    /// What the gate says.
    pub verdict: Verdict,
    /// Every check.
    pub checks: Vec<CheckResult>,
    /// One plain sentence.
    pub summary: String,
}

impl Judgement {
    /// The rules that failed and are more than a flag.
    pub fn failed(&self) -> Vec<&str> {
        self.checks.iter().filter(|check| !check.pass && check.severity != Severity::Flag).map(|check| check.name.as_str()).collect()
    }
}

/// The check whose statistic is the ratio of the forecast errors of a fit and of what it would replace.
pub const NO_WORSE_THAN_INCUMBENT: &str = "G4 no worse than incumbent";

const INCUMBENT_RATIO: f64 = 1.10;
const UNCHANGED_RATIO: f64 = 1.02;
const BARELY: f64 = 0.9;
const LARGEST_ERROR: f64 = 10.0;
const LARGEST_EXCURSION: f64 = 5.0;
const JUMP_RMS: f64 = 1.0;
const JUMP_FACTOR: f64 = 3.0;
const LEAST_VALID: f64 = 0.9;
/// No room changes by this much from one sample to the next; a sensor that changes its unit does.
const LARGEST_CHANGE: f64 = 15.0;
const STUCK_HOURS: f64 = 24.0;
const STUCK_HOURS_MOVING: f64 = 12.0;
const WEEK: i64 = 7 * 86_400;
const FORTNIGHT: i64 = 14 * 86_400;

/// Judges a fit.
pub fn validate(problem: &Problem, fit: &Fit, incumbent: Option<&Incumbent>, policy: &Policy) -> Judgement {
    let mut gate = Gate::default();
    // The fit may have needed shorter steps than the problem started with.
    let problem = &problem.with_substeps(fit.substeps);
    let theta = reread(fit);
    if theta.len() != problem.model().parameters().len() || theta.iter().any(|value| !value.is_finite()) {
        gate.check("G1 finite", None, "", None, "-", false, Severity::Reject, "a parameter is missing or no finite number".to_owned());
        return gate.judge(None);
    }
    let trajectory = problem.simulate(&theta);
    gate.finite(problem, fit, &trajectory);
    if trajectory.diverged {
        return gate.judge(None);
    }
    gate.bounds(fit);
    gate.checks.extend(physics::checks(problem, &theta, &trajectory));
    let run = filter(problem, &theta, Some(fit.process_noise));
    let incumbent = incumbent.and_then(|incumbent| incumbent_theta(problem, incumbent));
    let ratio = gate.hold_out(problem, &theta, &run, incumbent.as_deref(), policy);
    gate.free_run(problem, &trajectory);
    gate.jump(problem, &theta, &trajectory, incumbent.as_deref());
    gate.repeat(fit);
    gate.data(problem, &trajectory, policy);
    gate.judge(ratio)
}

/// The parameters as a reader of the stored document gets them.
fn reread(fit: &Fit) -> Vec<f64> {
    let text = serde_json::to_string(fit).unwrap_or_default();
    serde_json::from_str::<Fit>(&text).map(|fit| fit.theta()).unwrap_or_default()
}

/// The incumbent's vector where it belongs to the same model.
fn incumbent_theta(problem: &Problem, incumbent: &Incumbent) -> Option<Vec<f64>> {
    let same = incumbent.model == *problem.model().id();
    let theta: Option<Vec<f64>> =
        problem.model().parameters().iter().map(|parameter| incumbent.theta.get(&parameter.name).copied()).collect();
    theta.filter(|_| same)
}

#[derive(Default)]
struct Gate {
    checks: Vec<CheckResult>,
    flags: Vec<String>,
}

impl Gate {
    #[allow(clippy::too_many_arguments)]
    fn check(
        &mut self,
        name: &str,
        statistic: Option<f64>,
        operator: &str,
        threshold: Option<f64>,
        unit: &str,
        pass: bool,
        severity: Severity,
        comment: String,
    ) {
        let (name, operator, unit) = (name.to_owned(), operator.to_owned(), unit.to_owned());
        let statistic = statistic.filter(|value| value.is_finite());
        self.checks.push(CheckResult { name, statistic, operator, threshold, unit, pass, severity, comment });
    }

    /// A check of a statistic that must stay below a limit; one that is missing fails.
    fn at_most(&mut self, name: &str, statistic: Option<f64>, limit: f64, unit: &str, severity: Severity, comment: String) -> bool {
        let pass = statistic.is_some_and(|value| value <= limit);
        self.check(name, statistic, "<=", Some(limit), unit, pass, severity, comment);
        pass
    }

    fn finite(&mut self, problem: &Problem, fit: &Fit, trajectory: &Trajectory) {
        let again = problem.mean_square_error(trajectory, 0, problem.split().train.clone()).map(f64::sqrt);
        let stored = fit.first_metrics().map(|metrics| metrics.train_rmse);
        let difference = again
            .zip(stored)
            .filter(|_| !trajectory.diverged)
            .map(|(again, stored)| ((again - stored) / stored.max(f64::MIN_POSITIVE)).abs());
        let comment = "every number is finite, and the stored parameters reproduce the stored error".to_owned();
        self.at_most("G1 finite", difference, 1e-9, "-", Severity::Reject, comment);
    }

    fn bounds(&mut self, fit: &Fit) {
        let outside = fit.parameters.values().filter(|e| !e.fixed && !(e.bounds[0]..=e.bounds[1]).contains(&e.value)).count();
        self.at_most(
            "G2 bounds",
            Some(outside as f64),
            0.0,
            "parameters",
            Severity::Reject,
            "every estimate lies inside its bounds".to_owned(),
        );
        for name in &fit.non_identifiable {
            self.flags.push(format!("non_identifiable:{name}"));
        }
        for (name, _) in fit.parameters.iter().filter(|(_, estimate)| estimate.at_bound) {
            self.flags.push(format!("at_bound:{name}"));
            let comment = format!("{name} sits on a bound of the search: its value is a limit, not an estimate");
            self.check("G2 at bound", None, "", None, "-", false, Severity::Flag, comment);
        }
    }

    /// Forecasts at the policy's horizon on unseen data, against persistence and the incumbent. Returns the
    /// ratio to the incumbent's error.
    fn hold_out(&mut self, problem: &Problem, theta: &[f64], run: &FilterRun, incumbent: Option<&[f64]>, policy: &Policy) -> Option<f64> {
        let unseen = problem.split().validation.clone();
        let name = horizon_name(policy.horizon);
        let horizon = [(name.as_str(), policy.horizon.seconds())];
        let errors = ahead(problem, theta, run, unseen.clone(), &horizon);
        let error = errors.values().next();
        let ratio = error.map(|error| error.rmse / error.persistence.max(f64::MIN_POSITIVE));
        let comment = match error {
            Some(error) => {
                format!("forecasts {name} ahead err by {:.2}, holding the last measurement by {:.2}", error.rmse, error.persistence)
            }
            None => format!("there are no unseen measurements to forecast {name} ahead"),
        };
        self.at_most("G4 beats persistence", ratio, 1.0, "-", Severity::Reject, comment);
        if ratio.is_some_and(|ratio| ratio > BARELY && ratio <= 1.0) {
            self.flags.push("barely_better_than_persistence".to_owned());
            let comment = "the forecasts are hardly better than holding the last measurement".to_owned();
            self.at_most("G4 clearly beats persistence", ratio, BARELY, "-", Severity::Flag, comment);
        }
        let incumbent = incumbent?;
        let theirs = ahead(problem, incumbent, &filter(problem, incumbent, None), unseen, &horizon);
        let ratio = error.zip(theirs.values().next()).map(|(ours, theirs)| ours.rmse / theirs.rmse.max(f64::MIN_POSITIVE));
        let comment = format!("the error {name} ahead beside that of the parameters served now, on the same unseen data");
        self.at_most(NO_WORSE_THAN_INCUMBENT, ratio, INCUMBENT_RATIO, "-", Severity::Reject, comment);
        ratio
    }

    fn free_run(&mut self, problem: &Problem, trajectory: &Trajectory) {
        let last = problem.grid().len();
        let from = last.saturating_sub((FORTNIGHT / problem.grid().step()) as usize);
        let measured = problem.measured();
        let (values, valid) = measured[0];
        let used = problem.usable(0, from..last);
        let worst = used.iter().map(|k| (trajectory.outputs[0][*k] - values[*k]).abs()).fold(0.0, f64::max);
        let comment = format!("the free run never errs by more than {LARGEST_ERROR} K");
        self.at_most("G5 largest error", Some(worst), LARGEST_ERROR, "K", Severity::Reject, comment);
        let known = (0..last).filter(|k| valid[*k]).map(|k| values[k]);
        let (low, high) = known.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
        let excursion = (from..last).map(|k| trajectory.outputs[0][k]).map(|y| (low - y).max(y - high)).fold(0.0, f64::max);
        let comment = "how far the free run leaves the range that was ever measured".to_owned();
        self.at_most("G5 excursion", Some(excursion), LARGEST_EXCURSION, "K", Severity::Reject, comment);
    }

    fn jump(&mut self, problem: &Problem, theta: &[f64], trajectory: &Trajectory, incumbent: Option<&[f64]>) {
        let Some(incumbent) = incumbent else { return };
        let last = problem.grid().len();
        let from = last.saturating_sub((WEEK / problem.grid().step()) as usize);
        let before = problem.simulate(incumbent);
        let difference: Vec<f64> = (from..last).map(|k| trajectory.outputs[0][k] - before.outputs[0][k]).collect();
        let rms = mean_square(&difference).sqrt();
        let factor = theta
            .iter()
            .zip(incumbent)
            .zip(problem.model().parameters())
            .filter(|(_, parameter)| parameter.scale == crate::model::Scale::Log)
            .map(|((new, old), _)| (new / old).max(old / new))
            .fold(1.0, f64::max);
        let pass = !(rms > JUMP_RMS && factor > JUMP_FACTOR) && rms.is_finite();
        let comment =
            format!("the free run differs from the incumbent's by {rms:.2} K rms, the most changed parameter by a factor of {factor:.1}");
        self.check("G6 jump", Some(rms), "<=", Some(JUMP_RMS), "K", pass, Severity::Hold, comment);
    }

    fn repeat(&mut self, fit: &Fit) {
        let pass = fit.stopped_by == Stop::Converged;
        if !pass {
            self.flags.push("low_confidence".to_owned());
        }
        let comment = if pass { "restarts of the search agree" } else { "the search ended before two restarts agreed" };
        self.check("G7 repeat", None, "", None, "-", pass, Severity::Flag, comment.to_owned());
    }

    fn data(&mut self, problem: &Problem, trajectory: &Trajectory, policy: &Policy) {
        let (values, valid) = (&problem.measured()[0].0.to_vec(), &problem.measured()[0].1.to_vec());
        let split = problem.split();
        let unseen = split.validation.len();
        self.check(
            "G8 unseen data",
            Some(unseen as f64),
            ">",
            Some(0.0),
            "samples",
            unseen > 0,
            Severity::Reject,
            "there are measurements that the search has not seen".to_owned(),
        );
        let all: Range<usize> = split.train.start..split.validation.end.max(split.train.end);
        let excluded = |k: &usize| policy.excluded.iter().any(|(from, to)| (*from..=*to).contains(&problem.grid().time(*k)));
        let wanted = all.clone().filter(|k| !excluded(k)).count();
        let good = problem.usable(0, all).iter().filter(|k| !excluded(k)).count() as f64 / wanted.max(1) as f64;
        let comment = "share of samples at which the output and all inputs are known".to_owned();
        self.check("G8 complete", Some(good), ">=", Some(LEAST_VALID), "-", good >= LEAST_VALID, Severity::Reject, comment);
        for (index, input) in problem.model().inputs().iter().enumerate() {
            let (low, high) = problem.inputs().range(index);
            if high - low <= 0.0 {
                let comment = format!("{} never changes, so its effect cannot be estimated", input.channel);
                self.check("G8 excited", Some(0.0), ">", Some(0.0), &input.unit, false, Severity::Reject, comment);
            }
        }
        let change = (1..values.len()).filter(|k| valid[*k] && valid[k - 1]).map(|k| (values[k] - values[k - 1]).abs()).fold(0.0, f64::max);
        let comment = "largest change of the output from one sample to the next; a change of unit would be larger".to_owned();
        self.at_most("G8 no unit jump", Some(change), LARGEST_CHANGE, "K", Severity::Reject, comment);
        let step = problem.quanta().first().copied().flatten().unwrap_or(0.0);
        let (hours, moved) = longest_constant(values, valid, &trajectory.outputs[0], problem.grid().step());
        let limit = if step > 0.0 && moved > 5.0 * step { STUCK_HOURS_MOVING } else { STUCK_HOURS };
        let comment = "longest time for which the output sensor showed one value".to_owned();
        self.at_most("G8 not stuck", Some(hours), limit, "h", Severity::Reject, comment);
    }

    fn judge(self, ratio: Option<f64>) -> Judgement {
        let failed = |severity| self.checks.iter().find(|check| !check.pass && check.severity == severity);
        let (verdict, summary) = if let Some(check) = failed(Severity::Reject) {
            (Verdict::Rejected, format!("rejected by {}: {}", check.name, check.comment))
        } else if let Some(check) = failed(Severity::Hold) {
            (Verdict::Held(Holding { flags: self.flags.clone() }), format!("held by {}: {}", check.name, check.comment))
        } else if ratio.is_some_and(|ratio| ratio > UNCHANGED_RATIO) {
            (Verdict::Unchanged, "good, but the parameters served now forecast better: they stay".to_owned())
        } else {
            let note = if self.flags.is_empty() { String::new() } else { format!(" with flags {}", self.flags.join(", ")) };
            (Verdict::Accepted(Acceptance { flags: self.flags.clone() }), format!("accepted{note}"))
        };
        Judgement { verdict, checks: self.checks, summary }
    }
}

/// Hours for which the sensor showed one value longest, and how far the model moved meanwhile.
fn longest_constant(values: &[f64], valid: &[bool], simulated: &[f64], step: i64) -> (f64, f64) {
    let (mut longest, mut moved) = (0, 0.0);
    let mut start = 0;
    for k in 0..values.len() {
        if !valid[k] || !valid[start] || values[k] != values[start] {
            start = k;
        }
        if valid[k] && k - start > longest {
            longest = k - start;
            let run = &simulated[start..=k];
            moved = run.iter().copied().fold(f64::NEG_INFINITY, f64::max) - run.iter().copied().fold(f64::INFINITY, f64::min);
        }
    }
    (longest as f64 * step as f64 / 3600.0, moved)
}
