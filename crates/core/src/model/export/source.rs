//! Where the values of a written model come from.

/// Who the values belong to.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ExportSource {
    /// A line that says where they come from.
    pub line: String,
    /// The longest internal step with which it is simulated, in hours.
    pub longest_step_h: f64,
}
