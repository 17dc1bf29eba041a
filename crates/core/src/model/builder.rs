//! What a spec and its effects declare, with all that is wrong with it: names, units, limits, terms.

use super::bindings::Bindings;
use super::catalogue::{AppliedEffect, Composition};
use super::expr::{Node, Point};
use super::lower::{Lowering, Symbol, Value};
use super::parse::{declaration, is_quantity};
use super::spec::{AS_IT_COMES, InputHold, InputSpec, Nominal, ParameterSpec, Scale, StateSpec};
use super::{Initial, Input, Parameter};
use crate::fault::Fault;
use crate::units::Unit;
use indexmap::IndexMap;

/// Most states of a model.
pub(super) const MAX_STATES: usize = 256;
/// Channels of the clock on the wall, which begin again.
const CLOCK: [&str; 2] = ["hour_of_day", "weekday"];

/// A model on its way: what was declared, and the equations so far.
pub(super) struct Builder {
    pub lowering: Lowering,
    pub inputs: Vec<Input>,
    pub parameters: Vec<Parameter>,
    pub states: usize,
    pub applied: Vec<String>,
}

impl Builder {
    /// Nothing but the sets of a model.
    pub fn new(composition: &Composition, bindings: &Bindings) -> Self {
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

    /// Notes what is wrong.
    pub fn fault(&mut self, pointer: &str, code: &str, detail: String) {
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
    pub fn range(&mut self, pointer: &str, expr: &str, unit: &str) -> Value {
        let (expr_at, unit_at) = (format!("{pointer}/expr"), format!("{pointer}/unit"));
        let value = self.lowering.text(&expr_at, expr);
        if let Some(unit) = self.unit(&unit_at, unit) {
            self.lowering.demand(&expr_at, value, unit, "the check");
        }
        value
    }

    /// Declares a state.
    pub fn state(&mut self, name: &str, unit: &str) {
        let pointer = format!("/states/{name}");
        let unit = self.unit(&format!("{pointer}/unit"), unit);
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

    /// Declares an input, or a family of them.
    pub fn input(&mut self, pointer: &str, key: &str, spec: &InputSpec, bindings: &Bindings) {
        let unit = self.unit(&format!("{pointer}/unit"), &spec.unit);
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
            if CLOCK.contains(&channel.as_str()) && spec.hold != InputHold::ZeroOrder {
                let detail = format!(
                    "between two samples `{channel}` is no straight line: it begins again at midnight"
                );
                self.lowering.faults.push(
                    Fault::new(format!("{pointer}/hold"), "hold", detail)
                        .suggest("write hold = \"zero_order\""),
                );
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

    /// Declares a parameter, or a family of them.
    pub fn parameter(&mut self, pointer: &str, key: &str, spec: &ParameterSpec) {
        let unit = self.unit(&format!("{pointer}/unit"), &spec.unit);
        let finite = spec.lower.is_finite() && spec.upper.is_finite() && spec.lower < spec.upper;
        if !finite || (spec.scale == Scale::Log && spec.lower <= 0.0) {
            self.fault(
                &format!("{pointer}/lower"),
                "bounds",
                format!("the bounds [{}, {}] are not an interval on this scale", spec.lower, spec.upper),
            );
        }
        if let Nominal::Value(value) = spec.nominal
            && !(spec.lower..=spec.upper).contains(&value)
        {
            self.fault(
                &format!("{pointer}/nominal"),
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
    pub fn declare_effect(&mut self, effect: &AppliedEffect, bindings: &Bindings) -> bool {
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
    pub fn effect(
        &mut self,
        effect: &AppliedEffect,
        rhs: &mut [Value],
        outputs: &mut IndexMap<String, Value>,
    ) {
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

    /// Where the states begin.
    pub fn initials(&mut self, composition: &Composition) -> Vec<Initial> {
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
}

/// The states of the base, then those of its effects.
pub(super) fn states(composition: &Composition) -> impl Iterator<Item = (&String, &StateSpec)> {
    composition.spec.states.iter().chain(composition.effects.iter().flat_map(|effect| &effect.spec.states))
}
