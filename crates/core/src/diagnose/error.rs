//! Why there is no diagnosis.

use crate::estimate::{Control, EstimateError};
use crate::fault::Fault;

/// Why there is no diagnosis.
#[derive(Debug, Clone, PartialEq)]
pub enum DiagnoseError {
    /// The window or the catalogue does not serve.
    Faults(Vec<Fault>),
    /// The model diverges, or somebody stopped the work.
    Estimate(EstimateError),
}

impl std::fmt::Display for DiagnoseError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            DiagnoseError::Faults(faults) => {
                let lines: Vec<String> = faults.iter().map(ToString::to_string).collect();
                f.write_str(&lines.join("; "))
            }
            DiagnoseError::Estimate(error) => error.fmt(f),
        }
    }
}

impl std::error::Error for DiagnoseError {}

impl DiagnoseError {
    /// Why a model has no optimum: somebody has stopped the search, or it diverges.
    pub(super) fn nothing(control: &Control) -> Self {
        DiagnoseError::Estimate(
            (control.interrupt)().map_or(EstimateError::NothingFinite, EstimateError::Interrupted),
        )
    }
}

/// Nothing where the work goes on.
///
/// # Errors
/// [`EstimateError::Interrupted`] where somebody has stopped it.
pub(super) fn interrupted(control: &Control) -> Result<(), DiagnoseError> {
    match (control.interrupt)() {
        Some(interrupt) => Err(DiagnoseError::Estimate(EstimateError::Interrupted(interrupt))),
        None => Ok(()),
    }
}
