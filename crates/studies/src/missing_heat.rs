//! Whether the missing heat holds what was hidden, on synthetic rooms: hours within the bands with the
//! parameters that a room was made with, and events where the heat flows, with those and with fitted ones.

use super::options::Worlds;
use super::row::Row;
use super::twin_room::{TwinRoom, measured, twin_room};
use super::verdicts::judge_all;
use lampyris::cli::Failure;
use lampyris_core::data::SplitRequest;
use lampyris_core::diagnose::missing_heat::{MissingHeat, missing_heat};
use lampyris_core::estimate::{Control, Problem, estimate};
use lampyris_core::twin::{Level, World, WorldRequest, world};
use std::ops::Range;

/// What is hidden, in turns: what flows into the room air.
const HIDDEN: [&str; 11] = [
    "none",
    "stove",
    "laundry",
    "metered_gain",
    "occupancy_gain",
    "oriented_solar_gain",
    "window_opening",
    "wind_infiltration",
    "open_door",
    "direct_outdoor_loss",
    "constant_gain",
];
/// Those that come and go and that nothing measured explains.
const UNLOGGED: [&str; 2] = ["stove", "laundry"];
const DAYS: usize = 21;
/// Heat flows where it is more than this share of its most.
const FLOWS: f64 = 0.25;

/// What was seen of a world with one vector of parameters.
struct Seen {
    hidden: &'static str,
    /// Hours, and those of which the truth lies within the bands of 50 and 95 %.
    hours: [usize; 3],
    /// Events, those where heat flows, the stretches of hidden heat, and those with an event.
    events: [usize; 4],
}

/// Rooms with the parameters that they were made with, and with fitted ones.
pub fn run(asked: &Worlds) -> Result<Vec<Row>, Failure> {
    let (first, worlds, only, each) = asked.parts();
    let worlds: Vec<(u64, &'static str)> = (0..worlds)
        .map(|at| (first * 1_000_000 + at, HIDDEN[at as usize % HIDDEN.len()]))
        .filter(|(_, hidden)| only.is_none_or(|only| hidden.contains(only)))
        .collect();
    let seen = judge_all(&worlds, |(seed, hidden)| judge(*seed, hidden), each.then_some(line))?;
    let (known, fitted): (Vec<Seen>, Vec<Seen>) = seen.into_iter().unzip();
    let mut rows = rows("parameters known", &known);
    rows.extend(self::rows("parameters fitted", &fitted));
    Ok(rows)
}

fn judge(seed: u64, hidden: &'static str) -> Result<(Seen, Seen), Failure> {
    let effects: &[&str] = if hidden == "none" { &[] } else { &[hidden] };
    let made = world(&WorldRequest { days: DAYS, ..WorldRequest::new(seed, effects, Level::Matched) })
        .map_err(|fault| Failure::Error(fault.to_string()))?;
    let room = twin_room(&made, &measured(&made)?, "room3", SplitRequest::DIAGNOSE)?;
    let TwinRoom { asked, problem, .. } = room;
    let mut known = problem.nominal().to_vec();
    for (value, parameter) in known.iter_mut().zip(problem.model().parameters()) {
        if let Some((_, made)) = made.parameters.iter().find(|(name, _)| *name == parameter.name) {
            *value = *made;
        }
    }
    let fit = estimate(&problem, &asked, None, &Control::NONE)
        .map_err(|error| Failure::Error(error.to_string()))?;
    let problem = problem.with_substeps(fit.substeps);
    Ok((seen(&problem, &known, &made, hidden)?, seen(&problem, &fit.theta(), &made, hidden)?))
}

fn seen(problem: &Problem, theta: &[f64], made: &World, hidden: &'static str) -> Result<Seen, Failure> {
    let found =
        missing_heat(problem, theta, None, &|_| false).map_err(|fault| Failure::Error(fault.to_string()))?;
    let samples = (1.0 / problem.grid().step_hours()).round() as usize;
    let by_hour = |series: &[f64]| -> Vec<f64> {
        series.chunks(samples).map(|hour| hour.iter().sum::<f64>() / hour.len() as f64).collect()
    };
    let (heat, household) = (by_hour(&made.hidden_heat), by_hour(&made.household));
    let mut hours = [0; 3];
    for (at, hour) in found.hours.iter().enumerate() {
        if let Some((half, most)) = hour.band_50.zip(hour.band_95) {
            let truth = heat[at] + household[at];
            let holds = |[low, high]: [f64; 2]| usize::from((low..=high).contains(&truth));
            [1, holds(half), holds(most)].iter().zip(&mut hours).for_each(|(one, sum)| *sum += one);
        }
    }
    let events = spans(&found);
    let flows = flowing(&heat);
    let touches = |a: &Range<usize>, b: &Range<usize>| a.start < b.end && b.start < a.end;
    let touching = |these: &[Range<usize>], others: &[Range<usize>]| {
        these.iter().filter(|one| others.iter().any(|other| touches(one, other))).count()
    };
    let events = [events.len(), touching(&events, &flows), flows.len(), touching(&flows, &events)];
    Ok(Seen { hidden, hours, events })
}

/// The hours of each event.
fn spans(found: &MissingHeat) -> Vec<Range<usize>> {
    let place = |from: &str| found.hours.iter().position(|hour| hour.from == from).unwrap_or_default();
    found.events.iter().map(|event| place(&event.from)..place(&event.from) + event.hours).collect()
}

/// The stretches of hours in which hidden heat flows.
fn flowing(heat: &[f64]) -> Vec<Range<usize>> {
    let most = heat.iter().map(|heat| heat.abs()).fold(0.0, f64::max);
    let mut flows: Vec<Range<usize>> = Vec::new();
    for (at, _) in heat.iter().enumerate().filter(|(_, heat)| heat.abs() > FLOWS * most) {
        match flows.last_mut().filter(|last| last.end == at) {
            Some(last) => last.end = at + 1,
            None => flows.push(at..at + 1),
        }
    }
    flows
}

impl Seen {
    /// The harmonic mean of the share of events where heat flows and that of stretches with an event.
    fn f1(&self) -> f64 {
        let [events, right, flows, seen] = self.events.map(|count| count as f64);
        let (precision, recall) = (right / events.max(1.0), seen / flows.max(1.0));
        if precision + recall > 0.0 { 2.0 * precision * recall / (precision + recall) } else { 0.0 }
    }
}

fn line((known, fitted): &(Seen, Seen)) -> String {
    format!(
        "{:<20} known {:?} {:?} F1 {:.2}; fitted F1 {:.2} of {} events",
        known.hidden,
        known.hours,
        known.events,
        known.f1(),
        fitted.f1(),
        fitted.events[0]
    )
}

fn rows(parameters: &str, seen: &[Seen]) -> Vec<Row> {
    let hours: Vec<usize> = (0..3).map(|place| seen.iter().map(|one| one.hours[place]).sum()).collect();
    let share = |of: usize| hours[of] as f64 / hours[0].max(1) as f64;
    let bands = Row::new(format!("{parameters}: hours within their bands of 95 %"), share(2), "");
    let is_known = parameters.ends_with("known");
    let mut rows = vec![
        Row::new(format!("{parameters}: hours within their bands of 50 %"), share(1), ""),
        if is_known { bands.at_least(0.9) } else { bands },
    ];
    for hidden in HIDDEN {
        let these: Vec<&Seen> = seen.iter().filter(|one| one.hidden == hidden).collect();
        if these.is_empty() {
            continue;
        }
        let mean = |value: &dyn Fn(&Seen) -> f64| {
            these.iter().map(|one| value(one)).sum::<f64>() / these.len() as f64
        };
        if hidden == "none" {
            let what = format!("{parameters}: events of a room that hides nothing");
            rows.push(Row::new(what, mean(&|one| one.events[0] as f64), "events"));
        } else {
            let f1 = Row::new(format!("{parameters}: {hidden}, F1 of events"), mean(&Seen::f1), "");
            rows.push(if UNLOGGED.contains(&hidden) { f1.at_least(0.7) } else { f1 });
        }
    }
    rows
}
