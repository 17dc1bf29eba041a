//! What the rules of the gate write down.

use super::check::{CheckResult, Severity};
use super::context::ValidationContext;
use super::limits::OutputScale;
use super::past::{GatePolicy, Past};
use crate::estimate::fit::Fit;
use crate::estimate::problem::Problem;
use crate::model::waivers::{self, Waivers};

/// What the rules wrote down. It says what is wrong and lets nothing out.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct CheckTable {
    /// Every check, in the order of the rules.
    pub checks: Vec<CheckResult>,
    /// What the controller should know about the parameters.
    pub flags: Vec<String>,
}

impl CheckTable {
    /// Puts a fit to some rules.
    pub fn of(problem: &Problem, fit: &Fit, past: &Past, policy: &GatePolicy, rules: &[Rule]) -> Self {
        let mut table = Self::default();
        match ValidationContext::new(problem, fit, past, policy) {
            Ok(context) => rules.iter().for_each(|rule| {
                problem.brake().check();
                (rule.look)(&context, &mut table);
            }),
            // There is nothing that any rule could look at.
            Err(comment) => table.plain("G1 finite", false, Severity::Reject, comment.to_owned()),
        }
        table.waive(&[&policy.waived, problem.model().waivers()]);
        table
    }

    /// Lets pass with a flag what failed and does not hold here.
    fn waive(&mut self, waivers: &[&Waivers]) {
        for check in self.checks.iter_mut().filter(|check| !check.pass && check.severity != Severity::Flag) {
            let Some(reason) = waivers.iter().find_map(|waivers| waivers::reason(waivers, &check.name))
            else {
                continue;
            };
            check.severity = Severity::Flag;
            check.comment += &format!(" (waived: {reason})");
            self.flags.push(format!("waived:{}", check.name));
        }
    }

    /// The first check of a severity that failed.
    pub fn failed(&self, severity: Severity) -> Option<&CheckResult> {
        self.checks.iter().find(|check| !check.pass && check.severity == severity)
    }

    #[allow(clippy::too_many_arguments)]
    pub(super) fn check(
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

    /// A check of something that has no number.
    pub(super) fn plain(&mut self, name: &str, pass: bool, severity: Severity, comment: String) {
        self.check(name, None, "", None, "-", pass, severity, comment);
    }

    /// A check of every output, of which the worst is told. The limit is that of rooms.
    pub(super) fn worst(
        &mut self,
        context: &ValidationContext,
        name: &str,
        kelvin: f64,
        statistic: impl Fn(&OutputScale) -> f64,
        says: impl Fn(f64, &str) -> String,
    ) {
        let Some((scale, statistic, limit)) = context.worst(kelvin, statistic) else { return };
        let comment = scale.says(says(limit, scale.unit));
        self.at_most(name, Some(statistic), limit, scale.unit, Severity::Reject, comment);
    }

    /// A check of a statistic that must stay below a limit; one that is missing fails.
    pub(super) fn at_most(
        &mut self,
        name: &str,
        statistic: Option<f64>,
        limit: f64,
        unit: &str,
        severity: Severity,
        comment: String,
    ) -> bool {
        let pass = statistic.is_some_and(|value| value <= limit);
        self.check(name, statistic, "<=", Some(limit), unit, pass, severity, comment);
        pass
    }
}

/// A rule of the gate.
#[derive(Debug, Clone, Copy)]
pub struct Rule {
    /// What its checks are called; those of physics and of the inputs have names of their own behind `G3`,
    /// `G9`, `G10` and `G11`, and `G6` looks at older days as well.
    pub name: &'static str,
    pub(super) look: fn(&ValidationContext, &mut CheckTable),
}
