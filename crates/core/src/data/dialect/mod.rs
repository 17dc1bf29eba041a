//! How other programs write measurements: their encodings, separators, decimal commas, forms of dates, and
//! clocks on walls.
//!
//! What is recognised is written anew in the form that [`Window::parse_csv`](super::Window::parse_csv)
//! reads, line by line, so that faults name the lines of the file as it was sent.
//!
//! ```text
//! bytes --text--> text --layout--> separator, header --numbers, dates--> CsvDialect --rewrite--> CSV
//! ```
//!
//! Nothing is guessed that the file leaves open: days and months that could change places are a fault, as are
//! commas that could stand before decimals or thousands, and local times without a zone stay as they are,
//! which the parser refuses.

mod dates;
mod layout;
mod numbers;
mod rewrite;
mod text;

pub use dates::DateForm;
pub use numbers::DecimalMark;

use super::calendar::local_zone;
use crate::fault::Fault;
use dates::DateReader;
use layout::TextTable;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use utoipa::ToSchema;

/// What a sender says of a file, where it does not say it itself.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct DialectAsked {
    /// The IANA zone of times without offset.
    pub zone: Option<String>,
    /// The mark before decimals.
    pub decimal: Option<DecimalMark>,
    /// The form of the dates.
    pub dates: Option<DateForm>,
    /// Take these columns and no others, by names as in [`ColumnBindings`](super::ColumnBindings).
    pub only: Option<Vec<String>>,
}

/// How a file is written.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
pub struct CsvDialect {
    /// Its encoding, such as `UTF-8` or `windows-1252`.
    pub encoding: String,
    /// What separates its cells.
    pub separator: char,
    /// The mark before decimals.
    pub decimal: DecimalMark,
    /// The form of its dates.
    pub dates: DateForm,
    /// Whether its times have no offset, so that they need a zone.
    pub local: bool,
    /// The zone in which they were read; `null` where they have offsets, or nobody has said it.
    pub zone: Option<String>,
    /// The line of the header.
    pub header: u64,
}

impl CsvDialect {
    /// How the file was read, in a sentence; nothing where that goes without saying.
    pub fn summary(&self) -> Option<String> {
        let mut parts = Vec::new();
        if self.encoding != text::UTF_8 {
            parts.push(format!("the encoding {}", self.encoding));
        }
        if self.decimal == DecimalMark::Comma {
            parts.push("decimal commas".to_owned());
        }
        parts.extend(self.dates.in_words().map(str::to_owned));
        if let Some(zone) = &self.zone {
            parts.push(format!("times of {zone}"));
        }
        let (last, others) = parts.split_last()?;
        let others = others.join(", ");
        let joint = if others.is_empty() { "" } else { " and " };
        Some(format!("The file was read with {others}{joint}{last}."))
    }
}

/// A text in the form that the parser reads, and how it was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Recognised<'a> {
    /// The text, line by line that of the file.
    pub text: Cow<'a, str>,
    /// How it was written; nothing where there is no header to be found, which the parser will say.
    pub dialect: Option<CsvDialect>,
}

/// Recognises how a file is written, and writes it anew where the parser would not read it as it is.
///
/// # Errors
/// Where the zone is unknown, there are too many columns, days and months of the dates could change places,
/// or commas could stand before decimals and thousands.
pub fn recognise<'a>(body: &'a [u8], asked: &DialectAsked) -> Result<Recognised<'a>, Vec<Fault>> {
    let (text, encoding) = text::decode(body);
    let zone = asked
        .zone
        .as_deref()
        .map(local_zone)
        .transpose()
        .map_err(|fault| vec![Fault { pointer: "/zone".to_owned(), ..fault }])?;
    if let (Cow::Borrowed(body), None) = (&text, &asked.only)
        && let Some((separator, header)) = layout::plain(body).map_err(|fault| vec![fault])?
        && asked.decimal != Some(DecimalMark::Comma)
        && asked.dates.is_none_or(|dates| dates == DateForm::Iso)
    {
        let dialect = CsvDialect {
            encoding: encoding.to_owned(),
            separator,
            decimal: DecimalMark::Point,
            dates: DateForm::Iso,
            local: false,
            zone: None,
            header,
        };
        return Ok(Recognised { text, dialect: Some(dialect) });
    }
    let Some(layout) = TextTable::of(&text).map_err(|fault| vec![fault])? else {
        return Ok(Recognised { text, dialect: None });
    };
    let at_first_row = |fault| vec![Fault { pointer: format!("line {}", layout.first_row), ..fault }];
    let decimal = match asked.decimal {
        Some(decimal) => decimal,
        None => numbers::decimal_mark(layout.cells(), layout.separator).map_err(at_first_row)?,
    };
    let reader = match DateReader::of(layout.stamps(), asked.dates) {
        Ok(Some(reader)) => reader,
        Ok(None) => return Ok(Recognised { text, dialect: None }),
        Err(fault) => return Err(at_first_row(fault)),
    };
    let local = reader.is_local();
    let dialect = CsvDialect {
        encoding: encoding.to_owned(),
        separator: char::from(layout.separator),
        decimal,
        dates: reader.form,
        local,
        zone: asked.zone.clone().filter(|_| local),
        header: layout.header,
    };
    let text = rewrite::rewritten(&layout, reader, decimal, zone.as_ref(), asked.only.as_deref());
    Ok(Recognised { text: Cow::Owned(text), dialect: Some(dialect) })
}

#[cfg(test)]
mod tests;
