//! What an experiment is asked for, and whether that makes sense for a problem.

use super::plans::DrivenInput;
use crate::estimate::Problem;
use crate::fault::Fault;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// The longest experiment in days.
pub const LONGEST_DAYS: usize = 14;

/// What an experiment is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub enum ExperimentPurpose {
    /// To tell parameters or effects apart that are tied.
    Separate,
    /// To make the intervals of parameters narrow.
    Determine,
    /// To see whether there is an effect of a typical size.
    Detect,
}

/// Bounds that an output shall keep, in its unit.
#[derive(Debug, Clone, PartialEq)]
pub struct ComfortBounds {
    /// The output.
    pub channel: String,
    /// Its lowest and its highest value.
    pub range: [f64; 2],
}

/// What is asked for.
#[derive(Debug, Clone, PartialEq)]
pub struct ExperimentAsked {
    /// How many days.
    pub days: usize,
    /// What may be driven.
    pub inputs: Vec<DrivenInput>,
    /// What shall be kept.
    pub comfort: Vec<ComfortBounds>,
    /// What it is for.
    pub purpose: ExperimentPurpose,
    /// The parameters that it is about, by name.
    pub about: Vec<String>,
    /// Fixes the sequences that are tried.
    pub seed: u64,
}

/// The parameters that an experiment is about, by their places.
pub(super) fn checked(problem: &Problem, asked: &ExperimentAsked) -> Result<Vec<usize>, Vec<Fault>> {
    let model = problem.model();
    let mut faults = Vec::new();
    if asked.days == 0 || asked.days > LONGEST_DAYS {
        let detail = format!("an experiment takes 1 to {LONGEST_DAYS} days");
        faults.push(Fault::new("/days", "out-of-range", detail));
    }
    let least = if asked.purpose == ExperimentPurpose::Separate { 2 } else { 1 };
    if asked.about.len() < least {
        let detail = format!("name {least} or more parameters or effects that it is about");
        faults.push(Fault::new("/about", "too-few", detail));
    }
    if asked.inputs.is_empty() {
        faults.push(Fault::new("/inputs", "too-few", "name an input that may be driven, with its range"));
    }
    for input in &asked.inputs {
        let pointer = format!("/inputs/{}", input.channel);
        if model.inputs().iter().all(|known| known.channel != input.channel) {
            let detail = format!("`{}` is no input of the model", input.channel);
            faults.push(Fault::new(&pointer, "unknown-input", detail));
        }
        if !(input.range.iter().all(|value| value.is_finite()) && input.range[0] < input.range[1]) {
            faults.push(Fault::new(&pointer, "empty-range", "a range is a lower and a higher value"));
        }
        if !(input.slew.is_finite() && input.slew > 0.0) {
            faults.push(Fault::new(format!("/slew/{}", input.channel), "no-pace", "more than nothing"));
        }
    }
    for bounds in &asked.comfort {
        let pointer = format!("/comfort/{}", bounds.channel);
        if model.outputs().iter().all(|output| output.channel != bounds.channel) {
            let detail = format!("`{}` is no output of the model", bounds.channel);
            faults.push(Fault::new(&pointer, "unknown-output", detail));
        }
        if bounds.range[0].partial_cmp(&bounds.range[1]) != Some(std::cmp::Ordering::Less) {
            faults.push(Fault::new(&pointer, "empty-range", "comfort is a lower and a higher value"));
        }
    }
    let mut about = Vec::new();
    for name in &asked.about {
        let place = model.parameters().iter().position(|parameter| parameter.name == *name);
        match place.filter(|place| problem.free().contains(place)) {
            Some(place) => about.push(place),
            None => {
                let detail = format!("`{name}` is no estimated parameter of the model");
                faults.push(Fault::new("/about", "unknown-parameter", detail));
            }
        }
    }
    if faults.is_empty() { Ok(about) } else { Err(faults) }
}
