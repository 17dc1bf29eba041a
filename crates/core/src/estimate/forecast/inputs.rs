//! What drives the hours to come: inputs that a request gives, and forecasts of them that were kept.

use crate::data::{Column, Grid, Series, Window};
use crate::fault::Fault;

/// The inputs of the hours to come.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct InputsToCome(Vec<InputToCome>);

/// An input of the hours to come.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct InputToCome {
    pub series: Series,
    /// From this instant on it counts, in milliseconds; what was measured counts before.
    pub since: i64,
}

impl InputsToCome {
    /// Inputs that are given for the purpose: each counts from its first sample on, whatever was measured.
    pub fn given(window: &Window) -> Self {
        let since = |series: &Series| InputToCome { series: series.clone(), since: series.from() };
        Self(window.iter().map(since).collect())
    }

    /// The same with what was forecast of channels that these do not have: each counts behind the last
    /// measurement of its channel, so that what was measured counts as far as it reaches.
    #[must_use]
    pub fn or(mut self, forecast: &Window, measured: &Window) -> Self {
        let absent = forecast.iter().filter(|series| self.of(series.channel()).is_none());
        let kept = absent.filter_map(|series| {
            let since = measured.series(series.channel()).map_or(series.from(), |known| known.to() + 1);
            (since <= series.to()).then(|| InputToCome { series: series.clone(), since })
        });
        let kept: Vec<InputToCome> = kept.collect();
        self.0.extend(kept);
        self
    }

    /// Whether there is one of a channel.
    pub fn has(&self, channel: &str) -> bool {
        self.of(channel).is_some()
    }

    pub(super) fn of(&self, channel: &str) -> Option<&InputToCome> {
        self.0.iter().find(|input| input.series.channel() == channel)
    }

    fn iter(&self) -> impl Iterator<Item = &InputToCome> {
        self.0.iter()
    }

    /// A grid with these inputs as each goes by itself, from where it counts on. They have no gaps: weather
    /// services speak by the hour of tomorrow, and by six of next week. Inputs without a column are left out.
    ///
    /// # Errors
    /// A fault where a value is not finite.
    pub fn laid_on(&self, mut grid: Grid) -> Result<Grid, Fault> {
        for InputToCome { series, since } in self.iter() {
            let channel = series.channel();
            let alone = Window::from_series(vec![series.clone()]).ok();
            let Some(before) = grid.column(channel) else { continue };
            let Some(alone) =
                alone.and_then(|alone| alone.column_on(&grid, channel, before.hold(), u32::MAX))
            else {
                continue;
            };
            let (mut values, mut valid) = (before.values().to_vec(), before.valid().to_vec());
            for k in (0..grid.len()).filter(|k| grid.time(*k) >= *since && alone.valid()[*k]) {
                (values[k], valid[k]) = (alone.values()[k], true);
            }
            let column = Column::new(before.unit(), before.hold(), values, valid)?;
            grid = grid.with_column(channel, column)?;
        }
        Ok(grid)
    }

    /// What was measured, and what counts behind it, as one window.
    pub(super) fn behind(&self, measured: Window) -> Result<Window, Vec<Fault>> {
        let counts = |input: &InputToCome| input.series.slice(input.since, i64::MAX);
        let later: Vec<Series> = self.iter().filter_map(counts).collect();
        if later.is_empty() {
            return Ok(measured);
        }
        Window::stitch(&[measured, Window::from_series(later)?])
    }
}
