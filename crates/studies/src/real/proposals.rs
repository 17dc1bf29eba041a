//! Whether the terms that are proposed find the channel that drives a measured room, where no channel has a
//! name that says what it is, and how often they read channels of other days.

use super::super::options::Each;
use super::super::row::Row;
use super::super::verdicts::share;
use super::rooms::Room;
use super::{FittedPart, MeasuredRooms, Part, SHIFTS, parts};
use lampyris::cli::{Failure, faults};
use lampyris_core::data::{DAY, Series, Window, is_computed, rfc3339};
use lampyris_core::diagnose::library::{EffectSource, align};
use lampyris_core::diagnose::null_model::NullModel;
use lampyris_core::diagnose::proposals::{ProposalsAsked, ProposedTerm, propose};
use lampyris_core::diagnose::surrogates::Tests;
use lampyris_core::estimate::problem::request::AccusationRate;
use lampyris_core::estimate::{Problem, Site};
use lampyris_core::model::Catalogue;
use lampyris_core::model::spec::InputSpec;
use rayon::prelude::*;

/// What is known to drive a room shows this clearly in a window where the catalogue has it.
const CLEAR: f64 = 4.0;

#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    measured: MeasuredRooms,
    #[command(flatten)]
    each: Each,
}

/// What came of a window.
struct Found {
    /// How clearly segments show what drives the room.
    t: f64,
    first: bool,
    among: bool,
    /// Of the searches with channels of other days: whether a term of one was proposed.
    shifted: Vec<bool>,
    line: String,
}

/// Proposes terms for every window of the rooms of which it is known what drives them.
pub fn run(asked: &Arguments) -> Result<Vec<Row>, Failure> {
    let mut found = Vec::new();
    for room in asked.measured.rooms().filter(|room| !room.drivers.is_empty()) {
        let window = asked.measured.window(room)?;
        let windows: Vec<Part> = parts(room, &window).into_iter().filter(|part| !part.whole).collect();
        let judged = windows.par_iter().map(|part| judge(room, &window, *part));
        for one in judged.collect::<Result<Vec<Option<Found>>, Failure>>()?.into_iter().flatten() {
            if asked.each.each {
                eprintln!("{}", one.line);
            }
            found.push(one);
        }
    }
    let clear: Vec<&Found> = found.iter().filter(|one| one.t >= CLEAR).collect();
    let shifted: Vec<bool> = found.iter().flat_map(|one| one.shifted.iter().copied()).collect();
    let rows = [
        share("the channel that drives the room is in the first proposal", &clear, |one| one.first),
        share("it is in one of three", &clear, |one| one.among).map(|row| row.at_least(0.75)),
        share("channels of other days: one is proposed", &shifted, |proposed| *proposed)
            .map(|row| row.at_most(0.02)),
    ];
    Ok(rows.into_iter().flatten().collect())
}

fn judge(room: &Room, window: &Window, part: Part) -> Result<Option<Found>, Failure> {
    let FittedPart { catalogue, site, problem, fit } = FittedPart::new(room, window, part)?;
    let (problem, theta) = (problem.with_substeps(fit.substeps), fit.theta());
    let Some(t) = shown(&catalogue, &problem, &theta, window, &site, room)? else { return Ok(None) };
    let within = window.slice(part.from, part.to()).map_err(|found| faults(&found))?;
    let proposals = |days: i64| -> Result<Vec<ProposedTerm>, Failure> {
        let window = renamed(&problem, &within, part, days)?;
        let asked = ProposalsAsked {
            catalogue: &catalogue,
            problem: &problem,
            theta: &theta,
            window: &window,
            site: &site,
            rate: AccusationRate::USUAL,
        };
        Ok(propose(&asked).map_err(|fault| faults(&[fault]))?.proposals)
    };
    let drivers: Vec<String> = other_channels(&problem, &within)
        .enumerate()
        .filter(|(_, series)| room.driven_by(series.channel()))
        .map(|(place, _)| nameless(place))
        .collect();
    let found = proposals(0)?;
    let reads = |one: &ProposedTerm| channels(one).iter().any(|channel| drivers.contains(channel));
    let days = part.hours / 24;
    let shifted = (1..=SHIFTS)
        .map(|shift| {
            let found = proposals((shift * days / (SHIFTS + 1)).max(1))?;
            Ok(found.iter().any(|one| channels(one).iter().any(|channel| channel.starts_with(NAMELESS))))
        })
        .collect::<Result<Vec<bool>, Failure>>()?;
    let titles: Vec<&str> = found.iter().map(|one| one.effect.as_str()).collect();
    let line = format!(
        "{} from {}: t {t:.1}, driven by {drivers:?}, proposed {titles:?}, of other days {}",
        room.name,
        rfc3339(part.from),
        shifted.iter().filter(|proposed| **proposed).count(),
    );
    Ok(Some(Found {
        t,
        first: found.first().is_some_and(reads),
        among: found.iter().any(reads),
        shifted,
        line,
    }))
}

/// How clearly the segments of a window show what drives the room, of what the catalogue has; `None` where
/// the model does not settle there.
fn shown(
    catalogue: &Catalogue,
    problem: &Problem,
    theta: &[f64],
    window: &Window,
    site: &Site,
    room: &Room,
) -> Result<Option<f64>, Failure> {
    let source = EffectSource::new(catalogue, problem, window, site).map_err(|fault| faults(&[fault]))?;
    let (mut library, _) = source.candidates(problem);
    let Some(null) = NullModel::settle(align(problem, &mut library), theta, None, &|| false) else {
        return Ok(None);
    };
    let base = align(&null.problem, &mut library);
    let most = f64::from(AccusationRate::USUAL);
    let Some(tests) = Tests::new(&base, &null.fitted.plain, &library, most, &[], &|| false) else {
        return Ok(None);
    };
    let driver = library.iter().filter(|candidate| room.drivers.contains(&candidate.id.as_str()));
    let t = driver.filter_map(|candidate| tests.hear(candidate).ranked.map(|ranked| ranked.t));
    Ok(t.reduce(f64::max))
}

/// What a channel without a name is called.
const NAMELESS: &str = "x";

fn nameless(place: usize) -> String {
    format!("{NAMELESS}{}", place + 1)
}

/// The channels that the model does not read.
fn other_channels<'a>(problem: &'a Problem, window: &'a Window) -> impl Iterator<Item = &'a Series> {
    let model = problem.model();
    let used = |channel: &str| {
        model.inputs().iter().any(|input| input.channel == channel)
            || model.outputs().iter().any(|output| output.channel == channel)
            || is_computed(channel)
    };
    window.iter().filter(move |series| !used(series.channel()))
}

/// The window with every channel that the model does not read under a name that says nothing, and of so many
/// days later, circularly.
fn renamed(problem: &Problem, window: &Window, part: Part, days: i64) -> Result<Window, Failure> {
    let others: Vec<&Series> = other_channels(problem, window).collect();
    let is_other = |series: &Series| others.iter().any(|other| other.channel() == series.channel());
    let span = part.hours / 24 * DAY;
    let moved = |(place, series): (usize, &&Series)| {
        let later =
            |(time, value): (i64, f64)| (part.from + (time - part.from - days * DAY).rem_euclid(span), value);
        let mut samples: Vec<(i64, f64)> =
            series.samples().filter(|(time, _)| *time < part.from + span).map(later).collect();
        samples.sort_by_key(|(time, _)| *time);
        let (times, values) = samples.into_iter().unzip();
        Series::new(&nameless(place), series.unit(), series.hold(), times, values)
    };
    let renamed: Vec<Series> =
        others.iter().enumerate().map(moved).collect::<Result<_, _>>().map_err(|fault| faults(&[fault]))?;
    let kept = window.iter().filter(|series| !is_other(series)).cloned();
    Window::from_series(kept.chain(renamed).collect()).map_err(|found| faults(&found))
}

/// The channels that a proposal reads.
fn channels(proposed: &ProposedTerm) -> Vec<String> {
    let of = |(name, input): (&String, &InputSpec)| input.channel.clone().unwrap_or_else(|| name.clone());
    proposed.document.inputs.iter().map(of).collect()
}
