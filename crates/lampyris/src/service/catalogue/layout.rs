//! Proposes the layout of a building. Nothing is kept: neither the measurements nor the proposal.

use super::windows::{BodyAsked, Format, read};
use crate::service::error::ServiceError;
use crate::service::threads::blocking;
use lampyris_core::data::{ColumnBindings, Layout, propose_layout};

/// A proposal, and what was found while reading its measurements.
#[derive(Debug)]
pub struct Proposal {
    /// The proposal.
    pub layout: Layout,
    /// What else the sender should know, in sentences.
    pub warnings: Vec<String>,
}

/// Proposes rooms and neighbours from a window whose channels are the temperatures of many sensors.
///
/// # Errors
/// Every fault of the body, or too few sensors, or too little of them in common.
pub(crate) async fn propose(
    format: Format,
    body: impl AsRef<[u8]> + Send + 'static,
) -> Result<Proposal, ServiceError> {
    let work = move || {
        let (window, report) = read(format, body.as_ref(), &ColumnBindings::none(), &BodyAsked::default())?;
        let mut warnings = report.warnings;
        if let Some(first) = report.rejected_rows.first() {
            warnings.push(format!(
                "{} rows were left out, the first in line {}: {}",
                report.rejected_rows.len(),
                first.line,
                first.reason
            ));
        }
        Ok(Proposal { layout: propose_layout(&window).map_err(ServiceError::Faults)?, warnings })
    };
    blocking(work).await?
}
