//! The rules for rows and cells: which row is rejected, what is only missing, and what makes a whole window a
//! fault.
//!
//! CSV and JSON both end here, row by row. A cell that is no number is a missing one; a row without a time of
//! its own is left out. Rubbish that repeats (more than a tenth of the rows or of a column, a unit that
//! cannot be meant, stamps without offset) means that the window as a whole was misunderstood, and then every
//! kind of fault is reported at once.

use indexmap::IndexMap;

use super::channel::canonical_unit;
use super::header::Target;
use super::series::Series;
use super::stamp::{BadStamp, in_utc, read_stamp};
use super::window::{RejectedRow, Window, WindowReport};
use crate::fault::{Fault, shown};

/// Rejected rows that a report lists one by one.
const MAX_LISTED: usize = 100;
/// The share of rejected rows, or of odd or implausible cells of a channel, that a window survives.
const MAX_REJECTED_SHARE: f64 = 0.1;
/// What loggers write where they have no value, in any case.
const NO_VALUE: [&str; 9] = ["null", "nan", "n/a", "na", "none", "-", "--", "unavailable", "unknown"];

/// What stands in a cell.
pub(super) enum Cell<'a> {
    /// Nothing, or `null`.
    Missing,
    /// A number, finite or not.
    Number(f64),
    /// Anything else.
    Text(&'a str),
}

impl<'a> Cell<'a> {
    /// Reads a cell of a text file.
    pub fn of_text(text: &'a str) -> Self {
        let trimmed = text.trim();
        if is_no_value(trimmed) {
            return Cell::Missing;
        }
        trimmed.parse().map_or(Cell::Text(trimmed), Cell::Number)
    }

    /// Whether nothing stands there.
    pub fn is_missing(&self) -> bool {
        matches!(self, Cell::Missing)
    }
}

/// Whether a text says that there is no value.
pub(super) fn is_no_value(text: &str) -> bool {
    text.is_empty() || NO_VALUE.iter().any(|word| text.eq_ignore_ascii_case(word))
}

/// What stands in the time cell.
pub(super) enum Stamp<'a> {
    /// A text, to be read as RFC 3339.
    Text(&'a str),
    /// A bare number.
    Number,
    /// Nothing.
    Missing,
}

/// How a fault names a place.
#[derive(Clone, Copy)]
pub(super) enum Place {
    /// `line 12` and `column T_room` of a text file.
    Text,
    /// `/time/11` and `/values/T_room` of a JSON window.
    Json,
}

impl Place {
    fn as_str(self) -> &'static str {
        match self {
            Place::Text => "line",
            Place::Json => "row",
        }
    }

    /// A row as a whole.
    fn row(self, line: u64) -> String {
        match self {
            Place::Text => format!("line {line}"),
            Place::Json => format!("/time/{}", line - 1),
        }
    }

    /// A column by its header.
    pub fn column(self, name: &str) -> String {
        match self {
            Place::Text => format!("column {}", shown(name)),
            Place::Json => format!("/values/{}", shown(name).replace('~', "~0").replace('/', "~1")),
        }
    }
}

/// The first of several like faults, and how many there are.
#[derive(Default)]
struct Tally {
    count: usize,
    line: u64,
    example: String,
}

impl Tally {
    fn add(&mut self, line: u64, example: &str) {
        if self.count == 0 {
            self.line = line;
            self.example = shown(example);
        }
        self.count += 1;
    }
}

/// The present values of one column, as written, with the rows in which they stand, and the cells that are no
/// numbers.
#[derive(Default)]
pub(super) struct RawColumn {
    /// The row of each value, increasing.
    pub rows: Vec<u32>,
    /// The values.
    pub values: Vec<f64>,
    odd: Tally,
}

impl RawColumn {
    /// How many cells are no numbers.
    pub fn odd(&self) -> usize {
        self.odd.count
    }

    /// Takes the cell of a row.
    pub fn take(&mut self, row: usize, line: u64, cell: Cell<'_>) {
        match cell {
            Cell::Missing => {}
            Cell::Number(number) if number.is_finite() => {
                self.rows.push(row as u32);
                self.values.push(number);
            }
            Cell::Number(number) => self.odd.add(line, &number.to_string()),
            Cell::Text(text) => self.odd.add(line, text),
        }
    }
}

/// Whether a time may stand below the last one.
///
/// # Errors
/// Why its row is left out.
pub(super) fn order(last: Option<i64>, time: i64) -> Result<(), &'static str> {
    match last {
        Some(last) if last == time => Err("the time is the same as that of the row before"),
        Some(last) if last > time => Err("the time goes backwards"),
        _ => Ok(()),
    }
}

/// Whether so many cells of a column are a slip, and not another way of writing: one alone always is, also
/// in a row that comes alone.
fn is_slip(odd: usize, all: usize) -> bool {
    odd <= 1 || odd as f64 <= MAX_REJECTED_SHARE * all as f64
}

/// Rows on their way to a window.
pub(super) struct Table {
    names: Vec<String>,
    targets: Vec<Target>,
    columns: Vec<RawColumn>,
    times: Vec<i64>,
    lines: Vec<u64>,
    seen: usize,
    rejected: Vec<RejectedRow>,
    reasons: IndexMap<String, Tally>,
    naive: Tally,
    numeric: Tally,
    place: Place,
    warnings: Vec<String>,
}

impl Table {
    /// An empty table whose data columns have these names and feed these channels.
    pub fn new(names: Vec<String>, targets: Vec<Target>, place: Place, warnings: Vec<String>) -> Self {
        let columns = names.iter().map(|_| RawColumn::default()).collect();
        Self {
            names,
            targets,
            columns,
            times: Vec::new(),
            lines: Vec::new(),
            seen: 0,
            rejected: Vec::new(),
            reasons: IndexMap::new(),
            naive: Tally::default(),
            numeric: Tally::default(),
            place,
            warnings,
        }
    }

    /// Takes a row, or notes why not.
    pub fn push<'a>(&mut self, line: u64, stamp: Stamp<'_>, cells: impl Iterator<Item = Cell<'a>>) {
        self.seen += 1;
        let (read, text) = match stamp {
            Stamp::Text(text) => (read_stamp(text), text),
            Stamp::Number => (Err(BadStamp::Number), ""),
            Stamp::Missing => (Err(BadStamp::Unreadable), ""),
        };
        let time = match read {
            Ok(time) => time,
            Err(bad) => {
                match bad {
                    BadStamp::Naive => self.naive.add(line, text),
                    BadStamp::Number => self.numeric.add(line, text),
                    BadStamp::OutOfRange | BadStamp::Unreadable => {}
                }
                return self.note(line, bad.reason().to_owned());
            }
        };
        if let Err(reason) = order(self.times.last().copied(), time) {
            return self.note(line, reason.to_owned());
        }
        let row = self.times.len();
        for (column, cell) in self.columns.iter_mut().zip(cells) {
            column.take(row, line, cell);
        }
        self.times.push(time);
        self.lines.push(line);
    }

    /// Notes a row that never had the right number of cells.
    pub fn reject(&mut self, line: u64, reason: String) {
        self.seen += 1;
        self.note(line, reason);
    }

    fn note(&mut self, line: u64, reason: String) {
        if self.rejected.len() < MAX_LISTED {
            self.rejected.push(RejectedRow { line, reason: reason.clone() });
        }
        self.reasons.entry(reason).or_default().add(line, "");
    }

    /// Cells that are no numbers: a few are missing values, and more mean another way of writing numbers.
    fn odd_cells(&mut self, faults: &mut Vec<Fault>) {
        for (name, column) in self.names.iter().zip(&self.columns).filter(|(_, column)| column.odd.count > 0)
        {
            let (odd, all) = (&column.odd, column.odd.count + column.values.len());
            let place = format!("the first in {} {}: `{}`", self.place.as_str(), odd.line, odd.example);
            if is_slip(odd.count, all) {
                let what = format!("`{}`: {} cells that are no numbers left out", shown(name), odd.count);
                self.warnings.push(format!("{what}, {place}"));
                continue;
            }
            let detail = format!("{} of {all} cells of `{}` are no numbers, {place}", odd.count, shown(name));
            let fault = Fault::new(self.place.column(name), "not-numbers", detail);
            faults.push(match odd.example.replace(',', ".").parse::<f64>() {
                Ok(_) => fault.suggest("write decimals with a point: 21.5"),
                Err(_) => fault.suggest("leave cells empty where there is no value, or remove the column"),
            });
        }
    }

    /// The window of the rows that were taken, with its report.
    ///
    /// # Errors
    /// Every kind of fault that the rows and the channels show, behind those that the header has shown.
    pub fn finish(mut self, mut faults: Vec<Fault>) -> Result<(Window, WindowReport), Vec<Fault>> {
        faults.extend(self.row_faults());
        self.odd_cells(&mut faults);
        if self.times.is_empty() && faults.is_empty() {
            faults.push(Fault::new("rows", "no-valid-rows", "there is no valid row"));
        }
        let mut series = Vec::new();
        for target in &self.targets {
            let (name, column) = (&self.names[target.column], &self.columns[target.column]);
            match channel_series(
                target,
                name,
                column,
                &self.times,
                &self.lines,
                self.place,
                &mut self.warnings,
            ) {
                Ok(Some(found)) => series.push(found),
                Ok(None) => {
                    self.warnings.push(format!("`{}` has no values and was left out", shown(&target.channel)))
                }
                Err(fault) => faults.push(fault),
            }
        }
        if faults.is_empty() && series.is_empty() {
            faults.push(Fault::new("rows", "no-valid-rows", "no cell of any row holds a value"));
        }
        if !faults.is_empty() {
            return Err(faults);
        }
        let rejected: usize = self.reasons.values().map(|tally| tally.count).sum();
        if rejected > self.rejected.len() {
            self.warnings
                .push(format!("{rejected} rows were rejected; the first {} are listed", self.rejected.len()));
        }
        let rows = self.times.len();
        let window = Window::from_series(series)?;
        let report = WindowReport::new(
            &window,
            rows,
            (self.times[0], self.times[rows - 1]),
            self.rejected,
            self.warnings,
        );
        Ok((window, report))
    }

    /// What the rows as a whole do wrong.
    fn row_faults(&self) -> Vec<Fault> {
        let mut faults = Vec::new();
        let at = |tally: &Tally| self.place.row(tally.line);
        if self.naive.count > 0 {
            let detail = format!(
                "{} times have no offset: `{}` could mean many instants",
                self.naive.count, self.naive.example
            );
            faults.push(Fault::new(at(&self.naive), "naive-time", detail).suggest(format!(
                "append the offset of the clock that wrote them, `Z` for UTC: {}",
                in_utc(&self.naive.example)
            )));
        }
        if self.numeric.count > 0 {
            let detail = format!("{} times are bare numbers, not RFC 3339 times", self.numeric.count);
            faults.push(
                Fault::new(at(&self.numeric), "numeric-time", detail)
                    .suggest("write times like 2026-01-31T12:00:00Z"),
            );
        }
        let rejected: usize = self.reasons.values().map(|tally| tally.count).sum();
        if rejected as f64 > MAX_REJECTED_SHARE * self.seen as f64 {
            let mut reasons: Vec<(&String, &Tally)> = self.reasons.iter().collect();
            reasons.sort_by_key(|(_, tally)| std::cmp::Reverse(tally.count));
            for (reason, tally) in reasons.into_iter().take(MAX_LISTED - faults.len()) {
                if matches!(
                    reason.as_str(),
                    naive if naive == BadStamp::Naive.reason() || naive == BadStamp::Number.reason()
                ) {
                    continue;
                }
                let detail = format!("{} of {} rows rejected: {reason}", tally.count, self.seen);
                faults.push(Fault::new(at(tally), "rejected-rows", detail));
            }
        }
        faults
    }
}

/// The series of one channel, without implausible cells; `None` where no value remains.
fn channel_series(
    target: &Target,
    name: &str,
    column: &RawColumn,
    all_times: &[i64],
    lines: &[u64],
    place: Place,
    warnings: &mut Vec<String>,
) -> Result<Option<Series>, Fault> {
    let word = place.as_str();
    let convert = |raw: f64| target.from.convert(&target.to, raw).filter(|value| value.is_finite());
    let mut times = Vec::with_capacity(column.rows.len());
    let mut values = Vec::with_capacity(column.rows.len());
    let mut outside = Tally::default();
    for (row, raw) in column.rows.iter().zip(&column.values) {
        match convert(*raw) {
            Some(value) if target.kind.is_plausible(value) => {
                times.push(all_times[*row as usize]);
                values.push(value);
            }
            _ => outside.add(lines[*row as usize], &format!("{raw}")),
        }
    }
    if outside.count > 0 {
        let (low, high) = target.kind.plausible;
        let range = format!("{low} to {high} {}", target.kind.unit);
        // Zero is the same in watts and kilowatts: only the other values can tell which unit was meant.
        let telling = |value: &&f64| **value != 0.0;
        let told = column.values.iter().filter(telling).count().max(1);
        if !is_slip(outside.count, told) {
            let detail = format!(
                "{} of {} values of `{}` are outside {range}, such as {} in {word} {}",
                outside.count,
                column.values.len(),
                shown(&target.channel),
                outside.example,
                outside.line
            );
            let fault = Fault::new(place.column(name), "implausible-values", detail);
            let meant = target.kind.unit_that_explains(&target.channel, &column.values);
            return Err(match meant.filter(|unit| *unit != canonical_unit(&target.from_text)) {
                Some(unit) => fault.suggest(format!(
                    "they look like {unit}: state the unit, {}[{unit}]",
                    shown(&target.channel)
                )),
                None => fault.suggest("check the unit and the sensor, or remove the column"),
            });
        }
        warnings.push(format!(
            "`{}`: {} values outside {range} left out, the first in {word} {}: {}",
            shown(&target.channel),
            outside.count,
            outside.line,
            outside.example
        ));
    }
    if times.is_empty() {
        return Ok(None);
    }
    if let Some(limit) = target.kind.usual_limit(&target.channel).filter(|_| target.assumed) {
        let highest = values.iter().copied().fold(0.0, |highest: f64, value| highest.max(value.abs()));
        let other = target.kind.mistaken_units().iter().find(|unit| **unit != target.kind.unit);
        if let Some(other) = other.filter(|_| highest > limit) {
            let (channel, unit) = (shown(&target.channel), &target.kind.unit);
            warnings.push(format!(
                "`{channel}` states no unit and is taken as {unit}, with values up to {highest} {unit}: if \
                they are {other}, state it as {channel}[{other}]"
            ));
        }
    }
    Series::new(&target.channel, &target.kind.unit, target.kind.hold, times, values).map(Some)
}
