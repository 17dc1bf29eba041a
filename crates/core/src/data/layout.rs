//! Which sensors are probably in one room, and which rooms are probably neighbours: the layout of a building
//! from the correlations of its temperatures, where nobody has its plan (thesis 7.3).
//!
//! The thesis takes the Pearson correlation of the interpolated temperatures themselves over two weeks:
//! sensors that reach 0.96 are one room, of which one sensor is kept; rooms above 0.5 are neighbours.
//! Temperatures alone mislead, though: rooms far apart drift together with the weather and the heating curve,
//! and a common drift of a few kelvins drowns what tells them apart. Steps from sample to sample are no
//! better: at ten minutes they are mostly the sensor's noise and resolution. So a pair is judged twice, by
//! the temperatures and by what remains when the mean of the surrounding day is taken out, and the smaller of
//! the two correlations counts: one room must drift together and move together within the day.
//!
//! A correlation proposes, it does not prove. Two sensors of one measured office correlate by no more than
//! 0.75, as much as either does with the office next door: what is not proposed is not excluded.

use super::duration::DAY;
use super::seconds::Seconds;
use serde::Serialize;
use utoipa::ToSchema;

use super::channel::{ChannelKind, is_temperature};
use super::grid::Grid;
use super::resample::{DEFAULT_MAX_GAP_STEPS, interpolated};
use super::series::{Series, median_of};
use super::stamp::rfc3339;
use super::window::Window;
use crate::fault::Fault;

/// Sensors that correlate at least so much are proposed as one room.
pub const SAME_ROOM: f64 = 0.96;
/// Rooms that correlate by more are proposed as neighbours.
pub const NEIGHBOUR: f64 = 0.5;

/// Two sensors that have less time in common are not compared.
const LEAST_COMMON: i64 = 3 * DAY;
/// A shorter window has too little in common after the days at its ends are spent on their means.
const LEAST_SPAN: i64 = 4 * DAY;
/// Fewer common samples than this tell nothing, however far apart they are.
const LEAST_SAMPLES: usize = 50;
/// Finer or longer records are read at a longer step: five weeks at five minutes.
const MOST_POINTS: i64 = 10_080;
/// More sensors than a building of this service has; it bounds the work.
const MOST_SENSORS: usize = 200;
/// A sensor that moves by less, in its unit, does not move.
const STILL: f64 = 1e-6;

/// A proposal. Nothing follows from it until somebody confirms it.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = LayoutProposal)]
pub struct Layout {
    /// What was found, in sentences.
    pub summary: String,
    /// The rooms, in the order of their first sensor.
    pub rooms: Vec<Room>,
    /// Pairs of rooms, the most alike first.
    pub neighbours: Vec<LayoutPair>,
    /// The sensors, in the order of the rows and columns of the matrices.
    pub sensors: Vec<Sensor>,
    /// What counts: the smaller of `levels` and `daily`. `None` where two sensors have too little in common.
    pub correlation: Vec<Vec<Option<f64>>>,
    /// Correlations of the temperatures, as in the thesis.
    pub levels: Vec<Vec<Option<f64>>>,
    /// Correlations of the temperatures without the mean of the surrounding day.
    pub daily: Vec<Vec<Option<f64>>>,
    /// The step of the samples that were compared, in seconds.
    pub step_s: Seconds,
    /// The first sample, RFC 3339.
    #[schema(format = DateTime)]
    pub from: String,
    /// The last sample.
    #[schema(format = DateTime)]
    pub to: String,
    /// Channels that are no sensors of rooms.
    pub left_out: Vec<LeftOut>,
}

/// Sensors that are probably in one room.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = LayoutRoom)]
pub struct Room {
    /// A name that a system could have.
    pub id: String,
    /// Its sensors.
    pub sensors: Vec<String>,
    /// The one with the most samples: the one to bind.
    pub representative: String,
    /// The lowest correlation of two of its sensors; `None` for a single sensor.
    pub correlation: Option<f64>,
}

/// Two rooms that are probably neighbours.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct LayoutPair {
    /// The ids of the rooms.
    pub rooms: [String; 2],
    /// The correlation of their representatives.
    pub correlation: f64,
    /// Samples that both representatives have.
    pub samples: usize,
}

/// A sensor that was compared.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
#[schema(as = LayoutSensor)]
pub struct Sensor {
    /// Its channel.
    pub channel: String,
    /// Its samples on the common grid.
    pub samples: usize,
}

/// A channel that was not compared.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
#[schema(as = LayoutLeftOut)]
pub struct LeftOut {
    /// Its name.
    pub channel: String,
    /// Why, as the end of a sentence.
    pub reason: String,
}

type Matrix = Vec<Vec<Option<f64>>>;

/// Proposes rooms and neighbours from the temperatures of many sensors, whatever their names.
///
/// Channels in another unit, channels that are outdoors by their name, and sensors that never move are left
/// out.
///
/// # Errors
/// Faults where fewer than two sensors or more than 200 remain, or no two of them have three days in common.
pub fn propose_layout(window: &Window) -> Result<Layout, Vec<Fault>> {
    let (mut sensors, mut left_out) = (Vec::new(), Vec::new());
    for series in window.iter() {
        match unsuitable(series) {
            Some(reason) => left_out.push(LeftOut { channel: series.channel().to_owned(), reason }),
            None => sensors.push(series),
        }
    }
    if !(2..=MOST_SENSORS).contains(&sensors.len()) {
        let reasons: Vec<String> =
            left_out.iter().take(20).map(|one| format!("`{}`: {}", one.channel, one.reason)).collect();
        let detail = format!("{} temperature sensors; 2 to {MOST_SENSORS} can be compared", sensors.len());
        let fault = Fault::new("/values", "sensor-count", detail);
        return Err(vec![if reasons.is_empty() {
            fault
        } else {
            fault.suggest(format!("left out: {}", reasons.join("; ")))
        }]);
    }
    let grid = common_grid(&sensors)?;
    let levels: Vec<Vec<Option<f64>>> =
        sensors.iter().map(|series| interpolated(series, &grid, DEFAULT_MAX_GAP_STEPS)).collect();
    let daily: Vec<Vec<Option<f64>>> = levels.iter().map(|values| without_day(values, grid.step())).collect();
    let (by_level, by_day) = (matrix(&levels, grid.step()), matrix(&daily, grid.step()));
    let smaller = |a: &Option<f64>, b: &Option<f64>| a.zip(*b).map(|(a, b)| a.min(b));
    let correlation: Matrix = by_level
        .iter()
        .zip(&by_day)
        .map(|(a, b)| a.iter().zip(b).map(|(a, b)| smaller(a, b)).collect())
        .collect();
    let judged = |a: usize| (0..a).any(|b| correlation[a][b].is_some());
    if !(1..sensors.len()).any(judged) {
        let detail = "no two sensors have three days of moving temperatures in common";
        return Err(vec![
            Fault::new("/values", "window-too-short", detail).suggest("send two weeks or more"),
        ]);
    }
    let samples = |index: usize| levels[index].iter().flatten().count();
    let sensors: Vec<Sensor> = sensors
        .iter()
        .enumerate()
        .map(|(index, series)| Sensor { channel: series.channel().to_owned(), samples: samples(index) })
        .collect();

    let groups = groups(&correlation);
    let heads: Vec<usize> = groups.iter().map(|group| representative(group, &sensors)).collect();
    let ids = ids(heads.iter().map(|head| sensors[*head].channel.as_str()));
    let rooms: Vec<Room> = groups
        .iter()
        .zip(&heads)
        .zip(&ids)
        .map(|((group, head), id)| room(id, group, *head, &sensors, &correlation))
        .collect();
    let mut neighbours = Vec::new();
    for a in 0..heads.len() {
        for b in a + 1..heads.len() {
            if let Some(correlation) = correlation[heads[a]][heads[b]].filter(|found| *found > NEIGHBOUR) {
                let both = levels[heads[a]]
                    .iter()
                    .zip(&levels[heads[b]])
                    .filter(|(a, b)| a.is_some() && b.is_some())
                    .count();
                neighbours.push(LayoutPair {
                    rooms: [ids[a].clone(), ids[b].clone()],
                    correlation,
                    samples: both,
                });
            }
        }
    }
    neighbours.sort_by(|a, b| b.correlation.total_cmp(&a.correlation));
    let mut layout = Layout {
        summary: String::new(),
        rooms,
        neighbours,
        sensors,
        correlation,
        levels: by_level,
        daily: by_day,
        step_s: Seconds::of_millis(grid.step()),
        from: rfc3339(grid.start()),
        to: rfc3339(grid.time(grid.len().saturating_sub(1))),
        left_out,
    };
    layout.summary = summary(&layout, grid.len() as f64 * grid.step() as f64 / DAY as f64);
    Ok(layout)
}

/// Why a channel is no sensor of a room, if it is none.
fn unsuitable(series: &Series) -> Option<String> {
    let name = series.channel();
    // A column of an unknown name without a unit is taken for what its sender says that it is.
    let nameless = series.unit() == "-" && ChannelKind::of_name(name).is_none();
    if !is_temperature(series.unit()) && !nameless {
        return Some(format!("it is in {}, no temperature", series.unit()));
    }
    let lower = name.to_ascii_lowercase();
    let plain = lower.strip_prefix("t_").unwrap_or(&lower);
    if plain.starts_with("out") || plain.starts_with("forward") || plain.starts_with("ambient") {
        return Some("by its name it is not in a room".to_owned());
    }
    let (low, high) = series
        .values()
        .iter()
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (value.min(low), value.max(high)));
    (high - low < STILL).then(|| "it never moves".to_owned())
}

/// The grid on which all sensors are compared: at their median step, over the time that any of them covers.
fn common_grid(sensors: &[&Series]) -> Result<Grid, Vec<Fault>> {
    let from = sensors.iter().map(|series| series.from()).min().unwrap_or_default();
    let to = sensors.iter().map(|series| series.to()).max().unwrap_or_default();
    if to - from < LEAST_SPAN {
        let detail = format!(
            "the window covers {:.1} days; correlations of rooms need four at least",
            (to - from) as f64 / DAY as f64
        );
        return Err(vec![Fault::new("/time", "window-too-short", detail).suggest("send two weeks or more")]);
    }
    let steps: Vec<i64> = sensors.iter().filter_map(|series| series.median_step()).collect();
    let own = median_of(steps).unwrap_or(DAY);
    // A multiple of the sensors' own step meets their samples.
    let step = own * ((to - from) / MOST_POINTS / own + 1);
    Grid::new(from, step, ((to - from) / step + 1) as usize).map_err(|fault| vec![fault])
}

/// The values without the mean of the surrounding day, where three quarters of that day are measured: a mean
/// of one side only, as at the ends of a record, would leave the drift in.
fn without_day(values: &[Option<f64>], step: i64) -> Vec<Option<f64>> {
    let half = (DAY / 2 / step) as usize;
    let (mut sums, mut counts) = (vec![0.0], vec![0usize]);
    for value in values {
        sums.push(sums[sums.len() - 1] + value.unwrap_or(0.0));
        counts.push(counts[counts.len() - 1] + usize::from(value.is_some()));
    }
    let remains = |(index, value): (usize, &Option<f64>)| {
        let (first, end) = (index.saturating_sub(half), (index + half + 1).min(values.len()));
        let count = counts[end] - counts[first];
        let is_measured = 4 * count >= 3 * (2 * half + 1);
        value.filter(|_| is_measured).map(|value| value - (sums[end] - sums[first]) / count as f64)
    };
    values.iter().enumerate().map(remains).collect()
}

/// The correlations of all pairs.
fn matrix(signals: &[Vec<Option<f64>>], step: i64) -> Matrix {
    let mut matrix = vec![vec![None; signals.len()]; signals.len()];
    for a in 0..signals.len() {
        for b in 0..a {
            matrix[a][b] = pearson(&signals[a], &signals[b], step);
            matrix[b][a] = matrix[a][b];
        }
        matrix[a][a] = Some(1.0);
    }
    matrix
}

/// The correlation over the samples that both have, if those are enough and both move.
fn pearson(a: &[Option<f64>], b: &[Option<f64>], step: i64) -> Option<f64> {
    let both = || a.iter().zip(b).filter_map(|(a, b)| a.zip(*b));
    let count = both().count();
    if count < LEAST_SAMPLES || (count as i64).saturating_mul(step) < LEAST_COMMON {
        return None;
    }
    let n = count as f64;
    let (sum_a, sum_b) = both().fold((0.0, 0.0), |(sum_a, sum_b), (a, b)| (sum_a + a, sum_b + b));
    let (mean_a, mean_b) = (sum_a / n, sum_b / n);
    let (mut aa, mut bb, mut ab) = (0.0, 0.0, 0.0);
    for (a, b) in both() {
        let (a, b) = (a - mean_a, b - mean_b);
        (aa, bb, ab) = (aa + a * a, bb + b * b, ab + a * b);
    }
    let still = STILL * STILL * n;
    let correlation = ab / (aa.sqrt() * bb.sqrt());
    (aa > still && bb > still && correlation.is_finite()).then(|| correlation.clamp(-1.0, 1.0))
}

/// Groups of which every pair reaches [`SAME_ROOM`] (complete linkage), the most alike first: a chain of
/// sensors each of which resembles the next is no room.
fn groups(correlation: &Matrix) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = (0..correlation.len()).map(|index| vec![index]).collect();
    let link = |a: &[usize], b: &[usize]| {
        let pairs = a.iter().flat_map(|a| b.iter().map(move |b| correlation[*a][*b]));
        pairs.map(|pair| pair.unwrap_or(-1.0)).fold(1.0, f64::min)
    };
    loop {
        let mut best: Option<(f64, usize, usize)> = None;
        for a in 0..groups.len() {
            for b in a + 1..groups.len() {
                let found = link(&groups[a], &groups[b]);
                if found >= SAME_ROOM && best.is_none_or(|(best, ..)| found > best) {
                    best = Some((found, a, b));
                }
            }
        }
        let Some((_, a, b)) = best else { return groups };
        let joined = groups.remove(b);
        groups[a].extend(joined);
        groups[a].sort_unstable();
    }
}

/// The sensor of a group with the most samples, the first one among equals.
fn representative(group: &[usize], sensors: &[Sensor]) -> usize {
    group.iter().copied().fold(group[0], |best, index| {
        if sensors[index].samples > sensors[best].samples { index } else { best }
    })
}

fn room(id: &str, group: &[usize], head: usize, sensors: &[Sensor], correlation: &Matrix) -> Room {
    let pairs = group
        .iter()
        .flat_map(|a| group.iter().filter(move |b| *b < a).filter_map(move |b| correlation[*a][*b]));
    Room {
        id: id.to_owned(),
        sensors: group.iter().map(|index| sensors[*index].channel.clone()).collect(),
        representative: sensors[head].channel.clone(),
        correlation: pairs.reduce(f64::min),
    }
}

/// Names that systems could have, each once: `kitchen` from `T_kitchen`, `12` from `T_room_12`.
fn ids<'a>(channels: impl Iterator<Item = &'a str>) -> Vec<String> {
    let mut ids: Vec<String> = Vec::new();
    for channel in channels {
        let tail =
            ["T_room_", "T_"].iter().find_map(|prefix| channel.strip_prefix(prefix)).unwrap_or(channel);
        let plain: String = tail
            .chars()
            .take(48)
            .map(|c| if c.is_ascii_alphanumeric() || c == '_' { c } else { '-' })
            .collect();
        let plain = plain.trim_matches('-');
        let stem = if plain.is_empty() { "room" } else { plain };
        let mut id = stem.to_owned();
        let mut number = 2;
        while ids.contains(&id) {
            id = format!("{stem}-{number}");
            number += 1;
        }
        ids.push(id);
    }
    ids
}

fn summary(layout: &Layout, days: f64) -> String {
    const MOST_NAMED: usize = 12;
    let mut text = format!(
        "{} sensors over {days:.1} days look like {} rooms.",
        layout.sensors.len(),
        layout.rooms.len()
    );
    let list = |mut all: Vec<String>| {
        let more = all.len().saturating_sub(MOST_NAMED);
        all.truncate(MOST_NAMED);
        if more > 0 { format!("{} and {more} more", all.join(", ")) } else { all.join(", ") }
    };
    let groups = layout
        .rooms
        .iter()
        .filter_map(|room| Some(format!("{} ({:.2})", room.sensors.join(" and "), room.correlation?)));
    let groups: Vec<String> = groups.collect();
    if !groups.is_empty() {
        text += &format!(" Probably in one room: {}.", list(groups));
    }
    let pairs: Vec<String> = layout
        .neighbours
        .iter()
        .map(|pair| format!("{} ({:.2})", pair.rooms.join(" and "), pair.correlation))
        .collect();
    text += &if pairs.is_empty() {
        " No two rooms look like neighbours.".to_owned()
    } else {
        format!(" Probably neighbours: {}.", list(pairs))
    };
    let (mut apart, mut unjudged) = (Vec::new(), 0);
    for a in 0..layout.sensors.len() {
        for b in a + 1..layout.sensors.len() {
            match (layout.levels[a][b], layout.daily[a][b]) {
                (Some(level), Some(day)) if level >= SAME_ROOM && day < SAME_ROOM => {
                    apart.push(format!(
                        "{} and {} ({level:.2}, {day:.2})",
                        layout.sensors[a].channel, layout.sensors[b].channel
                    ));
                }
                (Some(_), Some(_)) => {}
                _ => unjudged += 1,
            }
        }
    }
    if !apart.is_empty() {
        text += &format!(
            " These drift together but move differently within the day, and were kept apart: {}.",
            list(apart)
        );
    }
    if unjudged > 0 {
        text += &format!(" {unjudged} pairs have too little in common to be compared.");
    }
    text + " Nothing is stored or bound: compare it with the plan of the building."
}
