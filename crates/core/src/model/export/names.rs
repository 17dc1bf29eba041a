//! Names that other languages take: one for every leaf of a model.

use crate::model::Model;
use crate::model::entrance::{Entrance, entrances};
use crate::model::expr::Node;
use std::collections::{HashMap, HashSet};

/// Words of Python and Modelica that no variable may have, and what the written programs call their own.
const TAKEN: [&str; 70] = [
    "algorithm",
    "and",
    "annotation",
    "as",
    "assert",
    "async",
    "await",
    "block",
    "break",
    "ca",
    "class",
    "connect",
    "connector",
    "constant",
    "continue",
    "def",
    "del",
    "der",
    "discrete",
    "each",
    "elif",
    "else",
    "elseif",
    "elsewhen",
    "end",
    "equation",
    "except",
    "expandable",
    "extends",
    "external",
    "false",
    "final",
    "finally",
    "flow",
    "for",
    "from",
    "function",
    "global",
    "hours",
    "if",
    "import",
    "in",
    "initial",
    "inner",
    "input",
    "is",
    "lambda",
    "loop",
    "model",
    "nonlocal",
    "not",
    "np",
    "operator",
    "or",
    "outer",
    "output",
    "p",
    "package",
    "parameter",
    "pass",
    "raise",
    "record",
    "return",
    "slope",
    "then",
    "time",
    "true",
    "u",
    "while",
    "x",
];

/// The names of a model's parts in a written program.
#[derive(Debug)]
pub struct Names {
    /// By state.
    pub states: Vec<String>,
    /// By parameter.
    pub parameters: Vec<String>,
    /// By input.
    pub inputs: Vec<String>,
    /// By output.
    pub outputs: Vec<String>,
    /// What enters the equations, and its name.
    pub entrances: Vec<(Entrance, String)>,
    leaves: HashMap<Node, String>,
}

impl Names {
    /// Names for a model: those of its documents, with what no language takes replaced.
    pub fn new(model: &Model) -> Self {
        let mut taken: HashSet<String> = TAKEN.iter().map(|word| (*word).to_owned()).collect();
        let states: Vec<String> = model.states().iter().map(|one| free(&one.name, &mut taken)).collect();
        let parameters: Vec<String> =
            model.parameters().iter().map(|one| free(&one.name, &mut taken)).collect();
        let inputs: Vec<String> = model.inputs().iter().map(|one| free(&one.name, &mut taken)).collect();
        let entrance = |entrance: Entrance| {
            let input = &inputs[entrance.input];
            let is_delayed = entrance.hours().is_some();
            let name = if is_delayed { free(&format!("{input}_delayed"), &mut taken) } else { input.clone() };
            (entrance, name)
        };
        let entrances: Vec<(Entrance, String)> = entrances(model).into_iter().map(entrance).collect();
        let outputs =
            model.outputs().iter().map(|one| free(&format!("y_{}", one.channel), &mut taken)).collect();
        let named = |names: &[String], leaf: fn(u16) -> Node| -> Vec<(Node, String)> {
            names.iter().enumerate().map(|(index, name)| (leaf(index as u16), name.clone())).collect()
        };
        let leaves = named(&states, Node::State)
            .into_iter()
            .chain(named(&parameters, Node::Param))
            .chain(entrances.iter().map(|(entrance, name)| (entrance.leaf, name.clone())))
            .collect();
        Self { states, parameters, inputs, outputs, entrances, leaves }
    }

    /// The same names, each written otherwise.
    #[must_use]
    pub fn map(self, write: impl Fn(&str) -> String) -> Self {
        let all = |names: Vec<String>| names.iter().map(|name| write(name)).collect();
        Self {
            states: all(self.states),
            parameters: all(self.parameters),
            inputs: all(self.inputs),
            outputs: all(self.outputs),
            entrances: self.entrances.into_iter().map(|(one, name)| (one, write(&name))).collect(),
            leaves: self.leaves.into_iter().map(|(leaf, name)| (leaf, write(&name))).collect(),
        }
    }

    /// The name of a leaf.
    pub fn leaf(&self, node: Node) -> &str {
        self.leaves.get(&node).map_or("0", String::as_str)
    }
}

/// A name that is taken by nothing else, and now is.
fn free(name: &str, taken: &mut HashSet<String>) -> String {
    let letter = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
    let mut name: String = name.chars().map(letter).collect::<String>().trim_matches('_').to_owned();
    if name.chars().next().is_none_or(|c| c.is_ascii_digit()) {
        name.insert_str(0, "n_");
    }
    while !taken.insert(name.clone()) {
        name.push('_');
    }
    name
}
