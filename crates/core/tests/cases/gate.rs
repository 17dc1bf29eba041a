//! Measurements that are spoilt on purpose, one folder each under `gate/`: the gate must stop what would harm
//! a controller, and say which channel is at fault.
//!
//! Harm is measured: a fit to spoilt data is harmful where it forecasts the true data half as badly again as
//! a fit to those, 6 or 24 h ahead. What no gate can see by its nature is listed with what would show it.

mod honest;
mod rooms;
mod spoilt;

use super::folders::{case, cases, names};
use lampyris_core::data::{DAY, HOUR};
use lampyris_core::estimate::assess::metrics::{ProcessNoise, ahead, filter};
use lampyris_core::estimate::gate::check::{CheckResult, Severity};
use lampyris_core::estimate::{Fit, GatePolicy, Judgement, Past, Problem, Verdict, validate};
use lampyris_core::twin::Level;
use rayon::prelude::*;
use rooms::{Everyday, Known, Room, twin};
use serde::Deserialize;
use spoilt::Change;

/// What a fit to spoilt data may err more than one to the true data before it harms.
const HARM: f64 = 1.5;
/// Days before the end at which the automatic path finds the measurements spoilt.
const FAULTY_DAYS: i64 = 14;
/// How many days of a record a fit sees.
const FIT_DAYS: i64 = 28;

/// A folder's `case.toml`.
#[derive(Debug, Clone, Deserialize)]
struct Case {
    /// The room that is spoilt everyday; the full figures spoil others as well.
    room: Everyday,
    /// Fixes what is drawn.
    seed: u64,
    /// Whether the way of the automatic path is tried everyday as well.
    #[serde(default)]
    automatic: bool,
    #[serde(flatten)]
    change: Change,
    expect: Expected,
    /// One of these is in the sentence that names the channel.
    #[serde(default)]
    says: Vec<String>,
    /// Ways on which its room is served all the same, although it harms: gaps that are known.
    #[serde(default)]
    passes: Vec<Way>,
    /// Whether what stops it cold names no channel.
    #[serde(default)]
    nameless: bool,
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

/// A way into the gate.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Way {
    Cold,
    WithAnIncumbent,
    Automatic,
}

impl Way {
    const ALL: [Self; 3] = [Self::Cold, Self::WithAnIncumbent, Self::Automatic];

    /// The share of what would harm that may be served.
    fn allowed(self) -> f64 {
        match self {
            Self::Cold => 0.05,
            Self::WithAnIncumbent => 0.03,
            Self::Automatic => 0.0,
        }
    }
}

cases!("gate", stopped_or_served, {
    clean
    coarse
    heat_12_h_late
    heat_3_h_late
    heat_6_h_early
    heat_6_h_late
    heat_and_neighbour_swapped
    heat_days_shuffled
    heat_halved
    heat_hangs_from_half_way
    heat_in_fahrenheit
    heat_in_fahrenheit_from_half_way
    heat_is_noise
    heat_is_noise_from_half_way
    heat_is_out
    heat_is_the_room
    heat_is_zero
    heat_mirrored
    heat_of_another_house
    heat_offset_by_15
    heat_reversed
    heat_shuffled
    heat_steps_by_10
    inputs_12_h_late
    inputs_of_another_house
    neighbour_is_noise
    neighbour_is_the_room
    one_spike
    out_12_h_early
    out_12_h_late
    out_3_h_late
    out_6_h_late
    out_and_heat_swapped
    out_and_neighbour_swapped
    out_days_shuffled
    out_drops_to_minus_20
    out_hangs_from_half_way
    out_in_fahrenheit
    out_in_fahrenheit_from_half_way
    out_is_noise
    out_is_noise_from_half_way
    out_is_the_heat
    out_is_the_room
    out_mirrored
    out_of_another_house
    out_offset
    out_offset_by_20
    out_reversed
    out_shuffled
    out_steps_by_10
    out_steps_by_20
    room_12_h_early
    room_12_h_late
    room_3_h_late
    room_6_h_late
    room_and_heat_swapped
    room_and_neighbour_swapped
    room_and_out_swapped
    room_days_shuffled
    room_drifts
    room_flattened
    room_hangs_from_half_way
    room_is_a_pipe
    room_is_a_walk
    room_is_noise
    room_is_noise_from_half_way
    room_mirrored
    room_of_another_house
    room_offset
    room_reversed
    room_shuffled
    room_slow
    room_steps_by_3
    room_with_a_sine
    sun_12_h_late
    sun_6_h_late
    sun_on_the_outdoor_sensor
    sun_on_the_room_sensor
}, full {});

/// The case in its room.
fn stopped_or_served(name: &str) {
    let case: Case = case("gate", name);
    let known = case.room.known();
    let ways = spoil(known, &case, case.automatic).expect("the room has no such channel");
    for (way, ended) in Way::ALL.into_iter().zip(ways).filter_map(|(way, ended)| Some((way, ended?))) {
        println!("{way:?}: {ended:?}");
        match case.expect {
            // What is harmless is served cold; a better incumbent may stay.
            Expected::Served => assert!(ended.served || way != Way::Cold, "{}", ended.why),
            Expected::Stopped if ended.harmful && !case.is_hidden_by_nature(way) => {
                assert_eq!(ended.served, case.passes.contains(&way), "{way:?}: {}", ended.why);
                let is_told = ended.named || ended.served || way != Way::Cold;
                assert!(is_told || case.nameless, "{way:?}: not named: {}", ended.why);
            }
            Expected::Stopped | Expected::Undetectable => {}
        }
    }
}

impl Case {
    /// Whether nothing that the gate is given on this way could show the fault.
    fn is_hidden_by_nature(&self, way: Way) -> bool {
        self.expect == Expected::Undetectable || (way == Way::Cold && self.shown_by.is_some())
    }
}

/// Errors 6 and 24 h ahead on the unseen part.
fn errors(problem: &Problem, fit: &Fit) -> Vec<f64> {
    let problem = problem.with_substeps(fit.substeps);
    let run = filter(&problem, &fit.theta(), ProcessNoise::Likeliest);
    let range = problem.split().validation.clone();
    ahead(&problem, &fit.theta(), &run, range, &[("PT6H", 6 * HOUR), ("PT24H", DAY)])
        .into_values()
        .map(|error| error.rmse)
        .collect()
}

/// How one way into the gate ended.
#[derive(Debug)]
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
    let names = |check: &CheckResult| {
        let channel =
            case.change.channel == "inputs" || channels.iter().any(|name| check.comment.contains(name));
        channel && case.says.iter().any(|word| check.comment.contains(word.as_str()))
    };
    let why = failed().map(|check| check.name.as_str()).collect::<Vec<_>>().join(", ");
    Ended { harmful: harm > HARM, served, named: failed().any(names), why }
}

/// All ways into the gate for one case in one room: cold, with an incumbent, and, where it is asked for,
/// automatic. Nothing where the room has no such channel.
fn spoil(known: &Known, case: &Case, automatic: bool) -> Option<[Option<Ended>; 3]> {
    let Known { room, problem: clean, fit: good } = known;
    let judge = |from: usize, past: &[Past]| -> Option<Vec<Ended>> {
        let spoilt =
            spoilt::apply(&case.change, &room.table, room.other.as_ref(), &room.roles, from, case.seed)?;
        let stopped = |why: String| Ended { harmful: true, served: false, named: true, why };
        let (problem, before) = match room.problems(&spoilt) {
            Ok(problems) => problems,
            // The faults of measurements name their channel.
            Err(code) => return Some(past.iter().map(|_| stopped(code.clone())).collect()),
        };
        let fit = match room.fitted(&problem) {
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
    let served = known.incumbent();
    let mut whole =
        judge(room.row(FIT_DAYS), &[Past::default(), Past::of(Some(served.clone()))])?.into_iter();
    let ways = [whole.next(), whole.next()];
    let grid = clean.grid();
    let since = grid.time(grid.len() - 1) - FAULTY_DAYS * DAY;
    // A day of the faulty measurements turns the room degraded, and the rest has come before anybody looks.
    let past = Past { degraded: Some(since + DAY), ..Past::of(Some(served)) };
    let third = if automatic { judge(room.row(FAULTY_DAYS), &[past])?.pop() } else { None };
    let [cold, kept] = ways;
    Some([cold, kept, third])
}

/// Every case in every room, on every way: of what would harm hardly anything is served, and most is named.
#[test]
#[ignore = "left to the full figures"]
fn spoilt_measurements_are_stopped_by_name() {
    let cases: Vec<(String, Case)> =
        names("gate").into_iter().map(|name| (name.clone(), case("gate", &name))).collect();
    assert!(cases.iter().filter(|(_, case)| case.expect != Expected::Served).count() >= 60);
    let twins: Vec<(Level, u64)> = [Level::Matched, Level::Rich]
        .into_iter()
        .flat_map(|level| (83_100..83_102).map(move |seed| (level, seed)))
        .collect();
    let twins: Vec<Known> = twins.into_par_iter().map(|(level, seed)| Known::of(twin(level, seed))).collect();
    let rooms: Vec<&Known> =
        twins.iter().chain([Everyday::HourlyHouse.known(), Everyday::Laundry.known()]).collect();
    let jobs: Vec<(&Known, &(String, Case))> =
        rooms.iter().flat_map(|room| cases.iter().map(move |case| (*room, case))).collect();
    let found: Vec<(&str, &str, &Case, [Option<Ended>; 3])> = jobs
        .into_par_iter()
        .filter_map(|(known, (name, case))| {
            Some((known.room.name.as_str(), name.as_str(), case, spoil(known, case, true)?))
        })
        .collect();
    let mut wrong = Vec::new();
    for (place, way) in Way::ALL.into_iter().enumerate() {
        let ended = || {
            found
                .iter()
                .filter_map(|(room, name, case, ways)| Some((room, name, case, ways[place].as_ref()?)))
        };
        let harmful: Vec<_> = ended()
            .filter(|(_, _, case, ended)| {
                ended.harmful && case.expect == Expected::Stopped && !case.is_hidden_by_nature(way)
            })
            .collect();
        let served = harmful.iter().filter(|(.., ended)| ended.served).count();
        let stopped = harmful.len() - served;
        let named = harmful.iter().filter(|(.., ended)| !ended.served && ended.named).count();
        println!("GATE-2 {way:?}: {} harmful, {served} served, {named} of {stopped} named", harmful.len());
        for (room, name, _, ended) in harmful.iter().filter(|(.., ended)| ended.served || !ended.named) {
            let how = if ended.served { "SERVED" } else { "not named" };
            println!("  {room}: {name} {how}: {}", ended.why);
        }
        for (room, name, case, ended) in ended().filter(|(_, _, case, _)| case.is_hidden_by_nature(way)) {
            let how = if ended.served { "served" } else { "stopped" };
            println!("  by nature: {room}: {name} {how}; {}", case.shown_by.as_deref().unwrap_or("-"));
        }
        if served as f64 > way.allowed() * harmful.len() as f64 {
            wrong.push(format!("{way:?}: {served} of {} harmful ones were served", harmful.len()));
        }
        if way == Way::Cold && (named as f64) < 0.7 * stopped as f64 {
            wrong.push(format!("{named} of {stopped} were named"));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}
