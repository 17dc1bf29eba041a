//! What drives the hours to come: inputs that a request gives, and forecasts of them that were kept.

use crate::data::{Series, Window};
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

    pub(super) fn of(&self, channel: &str) -> Option<&InputToCome> {
        self.0.iter().find(|input| input.series.channel() == channel)
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &InputToCome> {
        self.0.iter()
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
