//! What a problem was put together from, so that it can be put together again.

use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use utoipa::ToSchema;

/// What a problem was put together from beside the model and the request: what is needed to put it together
/// again, whatever has become of the system since.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, ToSchema)]
pub struct Basis {
    /// The first sample that was read, RFC 3339.
    pub from: String,
    /// The last one.
    pub to: String,
    /// The channels that there were for the model to choose from, computed ones included.
    pub channels: Vec<String>,
    /// The members of the model's sets.
    pub sets: BTreeMap<String, Vec<String>>,
    /// Latitude and longitude in degrees.
    #[schema(value_type = Option<Vec<f64>>, min_items = 2, max_items = 2)]
    pub location: Option<(f64, f64)>,
    /// The IANA zone of the clock on the wall.
    #[serde(default)]
    pub zone: Option<String>,
    /// Samples before the training part that delayed inputs look back at.
    #[serde(default)]
    pub lead: usize,
}
