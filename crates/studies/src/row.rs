//! The lines of the table that a study ends with, and the limits that some of them have.

use serde::{Deserialize, Deserializer, Serialize};
use std::borrow::Cow;

/// One line of the table.
#[derive(Debug, Serialize, Deserialize)]
pub struct Row {
    pub what: String,
    #[serde(deserialize_with = "number")]
    pub value: f64,
    pub unit: Cow<'static, str>,
    /// The limit of a ratio or count that binds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub limit: Option<Limit>,
}

/// A limit on a ratio, a share or a count.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Limit {
    AtMost(f64),
    AtLeast(f64),
}

impl Row {
    pub fn new(what: impl Into<String>, value: f64, unit: &'static str) -> Self {
        Self { what: what.into(), value, unit: Cow::Borrowed(unit), limit: None }
    }

    pub fn at_most(self, limit: f64) -> Self {
        Self { limit: Some(Limit::AtMost(limit)), ..self }
    }

    pub fn at_least(self, limit: f64) -> Self {
        Self { limit: Some(Limit::AtLeast(limit)), ..self }
    }

    pub fn holds(&self) -> bool {
        match self.limit {
            None => true,
            Some(Limit::AtMost(limit)) => self.value <= limit,
            Some(Limit::AtLeast(limit)) => self.value >= limit,
        }
    }

    pub fn line(&self) -> String {
        let [what, number, unit, limit, mark] = self.cells();
        format!("{what:<66} {number:>12} {unit:<8} {limit:<9} {mark}")
    }

    /// What, how much, in which unit, the limit, and whether it holds.
    pub fn cells(&self) -> [String; 5] {
        let limit = match self.limit {
            None => String::new(),
            Some(Limit::AtMost(limit)) => format!("<= {limit}"),
            Some(Limit::AtLeast(limit)) => format!(">= {limit}"),
        };
        let mark = match (self.limit.is_some(), self.holds()) {
            (false, _) => "",
            (true, true) => "holds",
            (true, false) => "FAILS",
        };
        [self.what.clone(), self.number(), self.unit.to_string(), limit, mark.to_owned()]
    }

    pub fn number(&self) -> String {
        if self.value != 0.0 && self.value.abs() < 1e-3 {
            format!("{:.2e}", self.value)
        } else {
            format!("{:.4}", self.value)
        }
    }
}

/// A value that is no number is written as null.
fn number<'de, D: Deserializer<'de>>(document: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(document)?.unwrap_or(f64::NAN))
}
