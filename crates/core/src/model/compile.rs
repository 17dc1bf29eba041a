//! A composition and its bindings become a [`Model`]: the only way to make one.

use super::catalogue::{AppliedEffect, Composition};
use super::derivative::{derivatives, time_derivative};
use super::expr::{Graph, Node, NodeId, Point};
use super::functions::{MAX_DELAY, delays};
use super::lower::{Lowering, Symbol, Value};
use super::parse::{declaration, is_quantity};
use super::spec::{Check, Hold, InputSpec, Nominal, ParameterSpec, Scale, StateSpec};
use super::warm_up::warm_up;
use super::{Initial, Input, Model, Output, Parameter, State};
use crate::fault::Fault;
use crate::units::Unit;
use indexmap::IndexMap;
use std::collections::{BTreeMap, BTreeSet};

/// Most states of a model.
const MAX_STATES: usize = 256;
/// Most checks of a model: each is looked at over the whole window.
const MAX_CHECKS: usize = 64;
/// Most parameters, and most inputs.
const MAX_PARAMETERS: usize = 128;

/// The unit of an input whose channel may have any.
pub const AS_IT_COMES: &str = "*";
/// Channels of the clock on the wall, which begin again.
const CLOCK: [&str; 2] = ["hour_of_day", "weekday"];

/// What a system tells a model: the members of its sets and the channels that are there.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Bindings {
    /// The members of each set; a set that is not named is empty.
    pub sets: BTreeMap<String, Vec<String>>,
    /// The channels of the window, derived ones included; `None` where nothing is known, then all are
    /// assumed.
    pub channels: Option<BTreeSet<String>>,
}

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
        let value = builder.lowering.text(&pointer, &output.expr);
        match Unit::parse(&output.unit) {
            Ok(unit) => builder.lowering.demand(&pointer, value, unit, &format!("the output `{channel}`")),
            Err(error) => builder.fault(&pointer, "unit", error.to_string()),
        }
        if !(output.noise_sd.is_finite() && output.noise_sd > 0.0) {
            builder.fault(
                &pointer,
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
    builder.lowering.judge_unused();
    for channel in std::mem::take(&mut builder.lowering.missing) {
        builder.fault(
            "/inputs",
            "missing-channel",
            format!("the model needs the channel `{channel}`, which is not there"),
        );
    }
    let initials = builder.initials(composition);
    builder.finish(composition, bindings, &rhs, &outputs, &ranges, initials)
}

struct Builder {
    lowering: Lowering,
    inputs: Vec<Input>,
    parameters: Vec<Parameter>,
    states: usize,
    applied: Vec<String>,
}

impl Builder {
    fn new(composition: &Composition, bindings: &Bindings) -> Self {
        let sets = composition
            .spec
            .sets
            .iter()
            .map(|set| (set.clone(), bindings.sets.get(set).cloned().unwrap_or_default()))
            .collect();
        let mut builder = Self {
            lowering: Lowering::new(sets),
            inputs: Vec::new(),
            parameters: Vec::new(),
            states: 0,
            applied: Vec::new(),
        };
        for set in bindings.sets.keys().filter(|set| !composition.spec.sets.contains(set)) {
            builder.fault("/bindings", "unknown-set", format!("the model has no set `{set}`"));
        }
        if composition.spec.states.is_empty() || composition.spec.states.len() > MAX_STATES {
            builder.fault("/states", "limit", format!("a model has between 1 and {MAX_STATES} states"));
        }
        if composition.spec.outputs.is_empty() {
            builder.fault("/outputs", "limit", "a model needs an output that is measured".to_owned());
        }
        builder
    }

    fn fault(&mut self, pointer: &str, code: &str, detail: String) {
        self.lowering.faults.push(Fault::new(pointer, code, detail));
    }

    /// The unit of a text; `*` stands for the numbers of a channel as they are.
    fn unit(&mut self, pointer: &str, text: &str) -> Option<Unit> {
        if text == AS_IT_COMES {
            return Some(Unit::ONE);
        }
        Unit::parse(text).map_err(|error| self.fault(pointer, "unit", error.to_string())).ok()
    }

    /// The expression of a check, in its unit.
    fn range(&mut self, pointer: &str, expr: &str, unit: &str) -> Value {
        let (expr_at, unit_at) = (format!("{pointer}/expr"), format!("{pointer}/unit"));
        let value = self.lowering.text(&expr_at, expr);
        if let Some(unit) = self.unit(&unit_at, unit) {
            self.lowering.demand(&expr_at, value, unit, "the check");
        }
        value
    }

    fn state(&mut self, name: &str, unit: &str) {
        let pointer = format!("/states/{name}");
        let unit = self.unit(&pointer, unit);
        // A state is a physical quantity whose sign nothing guarantees.
        let symbol =
            Symbol { node: Node::State(self.states as u16), unit, nonnegative: false, missing: None };
        if !is_quantity(name) || !self.lowering.add_symbol(name.to_owned(), symbol) {
            self.fault(&pointer, "name-taken", format!("`{name}` is no free name"));
        }
        self.states += 1;
    }

    /// The names that a declaration makes: one, or one per member of its set.
    fn declare(&mut self, pointer: &str, key: &str) -> Vec<(String, Option<String>)> {
        match declaration(key) {
            Some((name, None)) => vec![(name.to_owned(), None)],
            Some((name, Some((_, set)))) => match self.lowering.members(set).map(<[String]>::to_vec) {
                Some(members) => {
                    self.lowering.add_family(name, set);
                    members.into_iter().map(|member| (format!("{name}[{member}]"), Some(member))).collect()
                }
                None => {
                    self.fault(pointer, "unknown-set", format!("there is no set `{set}`"));
                    Vec::new()
                }
            },
            None => {
                self.fault(
                    pointer,
                    "name",
                    format!("`{key}` is neither a name nor a family such as `a[n in set]`"),
                );
                Vec::new()
            }
        }
    }

    fn input(&mut self, pointer: &str, key: &str, spec: &InputSpec, bindings: &Bindings) {
        let unit = self.unit(pointer, &spec.unit);
        let variable = declaration(key).and_then(|(_, family)| family).map(|(variable, _)| variable);
        let mark = format!("{{{}}}", variable.unwrap_or_default());
        if variable.is_some() && spec.channel.as_ref().is_some_and(|channel| !channel.contains(&mark)) {
            let fault = Fault::new(pointer, "channel", "the members of a family need channels of their own");
            self.lowering
                .faults
                .push(fault.suggest(format!("write {mark} where the member stands in the channel's name")));
        }
        for (name, member) in self.declare(pointer, key) {
            let channel = match (&spec.channel, &member) {
                (Some(channel), Some(member)) => channel.replace(&mark, member),
                (Some(channel), None) => channel.clone(),
                (None, Some(member)) => format!("{}_{member}", name.split('[').next().unwrap_or(&name)),
                (None, None) => name.clone(),
            };
            if let Some(known) = self.inputs.iter().find(|input| input.name == name) {
                // Two effects may name the same input, if they mean the same by it.
                if known.channel != channel || known.hold != spec.hold || known.unit != spec.unit {
                    self.fault(
                        pointer,
                        "name-taken",
                        format!("the input `{name}` is declared twice with different meanings"),
                    );
                }
                continue;
            }
            if CLOCK.contains(&channel.as_str()) && spec.hold != Hold::ZeroOrder {
                let detail = format!(
                    "between two samples `{channel}` is no straight line: it begins again at midnight"
                );
                self.lowering
                    .faults
                    .push(Fault::new(pointer, "hold", detail).suggest("write hold = \"zero_order\""));
            }
            let there = bindings.channels.as_ref().is_none_or(|channels| channels.contains(&channel));
            let node = Node::Input(self.inputs.len() as u16, Point::Start);
            let nonnegative = spec.min.is_some_and(|min| min >= 0.0);
            let symbol = Symbol { node, unit, nonnegative, missing: (!there).then(|| channel.clone()) };
            let may_be_constant = spec.may_be_constant;
            self.inputs.push(Input {
                name: name.clone(),
                channel,
                unit: spec.unit.clone(),
                hold: spec.hold,
                may_be_constant,
            });
            if !self.lowering.add_symbol(name.clone(), symbol) {
                self.fault(pointer, "name-taken", format!("`{name}` is no free name"));
            }
        }
    }

    fn parameter(&mut self, pointer: &str, key: &str, spec: &ParameterSpec) {
        let unit = self.unit(pointer, &spec.unit);
        let finite = spec.lower.is_finite() && spec.upper.is_finite() && spec.lower < spec.upper;
        if !finite || (spec.scale == Scale::Log && spec.lower <= 0.0) {
            self.fault(
                pointer,
                "bounds",
                format!("the bounds [{}, {}] are not an interval on this scale", spec.lower, spec.upper),
            );
        }
        if let Nominal::Value(value) = spec.nominal
            && !(spec.lower..=spec.upper).contains(&value)
        {
            self.fault(
                pointer,
                "bounds",
                format!("the nominal value {value} lies outside [{}, {}]", spec.lower, spec.upper),
            );
        }
        for (name, _) in self.declare(pointer, key) {
            let node = Node::Param(self.parameters.len() as u16);
            let symbol = Symbol { node, unit, nonnegative: spec.lower >= 0.0, missing: None };
            if !self.lowering.add_symbol(name.clone(), symbol) {
                self.fault(pointer, "name-taken", format!("`{name}` is no free name"));
                continue;
            }
            self.parameters.push(Parameter {
                name,
                unit: spec.unit.clone(),
                lower: spec.lower,
                upper: spec.upper,
                scale: spec.scale,
                nominal: spec.nominal.clone(),
                title: spec.title.clone(),
                excite: spec.excite.clone(),
            });
        }
    }

    /// Declares the names of an effect, and what it replaces, before any equation is read. False where it
    /// replaces something, is optional and one of its channels is missing: then it leaves no trace but a
    /// note.
    fn declare_effect(&mut self, effect: &AppliedEffect, bindings: &Bindings) -> bool {
        let at = |part: &str, name: &str| format!("/effects/{}/{part}/{name}", effect.id);
        for (key, input) in &effect.spec.inputs {
            self.input(&at("inputs", key), key, input, bindings);
        }
        for (key, parameter) in &effect.spec.parameters {
            self.parameter(&at("parameters", key), key, parameter);
        }
        for (name, state) in &effect.spec.states {
            self.state(name, &state.unit);
        }
        for (name, definition) in &effect.spec.define {
            // The base may define the same quantity by the same name, as room3 does with the sun.
            self.lowering.add_define(name, definition.clone());
        }
        let channel = |name: &String| self.lowering.symbol(name).and_then(|symbol| symbol.missing.clone());
        let missing: Vec<String> = effect.spec.inputs.keys().filter_map(channel).collect();
        if effect.optional && !effect.spec.replace.is_empty() && !missing.is_empty() {
            self.drop_effect(effect, missing);
            return false;
        }
        for (name, text) in &effect.spec.replace {
            let pointer = at("replace", name);
            if !self.lowering.replace(pointer.clone(), name, text.clone()) {
                self.fault(
                    &pointer,
                    "unknown-name",
                    format!("the model has no definition, parameter or input `{name}` to replace"),
                );
            }
        }
        true
    }

    fn drop_effect(&mut self, effect: &AppliedEffect, missing: impl IntoIterator<Item = String>) {
        let channels = missing.into_iter().collect::<Vec<_>>().join(", ");
        self.lowering.dropped.insert(format!("{}: the channel {channels} is not there", effect.spec.title));
    }

    /// Adds the terms of an effect; an optional one whose channels are missing leaves no trace but a note.
    fn effect(&mut self, effect: &AppliedEffect, rhs: &mut [Value], outputs: &mut IndexMap<String, Value>) {
        let at = |part: &str, name: &str| format!("/effects/{}/{part}/{name}", effect.id);
        let missing_before = std::mem::take(&mut self.lowering.missing);
        let mut terms = Vec::new();
        for (state, text) in &effect.spec.terms {
            let pointer = at("terms", state);
            let index = self.lowering.symbol(state).map(|symbol| (symbol.node, symbol.unit));
            let Some((Node::State(index), unit)) = index else {
                self.fault(
                    &pointer,
                    "unknown-state",
                    format!("the model has no state `{state}` for this effect"),
                );
                continue;
            };
            let value = self.lowering.text(&pointer, text);
            if let Some(unit) = unit {
                self.lowering.demand(&pointer, value, unit.divided_by(Unit::HOUR), "the term");
            }
            terms.push((usize::from(index), value));
        }
        let mut output_terms = Vec::new();
        for (channel, text) in &effect.spec.outputs {
            let value = self.lowering.text(&at("outputs", channel), text);
            output_terms.push((channel, value));
        }
        let missing = std::mem::replace(&mut self.lowering.missing, missing_before);
        if !missing.is_empty() && effect.optional {
            self.drop_effect(effect, missing);
            return;
        }
        self.lowering.missing.extend(missing);
        for (index, term) in terms {
            if let Some(value) = rhs.get_mut(index) {
                value.node = self.lowering.graph.add(value.node, term.node);
            }
        }
        for (channel, term) in output_terms {
            match outputs.get_mut(channel) {
                Some(value) => value.node = self.lowering.graph.add(value.node, term.node),
                None => self.fault(
                    &at("outputs", channel),
                    "unknown-output",
                    format!("the model has no output `{channel}`"),
                ),
            }
        }
        self.applied.push(effect.id.clone());
    }

    fn initials(&mut self, composition: &Composition) -> Vec<Initial> {
        let mut initials = Vec::new();
        for (name, state) in states(composition) {
            if let Some(output) = composition.spec.outputs.get_index_of(&state.initial) {
                initials.push(Initial::Measured(output));
            } else if let Some(value) = state.initial.parse().ok().filter(|value: &f64| value.is_finite()) {
                initials.push(Initial::Fixed(value));
            } else if let Some(parameter) =
                self.parameters.iter().position(|parameter| parameter.name == state.initial)
            {
                initials.push(Initial::Parameter(parameter));
            } else {
                let detail =
                    format!("`{}` is neither an output channel nor a parameter nor a number", state.initial);
                self.fault(&format!("/states/{name}/initial"), "unknown-name", detail);
            }
        }
        for parameter in &self.parameters {
            if let Nominal::Measured(channel) = &parameter.nominal
                && !composition.spec.outputs.contains_key(channel)
            {
                let detail = format!("`{channel}` is not an output channel");
                self.lowering.faults.push(Fault::new(
                    format!("/parameters/{}/nominal", parameter.name),
                    "unknown-name",
                    detail,
                ));
            }
        }
        initials
    }

    /// Drops what is not used, differentiates, and hashes.
    fn finish(
        mut self,
        composition: &Composition,
        bindings: &Bindings,
        rhs: &[Value],
        outputs: &IndexMap<String, Value>,
        ranges: &[Value],
        initials: Vec<Initial>,
    ) -> Result<Model, Vec<Fault>> {
        if self.parameters.len() > MAX_PARAMETERS || self.inputs.len() > MAX_PARAMETERS {
            self.fault(
                "",
                "limit",
                format!("a model has at most {MAX_PARAMETERS} parameters and {MAX_PARAMETERS} inputs"),
            );
        }
        if !self.lowering.faults.is_empty() {
            return Err(self.lowering.faults);
        }
        let source = self.lowering.graph;
        let roots: Vec<NodeId> =
            rhs.iter().chain(outputs.values()).chain(ranges).map(|value| value.node).collect();
        let used = source.reachable(&roots);
        let mut keep_input = vec![false; self.inputs.len()];
        let mut keep_parameter: Vec<bool> =
            (0..self.parameters.len()).map(|i| initials.contains(&Initial::Parameter(i))).collect();
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
        let inputs: Vec<Input> = self
            .inputs
            .into_iter()
            .zip(&keep_input)
            .filter(|(_, keep)| **keep)
            .map(|(input, _)| input)
            .collect();
        let parameters: Vec<Parameter> = self
            .parameters
            .into_iter()
            .zip(&keep_parameter)
            .filter(|(_, keep)| **keep)
            .map(|(parameter, _)| parameter)
            .collect();
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
        let (rhs, rest) = roots.split_at(self.states);
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
        let identity = serde_json::json!({
            "spec": composition.spec,
            "effects": composition.effects.iter().filter(|effect| self.applied.contains(&effect.id)).map(|effect| &effect.spec).collect::<Vec<_>>(),
            "sets": bindings.sets, "channels": channels,
        });
        Ok(Model {
            id: composition.id.clone(),
            title: composition.spec.title.clone(),
            hash: blake3::hash(identity.to_string().as_bytes()).to_hex().to_string(),
            states,
            inputs,
            parameters,
            outputs,
            effects: self.applied,
            dropped: self.lowering.dropped.into_iter().collect(),
            checks: composition.spec.checks.clone(),
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
}

/// The states of the base, then those of its effects.
fn states(composition: &Composition) -> impl Iterator<Item = (&String, &StateSpec)> {
    composition.spec.states.iter().chain(composition.effects.iter().flat_map(|effect| &effect.spec.states))
}
