//! When it is told that a parameter has changed, on synthetic rooms night by night: false alarms in rooms of
//! a year in which nothing changes, and how soon, how rightly and how nearly a step of a conductance is told.

use super::options::Worlds;
use super::row::Row;
use super::twin_room::{TwinRoom, measured, twin_room, watched};
use super::verdicts::judge_all;
use lampyris::cli::{Failure, faults};
use lampyris_core::data::{DAY, SplitRequest, read_time};
use lampyris_core::diagnose::change::{ChangeRecord, THRESHOLD, WINDOW_DAYS, settled};
use lampyris_core::estimate::assess::metrics::ProcessNoise;
use lampyris_core::estimate::fit::parameter_change::ParameterChange;
use lampyris_core::estimate::{Control, estimate};
use lampyris_core::twin::{ChangedParameter, Level, WorldRequest, world};
use std::ops::Range;

/// What changes, in turns.
const KINDS: [&str; 5] = ["quiet", "alpha_h", "alpha_a", "alpha_e", "alpha_w"];
/// The conductances that the bar is about: floor to room, and envelope to outdoors.
const JUDGED: [&str; 2] = ["alpha_h", "alpha_a"];
/// What a conductance is multiplied by, on the day behind so many.
const FACTOR: f64 = 1.2;
const DAY_OF_CHANGE: usize = 50;
/// For so many nights behind it the room is watched.
const WATCHED: usize = 28;
/// Nights until a change is to be told.
const SOON: f64 = 7.0;
/// Days of a quiet room, and those that are fitted.
const YEAR: usize = 365;
const FITTED: i64 = 28;
/// The first night that is looked at, by the days of its record.
const FIRST_NIGHT: usize = 21;
/// An alarm within so many days of one that was told is none of its own.
const SAME: usize = 28;

/// What the nights of one room came to.
struct Watched {
    kind: &'static str,
    level: Level,
    nights: usize,
    /// Alarms in nights before anything changed.
    false_alarms: usize,
    /// The largest statistic of those.
    largest: f64,
    /// The night behind the change in which it was told, and what.
    told: Option<(usize, Told)>,
}

/// What was told of a change.
#[derive(Clone, Copy)]
struct Told {
    /// Whether the parameter is the one, and whether it is told at least beside another.
    is_right: bool,
    is_among: bool,
    /// Days between the truth and the likeliest day, and whether the truth lies between the days told.
    days_off: f64,
    holds_day: bool,
    /// Whether the interval of the size holds the truth.
    holds_size: bool,
}

/// Rooms of a year in which nothing changes, and rooms with a step.
pub fn run(asked: &Worlds) -> Result<Vec<Row>, Failure> {
    let (first, worlds, only, each) = asked.parts();
    let name = |level: Level| if level == Level::Matched { "matched" } else { "rich" };
    let worlds: Vec<(u64, &'static str, Level)> = (0..worlds)
        .map(|at| {
            let turn = at as usize / KINDS.len();
            let level = if turn.is_multiple_of(2) { Level::Matched } else { Level::Rich };
            (first * 1_000_000 + at, KINDS[at as usize % KINDS.len()], level)
        })
        .filter(|(_, kind, level)| only.is_none_or(|only| format!("{} {kind}", name(*level)).contains(only)))
        .collect();
    let watched = judge_all(&worlds, |world| watch(*world), each.then_some(line))?;
    let mut rows = quiet(&watched);
    let all: Vec<&Watched> = watched.iter().filter(|one| JUDGED.contains(&one.kind)).collect();
    if !all.is_empty() {
        let what = format!("either of {} x {FACTOR}: nights until told, median", JUDGED.join(", "));
        let delays = delays(&all);
        rows.push(Row::new(what, delays[delays.len() / 2], "nights").at_most(SOON));
    }
    for kind in &KINDS[1..] {
        let these: Vec<&Watched> = watched.iter().filter(|one| one.kind == *kind).collect();
        if !these.is_empty() {
            rows.extend(stepped(kind, &these));
        }
    }
    Ok(rows)
}

fn watch((seed, kind, level): (u64, &'static str, Level)) -> Result<Watched, Failure> {
    let is_quiet = kind == KINDS[0];
    let days = if is_quiet { YEAR } else { DAY_OF_CHANGE + WATCHED };
    let change = (!is_quiet).then(|| ChangedParameter {
        parameter: kind.to_owned(),
        day: DAY_OF_CHANGE,
        factor: FACTOR,
    });
    let made = world(&WorldRequest { days, change, ..WorldRequest::new(seed, &[], level) })
        .map_err(|fault| Failure::Error(fault.to_string()))?;
    let window = measured(&made)?;
    let fitted = window.slice(window.from(), window.from() + FITTED * DAY).map_err(|found| faults(&found))?;
    let TwinRoom { problem, asked, .. } = twin_room(&made, &fitted, "room3", SplitRequest::ESTIMATE)?;
    let fit = estimate(&problem, &asked, None, &Control::NONE)
        .map_err(|error| Failure::Error(error.to_string()))?;
    // As a night settles on its own weeks before it looks for changes, on those before the first change.
    let weeks = window
        .slice(window.from(), window.from() + WINDOW_DAYS as i64 * DAY)
        .map_err(|found| faults(&found))?;
    let weeks = watched(&made, &weeks, WINDOW_DAYS + 1)?;
    let noise = ProcessNoise::of(&fit);
    let theta = settled(&weeks, &fit.theta(), noise).map_err(|fault| Failure::Error(fault.to_string()))?;
    let problem = watched(&made, &window, days + 1)?;
    let record = ChangeRecord::new(&problem, &theta, noise, WINDOW_DAYS)
        .map_err(|fault| Failure::Error(fault.to_string()))?;
    let mut seen = Watched { kind, level, nights: 0, false_alarms: 0, largest: 0.0, told: None };
    let quiet_until = if is_quiet { days } else { DAY_OF_CHANGE };
    let mut last_alarm: Option<usize> = None;
    for night in FIRST_NIGHT..=quiet_until {
        let found = record.changes(window_of(night));
        seen.nights += 1;
        seen.largest = seen.largest.max(found.largest.unwrap_or(0.0));
        if found.change.is_some() {
            let is_new = last_alarm.is_none_or(|last| night - last > SAME);
            seen.false_alarms += usize::from(is_new);
            last_alarm = Some(night);
        }
    }
    let truth = window.from() + DAY_OF_CHANGE as i64 * DAY;
    for night in quiet_until + 1..=days {
        if let Some(change) = record.changes(window_of(night)).change {
            seen.told = Some((night - DAY_OF_CHANGE, told(&change, kind, truth)?));
            break;
        }
    }
    Ok(seen)
}

/// The days that a night looks at.
fn window_of(night: usize) -> Range<usize> {
    night.saturating_sub(WINDOW_DAYS)..night
}

fn told(change: &ParameterChange, kind: &str, truth: i64) -> Result<Told, Failure> {
    let day = |text: &str| read_time("since", text).map_err(|fault| Failure::Error(fault.to_string()));
    let [first, last] = [day(&change.since_95[0])?, day(&change.since_95[1])?];
    let [low, high] = change.after_95.map(|value| value / change.before);
    let is_right = change.parameter == kind;
    Ok(Told {
        is_right,
        is_among: is_right || change.instead.iter().any(|other| other == kind),
        days_off: (day(&change.since)? - truth) as f64 / DAY as f64,
        holds_day: (first..=last).contains(&truth),
        holds_size: (low..=high).contains(&FACTOR),
    })
}

fn line(one: &Watched) -> String {
    let told = match &one.told {
        None => "nothing told".to_owned(),
        Some((nights, told)) => format!(
            "told after {nights} nights, {:+} days off, {}",
            told.days_off,
            match (told.is_right, told.is_among) {
                (true, _) => "right",
                (false, true) => "among others",
                _ => "of another parameter",
            }
        ),
    };
    format!(
        "{:<8} {:?}: {} false alarms in {} nights, largest {:.2}; {told}",
        one.kind, one.level, one.false_alarms, one.nights, one.largest
    )
}

/// False alarms in all nights before anything changed, with the upper bound of 95 % of a Poisson rate.
fn quiet(watched: &[Watched]) -> Vec<Row> {
    let nights: usize = watched.iter().map(|one| one.nights).sum();
    let alarms: usize = watched.iter().map(|one| one.false_alarms).sum();
    let years = nights as f64 / YEAR as f64;
    let mut largest: Vec<f64> =
        watched.iter().filter(|one| one.kind == KINDS[0]).map(|one| one.largest).collect();
    largest.sort_by(f64::total_cmp);
    let mut rows = vec![
        Row::new(format!("years of rooms in which nothing had changed, told at z >= {THRESHOLD}"), years, ""),
        Row::new("false alarms", alarms as f64, ""),
        Row::new("false alarms a room and year", alarms as f64 / years, "").at_most(1.0),
        Row::new("upper bound of 95 % of that", upper_bound(alarms) / years, ""),
    ];
    if let Some(most) = largest.last() {
        rows.push(Row::new("quiet years: largest z of a year, median", largest[largest.len() / 2], ""));
        rows.push(Row::new("quiet years: largest z of all", *most, ""));
    }
    rows
}

/// The mean of a Poisson distribution of which so few come in five of a hundred cases (Garwood 1936,
/// "Fiducial limits for the Poisson distribution", Biometrika 28).
fn upper_bound(count: usize) -> f64 {
    let at_most = |mean: f64| {
        let mut term = (-mean).exp();
        let mut sum = term;
        for k in 1..=count {
            term *= mean / k as f64;
            sum += term;
        }
        sum
    };
    let (mut low, mut high) = (0.0, 10.0 + 3.0 * count as f64);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        *(if at_most(middle) > 0.05 { &mut low } else { &mut high }) = middle;
    }
    high
}

/// Nights until a change was told, in order.
fn delays(these: &[&Watched]) -> Vec<f64> {
    let nights = |one: &&Watched| one.told.map_or(f64::INFINITY, |(nights, _)| nights as f64);
    let mut delays: Vec<f64> = these.iter().map(nights).collect();
    delays.sort_by(f64::total_cmp);
    delays
}

fn stepped(kind: &str, these: &[&Watched]) -> Vec<Row> {
    let what = format!("{kind} x {FACTOR}");
    let delays = delays(these);
    let found: Vec<Told> = these.iter().filter_map(|one| Some(one.told?.1)).collect();
    let share = |holds: &dyn Fn(&Told) -> bool| {
        found.iter().filter(|told| holds(told)).count() as f64 / found.len().max(1) as f64
    };
    let within =
        |nights: f64| delays.iter().filter(|delay| **delay <= nights).count() as f64 / delays.len() as f64;
    let median = Row::new(format!("{what}: nights until told, median"), delays[delays.len() / 2], "nights");
    let mut off: Vec<f64> = found.iter().map(|told| told.days_off.abs()).collect();
    off.sort_by(f64::total_cmp);
    vec![
        Row::new(format!("{what}: rooms"), these.len() as f64, "rooms"),
        if JUDGED.contains(&kind) { median.at_most(SOON) } else { median },
        Row::new(format!("{what}: told within {SOON} nights"), within(SOON), ""),
        Row::new(format!("{what}: told within {WATCHED} nights"), within(WATCHED as f64), ""),
        Row::new(format!("{what}: the right parameter"), share(&|told| told.is_right), ""),
        Row::new(
            format!("{what}: the right one, or told as one of several"),
            share(&|told| told.is_among),
            "",
        ),
        Row::new(
            format!("{what}: days from the truth, median"),
            off.get(off.len() / 2).copied().unwrap_or(f64::NAN),
            "days",
        ),
        Row::new(format!("{what}: the days told hold the truth"), share(&|told| told.holds_day), ""),
        Row::new(
            format!("{what}: the interval of the size holds it, where right"),
            share(&|told| told.is_right && told.holds_size) / share(&|told| told.is_right).max(1e-9),
            "",
        ),
    ]
}
