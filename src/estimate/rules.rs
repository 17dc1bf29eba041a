//! The rules of the gate, as a table: what each looks at, and what it writes down.
//!
//! A rule knows nothing of the others, and none decides: `validate` reads what they wrote.

use super::fit::{AheadError, Fit, Stop};
use super::metrics::{FilterRun, ahead, filter, filter_fit, horizon_name, lead};
use super::physics;
use super::problem::{Problem, mean_square};
use super::validate::{CheckResult, Incumbent, Policy, Severity};
use crate::model::Scale;
use crate::simulate::Trajectory;
use crate::simulate::trajectory::Measured;

/// The check whose statistic is the ratio of the forecast errors of a fit and of what it would replace.
pub const NO_WORSE_THAN_INCUMBENT: &str = "G4 no worse than incumbent";

const INCUMBENT_RATIO: f64 = 1.10;
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

/// A rule of the gate.
#[derive(Debug, Clone, Copy)]
pub struct Rule {
    /// What its checks are called; those of physics have names of their own behind `G3`.
    pub name: &'static str,
    look: fn(&Case, &mut Table),
}

impl Rule {
    /// Every rule, in the order in which an operator reads them.
    pub const ALL: &'static [Rule] = &[
        Rule { name: "G1 finite", look: finite },
        Rule { name: "G2 bounds", look: bounds },
        Rule { name: "G3", look: physical },
        Rule { name: "G4 beats persistence", look: persistence },
        Rule { name: NO_WORSE_THAN_INCUMBENT, look: incumbent },
        Rule { name: "G5 largest error", look: largest_error },
        Rule { name: "G5 excursion", look: excursion },
        Rule { name: "G6 jump", look: jump },
        Rule { name: "G7 repeat", look: repeat },
        Rule { name: "G8 unseen data", look: unseen },
        Rule { name: "G8 complete", look: complete },
        Rule { name: "G8 excited", look: excited },
        Rule { name: "G8 no unit jump", look: unit_jump },
        Rule { name: "G8 not stuck", look: stuck },
    ];
}

/// What the rules look at: a fit that is simulated again from its stored numbers.
struct Case<'a> {
    problem: Problem,
    fit: &'a Fit,
    theta: Vec<f64>,
    trajectory: Trajectory,
    /// Of the fit, on unseen data.
    forecast: Option<AheadError>,
    /// The parameters served now, where they are parameters of the same model.
    incumbent: Option<Vec<f64>>,
    policy: &'a Policy,
}

/// What the rules wrote down. It says what is wrong and lets nothing out.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Table {
    /// Every check, in the order of the rules.
    pub checks: Vec<CheckResult>,
    /// What the controller should know about the parameters.
    pub flags: Vec<String>,
}

impl Table {
    /// Puts a fit to some rules.
    pub fn of(problem: &Problem, fit: &Fit, incumbent: Option<&Incumbent>, policy: &Policy, rules: &[Rule]) -> Self {
        let mut table = Self::default();
        match Case::new(problem, fit, incumbent, policy) {
            Ok(case) => rules.iter().for_each(|rule| (rule.look)(&case, &mut table)),
            // There is nothing that any rule could look at.
            Err(comment) => table.check("G1 finite", None, "", None, "-", false, Severity::Reject, comment.to_owned()),
        }
        table
    }

    /// The first check of a severity that failed.
    pub fn failed(&self, severity: Severity) -> Option<&CheckResult> {
        self.checks.iter().find(|check| !check.pass && check.severity == severity)
    }

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
}

impl<'a> Case<'a> {
    fn new(problem: &Problem, fit: &'a Fit, incumbent: Option<&Incumbent>, policy: &'a Policy) -> Result<Self, &'static str> {
        // The fit may have needed shorter steps than the problem started with.
        let problem = problem.with_substeps(fit.substeps);
        let theta = reread(fit);
        if theta.len() != problem.model().parameters().len() || theta.iter().any(|value| !value.is_finite()) {
            return Err("a parameter is missing or no finite number");
        }
        let trajectory = problem.simulate(&theta);
        if trajectory.diverged {
            return Err("the simulation of the stored parameters leaves the numbers");
        }
        let forecast = forecast(&problem, &theta, &filter_fit(&problem, fit), policy);
        let incumbent = incumbent.and_then(|incumbent| incumbent_theta(&problem, incumbent));
        Ok(Self { problem, fit, theta, trajectory, forecast, incumbent, policy })
    }

    /// The measured output, and where it is known.
    fn measured(&self) -> Measured<'_> {
        self.problem.measured()[0]
    }

    /// The first sample of this many seconds before the end.
    fn since(&self, seconds: i64) -> usize {
        self.problem.grid().len().saturating_sub((seconds / self.problem.grid().step()) as usize)
    }
}

/// Forecast errors at the policy's horizon on unseen data: of the parameters, and of persistence. `None` where nothing is
/// comparable, or a forecast that could be made left the numbers: the others do not speak for it.
fn forecast(problem: &Problem, theta: &[f64], run: &FilterRun, policy: &Policy) -> Option<AheadError> {
    let name = horizon_name(policy.horizon);
    let horizon = [(name.as_str(), policy.horizon.seconds())];
    let unseen = problem.split().validation.clone();
    let error = ahead(problem, theta, run, unseen.clone(), &horizon).into_values().next()?;
    let lead = lead(policy.horizon.seconds(), problem.grid().step())?;
    let (_, valid) = problem.measured()[0];
    let known = problem.known();
    let possible =
        (unseen.start + lead..unseen.end).filter(|k| valid[*k] && valid[k - lead] && known[k - lead..*k].iter().all(|known| *known));
    (error.n >= possible.count()).then_some(error)
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

fn finite(case: &Case, table: &mut Table) {
    let again = case.problem.mean_square_error(&case.trajectory, 0, case.problem.split().train.clone()).map(f64::sqrt);
    let stored = case.fit.first_metrics().map(|metrics| metrics.train_rmse);
    let difference = again.zip(stored).map(|(again, stored)| ((again - stored) / stored.max(f64::MIN_POSITIVE)).abs());
    let comment = "every number is finite, and the stored parameters reproduce the stored error".to_owned();
    table.at_most("G1 finite", difference, 1e-9, "-", Severity::Reject, comment);
}

fn bounds(case: &Case, table: &mut Table) {
    let estimates = &case.fit.parameters;
    let outside = estimates.values().filter(|e| !(e.bounds[0]..=e.bounds[1]).contains(&e.value)).count();
    let comment = "every parameter, estimated or fixed, lies inside its bounds".to_owned();
    table.at_most("G2 bounds", Some(outside as f64), 0.0, "parameters", Severity::Reject, comment);
    for name in &case.fit.non_identifiable {
        table.flags.push(format!("non_identifiable:{name}"));
    }
    for (name, _) in estimates.iter().filter(|(_, estimate)| estimate.at_bound) {
        table.flags.push(format!("at_bound:{name}"));
        let comment = format!("{name} sits on a bound of the search: its value is a limit, not an estimate");
        table.check("G2 at bound", None, "", None, "-", false, Severity::Flag, comment);
    }
}

fn physical(case: &Case, table: &mut Table) {
    table.checks.extend(physics::checks(&case.problem, &case.theta, &case.trajectory));
}

fn persistence(case: &Case, table: &mut Table) {
    let name = horizon_name(case.policy.horizon);
    let ratio = case.forecast.as_ref().map(|error| error.rmse / error.persistence.max(f64::MIN_POSITIVE));
    let comment = match &case.forecast {
        Some(error) => format!("forecasts {name} ahead err by {:.2}, holding the last measurement by {:.2}", error.rmse, error.persistence),
        None => format!("there are no unseen measurements to forecast {name} ahead, or a forecast of them leaves the numbers"),
    };
    table.at_most("G4 beats persistence", ratio, 1.0, "-", Severity::Reject, comment);
    if ratio.is_some_and(|ratio| ratio > BARELY && ratio <= 1.0) {
        table.flags.push("barely_better_than_persistence".to_owned());
        let comment = "the forecasts are hardly better than holding the last measurement".to_owned();
        table.at_most("G4 clearly beats persistence", ratio, BARELY, "-", Severity::Flag, comment);
    }
}

fn incumbent(case: &Case, table: &mut Table) {
    let Some(incumbent) = &case.incumbent else { return };
    let theirs = forecast(&case.problem, incumbent, &filter(&case.problem, incumbent, None), case.policy);
    let ratio = case.forecast.as_ref().zip(theirs).map(|(ours, theirs)| ours.rmse / theirs.rmse.max(f64::MIN_POSITIVE));
    let name = horizon_name(case.policy.horizon);
    let comment = format!("the error {name} ahead beside that of the parameters served now, on the same unseen data");
    table.at_most(NO_WORSE_THAN_INCUMBENT, ratio, INCUMBENT_RATIO, "-", Severity::Reject, comment);
}

fn largest_error(case: &Case, table: &mut Table) {
    let (values, _) = case.measured();
    let used = case.problem.usable(0, case.since(FORTNIGHT)..values.len());
    let worst = used.iter().map(|k| (case.trajectory.outputs[0][*k] - values[*k]).abs()).fold(0.0, f64::max);
    let comment = format!("the free run never errs by more than {LARGEST_ERROR} K");
    table.at_most("G5 largest error", Some(worst), LARGEST_ERROR, "K", Severity::Reject, comment);
}

fn excursion(case: &Case, table: &mut Table) {
    let (values, valid) = case.measured();
    let known = (0..values.len()).filter(|k| valid[*k]).map(|k| values[k]);
    let (low, high) = known.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    let run = &case.trajectory.outputs[0][case.since(FORTNIGHT)..];
    let excursion = run.iter().map(|y| (low - y).max(y - high)).fold(0.0, f64::max);
    let comment = "how far the free run leaves the range that was ever measured".to_owned();
    table.at_most("G5 excursion", Some(excursion), LARGEST_EXCURSION, "K", Severity::Reject, comment);
}

fn jump(case: &Case, table: &mut Table) {
    let Some(incumbent) = &case.incumbent else { return };
    let before = case.problem.simulate(incumbent);
    let week = case.since(WEEK)..case.problem.grid().len();
    let difference: Vec<f64> = week.map(|k| case.trajectory.outputs[0][k] - before.outputs[0][k]).collect();
    let rms = mean_square(&difference).sqrt();
    let parameters = case.theta.iter().zip(incumbent).zip(case.problem.model().parameters());
    let factor = parameters
        .filter(|(_, parameter)| parameter.scale == Scale::Log)
        .map(|((new, old), _)| (new / old).max(old / new))
        .fold(1.0, f64::max);
    let pass = !(rms > JUMP_RMS && factor > JUMP_FACTOR) && rms.is_finite();
    let comment =
        format!("the free run differs from the incumbent's by {rms:.2} K rms, the most changed parameter by a factor of {factor:.1}");
    table.check("G6 jump", Some(rms), "<=", Some(JUMP_RMS), "K", pass, Severity::Hold, comment);
}

fn repeat(case: &Case, table: &mut Table) {
    let pass = case.fit.stopped_by == Stop::Converged;
    if !pass {
        table.flags.push("low_confidence".to_owned());
    }
    let comment = if pass { "restarts of the search agree" } else { "the search ended before two restarts agreed" };
    table.check("G7 repeat", None, "", None, "-", pass, Severity::Flag, comment.to_owned());
}

fn unseen(case: &Case, table: &mut Table) {
    let unseen = case.problem.split().validation.len();
    let comment = "there are measurements that the search has not seen".to_owned();
    table.check("G8 unseen data", Some(unseen as f64), ">", Some(0.0), "samples", unseen > 0, Severity::Reject, comment);
}

fn complete(case: &Case, table: &mut Table) {
    let (problem, split) = (&case.problem, case.problem.split());
    let all = split.train.start..split.validation.end.max(split.train.end);
    let excluded = |k: &usize| case.policy.excluded.iter().any(|(from, to)| (*from..=*to).contains(&problem.grid().time(*k)));
    let wanted = all.clone().filter(|k| !excluded(k)).count();
    let good = problem.usable(0, all).iter().filter(|k| !excluded(k)).count() as f64 / wanted.max(1) as f64;
    let comment = "share of samples at which the output and all inputs are known".to_owned();
    table.check("G8 complete", Some(good), ">=", Some(LEAST_VALID), "-", good >= LEAST_VALID, Severity::Reject, comment);
}

fn excited(case: &Case, table: &mut Table) {
    for (index, input) in case.problem.model().inputs().iter().enumerate() {
        let (low, high) = case.problem.inputs().range(index);
        if high - low <= 0.0 {
            let comment = format!("{} never changes, so its effect cannot be estimated", input.channel);
            table.check("G8 excited", Some(0.0), ">", Some(0.0), &input.unit, false, Severity::Reject, comment);
        }
    }
}

fn unit_jump(case: &Case, table: &mut Table) {
    let (values, valid) = case.measured();
    let change = (1..values.len()).filter(|k| valid[*k] && valid[k - 1]).map(|k| (values[k] - values[k - 1]).abs()).fold(0.0, f64::max);
    let comment = "largest change of the output from one sample to the next; a change of unit would be larger".to_owned();
    table.at_most("G8 no unit jump", Some(change), LARGEST_CHANGE, "K", Severity::Reject, comment);
}

fn stuck(case: &Case, table: &mut Table) {
    let (values, valid) = case.measured();
    let step = case.problem.quanta().first().copied().flatten().unwrap_or(0.0);
    let (hours, moved) = longest_constant(values, valid, &case.trajectory.outputs[0], case.problem.grid().step());
    let limit = if step > 0.0 && moved > 5.0 * step { STUCK_HOURS_MOVING } else { STUCK_HOURS };
    let comment = "longest time for which the output sensor showed one value".to_owned();
    table.at_most("G8 not stuck", Some(hours), limit, "h", Severity::Reject, comment);
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
