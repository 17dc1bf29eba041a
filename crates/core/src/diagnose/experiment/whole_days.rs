//! Days of a record that can be laid on each other.

use crate::estimate::Problem;
use crate::fault::Fault;
use std::ops::Range;

/// Most days, the newest ones: a system ages, and a fit may be in force for years.
const MOST_DAYS: usize = 56;

/// The newest whole days of a grid, the last one of which ends with it.
#[derive(Debug, Clone)]
pub(super) struct WholeDays {
    pub samples: Range<usize>,
    pub per_day: usize,
}

impl WholeDays {
    /// Those of a problem from a sample on.
    ///
    /// # Errors
    /// A fault where its step is no part of a day.
    pub fn of(problem: &Problem, from: usize) -> Result<Self, Fault> {
        let grid = problem.grid();
        let per_day = (24.0 / grid.step_hours()).round() as usize;
        if per_day < 2 || (per_day as f64 * grid.step_hours() - 24.0).abs() > 1e-9 {
            let detail = "the step of the fit is no part of a day, so its days cannot be laid on each other";
            return Err(Fault::new("/system", "step", detail));
        }
        let end = grid.len() - 1;
        let days = ((end - from.min(end)) / per_day).min(MOST_DAYS);
        Ok(Self { samples: end - days * per_day..end, per_day })
    }
}
