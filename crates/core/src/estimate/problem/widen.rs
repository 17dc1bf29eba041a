//! The grid of a problem with everything else that was measured.

use super::Problem;
use super::request::Site;
use crate::data::{ChannelKind, Column, DEFAULT_MAX_GAP_STEPS, DROPS, Grid, Window, add_calendar, add_drops};
use crate::fault::Fault;

/// A channel of which more than a tenth is missing tells too little.
const LEAST_VALID: f64 = 0.9;

/// Every channel of the window on the grid of a problem, so that any effect finds its inputs there. A channel
/// with holes too large to bridge is named instead.
pub fn widen(problem: &Problem, window: &Window, site: &Site) -> Result<(Grid, Vec<String>), Fault> {
    let output = problem.model().outputs().first().map(|output| output.channel.clone()).unwrap_or_default();
    let mut grid = problem.grid().clone();
    let mut holes = Vec::new();
    for series in window.iter() {
        let channel = series.channel();
        if grid.column(channel).is_some() {
            continue;
        }
        let hold = ChannelKind::of_name(channel).map_or(series.hold(), |kind| kind.hold);
        match window.column_on(&grid, channel, hold, DEFAULT_MAX_GAP_STEPS) {
            // Small holes hold the last value, so that every effect is judged on the same samples.
            Some(column) if column.valid_share() >= LEAST_VALID => {
                grid = grid.with_column(
                    channel,
                    Column::complete(column.unit(), column.hold(), column.values().to_vec())?,
                )?;
            }
            _ => holes.push(channel.to_owned()),
        }
    }
    let grid = if grid.column(DROPS).is_none() { add_drops(grid, &output)? } else { grid };
    let grid = add_calendar(grid, site.zone.as_deref().unwrap_or("UTC"))?;
    Ok((grid, holes))
}
