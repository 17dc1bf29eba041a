//! What a diagnosis names on synthetic rooms whose truth is known: right, wrong or silent, with intervals.

use super::super::{Failure, faults};
use super::Row;
use lampyris::data::{Bindings, SplitRequest, Window};
use lampyris::diagnose::fitted::Null;
use lampyris::diagnose::report::Considered;
use lampyris::diagnose::{Adequacy, Diagnosis, diagnose, preview};
use lampyris::estimate::{Control, EstimateRequest, Problem, Site, estimate, prepare};
use lampyris::model::Catalogue;
use lampyris::twin::{Level, Truth, World, WorldRequest, world};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::time::Instant;

/// Single effects that worlds hide in turn.
const SINGLE: [&str; 15] = [
    "wind_infiltration",
    "window_opening",
    "occupancy_gain",
    "oriented_solar_gain",
    "open_door",
    "direct_outdoor_loss",
    "emitter_exponent",
    "pipe_delay",
    "sensor_drift",
    "sensor_lag",
    "night_setback",
    "sky_radiation",
    "metered_gain",
    "envelope_solar_gain",
    "constant_gain",
];
/// Effects that no catalogue has.
const STRANGE: [&str; 2] = ["stove", "laundry"];
/// Pairs of effects that show.
const PAIRS: [[&str; 2]; 6] = [
    ["wind_infiltration", "metered_gain"],
    ["oriented_solar_gain", "night_setback"],
    ["window_opening", "wind_infiltration"],
    ["metered_gain", "oriented_solar_gain"],
    ["sky_radiation", "metered_gain"],
    ["night_setback", "wind_infiltration"],
];
/// An effect is material when knowing it cuts the test error by this share.
const MATERIAL: f64 = 0.10;

/// How a world came out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Outcome {
    Right,
    Wrong,
    /// A group of more than two that holds the truth.
    Vague,
    Silent,
}

/// A world and its diagnosis.
struct Judged {
    kind: String,
    level: Level,
    truth: Truth,
    diagnosis: Diagnosis,
    first: Outcome,
    found: usize,
    material: bool,
    logged: bool,
    seconds: f64,
    preview_seconds: f64,
}

pub fn run(first: u64, worlds: u64, only: Option<&str>, each: bool) -> Result<Vec<Row>, Failure> {
    let mut requests = Vec::new();
    for level in [Level::Matched, Level::Rich] {
        let mut kinds: Vec<Vec<&str>> = SINGLE.iter().chain(&STRANGE).map(|effect| vec![*effect]).collect();
        kinds.extend(PAIRS.iter().map(|pair| pair.to_vec()));
        // Nothing hidden is the case that matters most: as often as all others of its sort together.
        kinds.extend((0..6).map(|_| Vec::new()));
        for (place, effects) in kinds.iter().enumerate() {
            for round in 0..worlds {
                let seed = first * 1_000_000 + round * 1000 + place as u64 * 2 + u64::from(level == Level::Rich);
                requests.push(WorldRequest::new(seed, effects, level));
            }
        }
    }
    requests.retain(|request| only.is_none_or(|only| name(request).contains(only)));
    let judged: Vec<Judged> = requests
        .par_iter()
        .map(|request| {
            let judged = judge(request)?;
            if each {
                eprintln!("{}", line(&judged));
            }
            Ok(judged)
        })
        .collect::<Result<_, Failure>>()?;
    Ok(rows(&judged))
}

fn name(request: &WorldRequest) -> String {
    let effects = if request.effects.is_empty() { "none".to_owned() } else { request.effects.join("+") };
    format!("{:?} {effects}", request.level).to_lowercase()
}

/// One world: made, fitted, diagnosed.
fn judge(request: &WorldRequest) -> Result<Judged, Failure> {
    let world = world(request).map_err(|fault| Failure::Error(fault.to_string()))?;
    let (window, _) = Window::parse_csv(&world.csv, &Bindings::none()).map_err(|found| faults(&found))?;
    let catalogue = Catalogue::builtin().map_err(|found| faults(&found))?;
    let (problem, site, asked) = ask(&catalogue, &world, &window, "room3")?;
    let fit = estimate(&problem, &asked, None, &Control::NONE).map_err(|error| Failure::Error(error.to_string()))?;
    let theta = fit.theta();
    let start = Instant::now();
    preview(&catalogue, &problem, &theta, &window, &site).map_err(|error| Failure::Error(error.to_string()))?;
    let preview_seconds = start.elapsed().as_secs_f64();
    let start = Instant::now();
    let diagnosis =
        diagnose(&catalogue, &problem, &theta, &window, &site, &Control::NONE).map_err(|error| Failure::Error(error.to_string()))?;
    let seconds = start.elapsed().as_secs_f64();
    let first = diagnosis.findings.first().map_or(Outcome::Silent, |finding| {
        let mut group = vec![finding.effect.clone()];
        group.extend(finding.tied_with.iter().cloned());
        let holds = world.truth.effects.iter().any(|hidden| group.iter().any(|named| same(named, &hidden.effect)));
        match (holds, group.len()) {
            (true, ..=2) => Outcome::Right,
            (true, _) => Outcome::Vague,
            (false, _) => Outcome::Wrong,
        }
    });
    let named = |hidden: &str| {
        diagnosis.findings.iter().any(|finding| same(&finding.effect, hidden) || finding.tied_with.iter().any(|tied| same(tied, hidden)))
    };
    let found = world.truth.effects.iter().filter(|hidden| named(&hidden.effect)).count();
    let material = material(&catalogue, &world, &window, fit.first_metrics().and_then(|metrics| metrics.test_rmse), &problem, &theta)?;
    let logged = world.csv.contains("window_open");
    let truth = world.truth;
    Ok(Judged { kind: name(request), level: request.level, truth, diagnosis, first, found, material, logged, seconds, preview_seconds })
}

fn ask(catalogue: &Catalogue, world: &World, window: &Window, model: &str) -> Result<(Problem, Site, EstimateRequest), Failure> {
    let id = model.parse().map_err(|error| Failure::Error(format!("{error}")))?;
    let asked = EstimateRequest { split: SplitRequest::DIAGNOSE, ..EstimateRequest::default() };
    let site = Site { sets: [("neighbours".to_owned(), world.neighbours.clone())].into(), ..Site::default() };
    let problem = prepare(catalogue, &id, &asked, window, &site).map_err(|found| faults(&found))?;
    Ok((problem, site, asked))
}

/// Whether a name means the hidden effect. Hours of a set-back are its size, not its name.
fn same(named: &str, hidden: &str) -> bool {
    named == hidden || (hidden == "night_setback" && named.starts_with("night_setback:"))
}

/// Whether the true effects, given to the model, cut the test error by a tenth.
fn material(
    catalogue: &Catalogue,
    world: &World,
    window: &Window,
    without: Option<f64>,
    base: &Problem,
    theta: &[f64],
) -> Result<bool, Failure> {
    let known = |effect: &str| if effect == "night_setback" { "night_setback:22_6".to_owned() } else { effect.to_owned() };
    let effects: Vec<String> =
        world.truth.effects.iter().filter(|hidden| hidden.in_catalogue).map(|hidden| known(&hidden.effect)).collect();
    let Some(without) = without.filter(|_| !effects.is_empty()) else { return Ok(false) };
    let (problem, _, _) = ask(catalogue, world, window, &format!("room3+{}", effects.join("+")))?;
    let mut start = problem.nominal().to_vec();
    for (value, parameter) in start.iter_mut().zip(problem.model().parameters()) {
        if let Some(place) = base.model().parameters().iter().position(|known| known.name == parameter.name) {
            *value = theta[place];
        }
    }
    let with = Null::settle(problem, &start, None).and_then(|settled| settled.measured.plain[2]);
    Ok(with.is_some_and(|mse| mse.sqrt() <= (1.0 - MATERIAL) * without))
}

fn line(judged: &Judged) -> String {
    let hidden: Vec<String> = judged.truth.effects.iter().map(|one| format!("{} {:.2}K", one.effect, one.moves)).collect();
    let named: Vec<String> = judged
        .diagnosis
        .findings
        .iter()
        .map(|finding| {
            let tied = if finding.tied_with.is_empty() { String::new() } else { format!("~{}", finding.tied_with.join("~")) };
            let [before, after] = finding.rmse.test.unwrap_or([f64::NAN; 2]);
            let share = finding.explained_share.unwrap_or(f64::NAN);
            format!("{}{tied} dbic {:.0} share {share:.2} test {before:.2}>{after:.2}", finding.effect, finding.delta_bic)
        })
        .collect();
    let best = judged.diagnosis.considered.iter().find(|one| judged.truth.effects.iter().any(|hidden| same(&one.effect, &hidden.effect)));
    let missed = match best {
        Some(best) if judged.first != Outcome::Right => {
            format!(
                " [truth: dbic {:.1} share {:.2} {:?}]",
                best.delta_bic.unwrap_or(f64::NAN),
                best.explained_share.unwrap_or(f64::NAN),
                best.gate
            )
        }
        _ => String::new(),
    };
    let near: Vec<String> = judged.diagnosis.considered.iter().filter_map(near).collect();
    let logged = if judged.logged { " LOGGED" } else { "" };
    let missed = format!("{missed}{logged} <<{}>>", near.join(" | "));
    format!(
        "{} seed {} {:?}{} heat {:.3} rho {:.2} hidden ({}) named ({}){missed} {:.2}s",
        judged.kind,
        judged.truth.seed,
        judged.first,
        if judged.material { " material" } else { "" },
        judged.truth.household_heat,
        judged.diagnosis.rho.unwrap_or(f64::NAN),
        hidden.join(", "),
        named.join("; "),
        judged.seconds
    )
}

/// A suspect that explains something, in numbers.
fn near(one: &Considered) -> Option<String> {
    let measures = one.measures?;
    let (share, gain) = (one.explained_share.unwrap_or(f64::NAN), one.delta_bic.unwrap_or(f64::NAN));
    let number = |value: Option<f64>| value.unwrap_or(f64::NAN);
    let slow = number(measures.slow_delta_bic);
    (share > 0.3 || slow > 8.0 || gain > 8.0).then(|| {
        format!(
            "{} share {share:.2} dbic {gain:.0} white {:.2} slow {slow:.0} ahead {:.2} days {:.2} {:.2} rho {:.2}",
            one.effect,
            number(measures.white_share),
            number(measures.ahead_share),
            measures.better_days[0],
            measures.better_days[1],
            measures.rho
        )
    })
}

/// The table: per level and effect, then the goals.
fn rows(judged: &[Judged]) -> Vec<Row> {
    let mut rows = Vec::new();
    let mut kinds: BTreeMap<&str, Vec<&Judged>> = BTreeMap::new();
    judged.iter().for_each(|one| kinds.entry(&one.kind).or_default().push(one));
    for (kind, worlds) in kinds {
        let count = |outcome| worlds.iter().filter(|one| one.first == outcome).count();
        let what = format!(
            "{kind}: {} material; right {} wrong {} vague {} silent {} of",
            worlds.iter().filter(|one| one.material).count(),
            count(Outcome::Right),
            count(Outcome::Wrong),
            count(Outcome::Vague),
            count(Outcome::Silent)
        );
        rows.push(Row::new(what, worlds.len() as f64, "worlds"));
    }
    for level in [Level::Matched, Level::Rich] {
        rows.extend(goals(judged, level));
    }
    let mut times: Vec<f64> = judged.iter().map(|one| one.seconds).collect();
    times.sort_by(f64::total_cmp);
    let mut previews: Vec<f64> = judged.iter().map(|one| one.preview_seconds).collect();
    previews.sort_by(f64::total_cmp);
    let at = |times: &[f64], share: f64| times.get(((times.len() as f64 - 1.0) * share) as usize).copied().unwrap_or(f64::NAN);
    rows.push(Row::new("a diagnosis: median wall time", at(&times, 0.5), "s"));
    rows.push(Row::new("a diagnosis: 95th percentile", at(&times, 0.95), "s"));
    rows.push(Row::new("a preview: median wall time", at(&previews, 0.5), "s"));
    rows
}

fn goals(judged: &[Judged], level: Level) -> Vec<Row> {
    let matched = level == Level::Matched;
    let these = |keep: &dyn Fn(&Judged) -> bool| -> Vec<&Judged> { judged.iter().filter(|one| one.level == level && keep(one)).collect() };
    let none = these(&|one| one.truth.effects.is_empty());
    let strange = these(&|one| one.truth.effects.iter().any(|hidden| !hidden.in_catalogue));
    let single = these(&|one| one.truth.effects.len() == 1 && one.truth.effects[0].in_catalogue && one.material);
    let pairs = these(&|one| one.truth.effects.len() == 2 && one.material);
    let share = |what: &str, worlds: &[&Judged], test: &dyn Fn(&Judged) -> bool| {
        let (hits, n) = (worlds.iter().filter(|one| test(one)).count(), worlds.len());
        let [low, high] = interval(hits, n);
        let name = format!("{level:?}").to_lowercase();
        (n > 0).then(|| Row::new(format!("{name}: {what} ({hits} of {n}, {low:.2} to {high:.2})"), hits as f64 / n as f64, "-"))
    };
    let verdict = |verdict: Adequacy| move |one: &Judged| one.diagnosis.verdict == verdict;
    let named = |one: &Judged| !one.diagnosis.findings.is_empty();
    let wrong = |one: &Judged| one.first == Outcome::Wrong;
    let right = |one: &Judged| one.first == Outcome::Right;
    let limit = |row: Option<Row>, limit: Option<f64>, most: bool| {
        row.map(|row| match limit {
            Some(limit) if most => row.at_most(limit),
            Some(limit) => row.at_least(limit),
            None => row,
        })
    };
    [
        limit(share("nothing hidden, something named", &none, &named), Some(if matched { 0.02 } else { 0.04 }), true),
        limit(share("nothing hidden, adequate", &none, &verdict(Adequacy::Adequate)), matched.then_some(0.8), false),
        limit(share("not in the catalogue, something named", &strange, &named), matched.then_some(0.05), true),
        limit(share("not in the catalogue, unknown", &strange, &verdict(Adequacy::Unknown)), matched.then_some(0.7), false),
        limit(share("one material effect, right first", &single, &right), Some(if matched { 0.9 } else { 0.8 }), false),
        limit(share("one material effect, wrong first", &single, &wrong), Some(if matched { 0.02 } else { 0.04 }), true),
        limit(share("two effects, both found", &pairs, &|one| one.found == 2), matched.then_some(0.75), false),
        limit(share("two effects, first right", &pairs, &right), None, false),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// Wilson's 95 % interval of a share.
fn interval(hits: usize, n: usize) -> [f64; 2] {
    let (n, z) = (n.max(1) as f64, 1.96f64);
    let share = hits as f64 / n;
    let middle = share + z * z / (2.0 * n);
    let half = z * (share * (1.0 - share) / n + z * z / (4.0 * n * n)).sqrt();
    [(middle - half) / (1.0 + z * z / n), (middle + half) / (1.0 + z * z / n)]
}
