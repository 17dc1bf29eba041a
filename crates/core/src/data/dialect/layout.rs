//! Where in a text the header is, what separates its cells, and which columns are the time.

use super::dates::is_stamp;
use crate::data::csv_text::{CsvText, Rows, is_passed, is_time};
use crate::data::header::{ColumnHeader, ColumnUnit, MAX_COLUMNS, MAX_NAME, too_many, unit_text};
use crate::data::stamp::read_stamp;
use crate::data::table::is_no_value;
use crate::fault::Fault;
use csv::StringRecord;

/// Lines above the header that may say something else.
const MOST_ABOVE: usize = 50;
/// Rows that are looked at to tell a separator, and numbers.
const LOOKED_AT: usize = 500;
/// Rows that are like those behind them, where a program writes them.
const PLAIN_ROWS: usize = 20;
/// No header is longer.
const MOST_BYTES: usize = MAX_COLUMNS * MAX_NAME;
/// No time of the day is longer: `11:59:59.999`.
const LONGEST_CLOCK: usize = 12;
/// What separates cells, in the order in which a tie is decided: a comma may stand inside of numbers.
const SEPARATORS: [u8; 4] = *b";\t|,";
/// What columns of times are called, in a few languages.
const TIMES: [&str; 24] = [
    "time",
    "timestamp",
    "datetime",
    "date_time",
    "date time",
    "date/time",
    "date & time",
    "date",
    "datum",
    "zeit",
    "zeitstempel",
    "uhrzeit",
    "datum/zeit",
    "datum/uhrzeit",
    "datum und uhrzeit",
    "tijd",
    "tijdstip",
    "heure",
    "horodatage",
    "fecha",
    "hora",
    "data",
    "ora",
    "tid",
];

/// Which columns say when.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TimeColumns {
    /// One.
    One(usize),
    /// The day, and the time of the day.
    Two(usize, usize),
}

/// A text, taken apart.
#[derive(Debug)]
pub(super) struct TextTable<'a> {
    /// What separates its cells.
    pub separator: u8,
    /// The line of the header.
    pub header: u64,
    /// The names of the columns, with units of a line of their own.
    pub names: Vec<String>,
    /// The columns of times.
    pub times: TimeColumns,
    /// The line of the first row.
    pub first_row: u64,
    /// The first rows that have a cell for each name.
    sample: Vec<StringRecord>,
    /// The text below the header, and its line of units.
    below: &'a str,
    /// How many lines stand above that.
    above: u64,
}

impl<'a> TextTable<'a> {
    /// Takes a text apart; nothing where no line looks like a header with a column of times.
    ///
    /// # Errors
    /// Where the header has too many columns.
    pub fn of(text: &'a str) -> Result<Option<Self>, Fault> {
        let lines: Vec<Line<'_>> = first_lines(text);
        let Some((separator, at)) = separator(&lines) else { return Ok(None) };
        let head = cells(lines[at].text, separator);
        // One column is that of the times, or two are.
        too_many(head.len().saturating_sub(2))?;
        let mut names: Vec<String> = head.iter().map(|cell| cell.trim().to_owned()).collect();
        let mut last = at;
        if let Some(units) = lines.get(at + 1).and_then(|line| units(&cells(line.text, separator), &head)) {
            names = units;
            last = at + 1;
        }
        let below = &text[lines[last].end..];
        let above = lines[last].number;
        let mut rows = Rows::of(below, separator, above);
        let (mut first_row, mut sample) = (None, Vec::new());
        while let Some((line, record)) = rows.read().filter(|_| sample.len() < LOOKED_AT) {
            first_row = first_row.or(Some(line));
            if record.len() == names.len() {
                sample.push(record.clone());
            }
        }
        let Some((times, first_row)) = time_columns(&names, &sample).zip(first_row) else { return Ok(None) };
        let header = lines[at].number;
        Ok(Some(Self { separator, header, names, times, first_row, sample, below, above }))
    }

    /// Its rows, also those with too few cells or too many.
    pub fn rows(&self) -> Rows<'a> {
        Rows::of(self.below, self.separator, self.above)
    }

    /// The texts of the times, in the order of the rows.
    pub fn stamps(&self) -> Vec<String> {
        let mut stamps = Vec::new();
        let mut rows = self.rows();
        while let Some((_, row)) = rows.read() {
            if row.len() == self.names.len() {
                stamps.push(self.stamp(row));
            }
        }
        stamps
    }

    /// The text of the time of a row; empty where nothing says when.
    pub fn stamp(&self, row: &StringRecord) -> String {
        let cell = |column: usize| row.get(column).unwrap_or_default().trim();
        match self.times {
            TimeColumns::One(column) => cell(column).to_owned(),
            TimeColumns::Two(day, clock) => format!("{} {}", cell(day), cell(clock)).trim().to_owned(),
        }
    }

    /// Whether a column says when.
    pub fn is_time(&self, column: usize) -> bool {
        match self.times {
            TimeColumns::One(time) => column == time,
            TimeColumns::Two(day, clock) => column == day || column == clock,
        }
    }

    /// Cells of values, as many as tell how numbers are written.
    pub fn cells(&self) -> impl Iterator<Item = &str> {
        self.sample.iter().flat_map(|row| {
            row.iter().enumerate().filter(|(column, _)| !self.is_time(*column)).map(|(_, cell)| cell)
        })
    }
}

/// The separator and the line of the header of a text whose first rows the parser reads as they are.
///
/// # Errors
/// Where the header has too many columns.
pub(super) fn plain(text: &str) -> Result<Option<(char, u64)>, Fault> {
    let CsvText { separator, line, headers, times, mut rows } = CsvText::of(text)?;
    let Some(time) = times.first().copied().filter(|_| headers.len() > 1) else { return Ok(None) };
    // Commas in numbers may stand far below zeros and empty cells.
    if text.contains(if separator == b',' { '"' } else { ',' }) {
        return Ok(None);
    }
    let is_value = |cell: &str| is_no_value(cell.trim()) || cell.trim().parse::<f64>().is_ok();
    let mut count = 0;
    while let Some((_, row)) = rows.read().filter(|_| count < PLAIN_ROWS) {
        let mut cells = row.iter().enumerate();
        if !cells.all(|(column, cell)| if column == time { read_stamp(cell).is_ok() } else { is_value(cell) })
        {
            return Ok(None);
        }
        count += 1;
    }
    Ok((count > 0).then_some((char::from(separator), line)))
}

/// A line that says something.
struct Line<'a> {
    /// Its number.
    number: u64,
    /// What is looked at of it.
    text: &'a str,
    /// Where the next one begins.
    end: usize,
}

/// The first lines that say something.
fn first_lines(text: &str) -> Vec<Line<'_>> {
    let mut end = 0;
    let numbered = text.split_inclusive('\n').zip(1..).map(|(line, number)| {
        end += line.len();
        let line = line.trim_end_matches(['\r', '\n']);
        // What no header can have, and only costs time.
        let cut = line.char_indices().map(|(at, _)| at).find(|at| *at >= MOST_BYTES);
        Line { number, text: &line[..cut.unwrap_or(line.len())], end }
    });
    numbered.take(MOST_ABOVE + LOOKED_AT).filter(|line| !is_passed(line.text)).collect()
}

/// The cells of a line.
fn cells(line: &str, separator: u8) -> StringRecord {
    Rows::of(line, separator, 0).read().map(|(_, record)| record.clone()).unwrap_or_default()
}

/// What separates the cells of most lines, and which of them is the header.
fn separator(lines: &[Line<'_>]) -> Option<(u8, usize)> {
    let mut best: Option<(usize, u8, usize)> = None;
    for mark in SEPARATORS {
        let widths: Vec<usize> = lines.iter().map(|line| cells(line.text, mark).len()).collect();
        // The header has as many cells as the line below it, and so have nearly all that follow.
        let begins = |at: &usize| {
            let width = widths[*at];
            let below = &widths[at + 1..];
            width > 1 && below.first() == Some(&width) && {
                let same = below.iter().filter(|other| **other == width).count();
                same * 10 >= below.len() * 9
            }
        };
        let candidates: Vec<usize> = (0..widths.len().min(MOST_ABOVE)).filter(begins).collect();
        let Some(header) = header(lines, &candidates, mark) else { continue };
        if best.is_none_or(|(width, ..)| widths[header] > width) {
            best = Some((widths[header], mark, header));
        }
    }
    best.map(|(_, mark, header)| (mark, header))
}

/// The header among lines that have the width of one: no date stands in it, and a time in the line below it,
/// or below its line of units. Lines above it, such as `sep=;` and `Serial;123`, may have its width. Where
/// the first stamps cannot be read, the name of a column says that it is the header.
fn header(lines: &[Line<'_>], candidates: &[usize], mark: u8) -> Option<usize> {
    let row = |at: usize| lines.get(at).map(|line| cells(line.text, mark)).unwrap_or_default();
    let stamped = |row: &StringRecord| row.iter().take(MAX_COLUMNS).any(is_stamp);
    // A number that could be a time may be the name of a sensor.
    let is_date = |cell: &str| is_stamp(cell) && !cell.trim().bytes().all(|byte| byte.is_ascii_digit());
    let dated = |row: &StringRecord| row.iter().take(MAX_COLUMNS).any(is_date);
    let silent: Vec<(usize, StringRecord)> =
        candidates.iter().map(|at| (*at, row(*at))).filter(|(_, head)| !dated(head)).collect();
    let directly = |(at, head): &&(usize, StringRecord)| {
        let below = row(at + 1);
        stamped(&below) || units(&below, head).is_some() && stamped(&row(at + 2))
    };
    let names_time = |(_, head): &&(usize, StringRecord)| head.iter().take(MAX_COLUMNS).any(is_time_name);
    let soon =
        |(at, _): &&(usize, StringRecord)| (at + 1..=at + PLAIN_ROWS).any(|below| stamped(&row(below)));
    let found = silent.iter().find(|one| names_time(one) && directly(one));
    let found = found.or_else(|| silent.iter().find(|one| names_time(one) && soon(one)));
    found.or_else(|| silent.iter().find(directly)).map(|(at, _)| *at)
}

/// Whether a column of this name says when, in one of a few languages.
fn is_time_name(name: &str) -> bool {
    TIMES.contains(&ColumnHeader::parse(name).channel.to_lowercase().as_str())
}

/// The names with the units of the line below, where that line is one of units.
fn units(below: &StringRecord, names: &StringRecord) -> Option<Vec<String>> {
    let bare = |cell: &str| cell.trim().trim_matches(['[', ']', '(', ')']).to_owned();
    let is_unit = |cell: &str| {
        let unit = bare(cell);
        !is_no_value(&unit) && unit_text(&unit).is_some()
    };
    let filled = || below.iter().filter(|cell| !is_no_value(cell.trim()));
    let said = filled().filter(|cell| is_unit(cell)).count();
    if below.len() != names.len() || said * 2 <= filled().count() || filled().any(is_stamp) {
        return None;
    }
    let with = |(name, cell): (&str, &str)| {
        let name = name.trim();
        let is_silent = ColumnHeader::parse(name).unit == ColumnUnit::Unstated;
        if is_silent && is_unit(cell) { format!("{name}[{}]", bare(cell)) } else { name.to_owned() }
    };
    Some(names.iter().zip(below.iter()).map(with).collect())
}

/// The columns of times: by their names and cells, or the first where its cells are times.
fn time_columns(names: &[String], rows: &[StringRecord]) -> Option<TimeColumns> {
    let any = |column: usize, says: fn(&str) -> bool| {
        let texts = rows.iter().filter_map(|row| row.get(column)).map(str::trim);
        texts.filter(|text| !text.is_empty()).take(PLAIN_ROWS).any(says)
    };
    let is_day = |column: usize| any(column, |text| !text.contains(':') && is_stamp(text));
    let is_clock = |column: usize| any(column, is_clock);
    // A name alone says little: `data` is a date where the cells below it are.
    let says_when = |column: usize| any(column, is_stamp) || is_clock(column);
    let named: Vec<usize> =
        (0..names.len()).filter(|column| is_time_name(&names[*column]) && says_when(*column)).collect();
    match named[..] {
        [column] => Some(TimeColumns::One(column)),
        [one, other, ..] if is_day(one) && is_clock(other) => Some(TimeColumns::Two(one, other)),
        [one, other, ..] if is_clock(one) && is_day(other) => Some(TimeColumns::Two(other, one)),
        [first, ..] => {
            let plain = named.iter().copied().find(|column| is_time(&names[*column]));
            Some(TimeColumns::One(plain.unwrap_or(first)))
        }
        [] => any(0, is_stamp).then_some(TimeColumns::One(0)),
    }
}

/// Whether a text is a time of the day.
fn is_clock(text: &str) -> bool {
    let begins = text.starts_with(|letter: char| letter.is_ascii_digit());
    begins && text.contains(':') && text.len() <= LONGEST_CLOCK && !is_stamp(text)
}
