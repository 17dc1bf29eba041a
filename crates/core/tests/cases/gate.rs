//! Measurements that are spoilt on purpose, one folder each under `gate/`: the gate must stop what would harm
//! a controller, and say which channel is at fault.
//!
//! Harm is measured: a fit to spoilt data is harmful where it forecasts the true data half as badly again as
//! a fit to those, 6 or 24 h ahead. What no gate can see by its nature is listed with what would show it.

mod spoilt;

use super::plants::full;
use super::problem;
use lampyris_core::data::SplitRequest;
use lampyris_core::estimate::assess::metrics::{ahead, filter};
use lampyris_core::estimate::gate::check::Severity;
use lampyris_core::estimate::gate::past::NextDoor;
use lampyris_core::estimate::problem::request::days_before;
use lampyris_core::estimate::validate;
use lampyris_core::estimate::{
    Control, EstimateRequest, Fit, GatePolicy, Incumbent, Judgement, Past, Problem, Site, Verdict, estimate,
};
use lampyris_core::fault::Fault;
use lampyris_core::twin::{Level, WorldRequest, world};
use rayon::prelude::*;
use serde::Deserialize;
use spoilt::{Change, Table};
use std::collections::BTreeMap;

/// What a fit to spoilt data may err more than one to the true data before it harms.
const HARM: f64 = 1.5;
/// Days before the end at which the automatic path finds the measurements spoilt.
const FAULTY_DAYS: i64 = 14;

/// Days of a twin's record, and how many of them a fit sees.
const RECORD_DAYS: usize = 42;
const FIT_DAYS: i64 = 28;

/// A folder's `case.toml`.
#[derive(Debug, Clone, Deserialize)]
struct Case {
    #[serde(flatten)]
    change: Change,
    expect: Expected,
    /// One of these is in the sentence that names the channel.
    #[serde(default)]
    says: Vec<String>,
    /// What would show it where the gate cannot: never, or, of what is expected to be stopped, as long as it
    /// knows no months before.
    shown_by: Option<String>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Expected {
    Stopped,
    Served,
    Undetectable,
}

/// A room whose data are spoilt.
#[derive(Clone)]
struct Room {
    name: String,
    model: &'static str,
    binds: &'static [&'static str],
    /// Columns by what they are: `heat`, `out`, `room`, `neighbour`, `sun`.
    roles: BTreeMap<&'static str, &'static str>,
    table: Table,
    other: Option<Table>,
    site: Site,
    asked: EstimateRequest,
    /// The clean weather, as a neighbour measures it with a sensor of its own.
    next_door: Vec<NextDoor>,
}

fn folders() -> Vec<(String, Case)> {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/cases/gate");
    let read = |entry: std::io::Result<std::fs::DirEntry>| {
        let path = entry.unwrap().path();
        let text = std::fs::read_to_string(path.join("case.toml")).ok()?;
        let case = toml::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        Some((path.file_name().unwrap().to_string_lossy().into_owned(), case))
    };
    let mut folders: Vec<(String, Case)> = std::fs::read_dir(root).unwrap().filter_map(read).collect();
    folders.sort_by(|(one, _), (other, _)| one.cmp(other));
    assert!(folders.iter().filter(|(_, case)| case.expect != Expected::Served).count() >= 60);
    folders
}

fn twin(level: Level, seed: u64) -> Room {
    let made =
        |seed| world(&WorldRequest { days: RECORD_DAYS, ..WorldRequest::new(seed, &[], level) }).unwrap();
    let (own, other) = (made(seed), made(seed + 100_000));
    let table = Table::parse(&own.csv);
    let next_door =
        vec![NextDoor { name: "room/2".to_owned(), weather: spoilt::weather_next_door(&table, seed) }];
    Room {
        name: format!("{level:?} {seed}"),
        model: "room3",
        binds: &[],
        roles: [
            ("heat", "T_forward"),
            ("out", "T_out"),
            ("room", "T_room"),
            ("neighbour", "T_room_1"),
            ("sun", "sun_altitude"),
        ]
        .into(),
        table,
        next_door,
        other: Some(Table::parse(&other.csv)),
        site: Site { sets: [("neighbours".to_owned(), own.neighbours)].into(), ..Site::default() },
        asked: EstimateRequest::default(),
    }
}

/// The hourly house with its heating, and the laundry with its meter.
fn measured() -> [Room; 2] {
    let mut hourly = EstimateRequest::default();
    hourly.bounds.insert("c_P_heater".to_owned(), [0.0, 0.05]);
    [
        Room {
            name: "hourly house".to_owned(),
            model: "tite",
            binds: &["T_room=T_indoor_degC", "T_out=T_outdoor_degC", "P_heater=heat_input_raw"],
            roles: [("heat", "heat_input_raw"), ("out", "T_outdoor_degC"), ("room", "T_indoor_degC")].into(),
            table: Table::parse(include_str!("../../../../config/demo/hourly_house.csv")),
            other: None,
            site: Site::default(),
            asked: hourly,
            next_door: Vec::new(),
        },
        Room {
            name: "laundry".to_owned(),
            model: "rc2+solar_gain+metered_gain:P_appliances",
            binds: &["T_room=T_laundry", "irradiance=irradiance_clear_sky"],
            roles: [
                ("heat", "P_appliances"),
                ("out", "T_out"),
                ("room", "T_laundry"),
                ("sun", "irradiance_clear_sky"),
            ]
            .into(),
            table: Table::parse(include_str!("../../../../config/demo/belgian_house.csv")),
            other: None,
            site: Site::default(),
            asked: EstimateRequest::default(),
            next_door: Vec::new(),
        },
    ]
}

impl Room {
    /// The problem of measurements and the days before it, or the code of the first fault.
    fn problems(&self, table: &Table) -> Result<(Problem, Option<Problem>), String> {
        let code = |faults: Vec<Fault>| faults[0].code.clone();
        let bindings = lampyris_core::data::ColumnBindings::parse(self.binds.iter().copied()).unwrap();
        let (window, _) = lampyris_core::data::Window::parse_csv(&table.csv(), &bindings).map_err(code)?;
        let catalogue = lampyris_core::model::Catalogue::builtin().unwrap();
        let problem = lampyris_core::estimate::prepare(
            &catalogue,
            &self.model.parse().unwrap(),
            &self.asked,
            &window,
            &self.site,
        );
        let problem = problem.map_err(code)?;
        let before = days_before(&catalogue, &self.asked, &window, &self.site, &problem);
        Ok((problem, before))
    }

    /// The row from which on so many days are left.
    fn row(&self, days: i64) -> usize {
        let second = |time: &String| time.parse::<jiff::Timestamp>().unwrap().as_second();
        let times = &self.table.times;
        let since = second(&times[times.len() - 1]) - days * 86_400;
        times.iter().position(|time| second(time) >= since).unwrap()
    }

    /// The channel of the model that a column is.
    fn channel<'a>(&'a self, role: &'a str) -> &'a str {
        let column = self.roles.get(role).copied().unwrap_or(role);
        self.binds
            .iter()
            .filter_map(|bind| bind.split_once('='))
            .find(|(_, bound)| *bound == column)
            .map_or(column, |(channel, _)| channel)
    }
}

fn fitted(room: &Room, problem: &Problem) -> Result<Fit, String> {
    estimate(problem, &room.asked, None, &Control::NONE).map_err(|error| error.to_string())
}

/// Errors 6 and 24 h ahead on the unseen part.
fn errors(problem: &Problem, fit: &Fit) -> Vec<f64> {
    let problem = problem.with_substeps(fit.substeps);
    let run = filter(&problem, &fit.theta(), None);
    let range = problem.split().validation.clone();
    ahead(&problem, &fit.theta(), &run, range, &[("PT6H", 21_600), ("PT24H", 86_400)])
        .into_values()
        .map(|error| error.rmse)
        .collect()
}

fn incumbent(problem: &Problem, fit: &Fit) -> Incumbent {
    let theta = fit.parameters.iter().map(|(name, estimate)| (name.clone(), estimate.value)).collect();
    Incumbent { model: problem.model().id().clone(), theta, levels: fit.levels.clone() }
}

/// How one way into the gate ended.
struct Ended {
    /// Whether the fit would harm.
    harmful: bool,
    served: bool,
    /// Whether a sentence names the channel and the fault.
    named: bool,
    why: String,
}

fn ended(room: &Room, case: &Case, harm: f64, judgement: &Judgement) -> Ended {
    let served = matches!(judgement.verdict, Verdict::Accepted(_));
    let channels: Vec<&str> = [Some(&case.change.channel), case.change.other.as_ref()]
        .into_iter()
        .flatten()
        .map(|role| room.channel(role))
        .collect();
    let failed = || judgement.checks.iter().filter(|check| !check.pass && check.severity != Severity::Flag);
    let names = |check: &lampyris_core::estimate::gate::check::CheckResult| {
        let channel =
            case.change.channel == "inputs" || channels.iter().any(|name| check.comment.contains(name));
        channel && case.says.iter().any(|word| check.comment.contains(word.as_str()))
    };
    let why = failed().map(|check| check.name.as_str()).collect::<Vec<_>>().join(", ");
    Ended { harmful: harm > HARM, served, named: failed().any(names), why }
}

/// All ways into the gate for one case in one room: cold, with an incumbent, and, where it is asked for,
/// automatic.
fn spoil(
    room: &Room,
    case: &Case,
    truth: &(Problem, Fit),
    seed: u64,
    automatic: bool,
) -> Option<[Option<Ended>; 3]> {
    let (clean, good) = truth;
    let roles = &room.roles;
    let judge = |from: usize, past: &[Past]| -> Option<Vec<Ended>> {
        let spoilt = spoilt::apply(&case.change, &room.table, room.other.as_ref(), roles, from, seed)?;
        let stopped = |why: String| Ended { harmful: true, served: false, named: true, why };
        let (problem, before) = match room.problems(&spoilt) {
            Ok(problems) => problems,
            // The faults of measurements name their channel.
            Err(code) => return Some(past.iter().map(|_| stopped(code.clone())).collect()),
        };
        let fit = match fitted(room, &problem) {
            Ok(fit) => fit,
            Err(why) => return Some(past.iter().map(|_| stopped(why.clone())).collect()),
        };
        let harm = errors(clean, &fit)
            .iter()
            .zip(errors(clean, good))
            .map(|(spoilt, true_error)| spoilt / true_error)
            .fold(0.0, f64::max);
        let judged = |past: &Past| {
            // What came before was measured while all was well, and there was somebody to serve.
            let days_before = before.clone().filter(|_| past.incumbent.is_some());
            let past = Past { days_before, next_door: room.next_door.clone(), ..past.clone() };
            ended(room, case, harm, &validate(&problem, &fit, &past, &GatePolicy::default()))
        };
        Some(past.iter().map(judged).collect())
    };
    let served = incumbent(clean, good);
    let mut whole =
        judge(room.row(FIT_DAYS), &[Past::default(), Past::of(Some(served.clone()))])?.into_iter();
    let ways = [whole.next(), whole.next()];
    let grid = clean.grid();
    let since = grid.time(grid.len() - 1) - FAULTY_DAYS * 86_400;
    // A day of the faulty measurements turns the room degraded, and the rest has come before anybody looks.
    let past = Past { degraded: Some(since + 86_400), ..Past::of(Some(served)) };
    let third = if automatic { judge(room.row(FAULTY_DAYS), &[past])?.pop() } else { None };
    let [cold, kept] = ways;
    Some([cold, kept, third])
}

/// Spoilt measurements are stopped, by a sentence that names what is wrong.
#[test]
fn spoilt_measurements_are_stopped_by_name() {
    let cases = folders();
    let seeds: Vec<u64> = if full() { (83_100..83_102).collect() } else { vec![71_100] };
    let levels = if full() { vec![Level::Matched, Level::Rich] } else { vec![Level::Matched] };
    let mut rooms: Vec<Room> =
        levels.iter().flat_map(|level| seeds.iter().map(|seed| twin(*level, *seed))).collect();
    rooms.extend(measured());
    let truths: Vec<(Problem, Fit)> = rooms
        .par_iter()
        .map(|room| {
            let (problem, _) = room.problems(&room.table).unwrap();
            let fit = fitted(room, &problem).unwrap();
            (problem, fit)
        })
        .collect();
    // Everyday each room takes its share of the cases; the figures are those of the full run.
    let jobs: Vec<(usize, usize)> =
        (0..rooms.len()).flat_map(|room| (0..cases.len()).map(move |case| (room, case))).collect();
    let jobs: Vec<(usize, usize)> =
        jobs.into_iter().filter(|(room, case)| full() || case % rooms.len() == *room).collect();
    let found: Vec<(usize, usize, [Option<Ended>; 3])> = jobs
        .into_par_iter()
        .filter_map(|(room, case)| {
            let automatic = full() || case % 5 == 0;
            Some((
                room,
                case,
                spoil(&rooms[room], &cases[case].1, &truths[room], case as u64 + 1, automatic)?,
            ))
        })
        .collect();
    let mut wrong = Vec::new();
    for (way, (name, allowed)) in
        [("cold", 0.05), ("with an incumbent", 0.03), ("automatic", 0.0)].into_iter().enumerate()
    {
        let ended = || {
            found
                .iter()
                .filter_map(|(room, case, ways)| Some((&rooms[*room], &cases[*case], ways[way].as_ref()?)))
        };
        let by_nature =
            |case: &Case| case.expect == Expected::Undetectable || (way == 0 && case.shown_by.is_some());
        let harmful: Vec<_> = ended()
            .filter(|(_, (_, case), ended)| {
                ended.harmful && case.expect == Expected::Stopped && !by_nature(case)
            })
            .collect();
        let served: Vec<_> = harmful.iter().filter(|(_, _, ended)| ended.served).collect();
        let stopped = harmful.len() - served.len();
        let named = harmful.iter().filter(|(_, _, ended)| !ended.served && ended.named).count();
        println!(
            "GATE-2 {name}: {} harmful, {} served, {named} of {stopped} named",
            harmful.len(),
            served.len()
        );
        for (room, (case, _), ended) in &harmful {
            if ended.served || !ended.named {
                println!(
                    "  {}: {case} {}",
                    room.name,
                    if ended.served { "SERVED".to_owned() } else { format!("not named: {}", ended.why) }
                );
            }
        }
        for (room, (case, what), ended) in ended().filter(|(_, (_, case), _)| by_nature(case)) {
            let way = if ended.served { "served" } else { "stopped" };
            println!("  by nature: {}: {case} {way}; {}", room.name, what.shown_by.as_deref().unwrap_or("-"));
        }
        for (room, (case, _), ended) in ended().filter(|(_, (_, case), _)| case.expect == Expected::Served) {
            // What is harmless is served cold; a better incumbent may stay.
            if way == 0 && !ended.served && !full() {
                wrong.push(format!("{}: {case} is harmless and was stopped by {}", room.name, ended.why));
            }
        }
        if served.len() as f64
            > (allowed * harmful.len() as f64).max(if full() { 0.0 } else { 1.0 * f64::from(way < 2) })
        {
            wrong.push(format!("{name}: {} of {} harmful ones were served", served.len(), harmful.len()));
        }
        if way == 0 && (named as f64) < 0.7 * stopped as f64 {
            wrong.push(format!("{named} of {stopped} were named"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// Rooms with nothing hidden are served, at both distances from the model, and none is refused.
#[test]
fn rooms_with_nothing_hidden_are_served() {
    let count = if full() { 200 } else { 8 };
    for (level, held_share) in [(Level::Matched, 0.03), (Level::Rich, 0.15)] {
        let verdicts: Vec<(u64, Judgement)> = (0..count)
            .into_par_iter()
            .map(|index| {
                let seed = 85_000 + index;
                let made = world(&WorldRequest::new(seed, &[], level)).unwrap();
                let site = Site {
                    sets: [("neighbours".to_owned(), made.neighbours.clone())].into(),
                    ..Site::default()
                };
                let asked = EstimateRequest { split: SplitRequest::default(), ..EstimateRequest::default() };
                let problem = problem(&made.csv, "room3", &[], &site, &asked);
                let fit = estimate(&problem, &asked, None, &Control::NONE).unwrap();
                (seed, validate(&problem, &fit, &Past::default(), &GatePolicy::default()))
            })
            .collect();
        let held: Vec<&(u64, Judgement)> = verdicts
            .iter()
            .filter(|(_, judgement)| !matches!(judgement.verdict, Verdict::Accepted(_)))
            .collect();
        let rejected = held.iter().filter(|(_, judgement)| judgement.verdict == Verdict::Rejected).count();
        println!("GATE-2 {level:?}: {} of {count} not served, {rejected} of them rejected", held.len());
        held.iter().for_each(|(seed, judgement)| println!("  {seed}: {}", judgement.summary));
        assert_eq!(rejected, 0, "{level:?}");
        // So few rooms as everyday may hold one more by chance.
        let allowed = (held_share * count as f64).max(if full() { 0.0 } else { 2.0 });
        assert!(held.len() as f64 <= allowed, "{level:?}: {} of {count} held", held.len());
    }
}

/// A week later another fit of the same room is served as well: what it is held against, days before it and
/// parameters of before, stops no honest one.
#[test]
fn a_later_fit_of_the_same_room_is_served() {
    let count = if full() { 60 } else { 4 };
    for (level, held_share) in [(Level::Matched, 0.0), (Level::Rich, 0.05)] {
        let fits: Vec<(u64, Judgement)> = (0..count)
            .into_par_iter()
            .map(|index| {
                let room = twin(level, 82_000 + index);
                let week = room.row(7);
                let earlier = Room { table: room.table.until(week), ..room.clone() };
                let (before, _) = earlier.problems(&earlier.table).unwrap();
                let served = incumbent(&before, &fitted(&earlier, &before).unwrap());
                let (problem, days_before) = room.problems(&room.table).unwrap();
                let past = Past { days_before, next_door: room.next_door.clone(), ..Past::of(Some(served)) };
                (
                    82_000 + index,
                    validate(&problem, &fitted(&room, &problem).unwrap(), &past, &GatePolicy::default()),
                )
            })
            .collect();
        let ratio = |judgement: &Judgement| {
            judgement
                .checks
                .iter()
                .find(|check| check.name == "G6 days before")
                .and_then(|check| check.statistic)
        };
        let mut ratios: Vec<f64> = fits.iter().filter_map(|(_, judgement)| ratio(judgement)).collect();
        ratios.sort_by(f64::total_cmp);
        println!("GATE-2 {level:?}: days before {ratios:.2?}");
        assert_eq!(ratios.len(), count as usize, "every one is asked");
        // What else the gate says of these rooms is measured cold.
        let past = |name: &&str| *name == "G6 days before" || name.starts_with("G11");
        let held: Vec<_> = fits.iter().filter(|(_, judgement)| judgement.failed().iter().any(past)).collect();
        held.iter().for_each(|(seed, judgement)| println!("  {seed}: {}", judgement.summary));
        let allowed = held_share * count as f64;
        assert!(held.len() as f64 <= allowed, "{level:?}: {} of {count} held", held.len());
    }
}
