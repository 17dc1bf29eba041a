//! Whether the terms that are proposed are what was hidden, on synthetic rooms whose hidden effect is in no
//! catalogue but follows from something measured, on rooms that hide what nothing measured explains, and on
//! rooms that hide nothing.

use super::options::Worlds;
use super::row::Row;
use super::twin_room::{TwinRoom, measured, twin_room};
use super::verdicts::judge_all;
use lampyris::cli::Failure;
use lampyris_core::data::SplitRequest;
use lampyris_core::diagnose::proposals::{ProposalsAsked, propose_knowing};
use lampyris_core::estimate::{Control, estimate};
use lampyris_core::twin::{Level, MEASURED, STRANGE, WorldRequest, world};

/// What is hidden in a world in which nothing is.
const NOTHING: &str = "none";
/// A proposal does the same as the truth where their directions correlate so much.
const EQUIVALENT: f64 = 0.9;

/// What was seen of a world.
struct Seen {
    seed: u64,
    hidden: &'static str,
    /// By how much the hidden effect moves the room, in K.
    moves: f64,
    /// How much each proposal has in common with the truth, best first.
    common: Vec<f64>,
    /// The first proposal, in words.
    first: String,
}

/// Rooms of every kind, at both levels in turns.
pub fn run(asked: &Worlds) -> Result<Vec<Row>, Failure> {
    let (first, worlds, only, each) = asked.parts();
    let kinds: Vec<&'static str> = MEASURED.into_iter().chain(STRANGE).chain([NOTHING]).collect();
    let of =
        |at: u64| kinds.iter().zip(0..).map(move |(kind, place)| (first * 10_000 + at * 100 + place, *kind));
    let level = |seed: u64| if (seed / 100).is_multiple_of(2) { Level::Matched } else { Level::Rich };
    let worlds: Vec<(u64, &'static str)> =
        (0..worlds).flat_map(of).filter(|(_, kind)| only.is_none_or(|only| kind.contains(only))).collect();
    let seen = judge_all(&worlds, |(seed, kind)| judge(*seed, kind, level(*seed)), each.then_some(line))?;
    Ok(rows(&kinds, &seen))
}

fn judge(seed: u64, hidden: &'static str, level: Level) -> Result<Seen, Failure> {
    let effects: &[&str] = if hidden == NOTHING { &[] } else { &[hidden] };
    let made = world(&WorldRequest { more: true, ..WorldRequest::new(seed, effects, level) })
        .map_err(|fault| Failure::Error(fault.to_string()))?;
    let window = measured(&made)?;
    let TwinRoom { catalogue, site, asked, problem } =
        twin_room(&made, &window, "room3", SplitRequest::DIAGNOSE)?;
    let fit = estimate(&problem, &asked, None, &Control::NONE)
        .map_err(|error| Failure::Error(error.to_string()))?;
    let problem = problem.with_substeps(fit.substeps);
    let theta = fit.theta();
    let asked = ProposalsAsked {
        catalogue: &catalogue,
        problem: &problem,
        theta: &theta,
        window: &window,
        site: &site,
        rate: asked.accusation_rate,
    };
    let (found, common) = propose_knowing(&asked, Some(&made.hidden_heat))
        .map_err(|fault| Failure::Error(format!("{seed} {hidden}: {fault}")))?;
    let first = found.proposals.first().map_or_else(String::new, |first| first.sentence.clone());
    let moves = made.truth.effects.first().map_or(0.0, |effect| effect.moves);
    Ok(Seen { seed, hidden, moves, common, first })
}

fn line(seen: &Seen) -> String {
    let Seen { seed, hidden, moves, common, first } = seen;
    format!("{seed} {hidden:<16} moves {moves:.2} K  {common:.2?} {first}")
}

fn rows(kinds: &[&'static str], seen: &[Seen]) -> Vec<Row> {
    let share = |these: &[&Seen], test: &dyn Fn(&Seen) -> bool| {
        these.iter().filter(|one| test(one)).count() as f64 / these.len().max(1) as f64
    };
    let first = |one: &Seen| one.common.first().is_some_and(|common| *common >= EQUIVALENT);
    let among = |one: &Seen| one.common.iter().any(|common| *common >= EQUIVALENT);
    let any = |one: &Seen| !one.common.is_empty();
    let of =
        |kinds: &[&str]| -> Vec<&Seen> { seen.iter().filter(|one| kinds.contains(&one.hidden)).collect() };
    let mut rows = Vec::new();
    let driven = of(&MEASURED);
    if !driven.is_empty() {
        let what = |place: &str| format!("an equivalent proposal {place}, of {} worlds", driven.len());
        rows.push(Row::new(what("first"), share(&driven, &first), "").at_least(0.55));
        rows.push(Row::new(what("among three"), share(&driven, &among), "").at_least(0.7));
    }
    for kind in kinds.iter().filter(|kind| MEASURED.contains(kind)) {
        let these = of(&[kind]);
        if !these.is_empty() {
            let what = |place: &str| format!("{kind}: {place}, of {}", these.len());
            rows.push(Row::new(what("first"), share(&these, &first), ""));
            rows.push(Row::new(what("among three"), share(&these, &among), ""));
        }
    }
    for (what, kinds, most) in [
        ("nothing hidden: a proposal", &[NOTHING][..], 0.02),
        ("what nothing measured explains: a proposal", &STRANGE[..], 0.05),
    ] {
        let these = of(kinds);
        if !these.is_empty() {
            rows.push(Row::new(format!("{what}, of {}", these.len()), share(&these, &any), "").at_most(most));
        }
    }
    rows
}
