//! The parts of a body: what was measured, and what is forecast. They stand in the same rows and are kept
//! apart.

use super::bindings::ColumnBindings;
use super::header::ColumnHeader;
use super::role::ColumnRole;
use super::window::{Window, WindowReport};
use crate::fault::Fault;

/// A body as it was sent. It has one of the parts at least.
#[derive(Debug, Clone, PartialEq)]
pub struct WindowParts {
    /// The measurements, and what was found while reading them.
    pub measured: Option<(Window, WindowReport)>,
    /// The forecasts.
    pub forecast: Option<(Window, WindowReport)>,
}

/// Which columns of a body are read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ColumnPart {
    /// Those without a role.
    Measured,
    /// Forecasts.
    Forecast,
    /// Every column, whatever it says of its role.
    Whole,
}

/// A part that was read; none where the body has no column of it.
pub(super) type ReadPart = Result<Option<(Window, WindowReport)>, Vec<Fault>>;

impl ColumnPart {
    pub fn has(self, header: &ColumnHeader) -> bool {
        match self {
            ColumnPart::Measured => header.role.is_none(),
            ColumnPart::Forecast => header.role == Some(ColumnRole::Forecast),
            ColumnPart::Whole => true,
        }
    }

    /// The bindings without those that lead to columns of another part alone.
    pub fn bindings(self, headers: &[ColumnHeader], all: &ColumnBindings) -> ColumnBindings {
        let mut own = ColumnBindings::none();
        for (channel, column) in all.iter() {
            let mut named = headers.iter().filter(|header| header.is_named(column)).peekable();
            if named.peek().is_none() || named.any(|header| self.has(header)) {
                own.bind(channel, column);
            }
        }
        own
    }
}

impl WindowParts {
    /// Reads the parts of a body. `unmarked` is what columns are that say nothing of it: with a role, every
    /// column has that.
    pub(super) fn of(
        unmarked: Option<ColumnRole>,
        read: impl Fn(ColumnPart) -> ReadPart,
    ) -> Result<Self, Vec<Fault>> {
        match unmarked {
            Some(ColumnRole::Forecast) => Ok(Self { measured: None, forecast: read(ColumnPart::Whole)? }),
            None => match (read(ColumnPart::Measured), read(ColumnPart::Forecast)) {
                (Ok(measured), Ok(forecast)) => Ok(Self { measured, forecast }),
                (measured, forecast) => {
                    let mut faults = measured.err().unwrap_or_default();
                    // What is wrong with the times is wrong for both.
                    for fault in forecast.err().into_iter().flatten() {
                        if !faults.contains(&fault) {
                            faults.push(fault);
                        }
                    }
                    Err(faults)
                }
            },
        }
    }
}
