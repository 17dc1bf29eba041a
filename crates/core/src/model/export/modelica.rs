//! A model as a Modelica class.

use super::dialect::Dialect;
use super::json::start;
use super::listing::{listing, numbered};
use super::names::Names;
use super::source::ExportSource;
use crate::model::Model;
use crate::model::expr::NodeId;
use std::fmt::Write;

/// The class. Modelica counts seconds, so rates per hour are divided by 3600.
pub fn text(model: &Model, theta: &[f64], source: &ExportSource) -> String {
    let names = Names::new(model);
    let outputs = model.outputs().iter().map(|output| output.node);
    let hours: Vec<NodeId> = names.entrances.iter().filter_map(|(entrance, _)| entrance.hours()).collect();
    let roots: Vec<NodeId> = model.rhs().iter().copied().chain(outputs).chain(hours).collect();
    let listing = listing(model.graph(), &roots, &names, Dialect::Modelica, numbered(&names));
    let (rates, rest) = listing.roots.split_at(model.states().len());
    let (outputs, hours) = rest.split_at(model.outputs().len());
    let class = class(model);
    let mut text = format!("model {class} {}\n  // {}\n", comment(model.title()), line(&source.line));
    for ((name, parameter), value) in names.parameters.iter().zip(model.parameters()).zip(theta) {
        let about = comment(&format!("{} [{}]", parameter.title, parameter.unit));
        let _ = writeln!(text, "  parameter Real {name} = {value:?} {about};");
    }
    for (name, state) in names.states.iter().zip(model.states()) {
        let (value, from) = match start(state.initial, theta) {
            Some(value) => (value, "at the start of the fit's window"),
            None => (0.0, "to be set: its start is measured"),
        };
        let _ = writeln!(text, "  parameter Real {name}_start = {value:?} {};", comment(from));
    }
    for (name, input) in names.inputs.iter().zip(model.inputs()) {
        let _ = writeln!(
            text,
            "  input Real {name} {};",
            comment(&format!("{} [{}]", input.channel, input.unit))
        );
    }
    for (name, output) in names.outputs.iter().zip(model.outputs()) {
        let _ = writeln!(
            text,
            "  output Real {name} {};",
            comment(&format!("{} [{}]", output.channel, output.unit))
        );
    }
    for (name, state) in names.states.iter().zip(model.states()) {
        let about = comment(&format!("[{}]", state.unit));
        let _ = writeln!(text, "  Real {name}(start = {name}_start, fixed = true) {about};");
    }
    let delayed = || names.entrances.iter().filter(|(entrance, _)| entrance.hours().is_some());
    text.push_str("protected\n");
    for name in delayed().map(|(_, name)| name).chain(listing.definitions.iter().map(|(name, _)| name)) {
        let _ = writeln!(text, "  Real {name};");
    }
    text.push_str("equation\n");
    for ((entrance, name), hours) in delayed().zip(hours) {
        let _ = writeln!(text, "  {name} = delay({}, 3600*({hours}));", names.inputs[entrance.input]);
    }
    for (name, meaning) in &listing.definitions {
        let _ = writeln!(text, "  {name} = {meaning};");
    }
    for (name, rate) in names.states.iter().zip(rates) {
        let _ = writeln!(text, "  der({name}) = ({rate})/3600;");
    }
    for (name, output) in names.outputs.iter().zip(outputs) {
        let _ = writeln!(text, "  {name} = {output};");
    }
    let _ = writeln!(text, "end {class};");
    text
}

/// A name for the class.
fn class(model: &Model) -> String {
    let word = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    format!("Lampyris_{}", model.id().to_string().chars().map(word).collect::<String>())
}

/// A text as a string of Modelica.
fn comment(text: &str) -> String {
    format!("\"{}\"", line(text).replace('\\', "\\\\").replace('"', "\\\""))
}

/// A text on one line.
fn line(text: &str) -> String {
    text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}
