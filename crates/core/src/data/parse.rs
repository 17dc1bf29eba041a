//! The CSV and the JSON form of a window.

use std::fmt;
use std::marker::PhantomData;

use serde::de::{Deserialize, Deserializer, Error, MapAccess, SeqAccess, Visitor};

use super::bindings::ColumnBindings;
use super::csv_text::{CsvText, other_width};
use super::header::{ColumnHeader, MAX_COLUMNS, resolve};
use super::json_cell::JsonCell;
use super::parts::{ColumnPart, ReadPart, WindowParts};
use super::role::ColumnRole;
use super::table::{Cell, Place, Stamp, Table, is_no_value};
use super::window::{Window, WindowReport};
use crate::fault::{Fault, shown};
use crate::schema::Instant;
use utoipa::ToSchema;
use utoipa::openapi::schema::{ArrayBuilder, Object, ObjectBuilder, SchemaType, Type};

/// The code of a body that is no JSON, or JSON of another form.
const UNREADABLE: &str = "unreadable";
/// Eight years of one-minute data in one body.
const MAX_ROWS: usize = 1 << 22;
/// Cells of a JSON column whose text is kept for the report when it is no number.
const MAX_ODD: usize = 100;

impl Window {
    /// Reads a window from CSV: a header `time,T_room[degC],…`, then one row per time.
    ///
    /// Times carry an offset or `Z`. A cell that is no finite number is a missing value: silently where it is
    /// empty or says so (`null`, `NaN`, `-`, `n/a`, `unavailable`, `unknown`), with a warning else. A row
    /// with a time that does not increase or with another number of cells is rejected and listed in the
    /// report; a single value that no working sensor gives is left out with a warning. Columns of forecasts
    /// are no measurements and are left out.
    ///
    /// # Errors
    /// All kinds of faults at once, at most 100: no or several columns of times, unknown or inconvertible
    /// units, duplicate columns, bindings to missing columns, no data, times without offset, more than a
    /// tenth of the rows rejected or of a column no numbers, values that only another unit explains.
    pub fn parse_csv(text: &str, bindings: &ColumnBindings) -> Result<(Window, WindowReport), Vec<Fault>> {
        only_measured(csv(text, bindings, ColumnPart::Measured))
    }

    /// Reads a window from JSON:
    /// `{"channels":{"T_room":{"unit":"degC"}},"time":[…],"values":{"T_room":[21.1,null]}}`.
    ///
    /// `channels` is optional and states units; a name in `values` is a column header as in CSV. The rules
    /// for rows are those of [`Window::parse_csv`], and rows count from 1.
    ///
    /// # Errors
    /// As for CSV, and where the body is no such document or lists have different lengths.
    pub fn parse_json(body: &[u8], bindings: &ColumnBindings) -> Result<(Window, WindowReport), Vec<Fault>> {
        Window::read(document_of(body)?, bindings)
    }

    /// Reads a window from a JSON document whose form is right, by the rules of [`Window::parse_json`].
    ///
    /// # Errors
    /// As for CSV, and where lists have different lengths.
    pub fn read(
        document: WindowDocument,
        bindings: &ColumnBindings,
    ) -> Result<(Window, WindowReport), Vec<Fault>> {
        only_measured(self::document(&document, bindings, ColumnPart::Measured))
    }
}

impl WindowParts {
    /// Reads measurements and forecasts from CSV, by the rules of [`Window::parse_csv`]. Columns without a
    /// role have `unmarked`.
    ///
    /// # Errors
    /// All faults of both.
    pub fn parse_csv(
        text: &str,
        bindings: &ColumnBindings,
        unmarked: Option<ColumnRole>,
    ) -> Result<Self, Vec<Fault>> {
        Self::of(unmarked, |part| csv(text, bindings, part))
    }

    /// Reads measurements and forecasts from JSON, by the rules of [`Window::parse_json`].
    ///
    /// # Errors
    /// All faults of both.
    pub fn parse_json(
        body: &[u8],
        bindings: &ColumnBindings,
        unmarked: Option<ColumnRole>,
    ) -> Result<Self, Vec<Fault>> {
        Self::read(&document_of(body)?, bindings, unmarked)
    }

    /// Reads measurements and forecasts from a document whose form is right.
    ///
    /// # Errors
    /// All faults of both.
    pub fn read(
        document: &WindowDocument,
        bindings: &ColumnBindings,
        unmarked: Option<ColumnRole>,
    ) -> Result<Self, Vec<Fault>> {
        Self::of(unmarked, |part| self::document(document, bindings, part))
    }
}

/// The measurements, which must be there.
fn only_measured(read: ReadPart) -> Result<(Window, WindowReport), Vec<Fault>> {
    read?.ok_or_else(|| vec![Fault::new("header", "no-data-column", "all columns are forecasts")])
}

/// Reads a part of `time,T_room,…`.
fn csv(text: &str, bindings: &ColumnBindings, part: ColumnPart) -> ReadPart {
    let CsvText { headers, times, mut rows, .. } = CsvText::of(text).map_err(|fault| vec![fault])?;
    let mut faults = Vec::new();
    match times.len() {
        1 => {}
        0 => {
            let first: String = headers.first().map(|header| shown(&header.column)).unwrap_or_default();
            let detail = format!("there is no column `time`; the first column is `{first}`");
            faults.push(
                Fault::new("line 1", "no-time-column", detail)
                    .suggest("the header starts with time, such as time,T_room[degC],T_out[degC]"),
            );
        }
        _ => faults.push(
            Fault::new("line 1", "duplicate-column", "there are several columns of times")
                .suggest("keep one column `time`"),
        ),
    }
    let (data, others): (Vec<usize>, Vec<usize>) = (0..headers.len())
        .filter(|index| !times.contains(index))
        .partition(|index| part.has(&headers[*index]));
    if data.is_empty() && (part == ColumnPart::Forecast || !others.is_empty()) {
        return Ok(None);
    }
    let bindings = &part.bindings(&headers, bindings);
    let data_headers: Vec<ColumnHeader> = data.iter().map(|index| headers[*index].clone()).collect();
    let mut warnings = Vec::new();
    let (targets, more) =
        resolve(&data_headers, bindings, &|column| Place::Text.column(column), &mut warnings);
    faults.extend(more);
    let [time] = times[..] else {
        return Err(limited(faults));
    };
    let names = data_headers.into_iter().map(|header| header.column).collect();
    let mut table = Table::new(names, targets, Place::Text, warnings);
    while let Some((line, record)) = rows.read() {
        if record.len() != headers.len() {
            table.reject(line, other_width(headers.len()));
            continue;
        }
        let cell = |index: &usize| Cell::of_text(record.get(*index).unwrap_or_default());
        if !others.is_empty() && data.iter().all(|index| cell(index).is_missing()) {
            continue;
        }
        let stamp = Stamp::Text(record.get(time).unwrap_or_default());
        table.push(line, stamp, data.iter().map(cell));
    }
    table.finish(faults).map(Some).map_err(limited)
}

/// Reads `{"channels":{"T_room":{"unit":"degC"}},"time":[…],"values":{"T_room":[21.1,null]}}`.
fn document_of(body: &[u8]) -> Result<WindowDocument, Vec<Fault>> {
    serde_json::from_slice(body).map_err(|error| {
        // The parser's message may quote a name of the document, which may be of any length.
        let message: String = error.to_string().chars().take(200).collect();
        vec![Fault::new("", UNREADABLE, format!("the body is not a window: {message}"))]
    })
}

/// A part of a document whose form is right.
fn document(document: &WindowDocument, bindings: &ColumnBindings, part: ColumnPart) -> ReadPart {
    let WindowDocument { channels: Pairs(channels), roles: Pairs(roles), time: Times(time), values } =
        document;

    let mut faults = Vec::new();
    let stated = |name: &str| {
        channels.iter().find(|(channel, _)| channel == name).and_then(|(_, entry)| entry.unit.as_deref())
    };
    let role = |name: &str| roles.iter().find(|(channel, _)| channel == name).map(|(_, role)| *role);
    let header = |name: &str| {
        let header = match stated(name) {
            Some(unit) => ColumnHeader::with_unit(name, unit),
            None => ColumnHeader::parse(name),
        };
        ColumnHeader { role: role(name).or(header.role), ..header }
    };
    let all_headers: Vec<ColumnHeader> = values.0.iter().map(|(name, _)| header(name)).collect();
    let (own, others): (Vec<_>, Vec<_>) =
        values.0.iter().zip(&all_headers).partition(|(_, header)| part.has(header));
    if own.is_empty() && (part == ColumnPart::Forecast || !others.is_empty()) {
        return Ok(None);
    }
    let bindings = &part.bindings(&all_headers, bindings);
    let (values, headers): (Vec<&(String, JsonColumn)>, Vec<ColumnHeader>) =
        own.into_iter().map(|(values, header)| (values, header.clone())).unzip();
    let is_column = |name: &String| document.values.0.iter().any(|(column, _)| column == name);
    for (name, _) in roles.iter().filter(|(name, _)| !is_column(name)) {
        let detail = format!("`{}` has a role but no values", shown(name));
        faults.push(Fault::new(pointer_in("roles", name), "no-values", detail));
    }
    for (index, (name, _)) in channels.iter().enumerate() {
        let fault = |code, detail| Fault::new(channel_pointer(name), code, detail);
        if !is_column(name) {
            faults.push(fault("no-values", format!("`{}` is described but has no values", shown(name))));
        }
        if channels[..index].iter().any(|(earlier, _)| earlier == name) {
            faults.push(fault("duplicate-column", format!("`{}` is described twice", shown(name))));
        }
    }
    for (name, cells) in values.iter().filter(|(_, cells)| cells.numbers.len() != time.len()) {
        let detail = format!("{} values for {} times", cells.numbers.len(), time.len());
        faults.push(Fault::new(Place::Json.column(name), "length-mismatch", detail));
    }
    let mut warnings = Vec::new();
    let (targets, more) = resolve(&headers, bindings, &|column| Place::Json.column(column), &mut warnings);
    // A unit is wrong where it is stated.
    let stated_at = |fault: &Fault| {
        channels
            .iter()
            .find(|(name, entry)| entry.unit.is_some() && Place::Json.column(name) == fault.pointer)
    };
    faults.extend(more.into_iter().map(|fault| match stated_at(&fault) {
        Some((name, _)) if fault.code.ends_with("-unit") => {
            Fault { pointer: format!("{}/unit", channel_pointer(name)), ..fault }
        }
        _ => fault,
    }));
    let names = headers.into_iter().map(|header| header.column).collect();
    let mut table = Table::new(names, targets, Place::Json, warnings);
    for (row, stamp) in time.iter().enumerate() {
        let stamp = match stamp {
            JsonCell::Text(text) => Stamp::Text(text),
            JsonCell::Number(_) => Stamp::Number,
            JsonCell::Missing => Stamp::Missing,
        };
        if !others.is_empty() && values.iter().all(|(_, cells)| cells.cell(row).is_missing()) {
            continue;
        }
        table.push(row as u64 + 1, stamp, values.iter().map(|(_, cells)| cells.cell(row)));
    }
    table.finish(faults).map(Some).map_err(limited)
}

/// Where a channel is described.
fn channel_pointer(name: &str) -> String {
    pointer_in("channels", name)
}

/// Where something is said of a column beside its values.
fn pointer_in(place: &str, name: &str) -> String {
    Place::Json.column(name).replacen("values", place, 1)
}

/// At most a hundred faults: nobody reads more, and an answer stays small.
fn limited(mut faults: Vec<Fault>) -> Vec<Fault> {
    const MAX_FAULTS: usize = 100;
    faults.truncate(MAX_FAULTS);
    faults
}

/// Measurements as JSON; as CSV they are `time,T_room[degC],…`. A cell that is no number is a missing one. A
/// row whose time cannot be read is left out and listed; where more than a tenth of the rows or of a column
/// cannot be read, the window is refused.
// The form is right as soon as there is such a document; what its cells hold is judged by `Window::read`.
#[derive(serde::Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = WindowBody)]
pub struct WindowDocument {
    /// Units by channel; a channel that is not named has its own.
    #[serde(default)]
    #[schema(value_type = HashMap<String, ChannelEntry>)]
    channels: Pairs<ChannelEntry>,
    /// What columns are that are no measurements, by name.
    #[serde(default)]
    #[schema(value_type = HashMap<String, ColumnRole>)]
    roles: Pairs<ColumnRole>,
    /// Increasing times with offset.
    #[schema(value_type = Vec<Instant>, min_items = 1)]
    time: Times,
    #[schema(schema_with = columns)]
    values: Pairs<JsonColumn>,
}

fn columns() -> Object {
    let types = SchemaType::from_iter([Type::Number, Type::Null]);
    let column = ArrayBuilder::new().items(ObjectBuilder::new().schema_type(types)).min_items(Some(1));
    let columns = ObjectBuilder::new()
        .schema_type(Type::Object)
        .additional_properties(Some(column))
        .min_properties(Some(1));
    columns.description(Some("One list per channel, as long as `time`.")).build()
}

/// The unit of a channel.
#[derive(serde::Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
#[schema(as = ChannelUnit)]
struct ChannelEntry {
    /// Such as `degC`.
    unit: Option<String>,
}

/// The entries of a map in the order of the document; a name that occurs twice stays twice, so that it can be
/// a fault.
struct Pairs<T>(Vec<(String, T)>);

impl<T> Default for Pairs<T> {
    fn default() -> Self {
        Self(Vec::new())
    }
}

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Pairs<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Entries<T>(PhantomData<T>);
        impl<'de, T: Deserialize<'de>> Visitor<'de> for Entries<T> {
            type Value = Pairs<T>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a map with one entry per channel")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Pairs<T>, A::Error> {
                let mut entries = Vec::new();
                while let Some(entry) = map.next_entry()? {
                    entries.push(entry);
                    if entries.len() > MAX_COLUMNS {
                        return Err(A::Error::custom(format!("{MAX_COLUMNS} channels are the most")));
                    }
                }
                Ok(Pairs(entries))
            }
        }
        deserializer.deserialize_map(Entries(PhantomData))
    }
}

/// The list of times.
struct Times(Vec<JsonCell>);

impl<'de> Deserialize<'de> for Times {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Stamps;
        impl<'de> Visitor<'de> for Stamps {
            type Value = Times;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list of times")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Times, A::Error> {
                let mut stamps = Vec::new();
                while let Some(stamp) = seq.next_element()? {
                    stamps.push(stamp);
                    if stamps.len() > MAX_ROWS {
                        return Err(A::Error::custom(format!("{MAX_ROWS} times are the most")));
                    }
                }
                Ok(Times(stamps))
            }
        }
        deserializer.deserialize_seq(Stamps)
    }
}

/// The values of one channel, eight bytes each: a body of two bytes per value must not grow twelvefold in
/// memory.
///
/// JSON has neither NaN nor infinity, so inside this type NaN stands for `null`, and infinity for what is no
/// number; the first few of the latter keep their text for the report.
struct JsonColumn {
    numbers: Vec<f64>,
    odd: Vec<(usize, Box<str>)>,
}

impl JsonColumn {
    fn cell(&self, row: usize) -> Cell<'_> {
        // A list that is too short was found to be a fault before.
        match self.numbers.get(row).copied().unwrap_or(f64::NAN) {
            missing if missing.is_nan() => Cell::Missing,
            odd if odd.is_infinite() => match self.odd.binary_search_by_key(&row, |(row, _)| *row) {
                Ok(found) => Cell::Text(&self.odd[found].1),
                Err(_) => Cell::Text("no number"),
            },
            number => Cell::Number(number),
        }
    }
}

impl<'de> Deserialize<'de> for JsonColumn {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Values;
        impl<'de> Visitor<'de> for Values {
            type Value = JsonColumn;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a list of numbers and nulls")
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<JsonColumn, A::Error> {
                let mut column = JsonColumn { numbers: Vec::new(), odd: Vec::new() };
                while let Some(cell) = seq.next_element()? {
                    let number = match cell {
                        JsonCell::Missing => f64::NAN,
                        JsonCell::Number(number) => number,
                        JsonCell::Text(text) if is_no_value(text.trim()) => f64::NAN,
                        JsonCell::Text(text) => {
                            if column.odd.len() < MAX_ODD {
                                column.odd.push((column.numbers.len(), text));
                            }
                            f64::INFINITY
                        }
                    };
                    column.numbers.push(number);
                }
                Ok(column)
            }
        }
        deserializer.deserialize_seq(Values)
    }
}
