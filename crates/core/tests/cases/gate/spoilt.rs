//! The ways to spoil measurements.

use super::super::normal;
use lampyris_core::data::DAY;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde::Deserialize;
use std::collections::BTreeMap;

/// A change of one channel, by what the channel is.
#[derive(Debug, Clone, Deserialize)]
pub struct Change {
    pub does: String,
    pub channel: String,
    pub other: Option<String>,
    #[serde(default)]
    pub hours: f64,
    #[serde(default)]
    pub kelvin: f64,
    #[serde(default)]
    pub factor: f64,
    /// Only from the middle on.
    #[serde(default)]
    pub half: bool,
}

type Column = Vec<Option<f64>>;

/// Measurements as columns.
#[derive(Debug, Clone)]
pub struct Table {
    pub names: Vec<String>,
    pub times: Vec<String>,
    columns: Vec<Column>,
}

impl Table {
    pub fn parse(csv: &str) -> Self {
        let mut lines = csv.lines().filter(|line| !line.starts_with('#'));
        let names: Vec<String> = lines.next().unwrap().split(',').skip(1).map(str::to_owned).collect();
        let (mut times, mut columns) = (Vec::new(), vec![Vec::new(); names.len()]);
        for line in lines {
            let mut cells = line.split(',');
            times.push(cells.next().unwrap().to_owned());
            columns.iter_mut().zip(cells).for_each(|(column, cell)| column.push(cell.parse().ok()));
        }
        Self { names, times, columns }
    }

    pub fn csv(&self) -> String {
        let mut csv = format!("time,{}\n", self.names.join(","));
        for (k, time) in self.times.iter().enumerate() {
            csv.push_str(time);
            for column in &self.columns {
                csv.push(',');
                csv.push_str(&column[k].map(|value| format!("{value:.4}")).unwrap_or_default());
            }
            csv.push('\n');
        }
        csv
    }

    /// The rows before one.
    pub fn until(&self, row: usize) -> Self {
        let columns = self.columns.iter().map(|column| column[..row].to_vec()).collect();
        Self { names: self.names.clone(), times: self.times[..row].to_vec(), columns }
    }

    fn place(&self, name: &str) -> Option<usize> {
        self.names.iter().position(|known| known == name || known.starts_with(&format!("{name}[")))
    }

    fn per_day(&self) -> usize {
        let millis = |time: &String| time.parse::<jiff::Timestamp>().unwrap().as_millisecond();
        (DAY / (millis(&self.times[1]) - millis(&self.times[0]))) as usize
    }
}

/// The table with a change from a row on; `None` where it has no such channel.
pub fn apply(
    change: &Change,
    table: &Table,
    other_house: Option<&Table>,
    roles: &BTreeMap<&str, &str>,
    from: usize,
    seed: u64,
) -> Option<Table> {
    let column_of = |role: &str| roles.get(role).copied();
    let named: Vec<&str> = match change.channel.as_str() {
        "inputs" => roles.iter().filter(|(role, _)| **role != "room").map(|(_, column)| *column).collect(),
        role => vec![column_of(role)?],
    };
    let other = match &change.other {
        Some(role) => Some(table.place(column_of(role)?)?),
        None => None,
    };
    let from = if change.half { from + (table.times.len() - from) * 11 / 20 } else { from };
    let mut changed = table.clone();
    let mut dice = Xoshiro256PlusPlus::seed_from_u64(seed);
    for name in named {
        let place = table.place(name)?;
        let column = &table.columns[place][from..];
        let spoilt = match (change.does.as_str(), other) {
            ("swap" | "equal", Some(other))
                if !(name_of_temperature(name) && name_of_temperature(&table.names[other])) =>
            {
                return None;
            }
            ("swap", Some(other)) => {
                changed.columns[other][from..].copy_from_slice(column);
                table.columns[other][from..].to_vec()
            }
            ("equal", Some(other)) => {
                table.columns[other][from..].iter().map(|v| v.map(|v| v + 0.02 * normal(&mut dice))).collect()
            }
            ("other_house", _) => {
                let theirs = other_house?;
                let theirs = &theirs.columns[theirs.place(name)?];
                (from..table.times.len()).map(|k| theirs.get(k).copied().flatten()).collect()
            }
            ("pipe", _) => {
                let pipe = &table.columns[table.place(column_of("heat")?)?][from..];
                // Only water has a temperature that a pipe could have.
                if !name_of_temperature(column_of("heat")?) {
                    return None;
                }
                column.iter().zip(pipe).map(|(room, pipe)| Some(0.3 * (*room)? + 0.7 * (*pipe)?)).collect()
            }
            ("sun", _) => {
                let sun = &table.columns[table.place("sun_altitude")?][from..];
                let cloud = &table.columns[table.place("cloud_cover")?][from..];
                let shine =
                    |k: usize| Some(sun[k]?.to_radians().sin().max(0.0) * (1.0 - 0.75 * cloud[k]?.powf(3.4)));
                (0..column.len()).map(|k| Some(column[k]? + change.kelvin * shine(k)?)).collect()
            }
            // What a power is multiplied by, its gain takes up: that is no fault to a controller which reads
            // the same meter.
            ("fahrenheit" | "offset" | "scale", _) if !name_of_temperature(name) => return None,
            _ => one(change, column, table.per_day(), &mut dice),
        };
        changed.columns[place][from..].copy_from_slice(&spoilt);
    }
    Some(changed)
}

/// The outdoor temperature of a table by another sensor at another wall.
pub fn weather_next_door(table: &Table, seed: u64) -> lampyris_core::data::Window {
    let mut dice = Xoshiro256PlusPlus::seed_from_u64(seed);
    let place = table.place("T_out").unwrap();
    let theirs = table.columns[place].iter().map(|v| v.map(|v| v + 0.5 + 0.4 * normal(&mut dice))).collect();
    let only =
        Table { names: vec![table.names[place].clone()], times: table.times.clone(), columns: vec![theirs] };
    lampyris_core::data::Window::parse_csv(&only.csv(), &lampyris_core::data::ColumnBindings::none())
        .unwrap()
        .0
}

fn name_of_temperature(name: &str) -> bool {
    name.starts_with("T_")
}

fn one(change: &Change, column: &[Option<f64>], per_day: usize, dice: &mut Xoshiro256PlusPlus) -> Column {
    let per_hour = per_day as f64 / 24.0;
    let known = || column.iter().flatten();
    let mean = known().sum::<f64>() / known().count() as f64;
    let first = known().next().copied().unwrap_or(mean);
    let map = |f: &dyn Fn(usize, f64) -> f64| {
        column.iter().enumerate().map(|(k, value)| value.map(|value| f(k, value))).collect()
    };
    match change.does.as_str() {
        "nothing" => column.to_vec(),
        "mirror" => map(&|_, v| 2.0 * mean - v),
        "shuffle" => {
            let mut mixed = column.to_vec();
            shuffle(&mut mixed, dice);
            mixed
        }
        "shuffle_days" => {
            let mut days: Vec<&[Option<f64>]> = column.chunks(per_day).collect();
            let whole = column.len() / per_day;
            shuffle(&mut days[..whole], dice);
            days.concat()
        }
        "reverse" => column.iter().rev().copied().collect(),
        "late" => {
            let (shift, n) = ((change.hours * per_hour) as i64, column.len() as i64);
            (0..n).map(|k| column[(k - shift).clamp(0, n - 1) as usize]).collect()
        }
        "fahrenheit" => map(&|_, v| 1.8 * v + 32.0),
        "offset" => map(&|_, v| v + change.kelvin),
        "scale" => map(&|_, v| v * change.factor),
        "flatten" => map(&|_, v| mean + change.factor * (v - mean)),
        "constant" => map(&|_, _| change.kelvin),
        "hang" => map(&|_, _| first),
        "noise" => column
            .iter()
            .map(|v| v.map(|_| if change.half { first } else { mean } + 0.1 * normal(dice)))
            .collect(),
        "walk" => {
            let mut place = mean;
            column
                .iter()
                .map(|v| {
                    place += 0.3 * normal(dice) / per_hour.sqrt();
                    v.map(|_| place)
                })
                .collect()
        }
        "sine" => map(&|k, v| v + change.kelvin * (std::f64::consts::TAU * k as f64 / per_day as f64).sin()),
        "drift" => map(&|k, v| v + change.kelvin * k as f64 / per_day as f64),
        "dead" => map(&|k, v| if (k / (per_day / 2)).is_multiple_of(5) { -20.0 } else { v }),
        "lag" => {
            let share = 1.0 - (-1.0 / (change.hours * per_hour)).exp();
            let mut shown = first;
            column
                .iter()
                .map(|v| {
                    shown += v.map_or(0.0, |v| share * (v - shown));
                    v.map(|_| shown)
                })
                .collect()
        }
        "spike" => {
            let at = column.len() / 2;
            map(&|k, v| if k == at { v + change.kelvin } else { v })
        }
        "coarse" => map(&|_, v| (2.0 * v).round() / 2.0),
        unknown => panic!("nobody knows how to {unknown}"),
    }
}

fn shuffle<T>(values: &mut [T], dice: &mut Xoshiro256PlusPlus) {
    for i in (1..values.len()).rev() {
        values.swap(i, (dice.random::<f64>() * (i + 1) as f64) as usize);
    }
}
