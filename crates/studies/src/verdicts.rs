//! The table of a bench of diagnoses: what was named per kind of world, and the goals.

use super::judged::{Judged, Outcome};
use super::row::Row;
use lampyris::cli::Failure;
use lampyris_core::diagnose::Adequacy;
use lampyris_core::twin::Level;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Judges every world, on as many as there are cores at once; prints a line on each as it is done where asked
/// to.
pub fn judge_all<W: Sync, J: Send>(
    worlds: &[W],
    judge: impl Fn(&W) -> Result<J, Failure> + Sync,
    line: Option<fn(&J) -> String>,
) -> Result<Vec<J>, Failure> {
    let one = |world| {
        let judged = judge(world)?;
        line.into_iter().for_each(|line| eprintln!("{}", line(&judged)));
        Ok(judged)
    };
    worlds.par_iter().map(one).collect()
}

/// The table: per level and effect, then the goals.
pub fn rows(judged: &[Judged]) -> Vec<Row> {
    let mut rows = Vec::new();
    let mut kinds: BTreeMap<&str, Vec<&Judged>> = BTreeMap::new();
    judged.iter().for_each(|one| kinds.entry(&one.kind).or_default().push(one));
    for (kind, worlds) in kinds {
        let count = |outcome| worlds.iter().filter(|one| one.first == outcome).count();
        let what = format!(
            "{kind}: {} material; right {} wrong {} vague {} silent {} of",
            worlds.iter().filter(|one| one.material()).count(),
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
    let candidates = judged
        .iter()
        .flat_map(|one| &one.diagnosis.considered)
        .filter_map(|one| Some(one.measures?.evaluations as f64));
    rows.extend(spread("a candidate, simulations", "-", candidates.collect()));
    let rounds = judged.iter().flat_map(|one| &one.diagnosis.evaluations).map(|count| *count as f64);
    rows.extend(spread("a round, simulations", "-", rounds.collect()));
    rows
}

/// Two rows on how values are spread.
pub fn spread(what: &str, unit: &'static str, mut values: Vec<f64>) -> [Row; 2] {
    values.sort_by(f64::total_cmp);
    let at =
        |share: f64| values.get(((values.len() as f64 - 1.0) * share) as usize).copied().unwrap_or(f64::NAN);
    [("median", 0.5), ("95th percentile", 0.95)]
        .map(|(name, share)| Row::new(format!("{what}: {name}"), at(share), unit))
}

fn goals(judged: &[Judged], level: Level) -> Vec<Row> {
    let matched = level == Level::Matched;
    let these = |keep: &dyn Fn(&Judged) -> bool| -> Vec<&Judged> {
        judged.iter().filter(|one| one.level == level && keep(one)).collect()
    };
    let none = these(&|one| one.truth.effects.is_empty());
    let strange = these(&|one| one.truth.effects.iter().any(|hidden| !hidden.in_catalogue));
    let single =
        these(&|one| one.truth.effects.len() == 1 && one.truth.effects[0].in_catalogue && one.material());
    let pairs = these(&|one| one.truth.effects.len() == 2 && one.material());
    let name = format!("{level:?}").to_lowercase();
    let share = |what: &str, worlds: &[&Judged], test: &dyn Fn(&Judged) -> bool| {
        share(&format!("{name}: {what}"), worlds, |one| test(one))
    };
    let verdict = |verdict: Adequacy| move |one: &Judged| one.diagnosis.verdict == verdict;
    let named = |one: &Judged| !one.diagnosis.findings.is_empty();
    // Every name in a strange world is a wrong one.
    let wrong = |one: &Judged| one.first == Outcome::Wrong;
    let right = |one: &Judged| one.first == Outcome::Right;
    let limit = |row: Option<Row>, limit: Option<f64>, most: bool| {
        row.map(|row| match limit {
            Some(limit) if most => row.at_most(limit),
            Some(limit) => row.at_least(limit),
            None => row,
        })
    };
    let falls: Vec<&Judged> = these(&|one| one.named().is_some());
    let covered = these(&|one| one.covered().is_some());
    let strengths = these(&|one| one.covered_strength().is_some());
    let mut ratios: Vec<f64> = single.iter().filter_map(|one| Some(one.named()?[1] / one.test[1]?)).collect();
    ratios.sort_by(f64::total_cmp);
    let ratio = ratios.get(ratios.len() / 2).map(|ratio| {
        Row::new(
            format!("{name}: test error with what was named over that with the truth, median"),
            *ratio,
            "-",
        )
    });
    [
        limit(share("nothing hidden, something named", &none, &named), Some(0.02), true),
        limit(
            share("nothing hidden, adequate", &none, &verdict(Adequacy::Adequate)),
            matched.then_some(0.8),
            false,
        ),
        limit(share("not in the catalogue, something named", &strange, &named), Some(0.03), true),
        limit(
            share("not in the catalogue, unknown", &strange, &verdict(Adequacy::Unknown)),
            matched.then_some(0.7),
            false,
        ),
        limit(
            share("one material effect, right first", &single, &right),
            Some(if matched { 0.94 } else { 0.92 }),
            false,
        ),
        limit(share("one material effect, wrong first", &single, &wrong), Some(0.02), true),
        limit(share("two effects, both found", &pairs, &|one| one.found == 2), Some(0.9), false),
        limit(share("two effects, first right", &pairs, &right), None, false),
        limit(ratio, Some(1.05), true),
        limit(
            share("something named, test error falls", &falls, &|one| {
                one.named().is_some_and(|[a, b]| b < a)
            }),
            Some(0.95),
            false,
        ),
        limit(
            share("interval of 95 % holds what forecasts lose", &covered, &|one| one.covered() == Some(true)),
            Some(0.9),
            false,
        ),
        limit(
            share("interval of 95 % holds the true strength", &strengths, &|one| {
                one.covered_strength() == Some(true)
            }),
            Some(0.9),
            false,
        ),
    ]
    .into_iter()
    .flatten()
    .collect()
}

/// How many worlds pass a test, with Wilson's interval; none where there are no worlds.
pub fn share<T>(what: &str, worlds: &[T], test: impl Fn(&T) -> bool) -> Option<Row> {
    let (hits, n) = (worlds.iter().filter(|one| test(one)).count(), worlds.len());
    let [low, high] = interval(hits, n);
    (n > 0).then(|| {
        Row::new(format!("{what} ({hits} of {n}, {low:.2} to {high:.2})"), hits as f64 / n as f64, "-")
    })
}

/// Wilson's 95 % interval of a share.
fn interval(hits: usize, n: usize) -> [f64; 2] {
    let (n, z) = (n.max(1) as f64, 1.96f64);
    let share = hits as f64 / n;
    let middle = share + z * z / (2.0 * n);
    let half = z * (share * (1.0 - share) / n + z * z / (4.0 * n * n)).sqrt();
    [(middle - half) / (1.0 + z * z / n), (middle + half) / (1.0 + z * z / n)]
}
