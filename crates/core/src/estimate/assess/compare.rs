//! Several fits of one system on the same samples.

use super::comparison::{PartSpan, parts, samples};
use super::metrics::{HORIZONS, lead};
use super::replay::{Part, Replay};
use super::skill::Skill;
use crate::data::{Duration, Grid};
use crate::fault::Fault;
use crate::units::error_unit;
use indexmap::IndexMap;
use serde::Serialize;
use utoipa::ToSchema;

/// The name of the free run among the horizons.
pub const FREE_RUN: &str = "free_run";

/// A fit that takes part.
#[derive(Debug, Clone, Copy)]
pub struct Contender<'a> {
    /// Its id.
    pub id: &'a str,
    /// Its run.
    pub replay: &'a Replay,
}

/// Over which samples an error was taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Over {
    /// All of the range that all fits and the measurements have.
    Range,
    /// Those of them that lie in no fit's training part: the only fair contest.
    Unseen,
}

/// The errors of one fit in one output at one horizon, beside those of a skill.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ErrorRow {
    /// The fit.
    pub fit: String,
    /// The output.
    pub output: String,
    /// Unit of the errors.
    pub unit: String,
    /// `free_run`, or how far ahead.
    pub horizon: String,
    /// `range`: all samples that all fits have; `unseen`: those of them in no fit's training part.
    #[schema(value_type = String)]
    pub over: Over,
    /// The errors.
    #[serde(flatten)]
    #[schema(inline)]
    pub skill: Skill,
}

/// One output of several fits, sample by sample.
#[derive(Debug, Clone, PartialEq)]
pub struct ComparedOutput {
    /// Unit of all series.
    pub unit: String,
    /// What was measured.
    pub measured: Vec<Option<f64>>,
    /// What each fit says that has this output.
    pub simulated: IndexMap<String, Vec<Option<f64>>>,
}

/// Several fits beside the measurements.
#[derive(Debug, Clone, PartialEq)]
pub struct Compared {
    /// The time of the first sample, in milliseconds.
    pub start: i64,
    /// Milliseconds between samples.
    pub step: i64,
    /// Outputs by channel.
    pub outputs: IndexMap<String, ComparedOutput>,
    /// What each stretch was to each fit.
    pub parts: IndexMap<String, Vec<PartSpan>>,
    /// The table of errors.
    pub errors: Vec<ErrorRow>,
}

/// The series of one output of a fit on the common axis, by horizon.
type ByHorizon = IndexMap<String, Vec<Option<f64>>>;
/// Those of all its outputs.
type Lines = IndexMap<String, ByHorizon>;

/// Lays fits beside each other between two instants; `horizon` says which series are shown, the free run
/// where it is `None`, and the table has the usual horizons as well.
///
/// The axis is that of the fit with the longest step, the first of them. Where another fit has no sample at
/// one of its times, its series is read off on the line between its neighbouring samples.
///
/// # Errors
/// A fault where there is no fit or nothing to compare.
pub fn compare(
    contenders: &[Contender<'_>],
    horizon: Option<Duration>,
    from: i64,
    to: i64,
) -> Result<Compared, Vec<Fault>> {
    let longest_step = contenders.iter().map(|contender| contender.replay.problem().grid().step()).max();
    let owner =
        contenders.iter().find(|contender| Some(contender.replay.problem().grid().step()) == longest_step);
    let Some(owner) = owner else {
        return Err(vec![Fault::new("query fits", "empty", "no fit is named")]);
    };
    let grid = owner.replay.problem().grid();
    let range = samples(owner.replay, from, to)?;
    let axis = grid.slice(range);
    let mut horizons: Vec<(String, i64)> =
        HORIZONS.iter().map(|(name, horizon)| ((*name).to_owned(), *horizon)).collect();
    if let Some(asked) =
        horizon.filter(|asked| horizons.iter().all(|(_, horizon)| *horizon != asked.millis()))
    {
        horizons.push((asked.to_string(), asked.millis()));
    }
    let shown = horizon
        .and_then(|asked| horizons.iter().find(|(_, horizon)| *horizon == asked.millis()))
        .map_or(FREE_RUN, |(name, _)| name);
    let lines: Vec<Lines> =
        contenders.iter().map(|contender| lines(contender.replay, &axis, &horizons)).collect();
    let unseen: Vec<bool> = (0..axis.len())
        .map(|k| contenders.iter().all(|contender| !trained_on(contender.replay, axis.time(k))))
        .collect();
    let mut outputs: IndexMap<String, ComparedOutput> = IndexMap::new();
    let mut errors = Vec::new();
    for contender in contenders {
        let model = contender.replay.problem().model();
        for (index, output) in model.outputs().iter().enumerate() {
            if outputs.contains_key(&output.channel) {
                continue;
            }
            let measured =
                at_axis(contender.replay.problem().grid(), &contender.replay.measured(index), &axis, nearest);
            let mine: Vec<(&str, &ByHorizon)> = contenders
                .iter()
                .zip(&lines)
                .filter_map(|(contender, lines)| Some((contender.id, lines.get(&output.channel)?)))
                .collect();
            for (name, _) in std::iter::once(&(FREE_RUN.to_owned(), 0)).chain(&horizons) {
                errors.extend(rows(
                    &output.channel,
                    error_unit(&output.unit),
                    name,
                    &measured,
                    &mine,
                    &unseen,
                ));
            }
            let simulated = mine
                .iter()
                .filter_map(|(id, by_horizon)| Some(((*id).to_owned(), by_horizon.get(shown)?.clone())))
                .collect();
            outputs.insert(
                output.channel.clone(),
                ComparedOutput { unit: output.unit.clone(), measured, simulated },
            );
        }
    }
    let parts_of = |contender: &Contender<'_>| {
        let own = samples(contender.replay, from, to).unwrap_or(0..0);
        (contender.id.to_owned(), parts(contender.replay, &own))
    };
    Ok(Compared {
        start: axis.start(),
        step: axis.step(),
        outputs,
        parts: contenders.iter().map(parts_of).collect(),
        errors,
    })
}

/// All series of a fit on the axis.
fn lines(replay: &Replay, axis: &Grid, horizons: &[(String, i64)]) -> Lines {
    let grid = replay.problem().grid();
    let mut leads: Vec<usize> =
        horizons.iter().filter_map(|(_, horizon)| lead(*horizon, grid.step())).collect();
    leads.sort_unstable();
    leads.dedup();
    // Origins before the range lead to targets inside it.
    let longest = horizons.iter().map(|(_, horizon)| *horizon).max().unwrap_or(0);
    let last = axis.time(axis.len().saturating_sub(1)) + axis.step();
    let origins = samples(replay, axis.start() - longest - axis.step(), last).unwrap_or(0..0);
    let ahead = replay.ahead(origins, &leads);
    let mut found = Lines::new();
    for (index, output) in replay.problem().model().outputs().iter().enumerate() {
        let mut by_horizon =
            IndexMap::from([(FREE_RUN.to_owned(), at_axis(grid, &replay.free_run(index), axis, between))]);
        for (name, horizon) in horizons {
            if let Some(place) = lead(*horizon, grid.step()).and_then(|lead| leads.binary_search(&lead).ok())
            {
                by_horizon.insert(name.clone(), at_axis(grid, &ahead[index][place], axis, between));
            }
        }
        found.insert(output.channel.clone(), by_horizon);
    }
    found
}

/// Whether an instant lies in the training part of a fit.
fn trained_on(replay: &Replay, time: i64) -> bool {
    let train = replay.range(Part::Train);
    let grid = replay.problem().grid();
    (grid.time(train.start)..=grid.time(train.end.saturating_sub(1))).contains(&time)
}

/// How a series is read between two of its samples: the values around, and how far the instant is on the way.
type Reading = fn(Option<f64>, Option<f64>, f64) -> Option<f64>;

/// What was simulated lies on the line between two samples.
fn between(before: Option<f64>, after: Option<f64>, way: f64) -> Option<f64> {
    Some(before? * (1.0 - way) + after? * way)
}

/// What was measured is never interpolated.
fn nearest(before: Option<f64>, after: Option<f64>, way: f64) -> Option<f64> {
    if way <= 0.5 { before } else { after }
}

/// A series at the times of the axis.
fn at_axis(grid: &Grid, values: &[Option<f64>], axis: &Grid, reading: Reading) -> Vec<Option<f64>> {
    let read = |k: usize| {
        let since = axis.time(k) - grid.start();
        let index = usize::try_from(since.div_euclid(grid.step())).ok()?;
        let rest = since.rem_euclid(grid.step());
        let before = values.get(index).copied()?;
        if rest == 0 {
            before
        } else {
            reading(before, values.get(index + 1).copied()?, rest as f64 / grid.step() as f64)
        }
    };
    (0..axis.len()).map(read).collect()
}

/// The errors of all fits in one output at one horizon, on the samples that all of them have.
fn rows(
    output: &str,
    unit: &str,
    horizon: &str,
    measured: &[Option<f64>],
    fits: &[(&str, &ByHorizon)],
    unseen: &[bool],
) -> Vec<ErrorRow> {
    let Some(series) =
        fits.iter().map(|(id, by_horizon)| Some((*id, by_horizon.get(horizon)?))).collect::<Option<Vec<_>>>()
    else {
        return Vec::new();
    };
    let common: Vec<usize> = (0..measured.len())
        .filter(|k| measured[*k].is_some() && series.iter().all(|(_, values)| values[*k].is_some()))
        .collect();
    let row = |id: &str, values: &[Option<f64>], over: Over| {
        let counts = |k: &usize| over == Over::Range || unseen[*k];
        let pairs: Vec<(f64, f64)> =
            common.iter().copied().filter(counts).filter_map(|k| Some((values[k]?, measured[k]?))).collect();
        let skill = Skill::of(&pairs)?;
        Some(ErrorRow {
            fit: id.to_owned(),
            output: output.to_owned(),
            unit: unit.to_owned(),
            horizon: horizon.to_owned(),
            over,
            skill,
        })
    };
    let overs = [Over::Range, Over::Unseen];
    overs
        .into_iter()
        .flat_map(|over| {
            series.iter().filter_map(move |(id, values)| row(id, values, over)).collect::<Vec<_>>()
        })
        .collect()
}
