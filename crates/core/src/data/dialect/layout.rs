//! Where in a text the header is, what separates its cells, and which columns are the time.

use super::dates::is_stamp;
use crate::data::header::{ColumnHeader, ColumnUnit, unit_text};
use crate::data::stamp::read_stamp;
use crate::data::table::is_no_value;

/// Lines above the header that may say something else.
const MOST_ABOVE: usize = 50;
/// Rows that are looked at to tell a separator, and numbers.
const LOOKED_AT: usize = 500;
/// Rows that are like those behind them, where a program writes them.
const PLAIN_ROWS: usize = 20;
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
/// The names that the parser takes for the time.
const PLAIN_TIMES: [&str; 2] = ["time", "timestamp"];

/// Which columns say when.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum TimeColumns {
    /// One.
    One(usize),
    /// The day, and the time of the day.
    Two(usize, usize),
}

/// A row with the line on which it begins.
#[derive(Debug)]
pub(super) struct TextRow {
    pub line: u64,
    pub cells: Vec<String>,
}

/// A text, taken apart.
#[derive(Debug)]
pub(super) struct TextTable {
    /// What separates its cells.
    pub separator: u8,
    /// The line of the header.
    pub header: u64,
    /// The names of the columns, with units of a line of their own.
    pub names: Vec<String>,
    /// The columns of times.
    pub times: TimeColumns,
    /// The rows below.
    pub rows: Vec<TextRow>,
    /// The line of the first of them.
    pub first_row: u64,
}

impl TextTable {
    /// Takes a text apart; nothing where no line looks like a header with a column of times.
    pub fn of(text: &str) -> Option<Self> {
        let lines: Vec<&str> = text.lines().take(MOST_ABOVE + LOOKED_AT).collect();
        let (separator, skipped) = separator(&lines)?;
        let mut rows = text
            .lines()
            .enumerate()
            .skip(skipped)
            .filter(|(_, line)| !is_passed(line))
            .map(|(at, line)| TextRow { line: at as u64 + 1, cells: split(line, char::from(separator)) });
        let head = rows.next()?;
        let mut names: Vec<String> = head.cells.iter().map(|cell| cell.trim().to_owned()).collect();
        let mut rows: Vec<TextRow> = rows.collect();
        if let Some(units) = rows.first().and_then(|row| units(&row.cells, &names)) {
            names = units;
            rows.remove(0);
        }
        let times = time_columns(&names, &rows)?;
        let first_row = rows.first()?.line;
        Some(Self { separator, header: head.line, names, times, rows, first_row })
    }

    /// The texts of the times, in the order of the rows.
    pub fn stamps(&self) -> Vec<String> {
        self.rows.iter().map(|row| self.stamp(row)).collect()
    }

    /// The text of the time of a row.
    pub fn stamp(&self, row: &TextRow) -> String {
        let cell = |column: usize| row.cells.get(column).map(String::as_str).unwrap_or_default().trim();
        match self.times {
            TimeColumns::One(column) => cell(column).to_owned(),
            TimeColumns::Two(day, clock) => format!("{} {}", cell(day), cell(clock)),
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
    pub fn cells(&self) -> Vec<&str> {
        let mut cells = Vec::new();
        for row in self.rows.iter().take(LOOKED_AT) {
            let values = row.cells.iter().enumerate().filter(|(column, _)| !self.is_time(*column));
            cells.extend(values.map(|(_, cell)| cell.as_str()));
        }
        cells
    }
}

/// The separator and the line of the header of a text whose first rows the parser reads as they are.
pub(super) fn plain(text: &str) -> Option<(char, u64)> {
    let mut lines = text.lines().enumerate().filter(|(_, line)| !is_passed(line));
    let (at, header) = lines.next()?;
    let separator = [',', ';', '\t'].into_iter().find(|mark| header.contains(*mark))?;
    let is_time = |name: &str| PLAIN_TIMES.iter().any(|time| name.trim().eq_ignore_ascii_case(time));
    let time = header.split(separator).position(is_time)?;
    let is_value = |cell: &str| is_no_value(cell.trim()) || cell.trim().parse::<f64>().is_ok();
    let mut rows = lines.take(PLAIN_ROWS).peekable();
    rows.peek()?;
    let is_plain = rows.all(|(_, line)| {
        let mut cells = line.split(separator).enumerate();
        cells.all(|(column, cell)| if column == time { read_stamp(cell).is_ok() } else { is_value(cell) })
    });
    is_plain.then_some((separator, at as u64 + 1))
}

/// Whether a line says nothing.
fn is_passed(line: &str) -> bool {
    line.trim().is_empty() || line.starts_with('#')
}

/// What separates the cells of most lines, and how many lines stand above the first of those.
fn separator(lines: &[&str]) -> Option<(u8, usize)> {
    let mut best: Option<(usize, u8, usize)> = None;
    for mark in SEPARATORS {
        let count = |line: &&str| split(line, char::from(mark)).len();
        let kept: Vec<usize> = (0..lines.len()).filter(|at| !is_passed(lines[*at])).collect();
        let widths: Vec<usize> = kept.iter().map(|at| count(&lines[*at])).collect();
        // The header has as many cells as the line below it, and so have nearly all that follow.
        let begins = (0..widths.len().min(MOST_ABOVE)).find(|at| {
            let width = widths[*at];
            let below = &widths[at + 1..];
            width > 1 && below.first() == Some(&width) && {
                let same = below.iter().filter(|other| **other == width).count();
                same * 10 >= below.len() * 9
            }
        });
        let Some(begins) = begins else { continue };
        if best.is_none_or(|(width, ..)| widths[begins] > width) {
            best = Some((widths[begins], mark, kept[begins]));
        }
    }
    best.map(|(_, mark, skipped)| (mark, skipped))
}

/// The cells of a line; what stands in quotes is whole, and a quote in it is written twice.
fn split(line: &str, mark: char) -> Vec<String> {
    let mut cells = vec![String::new()];
    let mut quoted = false;
    let mut letters = line.chars().peekable();
    while let Some(letter) = letters.next() {
        let Some(cell) = cells.last_mut() else { break };
        match letter {
            '"' if quoted && letters.peek() == Some(&'"') => {
                letters.next();
                cell.push('"');
            }
            '"' => quoted = !quoted,
            letter if letter == mark && !quoted => cells.push(String::new()),
            letter => cell.push(letter),
        }
    }
    cells
}

/// The names with the units of the line below, where that line is one of units.
fn units(below: &[String], names: &[String]) -> Option<Vec<String>> {
    let bare = |cell: &str| cell.trim().trim_matches(['[', ']', '(', ')']).to_owned();
    let is_unit = |cell: &str| {
        let unit = bare(cell);
        !is_no_value(&unit) && unit_text(&unit).is_some()
    };
    let filled = || below.iter().map(String::as_str).filter(|cell| !is_no_value(cell.trim()));
    if filled().any(is_stamp) || filled().filter(|cell| is_unit(cell)).count() * 2 <= filled().count() {
        return None;
    }
    let with = |(name, cell): (&String, &String)| {
        let is_silent = ColumnHeader::parse(name).unit == ColumnUnit::Unstated;
        if is_silent && is_unit(cell) { format!("{name}[{}]", bare(cell)) } else { name.clone() }
    };
    Some(names.iter().zip(below.iter()).map(with).collect())
}

/// The columns of times: by their names, or the first where its cells are times.
fn time_columns(names: &[String], rows: &[TextRow]) -> Option<TimeColumns> {
    let named: Vec<usize> = (0..names.len())
        .filter(|column| {
            let name = ColumnHeader::parse(&names[*column]).channel.to_lowercase();
            TIMES.contains(&name.as_str())
        })
        .collect();
    let plain =
        named.iter().find(|column| PLAIN_TIMES.iter().any(|name| names[**column].eq_ignore_ascii_case(name)));
    let cell = |column: usize| {
        rows.iter()
            .filter_map(move |row| row.cells.get(column))
            .map(|cell| cell.trim())
            .find(|cell| !cell.is_empty())
    };
    let is_clock = |column: usize| {
        cell(column).is_some_and(|cell| cell.contains(':') && !cell.contains(['-', '/']) && cell.len() <= 12)
    };
    let is_day = |column: usize| cell(column).is_some_and(|cell| !cell.contains(':') && cell.len() >= 6);
    match named[..] {
        [column] => Some(TimeColumns::One(column)),
        [one, other, ..] if is_day(one) && is_clock(other) => Some(TimeColumns::Two(one, other)),
        [one, other, ..] if is_clock(one) && is_day(other) => Some(TimeColumns::Two(other, one)),
        [..] if plain.is_some() => plain.map(|column| TimeColumns::One(*column)),
        [first, ..] => Some(TimeColumns::One(first)),
        [] => is_stamp(cell(0)?).then_some(TimeColumns::One(0)),
    }
}
