//! What a system tells a model.

use std::collections::{BTreeMap, BTreeSet};

/// What a system tells a model: the members of its sets and the channels that are there.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Bindings {
    /// The members of each set; a set that is not named is empty.
    pub sets: BTreeMap<String, Vec<String>>,
    /// The channels of the window, derived ones included; `None` where nothing is known, then all are
    /// assumed.
    pub channels: Option<BTreeSet<String>>,
}
