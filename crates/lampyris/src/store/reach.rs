//! Which systems somebody may see.

use super::error::StoreError;
use super::value::to_json;
use lampyris_core::data::{SystemId, SystemPattern};

/// The systems that a caller may see: all of them, or those that one of some patterns selects.
///
/// Lists are cut in the database by `EXISTS (SELECT 1 FROM json_each($n) WHERE glob(value, system))`. Names
/// and patterns hold one `/` each and none of the other signs of `glob`, so that it means what
/// [`SystemPattern`] means.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct SystemScope(Option<Vec<SystemPattern>>);

impl SystemScope {
    /// Every system.
    pub const ALL: Self = Self(None);

    /// The systems of some patterns; every system where there are none.
    pub fn of(patterns: Vec<SystemPattern>) -> Self {
        Self(if patterns.is_empty() { None } else { Some(patterns) })
    }

    /// Whether it is every system.
    pub fn is_all(&self) -> bool {
        self.0.is_none()
    }

    /// The patterns; none where it is every system.
    pub fn patterns(&self) -> &[SystemPattern] {
        self.0.as_deref().unwrap_or_default()
    }

    /// Whether a system is among them.
    pub fn covers(&self, system: &SystemId) -> bool {
        self.0.as_ref().is_none_or(|patterns| patterns.iter().any(|pattern| pattern.matches(system)))
    }

    /// The first pattern that might select another system.
    pub fn beyond<'a>(&self, asked: &'a [SystemPattern]) -> Option<&'a SystemPattern> {
        let patterns = self.0.as_ref()?;
        asked.iter().find(|asked| !patterns.iter().any(|pattern| pattern.includes(asked)))
    }

    /// The patterns as the database takes them.
    pub(super) fn sql(&self) -> Result<Option<String>, StoreError> {
        self.0.as_ref().map(|patterns| to_json("patterns", patterns)).transpose()
    }
}
