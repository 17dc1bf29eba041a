//! What physics demands of any estimate, as documents say it.

use crate::fault::Fault;
use crate::schema::CheckInputs;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A demand of physics that the validation gate puts to an estimate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
#[serde(tag = "kind", rename_all = "snake_case", try_from = "CheckFields")]
#[schema(as = PhysicsCheck)]
pub enum Check {
    /// All eigenvalues of the linearised model have negative real parts.
    Stable,
    /// All time constants, in hours, lie inside this interval.
    TimeConstants {
        /// Shortest.
        lower: f64,
        /// Longest.
        upper: f64,
    },
    /// The steady gain from an input to a state lies in `(above, upto]`.
    SteadyGain {
        /// The input.
        input: String,
        /// The state.
        state: String,
        /// Exclusive lower limit.
        above: f64,
        /// Inclusive upper limit.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        upto: Option<f64>,
        /// Inputs that are set to these values for the check, such as an open valve.
        #[serde(default, skip_serializing_if = "IndexMap::is_empty")]
        #[schema(value_type = CheckInputs)]
        with: IndexMap<String, f64>,
    },
    /// Every state stays inside this interval in every simulation.
    StateRange {
        /// Lowest.
        lower: f64,
        /// Highest.
        upper: f64,
    },
    /// An expression stays inside this interval at every sample of the free run: of the parameters, such as a
    /// growth that is faster than the decay, or of what is simulated, such as an effluent that is never
    /// negative. It knows no delays.
    Range {
        /// What it is called.
        name: String,
        /// The expression, in the names of the model.
        expr: String,
        /// Its unit.
        unit: String,
        /// Lowest.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        lower: Option<f64>,
        /// Highest.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        upper: Option<f64>,
    },
}

/// The fields of all checks. Read first, so that a fault has its place; which of them belong together is a
/// matter of the kind.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CheckFields {
    kind: CheckKind,
    lower: Option<f64>,
    upper: Option<f64>,
    input: Option<String>,
    state: Option<String>,
    above: Option<f64>,
    upto: Option<f64>,
    with: Option<IndexMap<String, f64>>,
    name: Option<String>,
    expr: Option<String>,
    unit: Option<String>,
}

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum CheckKind {
    Stable,
    TimeConstants,
    SteadyGain,
    StateRange,
    Range,
}

impl TryFrom<CheckFields> for Check {
    type Error = &'static str;

    fn try_from(fields: CheckFields) -> Result<Self, Self::Error> {
        let is_gain = fields.input.is_some()
            || fields.state.is_some()
            || fields.above.is_some()
            || fields.upto.is_some()
            || fields.with.is_some();
        let is_range = fields.lower.is_some() || fields.upper.is_some();
        let is_text = fields.name.is_some() || fields.expr.is_some() || fields.unit.is_some();
        if is_text && !matches!(fields.kind, CheckKind::Range) {
            return Err("only `range` has `name`, `expr` and `unit`");
        }
        match (fields.kind, fields.lower.zip(fields.upper), fields.input.zip(fields.state).zip(fields.above))
        {
            (CheckKind::Stable, _, _) if !is_gain && !is_range => Ok(Check::Stable),
            (CheckKind::Stable, _, _) => Err("`stable` has no other fields"),
            (CheckKind::TimeConstants, Some((lower, upper)), _) if !is_gain => {
                Ok(Check::TimeConstants { lower, upper })
            }
            (CheckKind::StateRange, Some((lower, upper)), _) if !is_gain => {
                Ok(Check::StateRange { lower, upper })
            }
            (CheckKind::TimeConstants | CheckKind::StateRange, _, _) => {
                Err("`time_constants` and `state_range` have `lower` and `upper`")
            }
            (CheckKind::SteadyGain, _, Some(((input, state), above))) if !is_range => Ok(Check::SteadyGain {
                input,
                state,
                above,
                upto: fields.upto,
                with: fields.with.unwrap_or_default(),
            }),
            (CheckKind::Range, _, _) => match (fields.name, fields.expr, fields.unit) {
                (Some(name), Some(expr), Some(unit)) if !is_gain => {
                    Ok(Check::Range { name, expr, unit, lower: fields.lower, upper: fields.upper })
                }
                _ => Err("`range` has `name`, `expr` and `unit`, and may have `lower` and `upper`"),
            },
            (CheckKind::SteadyGain, _, _) => {
                Err("`steady_gain` has `input`, `state` and `above`, and may have `upto` and `with`")
            }
        }
    }
}

impl Check {
    /// What makes no sense in a check of a model with these inputs and states.
    pub(super) fn faults(
        &self,
        pointer: &str,
        is_input: impl Fn(&str) -> bool,
        is_state: impl Fn(&str) -> bool,
    ) -> Vec<Fault> {
        let mut faults = Vec::new();
        let mut demand = |holds: bool, field: &str, code: &str, detail: String| {
            if !holds {
                faults.push(Fault::new(format!("{pointer}/{field}"), code, detail));
            }
        };
        match self {
            Check::Stable => {}
            Check::TimeConstants { lower, upper } | Check::StateRange { lower, upper } => {
                demand(lower < upper, "upper", "bounds", format!("[{lower}, {upper}] is no interval"));
            }
            Check::Range { lower: None, upper: None, .. } => {
                demand(
                    false,
                    "lower",
                    "missing-value",
                    "a check without `lower` and `upper` demands nothing".to_owned(),
                );
            }
            Check::Range { lower, upper, .. } => {
                let (lower, upper) = (lower.unwrap_or(f64::NEG_INFINITY), upper.unwrap_or(f64::INFINITY));
                demand(lower < upper, "upper", "bounds", format!("[{lower}, {upper}] is no interval"));
            }
            Check::SteadyGain { input, state, above, upto, with } => {
                for (field, name) in
                    [("input", input)].into_iter().chain(with.keys().map(|name| ("with", name)))
                {
                    demand(is_input(name), field, "unknown-name", format!("there is no input `{name}`"));
                }
                demand(is_state(state), "state", "unknown-state", format!("there is no state `{state}`"));
                let is_interval = upto.is_none_or(|upto| *above < upto);
                demand(
                    is_interval,
                    "upto",
                    "bounds",
                    format!("nothing is above {above} and at most {}", upto.unwrap_or_default()),
                );
            }
        }
        faults
    }
}
