//! The gate: a table of checks between a fit and the controller.
//!
//! [`validate`] is the only maker of an [`Acceptance`], and only an acceptance can be served, or a [`Holding`]
//! with an operator's word. Rules G1 to G12 (`rules`)
//! each have a severity: a failed `reject` is final, a `hold` waits for an operator, a `flag` is published
//! with the parameters. Incumbent and fit are judged on the same unseen data.

use super::channels::Level;
use super::fit::Fit;
use super::problem::Problem;
pub use super::rules::NO_WORSE_THAN_INCUMBENT;
use super::rules::{Rule, Table};
use crate::data::{Duration, Window};
use crate::model::ModelId;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The parameters that are served now.
#[derive(Debug, Clone, PartialEq)]
pub struct Incumbent {
    /// The model that they belong to.
    pub model: ModelId,
    /// Values by name.
    pub theta: IndexMap<String, f64>,
    /// The levels of the channels that they were fitted to; none where they are not known.
    pub levels: IndexMap<String, Level>,
}

/// Parameters of the same system that were trusted at another time.
#[derive(Debug, Clone, PartialEq)]
pub struct Reference {
    /// What they are to an operator: `the parameters served 30 days ago`.
    pub name: String,
    /// The fit that found them.
    pub fit: Fit,
}

/// The outdoor temperature of another system in the same place.
#[derive(Debug, Clone, PartialEq)]
pub struct NextDoor {
    /// Whose it is: `room/3`.
    pub name: String,
    /// A window with the channel `T_out`.
    pub weather: Window,
}

/// What a fit is judged beside: what is served, what was, and what others measure.
#[derive(Debug, Clone, Default)]
pub struct Past {
    /// The parameters that are served now.
    pub incumbent: Option<Incumbent>,
    /// Older parameters, so that many small steps away from them are seen.
    pub references: Vec<Reference>,
    /// Since when newer measurements contradict the incumbent, in seconds, where they do.
    pub degraded: Option<i64>,
    /// The same model on the days right before those that the fit has seen, where there are any ([`super::request::days_before`]).
    pub days_before: Option<Problem>,
    /// The weather of the neighbours that measure it themselves.
    pub next_door: Vec<NextDoor>,
}

impl Past {
    /// A past of which only the incumbent is known.
    pub fn of(incumbent: Option<Incumbent>) -> Self {
        Self { incumbent, ..Self::default() }
    }
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

/// A fit that forecasts worse than the incumbent by more than this share is good for nothing new.
const UNCHANGED_RATIO: f64 = 1.02;

/// Judges a fit by every rule. A part of them gives a [`Table`], which lets nothing out.
pub fn validate(problem: &Problem, fit: &Fit, past: &Past, policy: &Policy) -> Judgement {
    let table = Table::of(problem, fit, past, policy, Rule::ALL);
    let ratio = table.checks.iter().find(|check| check.name == NO_WORSE_THAN_INCUMBENT).and_then(|check| check.statistic);
    let flags = &table.flags;
    let (verdict, summary) = if let Some(check) = table.failed(Severity::Reject) {
        (Verdict::Rejected, format!("rejected by {}: {}", check.name, check.comment))
    } else if let Some(check) = table.failed(Severity::Hold) {
        (Verdict::Held(Holding { flags: flags.clone() }), format!("held by {}: {}", check.name, check.comment))
    } else if ratio.is_some_and(|ratio| ratio > UNCHANGED_RATIO) {
        (Verdict::Unchanged, "good, but the parameters served now forecast better: they stay".to_owned())
    } else {
        let note = if flags.is_empty() { String::new() } else { format!(" with flags {}", flags.join(", ")) };
        (Verdict::Accepted(Acceptance { flags: flags.clone() }), format!("accepted{note}"))
    };
    Judgement { verdict, checks: table.checks, summary }
}
