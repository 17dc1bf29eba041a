//! Columns on a common time grid: what a simulation reads.

use super::duration::HOUR;
use std::ops::Range;
use std::sync::Arc;

use indexmap::IndexMap;

use super::channel::{Hold, canonical_unit, goes_round};
use crate::fault::{Fault, nearest};

/// The values of one channel on a grid. Every value is finite; `valid` says which stand for a measurement.
///
/// At an invalid index stands the last valid value before it (or the first after, at the start), so that a
/// simulation can run on through a gap while no cost is counted there. Copies share the values.
#[derive(Debug, Clone, PartialEq)]
pub struct Column {
    unit: String,
    hold: Hold,
    values: Arc<[f64]>,
    valid: Arc<[bool]>,
}

impl Column {
    /// A column of these values, valid where `valid` says so.
    ///
    /// # Errors
    /// A fault where the lengths differ or a value is not finite.
    pub fn new(unit: &str, hold: Hold, values: Vec<f64>, valid: Vec<bool>) -> Result<Self, Fault> {
        if values.len() != valid.len() {
            let detail = format!("{} values with {} marks of validity", values.len(), valid.len());
            return Err(Fault::new("/column", "length-mismatch", detail));
        }
        if let Some(index) = values.iter().position(|value| !value.is_finite()) {
            return Err(Fault::new(
                "/column",
                "not-finite",
                format!("the value at index {index} is not finite"),
            ));
        }
        Ok(Self { unit: canonical_unit(unit).to_owned(), hold, values: values.into(), valid: valid.into() })
    }

    /// A column that is valid throughout.
    ///
    /// # Errors
    /// A fault where a value is not finite.
    pub fn complete(unit: &str, hold: Hold, values: Vec<f64>) -> Result<Self, Fault> {
        let valid = vec![true; values.len()];
        Self::new(unit, hold, values, valid)
    }

    /// A column from values that are there only at some indices; the others hold the last one, and are
    /// invalid.
    ///
    /// `None` where there is no value at all. Values must be finite.
    pub(super) fn from_options(unit: &str, hold: Hold, found: &[Option<f64>]) -> Option<Self> {
        let mut last = found.iter().copied().flatten().next()?;
        let values = found
            .iter()
            .map(|value| {
                last = value.unwrap_or(last);
                last
            })
            .collect();
        let valid = found.iter().map(Option::is_some).collect();
        Some(Self { unit: unit.to_owned(), hold, values, valid })
    }

    /// The unit of the values, as a unit text.
    pub fn unit(&self) -> &str {
        &self.unit
    }

    /// What the column is between two grid points. A zero-order value holds over the interval that its point
    /// starts.
    pub fn hold(&self) -> Hold {
        self.hold
    }

    /// The values, finite at every index.
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Which values stand for a measurement.
    pub fn valid(&self) -> &[bool] {
        &self.valid
    }

    /// Both, for whoever keeps them.
    pub fn shared(&self) -> (Arc<[f64]>, Arc<[bool]>) {
        (self.values.clone(), self.valid.clone())
    }

    /// The share of valid values, from 0 to 1; 0 for an empty column.
    pub fn valid_share(&self) -> f64 {
        share(self.valid.iter().copied(), self.valid.len())
    }

    fn slice(&self, range: Range<usize>) -> Self {
        Self {
            unit: self.unit.clone(),
            hold: self.hold,
            values: self.values[range.clone()].into(),
            valid: self.valid[range].into(),
        }
    }

    /// Every n-th point. A zero-order value becomes the mean over what its point now stands for, where it has
    /// one.
    fn every(&self, n: usize, has_mean: bool) -> Self {
        let is_mean = self.hold == Hold::ZeroOrder && has_mean;
        let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len() as f64;
        let value = |values: &[f64]| if is_mean { mean(values) } else { values[0] };
        let valid = |valid: &[bool]| if is_mean { valid.iter().all(|valid| *valid) } else { valid[0] };
        Self {
            unit: self.unit.clone(),
            hold: self.hold,
            values: self.values.chunks(n).map(value).collect(),
            valid: self.valid.chunks(n).map(valid).collect(),
        }
    }
}

/// Columns of equal length on equidistant times.
#[derive(Debug, Clone, PartialEq)]
pub struct Grid {
    start: i64,
    step: i64,
    len: usize,
    columns: IndexMap<String, Column>,
}

impl Grid {
    /// A grid without columns: `len` points from `start` (Unix milliseconds) every `step` milliseconds.
    ///
    /// # Errors
    /// A fault where the step is not positive or the grid leaves the range of times.
    pub fn new(start: i64, step: i64, len: usize) -> Result<Self, Fault> {
        if step <= 0 {
            return Err(Fault::new(
                "/step",
                "bad-step",
                format!("a grid needs a positive step, not {step} ms"),
            ));
        }
        let end = i64::try_from(len)
            .ok()
            .and_then(|len| len.checked_mul(step))
            .and_then(|length| length.checked_add(start));
        if end.is_none() {
            return Err(Fault::new(
                "/step",
                "grid-too-long",
                "the grid does not end within the range of times",
            ));
        }
        Ok(Self { start, step, len, columns: IndexMap::new() })
    }

    /// The time of index 0, in Unix milliseconds.
    pub fn start(&self) -> i64 {
        self.start
    }

    /// The distance of two points, in milliseconds.
    pub fn step(&self) -> i64 {
        self.step
    }

    /// The distance of two points, in hours.
    pub fn step_hours(&self) -> f64 {
        self.step as f64 / HOUR as f64
    }

    /// The number of points.
    pub fn len(&self) -> usize {
        self.len
    }

    /// Whether there is no point.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The time of an index, in Unix milliseconds. An index behind the end gives the time that it would have.
    pub fn time(&self, index: usize) -> i64 {
        // `new` has checked this product for every index of the grid.
        self.start.saturating_add(self.step.saturating_mul(index as i64))
    }

    /// The index whose interval `[t, t + step)` holds a time; `None` outside the grid.
    pub fn index_at(&self, time: i64) -> Option<usize> {
        let index = usize::try_from(time.checked_sub(self.start)?.div_euclid(self.step)).ok()?;
        (index < self.len).then_some(index)
    }

    /// A column by name.
    pub fn column(&self, name: &str) -> Option<&Column> {
        self.columns.get(name)
    }

    /// A column that must be there.
    ///
    /// # Errors
    /// A fault that lists the columns there are.
    pub fn require(&self, name: &str) -> Result<&Column, Fault> {
        self.columns.get(name).ok_or_else(|| missing(name, self.columns.keys().map(String::as_str)))
    }

    /// All columns with their names, in the order in which they were asked for.
    pub fn columns(&self) -> impl Iterator<Item = (&str, &Column)> {
        self.columns.iter().map(|(name, column)| (name.as_str(), column))
    }

    /// The grid with one more column, or with another in place of the one of that name.
    ///
    /// # Errors
    /// A fault where the column is not as long as the grid.
    pub fn with_column(mut self, name: &str, column: Column) -> Result<Self, Fault> {
        if column.values.len() != self.len {
            let detail = format!("{} values for a grid of {}", column.values.len(), self.len);
            return Err(Fault::new(format!("/columns/{name}"), "length-mismatch", detail));
        }
        self.columns.insert(name.to_owned(), column);
        Ok(self)
    }

    /// The part of the grid with these indices; what lies beyond the end is left out.
    #[must_use]
    pub fn slice(&self, range: Range<usize>) -> Grid {
        let end = range.end.min(self.len);
        let range = range.start.min(end)..end;
        Grid {
            start: self.time(range.start),
            step: self.step,
            len: range.len(),
            columns: self
                .columns
                .iter()
                .map(|(name, column)| (name.clone(), column.slice(range.clone())))
                .collect(),
        }
    }

    /// The grid of every n-th point: what holds from one to the next as the mean, and all else as it is at
    /// its points. Directions and the clock go round and have no mean.
    #[must_use]
    pub fn every(&self, n: usize) -> Grid {
        let n = n.max(1);
        let coarser = |(name, column): (&String, &Column)| (name.clone(), column.every(n, !goes_round(name)));
        Grid {
            start: self.start,
            step: self.step.saturating_mul(i64::try_from(n).unwrap_or(i64::MAX)),
            len: self.len.div_ceil(n),
            columns: self.columns.iter().map(coarser).collect(),
        }
    }

    /// At which indices every column is valid.
    pub fn all_valid(&self) -> Vec<bool> {
        (0..self.len).map(|index| self.columns.values().all(|column| column.valid[index])).collect()
    }

    /// The share of indices at which every column is valid, from 0 to 1; 0 for an empty grid.
    pub fn valid_share(&self) -> f64 {
        share(self.all_valid().into_iter(), self.len)
    }
}

/// The fault of a name that is not there, with those that are.
fn missing<'a>(name: &str, there: impl Iterator<Item = &'a str> + Clone) -> Fault {
    let list: Vec<&str> = there.clone().take(50).collect();
    let detail = format!("there is no column `{name}`; there are {}", list.join(", "));
    let fault = Fault::new(format!("/columns/{name}"), "missing-channel", detail);
    match nearest(name, there) {
        Some(near) => fault.suggest(format!("did you mean `{near}`?")),
        None => fault,
    }
}

fn share(marks: impl Iterator<Item = bool>, len: usize) -> f64 {
    if len == 0 { 0.0 } else { marks.filter(|valid| *valid).count() as f64 / len as f64 }
}

#[cfg(test)]
mod tests {
    use super::{Column, Grid};
    use crate::data::Hold;

    fn grid() -> Grid {
        let column =
            Column::new("degC", Hold::Linear, vec![1.0, 2.0, 2.0, 4.0], vec![true, true, false, true])
                .unwrap();
        Grid::new(1_000, 600, 4).unwrap().with_column("T_room", column).unwrap()
    }

    #[test]
    fn times_and_indices_agree() {
        let grid = grid();
        for index in 0..4 {
            assert_eq!(grid.index_at(grid.time(index)), Some(index));
            assert_eq!(grid.index_at(grid.time(index) + 599), Some(index));
        }
        assert_eq!((grid.index_at(999), grid.index_at(1_000 + 2_400)), (None, None));
        assert_eq!((grid.index_at(i64::MIN), grid.index_at(i64::MAX)), (None, None));
    }

    #[test]
    fn slices_keep_their_times() {
        let part = grid().slice(1..3);
        assert_eq!((part.start(), part.len()), (1_600, 2));
        assert_eq!(part.column("T_room").unwrap().values(), [2.0, 2.0]);
        assert_eq!(part.valid_share(), 0.5);
        assert!(grid().slice(3..99).len() == 1 && grid().slice(7..9).is_empty());
    }

    #[test]
    fn every_other_point_holds_what_was_between() {
        let power = Column::new("kW", Hold::ZeroOrder, vec![1.0, 2.0, 3.0, 5.0, 7.0], vec![true; 5]).unwrap();
        let room = Column::new("degC", Hold::Linear, vec![1.0, 2.0, 3.0, 4.0, 5.0], vec![true; 5]).unwrap();
        let wind =
            Column::new("deg", Hold::ZeroOrder, vec![359.0, 1.0, 2.0, 4.0, 5.0], vec![true; 5]).unwrap();
        let clock =
            Column::new("h", Hold::ZeroOrder, vec![23.75, 0.0, 0.25, 0.5, 0.75], vec![true; 5]).unwrap();
        let mut grid = Grid::new(1_000, 600, 5).unwrap();
        let columns = [("P_heat", power), ("T_room", room), ("wind_direction", wind), ("hour_of_day", clock)];
        for (name, column) in columns {
            grid = grid.with_column(name, column).unwrap();
        }
        let coarse = grid.every(2);
        let values = |name: &str| coarse.column(name).unwrap().values().to_vec();
        assert_eq!((coarse.start(), coarse.step(), coarse.len()), (1_000, 1_200, 3));
        assert_eq!(values("P_heat"), [1.5, 4.0, 7.0]);
        assert_eq!(values("T_room"), [1.0, 3.0, 5.0]);
        assert_eq!(values("wind_direction"), [359.0, 2.0, 5.0]);
        assert_eq!(values("hour_of_day"), [23.75, 0.25, 0.75]);
        // A mean of which a part is missing is none.
        assert_eq!(self::grid().every(3).column("T_room").unwrap().valid(), [true, true]);
        let holed = Column::new("kW", Hold::ZeroOrder, vec![1.0; 5], vec![true, false, true, true, true]);
        let holed = Grid::new(0, 600, 5).unwrap().with_column("P_heat", holed.unwrap()).unwrap().every(2);
        assert_eq!(holed.column("P_heat").unwrap().valid(), [false, true, true]);
    }

    #[test]
    fn only_sound_columns_enter() {
        assert!(Column::complete("-", Hold::Linear, vec![f64::NAN]).is_err());
        assert!(Column::new("-", Hold::Linear, vec![0.0], vec![]).is_err());
        assert!(grid().with_column("x", Column::complete("-", Hold::Linear, vec![0.0]).unwrap()).is_err());
        assert!(Grid::new(0, 0, 1).is_err() && Grid::new(0, i64::MAX, 2).is_err());
        let fault = grid().require("T_rom").unwrap_err();
        assert_eq!(fault.suggestion.as_deref(), Some("did you mean `T_room`?"));
    }

    #[test]
    fn what_is_missing_holds_the_last_value() {
        let column = Column::from_options("-", Hold::Linear, &[None, Some(1.0), None, Some(2.0)]).unwrap();
        assert_eq!(column.values(), [1.0, 1.0, 1.0, 2.0]);
        assert_eq!(column.valid(), [false, true, false, true]);
        assert!(Column::from_options("-", Hold::Linear, &[None]).is_none());
    }
}
