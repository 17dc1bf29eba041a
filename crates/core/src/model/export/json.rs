//! A model as a document.

use super::dialect::Dialect;
use super::listing::{listing, numbered};
use super::names::Names;
use crate::model::expr::NodeId;
use crate::model::{Initial, InputHold, Model};
use indexmap::IndexMap;
use serde::Serialize;
use utoipa::ToSchema;

/// A model with its parameter values, written out: no variant, set or effect is left to be resolved.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ExportedModel {
    /// The model.
    pub model: String,
    /// A short title for people.
    pub title: String,
    /// The unit of time: rates are per hour.
    #[schema(value_type = String, example = "h")]
    pub time_unit: &'static str,
    /// The states.
    pub states: Vec<ExportedState>,
    /// What enters the equations.
    pub inputs: Vec<ExportedInput>,
    /// The parameters.
    pub parameters: Vec<ExportedParameter>,
    /// What the expressions use more than once, each before its use.
    pub definitions: IndexMap<String, String>,
    /// The outputs.
    pub outputs: Vec<ExportedOutput>,
}

/// A state.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ExportedState {
    /// Its name in the expressions.
    pub symbol: String,
    /// Its name in the documents of the model.
    pub name: String,
    /// Its unit.
    pub unit: String,
    /// Its time derivative, per hour.
    pub rate: String,
    /// Its value at the start of the fit's window; `null` where that is measured.
    pub start: Option<f64>,
    /// The channel that measures its start.
    pub measured_by: Option<String>,
}

/// What enters the equations.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ExportedInput {
    /// Its name in the expressions.
    pub symbol: String,
    /// The channel.
    pub channel: String,
    /// Its unit in the equations; `*` where it counts as it comes.
    pub unit: String,
    /// Between samples: `linear`, or `zero_order` where a value holds until the next one.
    #[schema(value_type = String)]
    pub hold: InputHold,
    /// How long ago it counts, in hours.
    pub delay_h: f64,
}

/// A parameter.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ExportedParameter {
    /// Its name in the expressions.
    pub symbol: String,
    /// Its name in the documents of the model.
    pub name: String,
    /// Its value.
    pub value: f64,
    /// Its unit.
    pub unit: String,
}

/// An output.
#[derive(Debug, Clone, PartialEq, Serialize, ToSchema)]
pub struct ExportedOutput {
    /// The channel that measures it.
    pub channel: String,
    /// Its unit.
    pub unit: String,
    /// What it is.
    pub expression: String,
    /// Standard deviation of the sensor's noise.
    pub noise_sd: f64,
}

/// The document of a model with a parameter vector.
pub fn document(model: &Model, theta: &[f64]) -> ExportedModel {
    let names = Names::new(model);
    let outputs = model.outputs().iter().map(|output| output.node);
    let roots: Vec<NodeId> = model.rhs().iter().copied().chain(outputs).collect();
    let listing = listing(model.graph(), &roots, &names, Dialect::Plain, numbered(&names));
    let (rates, expressions) = listing.roots.split_at(model.states().len());
    let state = |(index, state): (usize, &crate::model::State)| ExportedState {
        symbol: names.states[index].clone(),
        name: state.name.clone(),
        unit: state.unit.clone(),
        rate: rates[index].clone(),
        start: start(state.initial, theta),
        measured_by: match state.initial {
            Initial::Measured(output) => Some(model.outputs()[output].channel.clone()),
            Initial::Parameter(_) | Initial::Fixed(_) => None,
        },
    };
    let input = |(entrance, name): &(crate::model::entrance::Entrance, String)| {
        let input = &model.inputs()[entrance.input];
        ExportedInput {
            symbol: name.clone(),
            channel: input.channel.clone(),
            unit: input.unit.clone(),
            hold: input.hold,
            delay_h: entrance.delay(model.graph(), theta),
        }
    };
    let parameter = |(index, parameter): (usize, &crate::model::Parameter)| ExportedParameter {
        symbol: names.parameters[index].clone(),
        name: parameter.name.clone(),
        value: theta[index],
        unit: parameter.unit.clone(),
    };
    let output = |(index, output): (usize, &crate::model::Output)| ExportedOutput {
        channel: output.channel.clone(),
        unit: output.unit.clone(),
        expression: expressions[index].clone(),
        noise_sd: output.noise_sd,
    };
    ExportedModel {
        model: model.id().to_string(),
        title: model.title().to_owned(),
        time_unit: "h",
        states: model.states().iter().enumerate().map(state).collect(),
        inputs: names.entrances.iter().map(input).collect(),
        parameters: model.parameters().iter().enumerate().map(parameter).collect(),
        definitions: listing.definitions.into_iter().collect(),
        outputs: model.outputs().iter().enumerate().map(output).collect(),
    }
}

/// Where a state starts; `None` where that is measured.
pub fn start(initial: Initial, theta: &[f64]) -> Option<f64> {
    match initial {
        Initial::Measured(_) => None,
        Initial::Parameter(index) => theta.get(index).copied(),
        Initial::Fixed(value) => Some(value),
    }
}
