//! What the columns of a file are, proposed from their names and values: channels, units, the rooms that
//! share a file, and which of them are next door. Nothing follows from it until somebody confirms it.

mod words;

use super::channel::{ChannelKind, is_temperature};
use super::csv_text::{CsvText, other_width};
use super::dialect::{CsvDialect, DialectAsked, recognise};
use super::header::{ColumnHeader, ColumnUnit};
use super::layout::{NEIGHBOUR, propose_layout};
use super::series::Series;
use super::stamp::{BadStamp, in_utc, read_stamp, rfc3339};
use super::table::{Cell, RawColumn, order};
use super::window::Window;
use crate::fault::Fault;
use crate::units::Unit;
use serde::Serialize;
use utoipa::ToSchema;

/// Rows that are shown as they were read.
const SHOWN: usize = 5;
/// How the channels begin under which rooms are compared.
const ROOM: &str = "T_room_";
/// Rooms that are proposed next to one: the walls of a room.
const MOST_NEIGHBOURS: usize = 4;

/// How a file was understood, for somebody to confirm. Nothing is stored.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct FileReading {
    /// How it is written.
    pub dialect: CsvDialect,
    /// What it leaves open: `zone` where its times have no offset and nobody has said their zone.
    pub asks: Vec<String>,
    /// Its columns beside the time.
    pub columns: Vec<ColumnReading>,
    /// The rooms that are measured in it, where they are several.
    pub rooms: Vec<ProposedRoom>,
    /// Pairs of those that look like neighbours, the most alike first.
    pub neighbours: Vec<ProposedNeighbours>,
    /// Rows that were read.
    pub rows: usize,
    /// The first time.
    #[schema(format = DateTime)]
    pub from: Option<String>,
    /// The last time.
    #[schema(format = DateTime)]
    pub to: Option<String>,
    /// Times of the first rows; a text that could not be read as it is.
    pub first: Vec<String>,
    /// Why rows would be left out.
    pub rejected: Vec<RejectedRows>,
}

/// A column, and what it is probably.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ColumnReading {
    /// Its header.
    pub column: String,
    /// The channel; `null` where nothing in its name says.
    pub channel: Option<String>,
    /// The unit of its values.
    pub unit: String,
    /// Whether its header says so. Otherwise its values do, or nothing does.
    pub stated: bool,
    /// The room that it is in, by the id of one of `rooms`; `null` where it is of all.
    pub room: Option<String>,
    /// Values.
    pub samples: usize,
    /// Cells that hold something else than a number.
    pub odd: usize,
    /// Share of the rows that have a value.
    pub complete: f64,
    /// The lowest value.
    pub min: Option<f64>,
    /// The highest value.
    pub max: Option<f64>,
    /// The first values.
    pub first: Vec<Option<f64>>,
}

/// A room that shares a file with others.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct ProposedRoom {
    /// A name that a system could have.
    pub id: String,
    /// What people call it.
    pub label: String,
    /// The column of its temperature.
    pub column: String,
}

/// Two rooms that are probably next door.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ProposedNeighbours {
    /// Their ids.
    pub rooms: [String; 2],
    /// The correlation of their temperatures, as in a layout.
    pub correlation: f64,
}

/// Rows that would be left out for one reason.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct RejectedRows {
    /// Why.
    pub reason: String,
    /// How many.
    pub count: usize,
    /// The line of the first.
    pub line: u64,
}

/// Reads a file for somebody to confirm.
///
/// # Errors
/// Where there is no table with a column of times in it, or its dialect leaves more open than a zone.
pub fn read_file(body: &[u8], asked: &DialectAsked) -> Result<FileReading, Vec<Fault>> {
    let found = recognise(body, asked)?;
    let no_table = || {
        let detail = "there is no table whose rows begin with a time";
        vec![
            Fault::new("csv", "no-time-column", detail)
                .suggest("the header names a column of times, such as time,T_room[degC],T_out[degC]"),
        ]
    };
    let dialect = found.dialect.ok_or_else(no_table)?;
    let CsvText { headers, times: named, mut rows, .. } =
        CsvText::of(&found.text).map_err(|fault| vec![fault])?;
    let time_column = named.first().copied().ok_or_else(no_table)?;
    let mut raw: Vec<RawColumn> = headers.iter().map(|_| RawColumn::default()).collect();
    let (mut times, mut first, mut rejected) = (Vec::new(), Vec::new(), Vec::new());
    while let Some((line, record)) = rows.read() {
        let stamp = record.get(time_column).unwrap_or_default();
        if first.len() < SHOWN {
            first.push(stamp.to_owned());
        }
        if record.len() != headers.len() {
            note(&mut rejected, &other_width(headers.len()), line);
            continue;
        }
        match next_time(stamp, times.last().copied()) {
            Ok(time) => {
                for (column, cell) in raw.iter_mut().zip(record) {
                    column.take(times.len(), line, Cell::of_text(cell));
                }
                times.push(time);
            }
            Err(reason) => note(&mut rejected, reason, line),
        }
    }
    let kept: Vec<(&ColumnHeader, &RawColumn)> = headers
        .iter()
        .zip(&raw)
        .enumerate()
        .filter(|(at, _)| *at != time_column)
        .map(|(_, one)| one)
        .collect();
    let names: Vec<&ColumnHeader> = kept.iter().map(|(header, _)| *header).collect();
    let rooms = rooms(&names);
    let mut columns: Vec<ColumnReading> =
        kept.iter().map(|(header, raw)| column_reading(header, raw, times.len())).collect();
    assign(&mut columns, &rooms);
    let temperatures = rooms.iter().filter_map(|room| {
        let at = columns.iter().position(|column| column.column == room.column)?;
        temperature(&room.id, &columns[at].unit, kept[at].1, &times)
    });
    let neighbours = neighbours(temperatures.collect());
    let asks = if dialect.local && dialect.zone.is_none() { vec!["zone".to_owned()] } else { Vec::new() };
    Ok(FileReading {
        dialect,
        asks,
        columns,
        rooms,
        neighbours,
        rows: times.len(),
        from: times.first().copied().map(rfc3339),
        to: times.last().copied().map(rfc3339),
        first,
        rejected,
    })
}

/// The time of a row below the last one. A local time without a zone is one that waits for an answer.
fn next_time(stamp: &str, last: Option<i64>) -> Result<i64, &'static str> {
    let read = match read_stamp(stamp) {
        Err(BadStamp::Naive) => read_stamp(&in_utc(stamp)),
        other => other,
    };
    let time = read.map_err(BadStamp::reason)?;
    order(last, time).map(|()| time)
}

fn note(rejected: &mut Vec<RejectedRows>, reason: &str, line: u64) {
    match rejected.iter_mut().find(|known| known.reason == reason) {
        Some(known) => known.count += 1,
        None => rejected.push(RejectedRows { reason: reason.to_owned(), count: 1, line }),
    }
}

/// A column by itself: its channel by name, its unit by header or values.
fn column_reading(header: &ColumnHeader, raw: &RawColumn, rows: usize) -> ColumnReading {
    let known = ChannelKind::of_name(&header.channel).map(|_| header.channel.clone());
    let channel = known.or_else(|| words::meaning(&header.column).map(str::to_owned));
    let kind = channel.as_deref().and_then(ChannelKind::of_name);
    let (unit, stated) = match (&header.unit, &kind) {
        (ColumnUnit::Stated(unit), _) => (unit.clone(), true),
        (_, Some(kind)) => {
            let found = kind.unit_that_explains(channel.as_deref().unwrap_or_default(), &raw.values);
            (found.unwrap_or(&kind.unit).to_owned(), false)
        }
        (_, None) => ("-".to_owned(), false),
    };
    // A name that says heat, in a unit of temperature, is none of power.
    let fits = kind.as_ref().is_none_or(|kind| {
        Unit::parse(&unit).ok().zip(Unit::parse(&kind.unit).ok()).is_some_and(|(a, b)| a.same_dimension(&b))
    });
    let channel = match channel.filter(|_| fits) {
        Some(channel) => Some(channel),
        None if stated && is_temperature(&unit) => Some("T_room".to_owned()),
        None => None,
    };
    let value = |row: u32| raw.rows.binary_search(&row).ok().map(|at| raw.values[at]);
    ColumnReading {
        column: header.column.clone(),
        channel,
        unit,
        stated,
        room: None,
        samples: raw.values.len(),
        odd: raw.odd(),
        complete: raw.values.len() as f64 / rows.max(1) as f64,
        min: raw.values.iter().copied().min_by(f64::total_cmp),
        max: raw.values.iter().copied().max_by(f64::total_cmp),
        first: (0..rows.min(SHOWN) as u32).map(value).collect(),
    }
}

/// The rooms of a file with several temperatures of rooms. One that has `T_room` itself is a file of one
/// room, whose neighbours are `T_room_…`.
fn rooms(headers: &[&ColumnHeader]) -> Vec<ProposedRoom> {
    if headers.iter().any(|header| header.channel == "T_room") {
        return Vec::new();
    }
    let is_room = |header: &&&ColumnHeader| {
        let by_name = header.channel.starts_with(ROOM);
        let is_warmth = match &header.unit {
            ColumnUnit::Stated(unit) => is_temperature(unit),
            _ => true,
        };
        by_name
            || is_warmth && words::meaning(&header.column) == Some("T_room")
            || is_warmth && header.unit != ColumnUnit::Unstated && words::meaning(&header.channel).is_none()
    };
    let found: Vec<ProposedRoom> = headers
        .iter()
        .filter(is_room)
        .map(|header| {
            let words = words::room_words(&header.channel);
            let id = words::slug(&words);
            ProposedRoom { id, label: capital(&words.join(" ")), column: header.column.clone() }
        })
        .filter(|room| !room.id.is_empty())
        .collect();
    let mut unique: Vec<ProposedRoom> = Vec::new();
    for room in found {
        if !unique.iter().any(|known| known.id == room.id) {
            unique.push(room);
        }
    }
    if unique.len() > 1 { unique } else { Vec::new() }
}

fn capital(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map(|first| first.to_uppercase().chain(letters).collect()).unwrap_or_default()
}

/// Gives columns to the rooms whose words are in their names; what a room, or all, has already is given to
/// nothing.
fn assign(columns: &mut [ColumnReading], rooms: &[ProposedRoom]) {
    let labels: Vec<Vec<String>> = rooms.iter().map(|room| words::words(&room.label)).collect();
    let mut taken: Vec<(Option<String>, String)> = Vec::new();
    for column in columns.iter_mut() {
        let own = words::words(&column.column);
        let is_in = |label: &&[String]| {
            label.iter().all(|word| {
                // Digits must be whole: room 1 is not room 11.
                let is_number = word.parse::<u32>().is_ok();
                own.iter().any(|other| other == word || (!is_number && other.starts_with(word.as_str())))
            })
        };
        // The name that says most: what is in `bath guests` is not in `bath`.
        let named = || {
            let all = rooms.iter().zip(labels.iter().map(Vec::as_slice));
            let fitting = all.filter(|(_, label)| is_in(label));
            fitting.min_by_key(|(_, label)| std::cmp::Reverse(label.len())).map(|(room, _)| room)
        };
        let made = rooms.iter().find(|room| room.column == column.column);
        column.room = made.or_else(named).map(|room| room.id.clone());
        if !rooms.is_empty() && column.channel.as_deref().is_some_and(|name| name.starts_with("T_room")) {
            column.channel = made.map(|_| "T_room".to_owned());
        }
        if let Some(channel) = &column.channel {
            let place = (column.room.clone(), channel.clone());
            if taken.contains(&place) {
                column.channel = None;
            } else {
                taken.push(place);
            }
        }
    }
}

/// The temperature of a room; nothing where its column has none in this unit.
fn temperature(id: &str, unit: &str, raw: &RawColumn, times: &[i64]) -> Option<Series> {
    let channel = format!("{ROOM}{id}");
    let kind = ChannelKind::of_name(&channel)?;
    let (from, to) = Unit::parse(unit).ok().zip(Unit::parse(&kind.unit).ok())?;
    let value = |(row, value): (&u32, &f64)| {
        let value = from.convert(&to, *value).filter(|value| kind.is_plausible(*value))?;
        Some((times[*row as usize], value))
    };
    let (times, values) = raw.rows.iter().zip(&raw.values).filter_map(value).unzip();
    Series::new(&channel, &kind.unit, kind.hold, times, values).ok()
}

/// Pairs of rooms whose temperatures move together, at most so many for a room; none where too little says
/// so.
fn neighbours(temperatures: Vec<Series>) -> Vec<ProposedNeighbours> {
    let layout = Window::from_series(temperatures).and_then(|window| propose_layout(&window));
    let Ok(layout) = layout else { return Vec::new() };
    let id = |sensor: usize| layout.sensors[sensor].channel[ROOM.len()..].to_owned();
    let mut pairs: Vec<ProposedNeighbours> = (0..layout.sensors.len())
        .flat_map(|a| (0..a).map(move |b| (a, b)))
        .filter_map(|(a, b)| {
            let correlation = layout.correlation[a][b].filter(|found| *found > NEIGHBOUR)?;
            Some(ProposedNeighbours { rooms: [id(b), id(a)], correlation })
        })
        .collect();
    pairs.sort_by(|a, b| b.correlation.total_cmp(&a.correlation));
    let mut kept: Vec<ProposedNeighbours> = Vec::new();
    for pair in pairs {
        let has = |room: &String| kept.iter().filter(|known| known.rooms.contains(room)).count();
        if pair.rooms.iter().all(|room| has(room) < MOST_NEIGHBOURS) {
            kept.push(pair);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> FileReading {
        let zone = Some("Europe/Berlin".to_owned());
        read_file(text.as_bytes(), &DialectAsked { zone, ..DialectAsked::default() }).unwrap()
    }

    fn channels(reading: &FileReading) -> Vec<(&str, Option<&str>, &str, Option<&str>)> {
        reading
            .columns
            .iter()
            .map(|one| (one.column.as_str(), one.channel.as_deref(), one.unit.as_str(), one.room.as_deref()))
            .collect()
    }

    #[test]
    fn names_of_a_german_house_mean_channels_and_rooms() {
        let head = "Datum;Raum 1 Temperatur (°C);Raum 2 Temperatur (°C);Wohnzimmertemperatur [°C];Außentemperatur;\
            Raum 1 Ventil;Raum 2 Ventil;Globalstrahlung W/m²;Zähler";
        let row = |day: u32| format!("{day:02}.01.2026 12:00;21,5;20,1;22,3;-3,2;0,4;0,5;130,5;7");
        let text = format!("{head}\n{}\n{}\n", row(30), row(31));
        let reading = read(&text);
        assert_eq!(
            channels(&reading),
            [
                ("Raum 1 Temperatur (°C)", Some("T_room"), "degC", Some("raum_1")),
                ("Raum 2 Temperatur (°C)", Some("T_room"), "degC", Some("raum_2")),
                ("Wohnzimmertemperatur [°C]", Some("T_room"), "degC", Some("wohnzimmer")),
                ("Außentemperatur", Some("T_out"), "degC", None),
                ("Raum 1 Ventil", Some("valve"), "-", Some("raum_1")),
                ("Raum 2 Ventil", Some("valve"), "-", Some("raum_2")),
                ("Globalstrahlung W/m²", Some("irradiance"), "W/m2", None),
                ("Zähler", None, "-", None),
            ]
        );
        assert_eq!((reading.rows, reading.asks.len()), (2, 0));
    }

    #[test]
    fn rooms_keep_their_columns_where_one_name_is_a_part_of_another() {
        let reading = read(
            "time,Bad Temperatur,Bad Gäste Temperatur,Bad Gäste Ventil,Bad Ventil\n\
            2026-01-01T00:00:00Z,21,20,0.5,0.4\n",
        );
        let rooms: Vec<_> =
            channels(&reading).into_iter().map(|(_, channel, _, room)| (channel, room)).collect();
        assert_eq!(
            rooms,
            [
                (Some("T_room"), Some("bad")),
                (Some("T_room"), Some("bad_gaeste")),
                (Some("valve"), Some("bad_gaeste")),
                (Some("valve"), Some("bad")),
            ]
        );
    }

    #[test]
    fn one_bad_room_leaves_the_others_their_neighbours() {
        let row = |hour: i64| {
            let (day, warm) = (hour / 24, 20.0 + (hour as f64 / 3.0).sin() + (hour as f64 / 50.0).sin());
            let stamp = format!("{:02}.01.2026 {:02}:00", day + 1, hour % 24);
            format!("{stamp};{warm:.2};{:.2};{}\n", warm + 1.0, if hour % 2 == 0 { "-" } else { "kaputt" })
        };
        let rows: String = (0..10 * 24).map(row).collect();
        let head = "Zeit;Bad Temperatur;Flur Temperatur;Keller Temperatur";
        let reading = read_file(format!("{head}\n{rows}").as_bytes(), &DialectAsked::default()).unwrap();
        assert_eq!(reading.asks, ["zone"]);
        assert_eq!((reading.columns[2].samples, reading.columns[2].odd), (0, 120));
        let pairs: Vec<&[String; 2]> = reading.neighbours.iter().map(|pair| &pair.rooms).collect();
        assert_eq!(pairs, [&["bad".to_owned(), "flur".to_owned()]]);
    }

    #[test]
    fn rejected_rows_are_those_of_an_upload() {
        let good: String = (10..40).map(|minute| format!("2026-01-01T00:{minute}:00Z,21\n")).collect();
        let text = format!("time,T_room\n\n{good}2026-01-01T00:39:00Z,21\n2026-01-01T00:40:00Z\n");
        let found: Vec<_> = read(&text).rejected.into_iter().map(|rows| (rows.line, rows.reason)).collect();
        let (_, report) = Window::parse_csv(&text, &crate::data::ColumnBindings::none()).unwrap();
        let wanted: Vec<_> = report.rejected_rows.into_iter().map(|row| (row.line, row.reason)).collect();
        assert_eq!(found, wanted);
        assert_eq!(found.len(), 2);
    }

    #[test]
    fn units_follow_the_values_where_no_header_says_them() {
        let reading = read("time,T_room,T_out,P_heater,valve\n2026-01-01T00:00:00Z,70,41,1200,40\n");
        let units: Vec<&str> = reading.columns.iter().map(|column| column.unit.as_str()).collect();
        assert_eq!(units, ["degF", "degC", "W", "pct"]);
    }
}
