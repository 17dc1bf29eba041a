//! CSV as it stands in a text: what separates its cells, its header, and its rows with their lines.

use super::header::{ColumnHeader, MAX_COLUMNS, MAX_NAME, too_many};
use crate::fault::Fault;

/// The names that the column of times may have, in any case.
const TIME_NAMES: [&str; 2] = ["time", "timestamp"];
/// What may separate cells; a header without any comma may use the others.
const SEPARATORS: [u8; 3] = *b",;\t";

/// Whether a column of this name holds the times.
pub(super) fn is_time(column: &str) -> bool {
    TIME_NAMES.iter().any(|name| column.trim().eq_ignore_ascii_case(name))
}

/// Whether a line says nothing.
pub(super) fn is_passed(line: &str) -> bool {
    line.trim().is_empty() || line.starts_with('#')
}

/// Why a row with another number of cells than the header has is left out.
pub(super) fn other_width(headers: usize) -> String {
    format!("not the {headers} cells of the header")
}

/// The headers of a CSV; none where it has too many to be one.
pub fn csv_headers(text: &str) -> Vec<ColumnHeader> {
    CsvText::of(text).map(|csv| csv.headers).unwrap_or_default()
}

/// A CSV behind its header: `time,T_room,…`, then one row per time. Lines that start with `#` are comments.
pub(super) struct CsvText<'a> {
    /// What separates its cells.
    pub separator: u8,
    /// The line of the header.
    pub line: u64,
    /// What the columns are.
    pub headers: Vec<ColumnHeader>,
    /// Which of them are called as times are.
    pub times: Vec<usize>,
    /// What stands below.
    pub rows: Rows<'a>,
}

impl<'a> CsvText<'a> {
    /// Reads the header of a text.
    ///
    /// # Errors
    /// Where it has too many columns.
    pub fn of(text: &'a str) -> Result<Self, Fault> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let line = text.lines().find(|line| !is_passed(line)).unwrap_or_default();
        let separator =
            SEPARATORS.into_iter().find(|mark| line.as_bytes().contains(mark)).unwrap_or(SEPARATORS[0]);
        // A separator in quotes is a part of a name, but no name is longer: what has more is not taken apart.
        let marks = line.bytes().filter(|byte| *byte == separator).count();
        if marks > MAX_COLUMNS * MAX_NAME {
            too_many(marks)?;
        }
        let mut rows = Rows::of(text, separator, 0);
        let (line, headers) = match rows.read() {
            Some((line, record)) => {
                too_many(record.len().saturating_sub(1))?;
                (line, record.iter().map(ColumnHeader::parse).collect())
            }
            None => (1, Vec::new()),
        };
        let times = (0..headers.len()).filter(|index| is_time(&headers[*index].column)).collect();
        Ok(Self { separator, line, headers, times, rows })
    }
}

/// The rows of a text with the lines on which they end.
pub(super) struct Rows<'a> {
    text: &'a str,
    reader: csv::Reader<&'a [u8]>,
    record: csv::StringRecord,
    line: u64,
    counted: usize,
}

impl<'a> Rows<'a> {
    /// The rows of a text above which stand so many lines.
    pub fn of(text: &'a str, separator: u8, above: u64) -> Self {
        let reader = csv::ReaderBuilder::new()
            .delimiter(separator)
            .has_headers(false)
            .flexible(true)
            .comment(Some(b'#'))
            .from_reader(text.as_bytes());
        Self { text, reader, record: csv::StringRecord::new(), line: above + 1, counted: 0 }
    }

    /// The next row that says something. Reading from memory does not fail.
    pub fn read(&mut self) -> Option<(u64, &csv::StringRecord)> {
        while self.reader.read_record(&mut self.record).unwrap_or(false) {
            self.count_to(self.reader.position().byte() as usize);
            if self.record.len() > 1 || self.record.iter().any(|cell| !cell.trim().is_empty()) {
                return Some((self.line, &self.record));
            }
        }
        None
    }

    /// Counts the lines of what ends here: the reader says where it began to look for a record, which may be
    /// on lines above that it passes over.
    fn count_to(&mut self, end: usize) {
        let end = self.text.as_bytes()[..end].trim_ascii_end().len().max(self.counted);
        let more = &self.text.as_bytes()[self.counted..end];
        self.line += more.iter().filter(|byte| **byte == b'\n').count() as u64;
        self.counted = end;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_those_that_say_something() {
        let mut csv =
            CsvText::of("\u{feff}\n# made by hand\n \n\"a, b\";time\n\n1;2\n  \n\"x\ny\";3").unwrap();
        let names: Vec<&str> = csv.headers.iter().map(|header| header.column.as_str()).collect();
        // A comma in the header counts first, also in quotes: who writes one uses the recogniser.
        assert_eq!((csv.separator, csv.line, csv.times.len(), names.len()), (b',', 4, 0, 1));
        csv = CsvText::of("# made by hand\n \na;time\n\n1;2\n  \n\"x\ny\";3").unwrap();
        assert_eq!((csv.separator, csv.line, csv.times.clone()), (b';', 3, vec![1]));
        let mut rows = Vec::new();
        while let Some((line, record)) = csv.rows.read() {
            rows.push((line, record.len()));
        }
        assert_eq!(rows, [(5, 2), (8, 2)]);
        assert_eq!(csv_headers(&"a,".repeat(2_000)).len(), 0);
        assert_eq!(csv_headers("time,\"Temperatur, innen [degC]\"")[1].channel, "Temperatur, innen");
    }
}
