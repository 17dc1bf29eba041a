//! A file of another dialect, line by line in the form that the parser reads.

use super::dates::DateReader;
use super::layout::{TextTable, TimeColumns};
use super::numbers::{DecimalMark, with_point};
use crate::data::header::ColumnHeader;
use jiff::tz::TimeZone;
use std::borrow::Cow;

/// What stands where a line of the file is none of the table.
const NOTHING: &str = "#";
const LINE_ENDS: [char; 2] = ['\r', '\n'];

/// The text of a table; every row stands on the line on which it ended.
pub(super) fn rewritten(
    layout: &TextTable<'_>,
    mut dates: DateReader,
    decimal: DecimalMark,
    zone: Option<&TimeZone>,
    only: Option<&[String]>,
) -> String {
    let time = match layout.times {
        TimeColumns::One(column) | TimeColumns::Two(column, _) => column,
    };
    let is_wanted = |column: &usize| {
        let name = &layout.names[*column];
        let header = ColumnHeader::parse(name);
        *column == time
            || !layout.is_time(*column)
                && only.is_none_or(|only| only.iter().any(|wanted| header.is_named(wanted)))
    };
    let columns: Vec<usize> = (0..layout.names.len()).filter(is_wanted).collect();
    let mut lines =
        Lines { writer: csv::WriterBuilder::new().flexible(true).from_writer(Vec::new()), line: 1 };
    lines.write(
        layout.header,
        columns.iter().map(|column| if *column == time { "time" } else { layout.names[*column].as_str() }),
    );
    let mut rows = layout.rows();
    while let Some((line, row)) = rows.read() {
        if row.len() != layout.names.len() {
            // The parser says what is wrong with it: it has too few cells, or too many.
            lines.write(line, std::iter::repeat_n("", columns.len() + 1));
            continue;
        }
        let stamp = dates.written(&layout.stamp(row), zone);
        let cells = columns.iter().map(|column| {
            if *column == time { Cow::Borrowed(stamp.as_str()) } else { with_point(&row[*column], decimal) }
        });
        let cells: Vec<Cow<'_, str>> = cells.map(on_one_line).collect();
        lines.write(line, cells.iter().map(AsRef::as_ref));
    }
    let written = lines.writer.into_inner().unwrap_or_default();
    String::from_utf8(written).unwrap_or_default()
}

/// A remark of several lines would move all that follows.
fn on_one_line(cell: Cow<'_, str>) -> Cow<'_, str> {
    if cell.contains(LINE_ENDS) { Cow::Owned(cell.replace(LINE_ENDS, " ")) } else { cell }
}

/// Lines on their way into a text.
struct Lines {
    writer: csv::Writer<Vec<u8>>,
    /// The number of the next one.
    line: u64,
}

impl Lines {
    /// Writes a row on a line of its own; what lies before is left out. Writing into memory does not fail.
    fn write<'a>(&mut self, line: u64, cells: impl Iterator<Item = &'a str>) {
        while self.line < line {
            self.writer.write_record([NOTHING]).unwrap_or_default();
            self.line += 1;
        }
        self.writer.write_record(cells).unwrap_or_default();
        self.line += 1;
    }
}
