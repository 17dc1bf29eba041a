//! From a window, in which every channel has its own times, to a grid, without inventing data across gaps.
//!
//! | channel | value at `t` | valid where |
//! |---|---|---|
//! | output | the sample nearest to `t`, never an interpolation | a sample lies within half a step |
//! | linear input | on the line between the samples before and after | those two are no gap apart |
//! | zero-order input, finer than the grid | time-weighted mean over `[t, t + step)` | at least half of the interval is covered |
//! | zero-order input, as coarse or coarser | the value held at `t` | the value still holds |
//!
//! Two samples have a gap between them when they are more than `max_gap_steps` steps apart, the channel's
//! own median step or the grid's, whichever is longer. A held value lasts until the next sample; before a
//! gap, and at the end of the record, it lasts for one such step.

use super::channel::{Hold, is_compass};
use super::duration::{MINUTE, SECOND};
use super::grid::{Column, Grid};
use super::seconds::Seconds;
use super::series::{Series, median_step};
use super::stamp::rfc3339;
use super::window::Window;
use crate::fault::Fault;

/// Gaps longer than this many steps stay gaps.
pub const DEFAULT_MAX_GAP_STEPS: u32 = 3;
/// The shortest step that is chosen when none is asked for.
const MIN_STEP: i64 = MINUTE;
/// Nearly four years of one-minute data; a longer grid is a slip of the pen.
const MAX_POINTS: i64 = 2_000_000;

/// What a grid is to hold.
#[derive(Debug, Clone, Copy)]
pub struct GridRequest<'a> {
    /// The measured output that sets the grid: its first sample in the range is index 0, its last sample
    /// ends it.
    pub output: &'a str,
    /// More outputs, for models that have several; like the first they are never interpolated.
    pub more_outputs: &'a [&'a str],
    /// The inputs, each with its hold.
    pub channels: &'a [(&'a str, Hold)],
    /// The step in milliseconds; the median step of the output in whole seconds, at least a minute, where it
    /// is not given.
    pub step: Option<i64>,
    /// The first time that may enter, in Unix milliseconds.
    pub from: Option<i64>,
    /// The last time that may enter, in Unix milliseconds, itself included.
    pub to: Option<i64>,
    /// Gaps longer than this many steps stay gaps.
    pub max_gap_steps: u32,
}

impl<'a> GridRequest<'a> {
    /// The whole record of one output with these inputs, at the output's own step.
    pub fn new(output: &'a str, channels: &'a [(&'a str, Hold)]) -> Self {
        Self {
            output,
            more_outputs: &[],
            channels,
            step: None,
            from: None,
            to: None,
            max_gap_steps: DEFAULT_MAX_GAP_STEPS,
        }
    }
}

impl Window {
    /// The output and the inputs on one grid, by the rules at the head of this file.
    ///
    /// # Errors
    /// A fault for every channel that is missing or has no value in the range, for a range without two
    /// samples of the output, and for a step that is not positive or too short for the range.
    pub fn grid(&self, request: &GridRequest<'_>) -> Result<Grid, Vec<Fault>> {
        let mut faults = self.absent(request);
        let frame = self
            .require(request.output)
            .map_err(|_| Vec::new())
            .and_then(|output| frame(output, request).map_err(|fault| vec![fault]));
        match frame {
            Ok(frame) if faults.is_empty() => self.fill(frame, request),
            other => {
                faults.extend(other.err().into_iter().flatten());
                Err(faults)
            }
        }
    }

    /// The output and the inputs on points that are given, by the same rules. What the request says of step
    /// and range does not matter: a fit that is looked at again needs the very points that it was made on.
    ///
    /// # Errors
    /// A fault for every channel that is missing or has no value on these points.
    pub fn grid_on(&self, frame: Grid, request: &GridRequest<'_>) -> Result<Grid, Vec<Fault>> {
        let faults = self.absent(request);
        if faults.is_empty() { self.fill(frame, request) } else { Err(faults) }
    }

    /// A fault for every channel that is missing.
    fn absent(&self, request: &GridRequest<'_>) -> Vec<Fault> {
        let wanted =
            request.more_outputs.iter().copied().chain(request.channels.iter().map(|(name, _)| *name));
        std::iter::once(request.output)
            .chain(wanted)
            .filter_map(|channel| self.require(channel).err())
            .collect()
    }

    /// Puts the columns on an empty grid.
    fn fill(&self, mut grid: Grid, request: &GridRequest<'_>) -> Result<Grid, Vec<Fault>> {
        let mut faults = Vec::new();
        let outputs = std::iter::once(&request.output).chain(request.more_outputs);
        let outputs = outputs.map(|name| (*name, None));
        let inputs = request.channels.iter().map(|(name, hold)| (*name, Some(*hold)));
        for (name, hold) in outputs.chain(inputs) {
            // An output that a model also reads as an input keeps the strict rule.
            if grid.column(name).is_some() {
                continue;
            }
            let Some(series) = self.series(name) else {
                continue;
            };
            let found = match hold {
                None => nearest_samples(series, &grid),
                Some(Hold::Linear) => interpolated(series, &grid, request.max_gap_steps),
                Some(Hold::ZeroOrder) => held(series, &grid, request.max_gap_steps),
            };
            match Column::from_options(series.unit(), hold.unwrap_or(series.hold()), &found) {
                Some(column) => grid = grid.with_column(name, column).map_err(|fault| vec![fault])?,
                None => {
                    let last = grid.time(grid.len().saturating_sub(1));
                    let detail =
                        format!("`{name}` has no value from {} to {}", rfc3339(grid.start()), rfc3339(last));
                    let there =
                        format!("it has samples from {} to {}", rfc3339(series.from()), rfc3339(series.to()));
                    faults.push(
                        Fault::new(format!("/channels/{name}"), "no-data-in-range", detail).suggest(there),
                    );
                }
            }
        }
        if faults.is_empty() { Ok(grid) } else { Err(faults) }
    }
}

impl Window {
    /// One more channel on a grid that is there, by the rules at the head of this file, where gaps longer
    /// than so many steps stay gaps; `None` where it has no value.
    pub fn column_on(&self, grid: &Grid, channel: &str, hold: Hold, max_gap_steps: u32) -> Option<Column> {
        let series = self.series(channel)?;
        let found = match hold {
            Hold::Linear => interpolated(series, grid, max_gap_steps),
            Hold::ZeroOrder => held(series, grid, max_gap_steps),
        };
        Column::from_options(series.unit(), hold, &found)
    }
}

/// The empty grid under the samples of the output that lie in the range.
fn frame(output: &Series, request: &GridRequest<'_>) -> Result<Grid, Fault> {
    let first = output.times().partition_point(|time| request.from.is_some_and(|from| *time < from));
    let end = output.times().partition_point(|time| request.to.is_none_or(|to| *time <= to));
    let times = output.times().get(first..end).unwrap_or_default();
    let Some(own_step) = median_step(times) else {
        let detail =
            format!("`{}` has {} samples in the range; a grid needs two", request.output, times.len());
        let there = format!("it has samples from {} to {}", rfc3339(output.from()), rfc3339(output.to()));
        return Err(Fault::new("/window", "no-data-in-range", detail).suggest(there));
    };
    // A logger that polls every minute stamps some milliseconds late, now more, now less.
    let step = request.step.unwrap_or(((own_step + SECOND / 2) / SECOND * SECOND).max(MIN_STEP));
    if step <= 0 {
        return Err(Fault::new("/step", "bad-step", "a grid needs a positive step"));
    }
    let start = if step >= MIN_STEP { times[0].div_euclid(SECOND) * SECOND } else { times[0] };
    let points = (times[times.len() - 1] - start) / step + 1;
    if points > MAX_POINTS {
        let step = Seconds::of_millis(step);
        let detail = format!("{points} points at a step of {step}; {MAX_POINTS} are the most");
        return Err(
            Fault::new("/step", "grid-too-long", detail).suggest("ask for a longer step or a shorter range")
        );
    }
    Grid::new(start, step, points as usize)
}

/// The samples nearest to the grid points, each within `[-step/2, step/2)` and hence used at most once.
fn nearest_samples(series: &Series, grid: &Grid) -> Vec<Option<f64>> {
    let (times, step) = (series.times(), grid.step());
    points(grid)
        .map(|t| {
            let next = times.partition_point(|time| *time < t);
            let after =
                times.get(next).map(|time| (time - t, next)).filter(|(distance, _)| 2 * distance < step);
            let before = next
                .checked_sub(1)
                .map(|index| (t - times[index], index))
                .filter(|(distance, _)| 2 * distance <= step);
            before.into_iter().chain(after).min().map(|(_, index)| series.values()[index])
        })
        .collect()
}

/// The values on the lines between samples that have no gap between them.
pub(super) fn interpolated(series: &Series, grid: &Grid, max_gap_steps: u32) -> Vec<Option<f64>> {
    let (times, values) = (series.times(), series.values());
    let limit = gap_limit(series, grid, max_gap_steps);
    let compass = is_compass(series.channel());
    points(grid)
        .map(|t| {
            let next = times.partition_point(|time| *time < t);
            if times.get(next) == Some(&t) {
                return Some(values[next]);
            }
            let previous = next.checked_sub(1)?;
            let span = times.get(next)? - times[previous];
            let weight = (t - times[previous]) as f64 / span as f64;
            let between = if compass {
                turn(values[previous], values[next], weight)
            } else {
                line(values[previous], values[next], weight)
            };
            (span <= limit).then_some(between)
        })
        .collect()
}

/// The held values, as means over the grid's intervals where the series is finer than the grid.
fn held(series: &Series, grid: &Grid, max_gap_steps: u32) -> Vec<Option<f64>> {
    let (times, values, step) = (series.times(), series.values(), grid.step());
    let own_step = series.median_step().unwrap_or(step);
    let limit = gap_limit(series, grid, max_gap_steps);
    // Until when the value of a sample holds.
    let end = |index: usize| match times.get(index + 1) {
        Some(next) if next - times[index] <= limit => *next,
        _ => times[index] + own_step.max(step),
    };
    if own_step >= step {
        return points(grid)
            .map(|t| {
                let index = times.partition_point(|time| *time <= t).checked_sub(1)?;
                (t < end(index)).then_some(values[index])
            })
            .collect();
    }
    points(grid)
        .map(|t| {
            let first = times.partition_point(|time| *time <= t).saturating_sub(1);
            let (mut covered, mut mean) = (0, 0.0);
            for index in first..times.len() {
                if times[index] >= t + step {
                    break;
                }
                let length = (end(index).min(t + step) - times[index].max(t)).max(0);
                covered += length;
                // A running mean stays within the range of the values, where a sum could overflow.
                if length > 0 {
                    mean = line(mean, values[index], length as f64 / covered as f64);
                }
            }
            (2 * covered >= step).then_some(mean)
        })
        .collect()
}

fn points(grid: &Grid) -> impl Iterator<Item = i64> {
    (0..grid.len()).map(|index| grid.time(index))
}

/// The longest distance of two samples, in milliseconds, that is no gap.
fn gap_limit(series: &Series, grid: &Grid, max_gap_steps: u32) -> i64 {
    let step = series.median_step().unwrap_or(0).max(grid.step());
    step.saturating_mul(i64::from(max_gap_steps))
}

/// The value at a share of the way, written so that it stays between the ends and never overflows.
fn line(from: f64, to: f64, weight: f64) -> f64 {
    from * (1.0 - weight) + to * weight
}

/// The bearing at a share of the shorter way round, in the range of the ends: from 350 to 10 leads through
/// 0, not 180.
fn turn(from: f64, to: f64, weight: f64) -> f64 {
    let way = (to - from + 180.0).rem_euclid(360.0) - 180.0;
    let bearing = from + way * weight;
    if (to - from).abs() <= 180.0 { bearing } else { bearing.rem_euclid(360.0) }
}
