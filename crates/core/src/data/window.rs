//! The measurements of one system over a stretch of time.

use super::duration::SECOND;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};

use super::series::{Series, SeriesStatistics};
use super::stamp::rfc3339;
use crate::fault::{Fault, nearest};
use std::collections::BTreeSet;
use utoipa::ToSchema;

/// Measurements of one system: a series per channel, each with its own times.
///
/// A window comes from a text ([`Window::parse_csv`], [`Window::parse_json`]), from stored blocks
/// ([`Window::from_series`]) or from other windows ([`Window::stitch`], [`Window::slice`]); nothing else
/// makes one. It has at least one channel.
#[derive(Debug, Clone, PartialEq)]
pub struct Window {
    series: IndexMap<String, Series>,
}

/// What was found while reading a window, for its sender.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
pub struct WindowReport {
    /// Rows that were taken.
    pub rows: usize,
    /// The time of the first row, RFC 3339 in UTC.
    pub from: String,
    /// The time of the last row, RFC 3339 in UTC.
    pub to: String,
    /// What can be said about each channel.
    pub channels: IndexMap<String, SeriesStatistics>,
    /// Rows that were left out, at most a hundred of them.
    pub rejected_rows: Vec<RejectedRow>,
    /// What else the sender should know, in sentences.
    pub warnings: Vec<String>,
}

/// A row that was left out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct RejectedRow {
    /// The line of a CSV text, or the row of a JSON window, counted from 1.
    pub line: u64,
    /// Why it was left out.
    pub reason: String,
}

impl WindowReport {
    /// The report of a window together with one that goes on with it: `whole` is both, and `more_rows` of the
    /// newer are behind the last of the earlier. What was left out, and what else is to be known, is told of
    /// the newer.
    pub fn going_on(&self, newer: WindowReport, whole: &Window, more_rows: usize) -> Self {
        let rows = self.rows + more_rows;
        let channels =
            whole.series.iter().map(|(name, series)| (name.clone(), series.statistics(rows))).collect();
        Self { rows, from: self.from.clone(), channels, ..newer }
    }

    /// The report of a window of which nothing was left out; a row is a time at which anything was measured.
    pub fn of(window: &Window) -> Self {
        let times: BTreeSet<&i64> = window.iter().flat_map(Series::times).collect();
        Self::new(window, times.len(), (window.from(), window.to()), Vec::new(), Vec::new())
    }

    pub(super) fn new(
        window: &Window,
        rows: usize,
        (from, to): (i64, i64),
        rejected_rows: Vec<RejectedRow>,
        warnings: Vec<String>,
    ) -> Self {
        let channels =
            window.series.iter().map(|(name, series)| (name.clone(), series.statistics(rows))).collect();
        Self { rows, from: rfc3339(from), to: rfc3339(to), channels, rejected_rows, warnings }
    }
}

impl Window {
    /// The window of these series, as decoded from stored blocks.
    ///
    /// # Errors
    /// A fault where there is no series, or a channel twice.
    pub fn from_series(all: Vec<Series>) -> Result<Window, Vec<Fault>> {
        if all.is_empty() {
            return Err(vec![Fault::new("/values", "no-data-column", "a window has at least one channel")]);
        }
        let mut series = IndexMap::with_capacity(all.len());
        let mut faults = Vec::new();
        for one in all {
            if let Some(twice) = series.insert(one.channel().to_owned(), one) {
                faults.push(Fault::new(
                    format!("/values/{}", twice.channel()),
                    "duplicate-column",
                    "a channel occurs twice",
                ));
            }
        }
        if faults.is_empty() { Ok(Window { series }) } else { Err(faults) }
    }

    /// The series of a channel, if the window has it.
    pub fn series(&self, channel: &str) -> Option<&Series> {
        self.series.get(channel)
    }

    /// The series of all channels, in the order of the columns.
    pub fn iter(&self) -> impl Iterator<Item = &Series> {
        self.series.values()
    }

    /// The names of all channels, in the order of the columns.
    pub fn channels(&self) -> impl Iterator<Item = &str> {
        self.series.keys().map(String::as_str)
    }

    /// The time of the first sample of any channel.
    pub fn from(&self) -> i64 {
        self.series.values().map(Series::from).min().unwrap_or_default()
    }

    /// The time of the last sample of any channel.
    pub fn to(&self) -> i64 {
        self.series.values().map(Series::to).max().unwrap_or_default()
    }

    /// The series of a channel that must be there.
    ///
    /// # Errors
    /// A fault that lists the channels there are and suggests the one that was probably meant.
    pub fn require(&self, channel: &str) -> Result<&Series, Fault> {
        self.series.get(channel).ok_or_else(|| {
            let there: Vec<&str> = self.channels().take(50).collect();
            let detail = format!("there is no channel `{channel}`; there are {}", there.join(", "));
            let fault = Fault::new(format!("/channels/{channel}"), "missing-channel", detail);
            match nearest(channel, self.channels()) {
                Some(near) => fault.suggest(format!("bind it: {channel}={near}")),
                None => fault.suggest(format!("bind it to a column: {channel}=<column>")),
            }
        })
    }

    /// The part from `from` to `to`, both included; channels without a sample there are left out.
    ///
    /// # Errors
    /// A fault where no channel has a sample there.
    pub fn slice(&self, from: i64, to: i64) -> Result<Window, Vec<Fault>> {
        let series: IndexMap<String, Series> = self
            .series
            .iter()
            .filter_map(|(name, series)| Some((name.clone(), series.slice(from, to)?)))
            .collect();
        if series.is_empty() {
            let detail = format!("no data from {} to {}", rfc3339(from), rfc3339(to));
            let there = format!("there are data from {} to {}", rfc3339(self.from()), rfc3339(self.to()));
            return Err(vec![Fault::new("/window", "no-data-in-range", detail).suggest(there)]);
        }
        Ok(Window { series })
    }

    /// One window from several, of which the last is the newest: where two have a sample of a channel at the
    /// same time, the newer one's counts.
    ///
    /// Unit and hold of a channel are the newest one's.
    ///
    /// # Errors
    /// Faults where there is no window, or where an older window has a channel in a unit that does not
    /// convert.
    pub fn stitch(windows: &[Window]) -> Result<Window, Vec<Fault>> {
        let mut by_channel: IndexMap<&str, Vec<&Series>> = IndexMap::new();
        for one in windows.iter().flat_map(Window::iter) {
            by_channel.entry(one.channel()).or_default().push(one);
        }
        let mut series = IndexMap::with_capacity(by_channel.len());
        let mut faults = Vec::new();
        for (channel, oldest_first) in by_channel {
            match merge(&oldest_first) {
                Ok(merged) => drop(series.insert(channel.to_owned(), merged)),
                Err(fault) => faults.push(fault),
            }
        }
        if series.is_empty() {
            faults.push(Fault::new("/window", "no-data-in-range", "there are no measurements"));
        }
        if faults.is_empty() { Ok(Window { series }) } else { Err(faults) }
    }

    /// A hash of the content: channels with their units, holds and samples, whatever the order of the
    /// columns.
    ///
    /// 64 hexadecimal digits. Two texts that mean the same measurements have the same hash.
    pub fn content_hash(&self) -> String {
        let mut sorted: Vec<&Series> = self.series.values().collect();
        sorted.sort_by_key(|series| series.channel());
        let mut hasher = blake3::Hasher::new();
        for series in sorted {
            for text in [series.channel(), series.unit()] {
                // The length in front keeps `ab`,`c` apart from `a`,`bc`.
                hasher.update(&(text.len() as u64).to_le_bytes()).update(text.as_bytes());
            }
            hasher.update(&[series.hold() as u8]).update(&(series.len() as u64).to_le_bytes());
            // Whole seconds have the hash that they had before there were others.
            let unit_of_time = if series.has_whole_seconds() { SECOND } else { 1 };
            if unit_of_time == 1 {
                hasher.update(b"ms");
            }
            for time in series.times() {
                hasher.update(&(time / unit_of_time).to_le_bytes());
            }
            for value in series.values() {
                hasher.update(&value.to_bits().to_le_bytes());
            }
        }
        hasher.finalize().to_hex().to_string()
    }
}

/// The samples of all series of one channel, of which the last is the newest and counts at equal times.
pub(super) fn merge(oldest_first: &[&Series]) -> Result<Series, Fault> {
    let (newest, older) = match oldest_first {
        [only] => return Ok((*only).clone()),
        [older @ .., newest] => (*newest, older),
        [] => {
            return Err(Fault::new("/values", "no-data-column", "a channel has at least one series"));
        }
    };
    let mut samples: Vec<(i64, f64)> = Vec::new();
    for one in older {
        let converted = one.in_unit(newest.unit()).ok_or_else(|| {
            let detail = format!(
                "`{}` is in {} in an older window and in {} in a newer one",
                newest.channel(),
                one.unit(),
                newest.unit()
            );
            Fault::new(format!("/values/{}", newest.channel()), "unit-conflict", detail)
        })?;
        samples.extend(converted.times().iter().copied().zip(converted.values().iter().copied()));
    }
    samples.extend(newest.times().iter().copied().zip(newest.values().iter().copied()));
    // The sort is stable, so that equal times stay in the order of the windows; one sort for all keeps a year
    // of small uploads from costing its square.
    samples.sort_by_key(|(time, _)| *time);
    let mut times: Vec<i64> = Vec::with_capacity(samples.len());
    let mut values: Vec<f64> = Vec::with_capacity(samples.len());
    for (time, value) in samples {
        if times.last() == Some(&time) {
            times.pop();
            values.pop();
        }
        times.push(time);
        values.push(value);
    }
    Series::new(newest.channel(), newest.unit(), newest.hold(), times, values)
}
