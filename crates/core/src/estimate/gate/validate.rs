//! The gate: a table of checks between a fit and the controller.
//!
//! [`validate`] is the only maker of an [`Acceptance`], and only an acceptance can be served, or a
//! [`Holding`] with an operator's word. Rules G1 to G12 (`rules`) each have a severity: a failed `reject` is
//! final, a `hold` waits for an operator, a `flag` is published with the parameters. Incumbent and fit are
//! judged on the same unseen data.

use super::check::{CheckResult, Severity};
use super::past::{GatePolicy, Past};
use super::rules::ALL;
pub use super::rules::NO_WORSE_THAN_INCUMBENT;
use super::table::CheckTable;
use crate::estimate::fit::Fit;
use crate::estimate::problem::Problem;

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
    pub fn as_str(&self) -> &'static str {
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
        self.checks
            .iter()
            .filter(|check| !check.pass && check.severity != Severity::Flag)
            .map(|check| check.name.as_str())
            .collect()
    }
}

/// A fit that forecasts worse than the incumbent by more than this share is good for nothing new.
const UNCHANGED_RATIO: f64 = 1.02;

/// Judges a fit by every rule. A part of them gives a [`CheckTable`], which lets nothing out.
pub fn validate(problem: &Problem, fit: &Fit, past: &Past, policy: &GatePolicy) -> Judgement {
    let table = CheckTable::of(problem, fit, past, policy, ALL);
    let ratio = table
        .checks
        .iter()
        .find(|check| check.name == NO_WORSE_THAN_INCUMBENT)
        .and_then(|check| check.statistic);
    let flags = &table.flags;
    let (verdict, summary) = if let Some(check) = table.failed(Severity::Reject) {
        (Verdict::Rejected, format!("rejected by {}: {}", check.name, check.comment))
    } else if let Some(check) = table.failed(Severity::Hold) {
        (
            Verdict::Held(Holding { flags: flags.clone() }),
            format!("held by {}: {}", check.name, check.comment),
        )
    } else if ratio.is_some_and(|ratio| ratio > UNCHANGED_RATIO) {
        (Verdict::Unchanged, "good, but the parameters served now forecast better: they stay".to_owned())
    } else {
        let note = if flags.is_empty() { String::new() } else { format!(" with flags {}", flags.join(", ")) };
        (Verdict::Accepted(Acceptance { flags: flags.clone() }), format!("accepted{note}"))
    };
    Judgement { verdict, checks: table.checks, summary }
}
