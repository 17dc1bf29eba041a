//! One fit beside what was measured, sample by sample.

use super::replay::{Part, Replay};
use super::skill::Skill;
use crate::data::rfc3339;
use crate::fault::Fault;
use crate::units::error_unit;
use indexmap::IndexMap;
use serde::Serialize;
use std::ops::Range;
use utoipa::ToSchema;

/// How the model is run beside the measurements.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ComparisonMode {
    /// One simulation from the start of the fit's window.
    FreeRun,
    /// At each sample the forecast made so many samples before, from re-estimated states.
    Ahead(usize),
}

/// One output, sample by sample; `None` where there is nothing.
#[derive(Debug, Clone, PartialEq)]
pub struct OutputLines {
    /// Unit of both series.
    pub unit: String,
    /// Unit of their difference.
    pub error_unit: String,
    /// What was measured.
    pub measured: Vec<Option<f64>>,
    /// What the model says.
    pub simulated: Vec<Option<f64>>,
}

impl OutputLines {
    /// Measured minus simulated: positive where the model is too low.
    pub fn residual(&self) -> Vec<Option<f64>> {
        self.simulated
            .iter()
            .zip(&self.measured)
            .map(|(simulated, measured)| Some((*measured)? - (*simulated)?))
            .collect()
    }
}

/// One input, sample by sample.
#[derive(Debug, Clone, PartialEq)]
pub struct InputLine {
    /// Its unit.
    pub unit: String,
    /// Its values; `None` in a gap.
    pub values: Vec<Option<f64>>,
}

/// A stretch of a fit's window.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, ToSchema)]
pub struct PartSpan {
    /// Which part.
    #[schema(value_type = String)]
    pub part: Part,
    /// Its first sample in the range, RFC 3339.
    #[schema(format = DateTime)]
    pub from: String,
    /// Its last one.
    #[schema(format = DateTime)]
    pub to: String,
}

/// Errors of one output.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct OutputErrors {
    /// Unit of the errors.
    pub unit: String,
    /// Over the whole range.
    pub range: Option<Skill>,
    /// By part; forecasts count where origin and target lie in the same part, as for the stored errors.
    #[schema(value_type = IndexMap<String, Skill>)]
    pub parts: IndexMap<Part, Skill>,
}

/// A fit beside the measurements over a range.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    /// The time of the first sample, in milliseconds.
    pub start: i64,
    /// Milliseconds between samples.
    pub step: i64,
    /// Outputs by channel.
    pub outputs: IndexMap<String, OutputLines>,
    /// The model's inputs by channel.
    pub inputs: IndexMap<String, InputLine>,
    /// Which part each stretch belongs to.
    pub parts: Vec<PartSpan>,
    /// Errors by output.
    pub errors: IndexMap<String, OutputErrors>,
}

/// The samples of a replay between two instants, both included.
///
/// # Errors
/// A fault where there is none.
pub fn samples(replay: &Replay, from: i64, to: i64) -> Result<Range<usize>, Vec<Fault>> {
    let grid = replay.problem().grid();
    let (start, step, len) = (grid.start(), grid.step(), grid.len());
    let first = usize::try_from((from - start + step - 1).div_euclid(step)).unwrap_or(0);
    let end = usize::try_from((to - start).div_euclid(step) + 1).unwrap_or(0).min(len);
    if first < end {
        return Ok(first..end);
    }
    let detail = format!("there is nothing to compare from {} to {}", rfc3339(from), rfc3339(to));
    let there = format!(
        "the run of the fit covers {} to {}",
        rfc3339(start),
        rfc3339(grid.time(len.saturating_sub(1)))
    );
    Err(vec![Fault::new("query from", "no-data-in-range", detail).suggest(there)])
}

/// Lays a fit beside the measurements between two instants.
///
/// # Errors
/// A fault where there is nothing between them.
pub fn comparison(
    replay: &Replay,
    mode: ComparisonMode,
    from: i64,
    to: i64,
) -> Result<Comparison, Vec<Fault>> {
    let range = samples(replay, from, to)?;
    let (problem, grid) = (replay.problem(), replay.problem().grid());
    let lead = match mode {
        ComparisonMode::FreeRun => 0,
        ComparisonMode::Ahead(lead) => lead,
    };
    let ahead = match mode {
        ComparisonMode::FreeRun => Vec::new(),
        ComparisonMode::Ahead(lead) => {
            replay.ahead(range.start.saturating_sub(lead)..range.end.saturating_sub(lead), &[lead])
        }
    };
    let mut outputs = IndexMap::new();
    let mut errors = IndexMap::new();
    for (index, output) in problem.model().outputs().iter().enumerate() {
        let (measured, simulated) = (
            replay.measured(index),
            ahead.get(index).map_or_else(|| replay.free_run(index), |leads| leads[0].clone()),
        );
        let unit = error_unit(&output.unit).to_owned();
        let part = |part: Part| {
            let own = replay.range(part);
            let within = range.start.max(own.start + lead)..range.end.min(own.end);
            Some((part, Skill::over(&simulated, &measured, within)?))
        };
        let parts = Part::ALL.into_iter().filter_map(part).collect();
        errors.insert(
            output.channel.clone(),
            OutputErrors {
                unit: unit.clone(),
                range: Skill::over(&simulated, &measured, range.clone()),
                parts,
            },
        );
        let lines = OutputLines {
            unit: output.unit.clone(),
            error_unit: unit,
            measured: measured[range.clone()].to_vec(),
            simulated: simulated[range.clone()].to_vec(),
        };
        outputs.insert(output.channel.clone(), lines);
    }
    let inputs = problem.model().inputs().iter().filter_map(|input| {
        let column = grid.column(&input.channel)?;
        let values = range.clone().map(|k| column.valid()[k].then_some(column.values()[k])).collect();
        Some((input.channel.clone(), InputLine { unit: column.unit().to_owned(), values }))
    });
    Ok(Comparison {
        start: grid.time(range.start),
        step: grid.step(),
        inputs: inputs.collect(),
        parts: parts(replay, &range),
        outputs,
        errors,
    })
}

/// The parts of a fit's window in a range of samples.
pub fn parts(replay: &Replay, range: &Range<usize>) -> Vec<PartSpan> {
    let grid = replay.problem().grid();
    let within = |part: Part| {
        let own = replay.range(part);
        let (first, end) = (own.start.max(range.start), own.end.min(range.end));
        (first < end).then(|| PartSpan {
            part,
            from: rfc3339(grid.time(first)),
            to: rfc3339(grid.time(end - 1)),
        })
    };
    Part::ALL.into_iter().filter_map(within).collect()
}
