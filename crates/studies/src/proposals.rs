//! Whether the terms that are proposed are what was hidden, on synthetic rooms whose hidden effect is in no
//! catalogue but follows from something measured, on rooms that hide what nothing measured explains, and on
//! rooms that hide nothing.

use super::options::Worlds;
use super::quantile::quantile;
use super::row::Row;
use super::twin_room::{TwinRoom, measured, twin_room};
use super::verdicts::judge_all;
use lampyris::cli::{Failure, faults};
use lampyris_core::data::{ColumnBindings, SplitRequest, Window};
use lampyris_core::diagnose::proposals::{ProposalsAsked, ProposedTerm, propose_knowing};
use lampyris_core::estimate::{Control, Fit, Problem, estimate, prepare};
use lampyris_core::model::spec::EffectSpec;
use lampyris_core::twin::{Level, MEASURED, STRANGE, World, WorldRequest, world};
use serde_json::json;
use std::fmt::Write;

/// What is hidden in a world in which nothing is.
const NOTHING: &str = "none";
/// A proposal does the same as the truth where their directions correlate so much.
const EQUIVALENT: f64 = 0.9;

/// How much larger than with the truth the error may be with a proposal.
const BESIDE_TRUTH: f64 = 1.15;
/// The heat that is hidden, as an effect that the model is told.
const TOLD: &str = "told";

/// What was seen of a world.
struct Seen {
    seed: u64,
    hidden: &'static str,
    /// By how much the hidden effect moves the room, in K.
    moves: f64,
    /// How much each proposal has in common with the truth, best first.
    common: Vec<f64>,
    /// The first proposal, in words, and how sure it is.
    first: String,
    /// The error on unseen days in K: without anything, with the first proposal, and with the truth; where
    /// there is a proposal of something that is hidden.
    errors: Option<[f64; 3]>,
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
    let estimated = |problem: &Problem| {
        estimate(problem, &asked, None, &Control::NONE).map_err(|error| Failure::Error(error.to_string()))
    };
    let fit = estimated(&problem)?;
    let unseen = |fit: &Fit| fit.first_metrics().and_then(|metrics| metrics.test_rmse).unwrap_or(f64::NAN);
    let problem = problem.with_substeps(fit.substeps);
    let theta = fit.theta();
    let sought = ProposalsAsked {
        catalogue,
        problem: &problem,
        theta: &theta,
        window: &window,
        site: &site,
        rate: asked.accusation_rate,
    };
    let (found, common) = propose_knowing(&sought, Some(&made.hidden_heat))
        .map_err(|fault| Failure::Error(format!("{seed} {hidden}: {fault}")))?;
    let with = |effect: &EffectSpec, window: &Window| {
        let mut catalogue = catalogue.clone();
        catalogue.add_effect(effect.clone());
        let model = problem.model().id().plus(&effect.id);
        let larger = prepare(&catalogue, &model, &asked, window, &site).map_err(|found| faults(&found))?;
        Ok::<_, Failure>(unseen(&estimated(&larger)?))
    };
    let errors = match found.proposals.first().filter(|_| !effects.is_empty()) {
        Some(first) => {
            let (effect, told) = told(&made)?;
            Some([unseen(&fit), with(&first.document, &window)?, with(&effect, &told)?])
        }
        None => None,
    };
    let first = found.proposals.first().map_or_else(String::new, |first| {
        let ProposedTerm { sentence, left, share, t, confirmed, .. } = first;
        format!("{sentence} Left {left:.2}, share {share:.2}, confirmed {confirmed:.2}, t {t:.1}")
    });
    let moves = made.truth.effects.first().map_or(0.0, |effect| effect.moves);
    Ok(Seen { seed, hidden, moves, common, first, errors })
}

/// What was measured and the hidden heat, and the effect that it is.
fn told(made: &World) -> Result<(EffectSpec, Window), Failure> {
    let mut csv = String::new();
    let heat = made.hidden_heat.iter().chain(made.hidden_heat.last());
    let mut lines = made.csv.lines();
    lines.by_ref().take(1).for_each(|head| csv += &format!("{head},{TOLD}[K/h]\n"));
    lines.zip(heat).for_each(|(line, heat)| {
        let _ = writeln!(csv, "{line},{heat}");
    });
    let (window, _) = Window::parse_csv(&csv, &ColumnBindings::none()).map_err(|found| faults(&found))?;
    let effect = json!({
        "id": TOLD,
        "title": "The hidden heat",
        "explain": "What the twin knows.",
        "inputs": { TOLD: { "unit": "K/h", "hold": "zero_order" } },
        "terms": { "T_r": TOLD },
    });
    let effect = serde_json::from_value(effect).map_err(|error| Failure::Error(error.to_string()))?;
    Ok((effect, window))
}

fn line(seen: &Seen) -> String {
    let Seen { seed, hidden, moves, common, first, errors } = seen;
    let errors = errors.map_or_else(String::new, |errors| format!(" {errors:.3?} K"));
    format!("{seed} {hidden:<16} moves {moves:.2} K  {common:.2?}{errors} {first}")
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
    let errors: Vec<[f64; 3]> = driven.iter().filter_map(|one| one.errors).collect();
    if !errors.is_empty() {
        let median = |which: usize| {
            let mut sorted: Vec<f64> = errors.iter().map(|errors| errors[which]).collect();
            sorted.sort_by(f64::total_cmp);
            quantile(&sorted, 0.5)
        };
        let [without, proposed, truth] = [0, 1, 2].map(median);
        let what = |with: &str| format!("error on unseen days {with}, median of {}", errors.len());
        rows.push(Row::new(what("without anything"), without, "K"));
        rows.push(Row::new(what("with the first proposal"), proposed, "K"));
        rows.push(Row::new(what("with the truth"), truth, "K"));
        rows.push(Row::new("proposal beside truth", proposed / truth, "").at_most(BESIDE_TRUTH));
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
