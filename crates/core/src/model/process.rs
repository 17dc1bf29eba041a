//! Processes: a Gujer matrix as the field writes it, of components, rates and stoichiometry.
//!
//! Processes make no model by themselves, because they do not say where they happen: a plant does (`plant`).
//! Its texts come from here, once per tank, with every name of a component or rate followed by the tank's,
//! `S_NH[aerobic]`.

use super::expr::{Node, NodeId};
use super::lower::{Lowering, Symbol, Value};
use super::spec::{Definition, ModelSpec, from_toml};
use crate::fault::{Fault, nearest};
use crate::units::Unit;
use indexmap::IndexMap;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use utoipa::ToSchema;

/// Largest amount of a conserved quantity that a process may make or destroy, per unit of its rate.
const CONTINUITY: f64 = 1e-12;

/// Components and processes, such as the Activated Sludge Model No. 1.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct ReactionsSpec {
    /// The name by which plants ask for it.
    pub id: String,
    /// A short title for people.
    pub title: String,
    /// What it describes and where it comes from.
    #[serde(default)]
    pub description: String,
    /// What reacts, in the order of the states of a tank.
    pub components: IndexMap<String, Component>,
    /// The numbers in rates and stoichiometry.
    pub parameters: IndexMap<String, Constant>,
    /// Named subexpressions of the rates.
    #[serde(default)]
    pub define: IndexMap<String, String>,
    /// What happens.
    #[serde(rename = "process")]
    pub processes: Vec<Process>,
}

/// A component.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Component {
    /// Its unit.
    pub unit: String,
    /// A short title for people.
    pub title: String,
    /// Its share in the suspended solids, for a component that settles.
    pub tss: Option<String>,
    /// Whether it leaves at once, as a gas: tanks keep no account of it, but the balances do.
    #[serde(default)]
    pub leaves: bool,
    /// How much of each conserved quantity it has.
    #[serde(default)]
    pub holds: BTreeMap<String, String>,
}

/// A number in rates and stoichiometry, with the interval that an estimate may search.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Constant {
    /// Its unit.
    pub unit: String,
    /// Its value, where the plant says no other.
    pub value: f64,
    /// Lower bound.
    pub lower: Option<f64>,
    /// Upper bound.
    pub upper: Option<f64>,
    /// A short title for people.
    pub title: String,
    /// What would tell it apart from others.
    pub excite: Option<String>,
}

/// A process: a row of the Gujer matrix.
#[derive(Debug, Clone, PartialEq, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub struct Process {
    /// The name of its rate in the equations of a plant.
    pub name: String,
    /// A short title for people.
    pub title: String,
    /// Its rate over the components of one tank.
    pub rate: String,
    /// What it makes (above zero) and uses (below) of each component per unit of its rate.
    pub stoichiometry: IndexMap<String, String>,
}

impl ReactionsSpec {
    /// Whether a document in TOML says processes rather than a model.
    pub fn is_one(text: &str) -> bool {
        toml::from_str::<toml::Table>(text).is_ok_and(|table| table.contains_key("process"))
    }

    /// Reads a document in TOML.
    ///
    /// # Errors
    /// One fault with the place where the document stops making sense.
    pub fn from_toml(text: &str) -> Result<Self, Fault> {
        from_toml(text)
    }

    /// The components that tanks keep account of.
    pub(super) fn kept(&self) -> impl Iterator<Item = (&str, &Component)> {
        self.components
            .iter()
            .filter(|(_, component)| !component.leaves)
            .map(|(name, component)| (name.as_str(), component))
    }

    /// The suspended solids of a tank.
    pub(super) fn solids(&self, tank: &str) -> String {
        let share = |(name, component): (&str, &Component)| {
            component.tss.as_ref().map(|tss| format!("({tss})*{name}[{tank}]"))
        };
        self.kept().filter_map(share).collect::<Vec<_>>().join(" + ")
    }

    /// What the processes make of a component in a tank, per hour; nothing where none touches it.
    pub(super) fn made(&self, component: &str, tank: &str) -> Option<String> {
        let term = |process: &Process| {
            let coefficient = process.stoichiometry.get(component)?;
            Some(format!("({coefficient})*{}[{tank}]", process.name))
        };
        let terms: Vec<String> = self.processes.iter().filter_map(term).collect();
        (!terms.is_empty()).then(|| terms.join(" + "))
    }

    /// Defines the rates of a tank, in g/m3/h.
    pub(super) fn define_rates(&self, spec: &mut ModelSpec, tank: &str) {
        for (name, text) in &self.define {
            spec.define.insert(format!("{name}[{tank}]"), Definition::Text(self.within(text, tank)));
        }
        for process in &self.processes {
            let rate = format!("convert({}, 1[g/m3/h])", self.within(&process.rate, tank));
            spec.define.insert(format!("{}[{tank}]", process.name), Definition::Text(rate));
        }
    }

    /// The text with every name that belongs to a tank followed by this one. Units in brackets stay.
    fn within(&self, text: &str, tank: &str) -> String {
        let local = |word: &str| {
            self.components.contains_key(word)
                || self.define.contains_key(word)
                || self.processes.iter().any(|process| process.name == word)
        };
        let mut placed = String::new();
        let mut rest = text;
        while let Some(first) = rest.chars().next() {
            let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
            let end = match first {
                '[' => rest.find(']').map_or(rest.len(), |end| end + 1),
                c if is_word(c) => rest.find(|c| !is_word(c)).unwrap_or(rest.len()),
                c => c.len_utf8(),
            };
            placed.push_str(&rest[..end]);
            if local(&rest[..end]) {
                placed.push_str(&format!("[{tank}]"));
            }
            rest = &rest[end..];
        }
        placed
    }

    /// Every process that makes or destroys something that is conserved, at the values of the parameters and
    /// at both ends of their intervals.
    pub(super) fn continuity(&self) -> Vec<Fault> {
        let mut lowering = Lowering::new(BTreeMap::new());
        for (index, (name, constant)) in self.parameters.iter().enumerate() {
            let node = Node::Param(index as u16);
            let unit = Unit::parse(&constant.unit).ok();
            lowering.add_symbol(
                name.clone(),
                Symbol { node, unit, nonnegative: constant.value >= 0.0, missing: None },
            );
        }
        let quantities: BTreeSet<&String> =
            self.components.values().flat_map(|component| component.holds.keys()).collect();
        let mut balances: Vec<(String, String, NodeId)> = Vec::new();
        for process in &self.processes {
            let pointer = format!("/process/{}", process.name);
            for name in process.stoichiometry.keys().filter(|name| !self.components.contains_key(*name)) {
                let fault = Fault::new(
                    format!("{pointer}/{name}"),
                    "unknown-name",
                    format!("there is no component `{name}`"),
                );
                lowering.faults.push(match nearest(name, self.components.keys().map(String::as_str)) {
                    Some(near) => fault.suggest(format!("did you mean `{near}`?")),
                    None => fault,
                });
            }
            for quantity in &quantities {
                let term = |(name, coefficient): (&String, &String)| {
                    let holds = self.components.get(name)?.holds.get(*quantity)?;
                    Some(format!("({coefficient})*({holds})"))
                };
                let terms: Vec<String> = process.stoichiometry.iter().filter_map(term).collect();
                if !terms.is_empty() {
                    let Value { node, .. } = lowering.text(&pointer, &terms.join(" + "));
                    balances.push((pointer.clone(), (*quantity).clone(), node));
                }
            }
        }
        if !lowering.faults.is_empty() {
            return lowering.faults;
        }
        let roots: Vec<NodeId> = balances.iter().map(|(_, _, node)| *node).collect();
        let at = |value: fn(&Constant) -> f64| {
            let leaf = |node: Node| match node {
                Node::Param(i) => self
                    .parameters
                    .get_index(usize::from(i))
                    .map_or(f64::NAN, |(_, constant)| value(constant)),
                _ => f64::NAN,
            };
            lowering.graph.evaluate(&roots, leaf)
        };
        let all = [
            at(|constant| constant.value),
            at(|c| c.lower.unwrap_or(c.value)),
            at(|c| c.upper.unwrap_or(c.value)),
        ];
        let mut faults = Vec::new();
        for (index, (pointer, quantity, _)) in balances.into_iter().enumerate() {
            let larger =
                |worst: f64, x: f64| if worst.is_nan() || worst.abs() >= x.abs() { worst } else { x };
            let worst = all.iter().map(|residuals| residuals[index]).fold(0.0f64, larger);
            if worst.is_nan() || worst.abs() > CONTINUITY {
                let detail = format!(
                    "the process makes {worst:.3e} of {quantity} out of nothing, per unit of its rate"
                );
                faults.push(Fault::new(pointer, "continuity", detail));
            }
        }
        faults
    }
}
