//! What jobs go by that are not asked for otherwise.

use serde::{Deserialize, Serialize};

/// What estimates go by.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Estimates {
    /// Whether systems with the prior `siblings` learn from those of their building.
    pub borrow: bool,
}

/// What diagnoses go by that are not asked for otherwise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Diagnose {
    /// The share of rooms with nothing missing that a diagnosis may accuse, above 0 and at most 0.2.
    pub accusation_rate: f64,
}

impl Default for Estimates {
    fn default() -> Self {
        Self { borrow: true }
    }
}

impl Default for Diagnose {
    fn default() -> Self {
        Self { accusation_rate: 0.01 }
    }
}
