//! One check of the gate, and what its failure does.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

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
