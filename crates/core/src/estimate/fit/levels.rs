//! Level and spread of the channels behind a fit.

use crate::data::Column;
use crate::estimate::problem::Problem;
use indexmap::IndexMap;
use serde::{Deserialize, Serialize};
use std::ops::Range;
use utoipa::ToSchema;

/// The level and the spread of a channel in a fit's window.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, ToSchema)]
#[schema(as = Level)]
pub struct ChannelLevel {
    /// Mean of its valid samples.
    pub mean: f64,
    /// Their standard deviation.
    pub sd: f64,
}

/// The level of every channel that a problem reads, by its name.
pub fn levels(problem: &Problem) -> IndexMap<String, ChannelLevel> {
    let levels = read(problem)
        .map(|(name, column)| (name.to_owned(), level(&known(column, 0..column.values().len()))));
    levels.filter(|(_, level)| level.mean.is_finite()).collect()
}

/// No numbers where there are no values.
pub(in crate::estimate) fn level(values: &[f64]) -> ChannelLevel {
    let mean = mean(values);
    let sd = (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt();
    ChannelLevel { mean, sd }
}

/// The columns that a problem reads and that were logged or computed for it.
pub(in crate::estimate) fn read(problem: &Problem) -> impl Iterator<Item = (&str, &Column)> {
    let model = problem.model();
    let names = model
        .outputs()
        .iter()
        .map(|output| output.channel.as_str())
        .chain(model.inputs().iter().map(|input| input.channel.as_str()));
    names.filter_map(|name| Some((name, problem.grid().column(name)?)))
}

pub(in crate::estimate) fn known(column: &Column, range: Range<usize>) -> Vec<f64> {
    range.filter(|k| column.valid()[*k]).map(|k| column.values()[k]).collect()
}

pub(in crate::estimate) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}
