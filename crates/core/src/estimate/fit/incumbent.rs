//! What a controller uses now.

use super::levels::ChannelLevel;
use crate::model::ModelId;
use indexmap::IndexMap;

/// The parameters that are served now.
#[derive(Debug, Clone, PartialEq)]
pub struct Incumbent {
    /// The model that they belong to.
    pub model: ModelId,
    /// Values by name.
    pub theta: IndexMap<String, f64>,
    /// The levels of the channels that they were fitted to; none where they are not known.
    pub levels: IndexMap<String, ChannelLevel>,
}
