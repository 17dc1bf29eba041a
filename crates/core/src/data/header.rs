//! From the columns of a file to channels: `T_room[degC]`, `P_heater_W`, `T_out[degC](forecast)`, and
//! bindings such as `T_room=T_indoor_degC`.

use indexmap::IndexMap;
use std::borrow::Cow;

use super::bindings::ColumnBindings;
use super::channel::{ChannelKind, KNOWN, canonical_unit, means_same_quantity};
use super::role::{ColumnRole, marked};
use crate::fault::{Fault, nearest, shown};
use crate::units::Unit;

/// More columns than any building automation export has; it bounds the work on a hostile header.
pub(super) const MAX_COLUMNS: usize = 1_000;
/// The bytes of a column's name.
pub(super) const MAX_NAME: usize = 128;

/// Unit suffixes of column names, with the unit texts that they stand for; a longer one comes before its own
/// tail.
const SUFFIXES: &[(&str, &str)] = &[
    ("_kW_m2", "kW/m2"),
    ("_W_m2", "W/m2"),
    ("_mol_m3", "mol/m3"),
    ("_mg_l", "mg/l"),
    ("_g_m3", "g/m3"),
    ("_km_h", "km/h"),
    ("_m3_d", "m3/d"),
    ("_m3_h", "m3/h"),
    ("_m_s", "m/s"),
    ("_degC", "degC"),
    ("_degF", "degF"),
    ("_deg", "deg"),
    ("_ppm", "ppm"),
    ("_pct", "pct"),
    ("_frac", "-"),
    ("_kW", "kW"),
    ("_MW", "MW"),
    ("_W", "W"),
    ("_K", "K"),
];

/// The end of a column name that says: the unit is not stated on purpose.
const RAW: &str = "_raw";

/// Unit texts to suggest for a slip of the pen.
const COMMON_UNITS: &[&str] = &[
    "degC", "degF", "K", "W", "kW", "MW", "W/m2", "kW/m2", "m/s", "km/h", "ppm", "pct", "deg", "g/m3",
    "mol/m3", "m3/d", "m3/h", "people", "-",
];

/// What a column says about its unit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ColumnUnit {
    /// A unit text, in brackets, by suffix or in the `channels` of a JSON window.
    Stated(String),
    /// Nothing: the channel's own unit is meant.
    Unstated,
    /// The name ends in `_raw`: nobody knows the unit. Such a column is neither converted nor judged for
    /// plausibility.
    Raw,
}

/// A column header, taken apart.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ColumnHeader {
    /// The header as written, without surrounding blanks.
    pub column: String,
    /// The name without unit: the channel that an unbound column is taken for.
    pub channel: String,
    /// What it says about its unit.
    pub unit: ColumnUnit,
    /// What its values are, where they are no measurements.
    pub role: Option<ColumnRole>,
}

impl ColumnHeader {
    /// Takes a header apart.
    ///
    /// A bracket is the last word: in `T_out_W[degC]` the `_W` belongs to the name. Without one a known
    /// suffix, or a known unit in parentheses, is the unit and no part of the name. Only a role stands behind
    /// both, in parentheses.
    pub fn parse(header: &str) -> Self {
        let column = unshielded(header.trim());
        let (named, role) = marked(column);
        let (channel, unit) = match named.strip_suffix(']').and_then(|open| open.rsplit_once('[')) {
            Some((name, unit)) => (name.trim(), ColumnUnit::Stated(canonical_unit(unit.trim()).to_owned())),
            None => match split_suffix(named).or_else(|| split_parentheses(named)) {
                Some((name, unit)) => (name, ColumnUnit::Stated(unit.to_owned())),
                None if named.len() > RAW.len() && named.ends_with(RAW) => (named, ColumnUnit::Raw),
                None => (named, ColumnUnit::Unstated),
            },
        };
        Self { column: column.to_owned(), channel: channel.to_owned(), unit, role }
    }

    /// Whether a binding to this name means this column: a role is no part of it, and a binding may state the
    /// unit of a column that does not (`T_aussen[degC]`). A column in another unit is another one.
    pub fn is_named(&self, column: &str) -> bool {
        let is = |name: &str| self.column == name || marked(&self.column).0 == name || self.channel == name;
        let is_silent = !matches!(self.unit, ColumnUnit::Stated(_));
        is(column)
            || stated(column).is_some_and(|said| is(&said.channel) && (is_silent || self.unit == said.unit))
    }

    /// A header whose unit is stated elsewhere (in the `channels` of a JSON window), so that the name stands
    /// as it is.
    pub(super) fn with_unit(name: &str, unit: &str) -> Self {
        let name = name.trim();
        Self {
            column: name.to_owned(),
            channel: name.to_owned(),
            unit: ColumnUnit::Stated(canonical_unit(unit.trim()).to_owned()),
            role: None,
        }
    }
}

/// A bound column that states a unit beside its name, in brackets: the end of `P_heater_W` is a part of the
/// name of the column that is meant.
fn stated(column: &str) -> Option<ColumnHeader> {
    marked(column).0.ends_with(']').then(|| ColumnHeader::parse(column))
}

/// What spreadsheets take for the beginning of a formula.
const FORMULA: [char; 4] = ['=', '+', '-', '@'];
/// What keeps a text from being one.
const SHIELD: char = '\'';

/// A header as it may stand in a table that somebody opens in a spreadsheet: one that looks like a formula
/// begins with an apostrophe, which [`ColumnHeader::parse`] takes away again.
pub(super) fn shielded(header: &str) -> Cow<'_, str> {
    if header.trim_start_matches(SHIELD).trim_start().starts_with(FORMULA) {
        Cow::Owned(format!("{SHIELD}{header}"))
    } else {
        Cow::Borrowed(header)
    }
}

fn unshielded(header: &str) -> &str {
    header
        .strip_prefix(SHIELD)
        .filter(|rest| rest.trim_start_matches(SHIELD).trim_start().starts_with(FORMULA))
        .unwrap_or(header)
}

/// The unit that a text of another program states. A number states none: `1` counts sensors, or is a value.
pub(super) fn unit_text(text: &str) -> Option<&str> {
    let text = text.trim();
    let unit = canonical_unit(text);
    (text.parse::<f64>().is_err() && Unit::parse(unit).is_ok()).then_some(unit)
}

/// `Temperatur (°C)`: as other programs state units. `Zone (A)` and `Zone (F)` are zones.
fn split_parentheses(column: &str) -> Option<(&str, &str)> {
    let (name, text) = column.strip_suffix(')')?.rsplit_once('(')?;
    let (name, text) = (name.trim(), text.trim());
    let is_label = text.len() == 1 && text.starts_with(char::is_alphabetic) && !["W", "K"].contains(&text);
    Some((name, unit_text(text)?)).filter(|_| !name.is_empty() && !is_label)
}

fn split_suffix(column: &str) -> Option<(&str, &str)> {
    SUFFIXES.iter().find_map(|(suffix, unit)| {
        let name = column.strip_suffix(suffix)?;
        (!name.is_empty()).then_some((name, *unit))
    })
}

/// A channel that a window will have, and how its values come about.
#[derive(Debug)]
pub(super) struct Target {
    /// Index of the column among the headers.
    pub column: usize,
    /// The name of the channel.
    pub channel: String,
    /// Its unit, hold and plausible range.
    pub kind: ChannelKind,
    /// The unit in which the column is written.
    pub from: Unit,
    /// The text of `from`.
    pub from_text: String,
    /// The unit of the channel.
    pub to: Unit,
    /// Whether the column says nothing of its unit, so that the channel's own was taken.
    pub assumed: bool,
}

/// Refuses more columns beside the time than a file may have.
pub(super) fn too_many(columns: usize) -> Result<(), Fault> {
    if columns <= MAX_COLUMNS {
        return Ok(());
    }
    let detail = format!("{columns} columns, {MAX_COLUMNS} are the most");
    Err(Fault::new("header", "too-many-columns", detail))
}

/// The channels behind all columns of a file that make sense, and every fault of the others: of columns
/// without a name, in units that do not convert, there twice, or bound although they are not there.
///
/// `pointer` turns a column's name into the place that a fault names: `column T_room` or `/values/T_room`.
pub(super) fn resolve(
    headers: &[ColumnHeader],
    bindings: &ColumnBindings,
    pointer: &dyn Fn(&str) -> String,
    warnings: &mut Vec<String>,
) -> (Vec<Target>, Vec<Fault>) {
    let mut faults = Vec::new();
    if let Err(fault) = too_many(headers.len()) {
        return (Vec::new(), vec![fault]);
    }
    let mut targets: IndexMap<String, Target> = IndexMap::new();
    let mut bound = vec![false; headers.len()];
    for (channel, column) in bindings.iter() {
        let exact = headers.iter().position(|header| header.column == column);
        match exact.or_else(|| headers.iter().position(|header| header.is_named(column))) {
            Some(index) => {
                bound[index] = true;
                let header = match (&headers[index].unit, stated(column)) {
                    (ColumnUnit::Unstated | ColumnUnit::Raw, Some(said)) => {
                        ColumnHeader { unit: said.unit, ..headers[index].clone() }
                    }
                    _ => headers[index].clone(),
                };
                match target(index, channel, &header, pointer, warnings) {
                    Ok(found) => drop(targets.insert(channel.to_owned(), found)),
                    Err(fault) => faults.push(fault),
                }
            }
            None => {
                let detail = format!(
                    "`{}` is bound to a column `{}` that is not there",
                    shown(channel),
                    shown(column)
                );
                let near = nearest(column, headers.iter().map(|header| header.column.as_str()));
                faults.push(with_near(Fault::new("/bind", "unknown-column", detail), near));
            }
        }
    }
    let mut own: IndexMap<&str, &str> = IndexMap::new();
    for (index, header) in headers.iter().enumerate() {
        if let Some(fault) = bad_name(header, &pointer(&shown(&header.column))) {
            faults.push(fault);
        } else if bound[index] {
            continue;
        } else if bindings.column(&header.channel).is_some() {
            warnings
                .push(format!("column `{}` left out: its channel is bound to another column", header.column));
        } else if let Some(first) = own.insert(&header.channel, &header.column) {
            let detail = format!(
                "`{}` and `{}` are both the channel `{}`",
                shown(first),
                shown(&header.column),
                shown(&header.channel)
            );
            faults.push(Fault::new(pointer(&shown(&header.column)), "duplicate-column", detail).suggest(
                format!("rename one of them, or bind one: {0}={1}", shown(&header.channel), shown(first)),
            ));
        } else {
            match target(index, &header.channel, header, pointer, warnings) {
                Ok(found) => drop(targets.insert(header.channel.clone(), found)),
                Err(fault) => faults.push(fault),
            }
        }
    }
    if targets.is_empty() && faults.is_empty() {
        faults.push(Fault::new("header", "no-data-column", "there is no column beside the time"));
    }
    (targets.into_values().collect(), faults)
}

/// The channel that one column feeds.
pub(super) fn target(
    column: usize,
    channel: &str,
    header: &ColumnHeader,
    pointer: &dyn Fn(&str) -> String,
    warnings: &mut Vec<String>,
) -> Result<Target, Fault> {
    let at = || pointer(&shown(&header.column));
    let known = ChannelKind::of_name(channel);
    let unknown_unit = |text: &str| {
        let detail = format!("`{}` is not a known unit", shown(text));
        with_near(Fault::new(at(), "unknown-unit", detail), nearest(text, COMMON_UNITS.iter().copied()))
    };
    let (kind, from_text) = match (&header.unit, known) {
        (ColumnUnit::Stated(text), Some(kind)) => (kind, text.clone()),
        (ColumnUnit::Stated(text), None) => (ChannelKind::of_unit(text), text.clone()),
        (ColumnUnit::Unstated | ColumnUnit::Raw, Some(kind)) => {
            let unit = kind.unit.clone();
            if header.unit == ColumnUnit::Raw {
                warnings.push(format!(
                    "`{}` does not state its unit: its numbers are taken as {unit} and not checked",
                    header.column
                ));
            }
            (kind, unit)
        }
        (ColumnUnit::Unstated | ColumnUnit::Raw, None) => {
            if header.unit == ColumnUnit::Unstated
                && let Some(near) = nearest(channel, KNOWN).filter(|near| near.eq_ignore_ascii_case(channel))
            {
                warnings.push(format!("`{channel}` is not a known channel; `{near}` is"));
            }
            (ChannelKind::of_unit("-"), "-".to_owned())
        }
    };
    let from = Unit::parse(&from_text).map_err(|unknown| unknown_unit(&unknown.0))?;
    let to = Unit::parse(&kind.unit).map_err(|unknown| unknown_unit(&unknown.0))?;
    if !from.same_dimension(&to) || !means_same_quantity(&from_text, &kind.unit) {
        let detail = format!(
            "column `{}` is in {from_text}, which does not convert to the {} of `{}`",
            shown(&header.column),
            kind.unit,
            shown(channel)
        );
        return Err(Fault::new(at(), "inconvertible-unit", detail).suggest(format!(
            "if the end of the name is no unit, say the unit in brackets: {}[{}]",
            shown(&header.column),
            kind.unit
        )));
    }
    let kind = if header.unit == ColumnUnit::Raw { kind.of_any_unit() } else { kind };
    let assumed = header.unit == ColumnUnit::Unstated;
    Ok(Target { column, channel: channel.to_owned(), kind, from, from_text, to, assumed })
}

fn bad_name(header: &ColumnHeader, pointer: &str) -> Option<Fault> {
    if header.channel.is_empty() {
        let detail = "a column has no name";
        return Some(
            Fault::new(pointer, "unnamed-column", detail)
                .suggest("name it, or remove it (a comma at the end of every line makes one)"),
        );
    }
    if header.channel.contains("](") {
        let detail = "behind the unit stands a role, and `(forecast)` is the only one";
        return Some(Fault::new(pointer, "unknown-role", detail).suggest("write T_out[degC](forecast)"));
    }
    let ends_up = header.channel.len() > MAX_NAME || header.channel.chars().any(char::is_control);
    ends_up.then(|| {
        Fault::new(
            pointer,
            "bad-column-name",
            format!("a column name has at most {MAX_NAME} bytes and no control characters"),
        )
    })
}

fn with_near(fault: Fault, near: Option<&str>) -> Fault {
    match near {
        Some(near) => fault.suggest(format!("did you mean `{}`?", shown(near))),
        None => fault,
    }
}

#[cfg(test)]
mod tests {
    use super::{ColumnBindings, ColumnHeader, ColumnRole, ColumnUnit, SUFFIXES, Target, resolve};
    use crate::fault::Fault;
    use crate::units::Unit;
    use proptest::prelude::{any, proptest};

    fn channels(headers: &[&str], binds: &[&str]) -> Result<Vec<Target>, Vec<Fault>> {
        let headers: Vec<ColumnHeader> = headers.iter().map(|header| ColumnHeader::parse(header)).collect();
        let bindings = ColumnBindings::parse(binds.iter().copied())?;
        let (targets, faults) =
            resolve(&headers, &bindings, &|name| format!("column {name}"), &mut Vec::new());
        if faults.is_empty() { Ok(targets) } else { Err(faults) }
    }

    fn codes(result: Result<Vec<Target>, Vec<Fault>>) -> Vec<String> {
        result.unwrap_err().into_iter().map(|fault| fault.code).collect()
    }

    #[test]
    fn headers_come_apart() {
        let parts = |text: &str| {
            let header = ColumnHeader::parse(text);
            (header.channel, header.unit)
        };
        let stated = |name: &str, unit: &str| (name.to_owned(), ColumnUnit::Stated(unit.to_owned()));
        assert_eq!(parts("T_room[degC]"), stated("T_room", "degC"));
        assert_eq!(parts(" T_room [ °C ] "), stated("T_room", "degC"));
        assert_eq!(parts("P_heater_W"), stated("P_heater", "W"));
        assert_eq!(parts("T_out[degC](forecast)"), stated("T_out", "degC"));
        assert_eq!(parts("P_heater_W (forecast)"), stated("P_heater", "W"));
        let role = |text: &str| ColumnHeader::parse(text).role;
        assert_eq!(
            (role("T_out(forecast)"), role("T_out"), role("(forecast)")),
            (Some(ColumnRole::Forecast), None, None)
        );
        assert!(ColumnHeader::parse("T_out_degC(forecast)").is_named("T_out_degC"));
        assert_eq!(codes(channels(&["T_out[degC](forcast)"], &[])), ["unknown-role"]);
        assert_eq!(parts("P_heater_kW"), stated("P_heater", "kW"));
        assert_eq!(parts("ghi_W_m2"), stated("ghi", "W/m2"));
        assert_eq!(parts("wind_speed_m_s"), stated("wind_speed", "m/s"));
        assert_eq!(parts("ventilation_valve_frac"), stated("ventilation_valve", "-"));
        assert_eq!(parts("T_out_W[degC]"), stated("T_out_W", "degC"));
        assert_eq!(parts("Temperatur (°C)"), stated("Temperatur", "degC"));
        assert_eq!(parts("Temperatur (innen)"), ("Temperatur (innen)".to_owned(), ColumnUnit::Unstated));
        for label in ["Temperatur (1)", "Zone (A)", "Zone (F)", "Zone (0.5)"] {
            assert_eq!(parts(label), (label.to_owned(), ColumnUnit::Unstated));
        }
        assert_eq!(parts("Leistung (W)"), stated("Leistung", "W"));
        assert_eq!(parts("Ventil (%)"), stated("Ventil", "pct"));
        assert_eq!(parts("heat_input_raw"), ("heat_input_raw".to_owned(), ColumnUnit::Raw));
        assert_eq!(parts("S_S"), ("S_S".to_owned(), ColumnUnit::Unstated));
        assert_eq!(parts("_W"), ("_W".to_owned(), ColumnUnit::Unstated));
        for (suffix, unit) in SUFFIXES {
            assert!(Unit::parse(unit).is_ok(), "{unit}");
            assert_eq!(
                parts(&format!("x{suffix}")),
                stated("x", unit),
                "no shorter suffix may hide {suffix}"
            );
        }
    }

    #[test]
    fn bound_columns_are_converted_and_not_taken_twice() {
        let found = channels(
            &["T_indoor_degC", "T_outdoor_degC", "P_heater_W", "ghi_W_m2"],
            &["T_room=T_indoor_degC", "T_out=T_outdoor"],
        )
        .unwrap();
        let names: Vec<(&str, &str)> =
            found.iter().map(|target| (target.channel.as_str(), target.kind.unit.as_str())).collect();
        assert_eq!(names, [("T_room", "degC"), ("T_out", "degC"), ("P_heater", "kW"), ("ghi", "W/m2")]);
        let one_for_two = channels(&["T_a"], &["T_room=T_a", "T_forward=T_a"]).unwrap();
        assert_eq!(one_for_two.len(), 2);
        let stated =
            channels(&["Aussen", "Leistung"], &["T_out=Aussen[degF]", "P_heater=Leistung[W]"]).unwrap();
        assert_eq!((stated[0].from_text.as_str(), stated[1].from_text.as_str()), ("degF", "W"));
        let raw = channels(&["heat_input_raw"], &["P_heater=heat_input_raw"]).unwrap();
        assert!(raw[0].kind.is_plausible(1e9));
        assert_eq!(raw[0].kind.unit, "kW");
    }

    #[test]
    fn a_binding_means_no_column_in_another_unit() {
        for (header, bind) in [
            ("P_heater", "P_heater=P_heater_W"),
            ("Leistung (kW)", "P_heater=Leistung[W]"),
            ("T_out[degF]", "T_out=T_out[degC]"),
        ] {
            assert_eq!(codes(channels(&[header], &[bind]))[0], "unknown-column", "{bind}");
        }
        let said = channels(&["heat_raw"], &["P_heater=heat_raw[W]"]).unwrap();
        assert_eq!((said[0].from_text.as_str(), said[0].kind.is_plausible(1e9)), ("W", false));
        let found = channels(&["T_out_degC", "Leistung (W)"], &["T_out=T_out[degC]", "P_heater=Leistung"]);
        assert_eq!(found.unwrap().len(), 2);
    }

    #[test]
    fn every_fault_of_a_header_is_named() {
        assert_eq!(
            codes(channels(&["T_room[furlong]", "T_out_W", ""], &[])),
            ["unknown-unit", "inconvertible-unit", "unnamed-column"]
        );
        assert_eq!(codes(channels(&["T_room", "T_room_degC"], &[])), ["duplicate-column"]);
        assert_eq!(channels(&["T_room", "T_room_degC"], &["T_room=T_room_degC"]).unwrap().len(), 1);
        assert_eq!(codes(channels(&["T_indoor"], &["T_room=T_indor"])), ["unknown-column"]);
        assert_eq!(codes(channels(&[], &[])), ["no-data-column"]);
        assert_eq!(
            codes(channels(&["CO2_degC", "occupancy[deg]"], &[])),
            ["inconvertible-unit", "inconvertible-unit"]
        );
        assert_eq!(
            codes(channels(&["a"], &["T_room", "T_room=a", "T_room=b"])),
            ["bad-binding", "bound-twice"]
        );
        let suggestion = channels(&["T_room[degc]"], &[]).unwrap_err().remove(0).suggestion;
        assert_eq!(suggestion.as_deref(), Some("did you mean `degC`?"));
    }

    proptest! {
        #[test]
        fn no_header_panics(names in proptest::collection::vec(any::<String>(), 0..6), bind in any::<String>()) {
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            let _ = channels(&names, &[&bind]);
        }
    }
}
