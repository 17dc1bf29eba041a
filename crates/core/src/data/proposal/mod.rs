//! What the columns of a file are, proposed from their names and values: channels, units, the rooms that
//! share a file, and which of them are next door. Nothing follows from it until somebody confirms it.

mod words;

use super::bindings::ColumnBindings;
use super::channel::ChannelKind;
use super::dialect::{CsvDialect, DialectAsked, recognise};
use super::header::{ColumnHeader, ColumnUnit};
use super::layout::{NEIGHBOUR, propose_layout};
use super::stamp::{read_stamp, rfc3339};
use super::table::is_no_value;
use super::window::Window;
use crate::fault::Fault;
use crate::units::Unit;
use serde::Serialize;
use utoipa::ToSchema;

/// Rows that are shown as they were read.
const SHOWN: usize = 5;
/// Reasons for rejected rows that are told apart.
const MOST_REASONS: usize = 20;
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
    let text = &found.text;
    let separator = if matches!(text, std::borrow::Cow::Owned(_)) { ',' } else { dialect.separator };
    let mut reader = csv::ReaderBuilder::new()
        .delimiter(separator as u8)
        .flexible(true)
        .comment(Some(b'#'))
        .from_reader(text.trim_start_matches('\u{feff}').as_bytes());
    let headers: Vec<ColumnHeader> =
        reader.headers().map_err(|_| no_table())?.iter().map(ColumnHeader::parse).collect();
    let is_time = |header: &ColumnHeader| {
        ["time", "timestamp"].iter().any(|name| header.column.eq_ignore_ascii_case(name))
    };
    let time = headers.iter().position(is_time).ok_or_else(no_table)?;
    let mut values: Vec<Vec<Option<f64>>> = vec![Vec::new(); headers.len()];
    let (mut times, mut first, mut rejected) = (Vec::new(), Vec::new(), Vec::new());
    for record in reader.records() {
        let record = record.map_err(|_| no_table())?;
        let line = record.position().map_or(0, csv::Position::line);
        let stamp = record.get(time).unwrap_or_default();
        if first.len() < SHOWN {
            first.push(stamp.to_owned());
        }
        // A local time without a zone is one that waits for an answer.
        let read = read_stamp(stamp).or_else(|_| read_stamp(&format!("{stamp}Z")));
        let reason = match read {
            _ if record.len() != headers.len() => Some("it has another number of cells than the header"),
            Err(_) => Some("the time cannot be read"),
            Ok(time) => match times.last() {
                Some(last) if *last == time => Some("the time is the same as that of the row before"),
                Some(last) if *last > time => Some("the time goes backwards"),
                _ => None,
            },
        };
        if let Some(reason) = reason {
            note(&mut rejected, reason, line);
            continue;
        }
        times.extend(read);
        for (column, cell) in record.iter().enumerate() {
            let cell = cell.trim();
            let number = || cell.parse::<f64>().ok().filter(|number| number.is_finite());
            values[column].push(if is_no_value(cell) { None } else { number() });
        }
    }
    let kept: Vec<usize> = (0..headers.len()).filter(|column| *column != time).collect();
    let names: Vec<&ColumnHeader> = kept.iter().map(|column| &headers[*column]).collect();
    let rooms = rooms(&names);
    let mut columns: Vec<ColumnReading> =
        kept.iter().map(|column| column_reading(&headers[*column], &values[*column])).collect();
    assign(&mut columns, &rooms);
    let asks = if dialect.local && dialect.zone.is_none() { vec!["zone".to_owned()] } else { Vec::new() };
    let neighbours = neighbours(body, asked, &rooms);
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

fn note(rejected: &mut Vec<RejectedRows>, reason: &str, line: u64) {
    if let Some(known) = rejected.iter_mut().find(|known| known.reason == reason) {
        known.count += 1;
    } else if rejected.len() < MOST_REASONS {
        rejected.push(RejectedRows { reason: reason.to_owned(), count: 1, line });
    }
}

/// A column by itself: its channel by name, its unit by header or values.
fn column_reading(header: &ColumnHeader, values: &[Option<f64>]) -> ColumnReading {
    let known = ChannelKind::of_name(&header.channel).map(|_| header.channel.clone());
    let channel = known.or_else(|| words::meaning(&header.column).map(str::to_owned));
    let kind = channel.as_deref().and_then(ChannelKind::of_name);
    let present = || values.iter().flatten().copied();
    let (unit, stated) = match (&header.unit, &kind) {
        (ColumnUnit::Stated(unit), _) => (unit.clone(), true),
        (_, Some(kind)) => {
            let values: Vec<f64> = present().collect();
            let found = kind.unit_that_explains(channel.as_deref().unwrap_or_default(), &values);
            (found.unwrap_or(&kind.unit).to_owned(), false)
        }
        (_, None) => ("-".to_owned(), false),
    };
    // A name that says heat, in a unit of temperature, is none of power.
    let fits = kind.as_ref().is_none_or(|kind| {
        Unit::parse(&unit).ok().zip(Unit::parse(&kind.unit).ok()).is_some_and(|(a, b)| a.same_dimension(&b))
    });
    let is_warmth = || ChannelKind::of_unit(&unit).unit == "degC" || unit == "degF" || unit == "K";
    let channel = match channel.filter(|_| fits) {
        Some(channel) => Some(channel),
        None if stated && is_warmth() => Some("T_room".to_owned()),
        None => None,
    };
    ColumnReading {
        column: header.column.clone(),
        channel,
        unit,
        stated,
        room: None,
        samples: present().count(),
        complete: present().count() as f64 / values.len().max(1) as f64,
        min: present().min_by(f64::total_cmp),
        max: present().max_by(f64::total_cmp),
        first: values.iter().take(SHOWN).copied().collect(),
    }
}

/// The rooms of a file with several temperatures of rooms. One that has `T_room` itself is a file of one
/// room, whose neighbours are `T_room_…`.
fn rooms(headers: &[&ColumnHeader]) -> Vec<ProposedRoom> {
    if headers.iter().any(|header| header.channel == "T_room") {
        return Vec::new();
    }
    let is_room = |header: &&&ColumnHeader| {
        let by_name = header.channel.strip_prefix("T_room_").is_some();
        let is_warmth = match &header.unit {
            ColumnUnit::Stated(unit) => ["degC", "degF", "K"].contains(&unit.as_str()),
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

/// Pairs of rooms whose temperatures move together, at most so many for a room; none where too little says
/// so.
fn neighbours(body: &[u8], asked: &DialectAsked, rooms: &[ProposedRoom]) -> Vec<ProposedNeighbours> {
    let only = rooms.iter().map(|room| room.column.clone()).collect();
    let zone = asked.zone.clone().or_else(|| Some("UTC".to_owned()));
    let asked = DialectAsked { only: Some(only), zone, ..asked.clone() };
    let read = || {
        let found = recognise(body, &asked).ok()?;
        let mut bindings = ColumnBindings::none();
        rooms.iter().for_each(|room| bindings.bind(format!("T_room_{}", room.id), room.column.clone()));
        let (window, _) = Window::parse_csv(&found.text, &bindings).ok()?;
        propose_layout(&window).ok()
    };
    let Some(layout) = (rooms.len() > 1).then(read).flatten() else { return Vec::new() };
    let id = |sensor: usize| layout.sensors[sensor].channel["T_room_".len()..].to_owned();
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
    fn units_follow_the_values_where_no_header_says_them() {
        let reading = read("time,T_room,T_out,P_heater,valve\n2026-01-01T00:00:00Z,70,41,1200,40\n");
        let units: Vec<&str> = reading.columns.iter().map(|column| column.unit.as_str()).collect();
        assert_eq!(units, ["degF", "degC", "W", "pct"]);
    }
}
