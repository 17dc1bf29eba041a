//! What columns are beside measurements: forecasts.

use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// How a header says that its column is a forecast: behind name and unit.
const FORECAST: &str = "(forecast)";

/// What the values of a column are, where they are no measurements.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ColumnRole {
    /// They were forecast, by whoever sends them.
    Forecast,
}

/// A header without its role, and the role.
pub(super) fn marked(header: &str) -> (&str, Option<ColumnRole>) {
    match header.strip_suffix(FORECAST) {
        Some(named) if !named.trim().is_empty() => (named.trim_end(), Some(ColumnRole::Forecast)),
        _ => (header, None),
    }
}
