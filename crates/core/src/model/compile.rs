//! A composition and its bindings become a [`Model`]: the only way to make one.

use super::bindings::Bindings;
use super::builder::{Builder, states};
use super::catalogue::{AppliedEffect, Composition};
use super::derivative::{derivatives, time_derivative};
use super::expr::{Graph, Node, NodeId};
use super::functions::{MAX_DELAY, delays};
use super::lower::Value;
use super::parse::is_quantity;
use super::spec::{Check, clear_quantities};
use super::waivers::waiver_faults;
use super::warm_up::warm_up;
use super::{Initial, Input, Model, Output, Parameter, State};
use crate::fault::Fault;
use crate::units::Unit;
use indexmap::IndexMap;

/// Most checks of a model: each is looked at over the whole window.
pub(super) const MAX_CHECKS: usize = 64;
/// Most parameters, and most inputs.
pub(super) const MAX_PARAMETERS: usize = 128;

/// Compiles a model.
///
/// # Errors
/// Every fault of the spec and its effects: unknown names, wrong units, limits, missing channels.
pub fn compile(composition: &Composition, bindings: &Bindings) -> Result<Model, Vec<Fault>> {
    let spec = &composition.spec;
    let mut builder = Builder::new(composition, bindings);
    for (name, state) in &spec.states {
        builder.state(name, &state.unit);
    }
    for (key, input) in &spec.inputs {
        builder.input(&format!("/inputs/{key}"), key, input, bindings);
    }
    for (key, parameter) in &spec.parameters {
        builder.parameter(&format!("/parameters/{key}"), key, parameter);
    }
    for (name, definition) in &spec.define {
        if !is_quantity(name) || !builder.lowering.add_define(name, definition.clone()) {
            builder.fault(&format!("/define/{name}"), "name-taken", format!("`{name}` is no free name"));
        }
    }
    let effects: Vec<&AppliedEffect> =
        composition.effects.iter().filter(|effect| builder.declare_effect(effect, bindings)).collect();
    let mut rhs: Vec<Value> = Vec::new();
    for (name, state) in &spec.states {
        let pointer = format!("/equations/{name}");
        let Some(text) = spec.equations.get(name) else {
            builder.fault(&pointer, "equation-missing", format!("the state `{name}` has no equation"));
            continue;
        };
        let value = builder.lowering.text(&pointer, text);
        if let Ok(unit) = Unit::parse(&state.unit) {
            builder.lowering.demand(
                &pointer,
                value,
                unit.divided_by(Unit::HOUR),
                &format!("the rate of `{name}`"),
            );
        }
        rhs.push(value);
    }
    for name in spec.equations.keys().filter(|name| !spec.states.contains_key(*name)) {
        builder.fault(&format!("/equations/{name}"), "unknown-state", format!("there is no state `{name}`"));
    }
    // A state of an effect's own has nothing but its terms.
    rhs.resize_with(builder.states, || builder.lowering.zero());
    let mut outputs: IndexMap<String, Value> = IndexMap::new();
    for (channel, output) in &spec.outputs {
        let pointer = format!("/outputs/{channel}");
        let expr_at = format!("{pointer}/expr");
        let value = builder.lowering.text(&expr_at, &output.expr);
        match Unit::parse(&output.unit) {
            Ok(unit) => builder.lowering.demand(&expr_at, value, unit, &format!("the output `{channel}`")),
            Err(error) => builder.fault(&format!("{pointer}/unit"), "unit", error.to_string()),
        }
        if !(output.noise_sd.is_finite() && output.noise_sd > 0.0) {
            builder.fault(
                &format!("{pointer}/noise_sd"),
                "noise",
                "the standard deviation of the noise must be positive".to_owned(),
            );
        }
        outputs.insert(channel.clone(), value);
    }
    for effect in effects {
        builder.effect(effect, &mut rhs, &mut outputs);
    }
    let mut ranges = Vec::new();
    if spec.checks.len() > MAX_CHECKS {
        builder.fault("/check", "limit", format!("a model has at most {MAX_CHECKS} checks"));
    }
    for (index, check) in spec.checks.iter().take(MAX_CHECKS).enumerate() {
        let (is_input, is_state) =
            (|name: &str| spec.inputs.contains_key(name), |name: &str| spec.states.contains_key(name));
        builder.lowering.faults.extend(check.faults(&format!("/check/{index}"), is_input, is_state));
        if let Check::Range { expr, unit, .. } = check {
            ranges.push(builder.range(&format!("/check/{index}"), expr, unit));
        }
    }
    builder.lowering.faults.extend(waiver_faults("/waive", &spec.waive));
    builder.lowering.judge_unused();
    for channel in std::mem::take(&mut builder.lowering.missing) {
        builder.fault(
            "/inputs",
            "missing-channel",
            format!("the model needs the channel `{channel}`, which is not there"),
        );
    }
    let initials = builder.initials(composition);
    finish(builder, composition, bindings, &rhs, &outputs, &ranges, initials)
}

/// Drops what is not used, differentiates, and hashes.
fn finish(
    mut builder: Builder,
    composition: &Composition,
    bindings: &Bindings,
    rhs: &[Value],
    outputs: &IndexMap<String, Value>,
    ranges: &[Value],
    initials: Vec<Initial>,
) -> Result<Model, Vec<Fault>> {
    if builder.parameters.len() > MAX_PARAMETERS || builder.inputs.len() > MAX_PARAMETERS {
        builder.fault(
            "",
            "limit",
            format!("a model has at most {MAX_PARAMETERS} parameters and {MAX_PARAMETERS} inputs"),
        );
    }
    if !builder.lowering.faults.is_empty() {
        return Err(builder.lowering.faults);
    }
    let source = builder.lowering.graph;
    let roots: Vec<NodeId> =
        rhs.iter().chain(outputs.values()).chain(ranges).map(|value| value.node).collect();
    let used = source.reachable(&roots);
    let mut keep_input = vec![false; builder.inputs.len()];
    let mut keep_parameter: Vec<bool> =
        (0..builder.parameters.len()).map(|i| initials.contains(&Initial::Parameter(i))).collect();
    for (node, _) in source.nodes().iter().zip(&used).filter(|(_, used)| **used) {
        match node {
            Node::Input(i, _) | Node::Delayed(i, ..) => keep_input[usize::from(*i)] = true,
            Node::Param(i) => keep_parameter[usize::from(*i)] = true,
            _ => {}
        }
    }
    let rank = |keep: &[bool], i: usize| keep[..i].iter().filter(|kept| **kept).count();
    let mut graph = Graph::default();
    let roots = graph.import(&source, &roots, |graph, leaf| {
        graph.intern(match leaf {
            Node::Input(i, point) => Node::Input(rank(&keep_input, usize::from(i)) as u16, point),
            Node::Delayed(i, point, hours) => {
                Node::Delayed(rank(&keep_input, usize::from(i)) as u16, point, hours)
            }
            Node::Param(i) => Node::Param(rank(&keep_parameter, usize::from(i)) as u16),
            other => other,
        })
    });
    let inputs: Vec<Input> = builder
        .inputs
        .into_iter()
        .zip(&keep_input)
        .filter(|(_, keep)| **keep)
        .map(|(input, _)| input)
        .collect();
    let mut unused = Vec::new();
    let mut parameters: Vec<Parameter> = Vec::new();
    for (parameter, keep) in builder.parameters.into_iter().zip(&keep_parameter) {
        if *keep { parameters.push(parameter) } else { unused.push(parameter.name) }
    }
    let delays = delays(&graph, &parameters);
    let too_long = delays
        .iter()
        .filter(|delay| delay.longest > MAX_DELAY)
        .filter_map(|delay| parameters.get(delay.parameter?));
    let mut faults: Vec<Fault> = too_long
        .map(|parameter| {
            Fault::new(
                format!("/parameters/{}", parameter.name),
                "limit",
                format!("a delay is at most {MAX_DELAY} h"),
            )
        })
        .collect();
    let (warm_up, more) = warm_up(&composition.spec, &inputs, &delays);
    faults.extend(more);
    if !faults.is_empty() {
        return Err(faults);
    }
    let (rhs, rest) = roots.split_at(builder.states);
    let (output_nodes, ranges) = rest.split_at(outputs.len());
    let rhs = rhs.to_vec();
    // All equations and outputs by one state at a time: they share most of what they are made of.
    let roots: Vec<NodeId> = rhs.iter().chain(output_nodes).copied().collect();
    let by_state: Vec<Vec<NodeId>> =
        (0..rhs.len()).map(|j| derivatives(&mut graph, &roots, Node::State(j as u16))).collect();
    let gradient = |root: usize| by_state.iter().map(|column| column[root]).collect::<Vec<NodeId>>();
    let jacobian: Vec<Vec<NodeId>> = (0..rhs.len()).map(gradient).collect();
    let rate = rhs.iter().map(|f| time_derivative(&mut graph, *f, &inputs)).collect();
    let outputs = composition
        .spec
        .outputs
        .iter()
        .zip(output_nodes)
        .enumerate()
        .map(|(index, ((channel, spec), node))| Output {
            channel: channel.clone(),
            unit: spec.unit.clone(),
            noise_sd: spec.noise_sd,
            node: *node,
            gradient: gradient(rhs.len() + index),
        })
        .collect();
    let states = states(composition)
        .zip(initials)
        .map(|((name, state), initial)| State {
            name: name.clone(),
            unit: state.unit.clone(),
            initial: match initial {
                Initial::Parameter(i) => Initial::Parameter(rank(&keep_parameter, i)),
                known => known,
            },
        })
        .collect();
    let channels: Vec<&str> = inputs.iter().map(|input| input.channel.as_str()).collect();
    // A quantity is a name: with or without it, the fits that are kept are fits of this model.
    let mut spec = composition.spec.clone();
    clear_quantities(&mut spec.parameters);
    let applied = composition.effects.iter().filter(|effect| builder.applied.contains(&effect.id));
    let mut effects: Vec<_> = applied.map(|effect| effect.spec.clone()).collect();
    effects.iter_mut().for_each(|effect| clear_quantities(&mut effect.parameters));
    let identity = serde_json::json!({
        "spec": spec, "effects": effects,
        "sets": bindings.sets, "channels": channels,
    });
    Ok(Model {
        id: composition.id.clone(),
        title: composition.spec.title.clone(),
        hash: blake3::hash(identity.to_string().as_bytes()).to_hex().to_string(),
        states,
        inputs,
        parameters,
        unused,
        outputs,
        effects: builder.applied,
        dropped: builder.lowering.dropped.into_iter().collect(),
        checks: composition.spec.checks.clone(),
        waivers: composition.spec.waive.clone(),
        ranges: ranges.to_vec(),
        graph,
        rhs,
        jacobian,
        rate,
        delays,
        stepper: composition.spec.stepper,
        warm_up,
    })
}
