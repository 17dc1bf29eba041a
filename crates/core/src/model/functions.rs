//! The functions of the model language: their arguments, their units, and which of them can be negative.

use super::builtin::{Builtin, DELAY, FUNCTIONS, LanguageFunction, functions};
use super::expr::{Binary, Graph, Node, NodeId, Unary};
use super::lower::{Lowering, Value};
use super::parse::Expr;
use super::token::TextPosition;
use super::{Delay, Parameter};
use crate::fault::nearest;
use crate::units::Unit;

/// Longest delay of an input in hours: a week, which is the shortest window that is usually fitted.
pub(super) const MAX_DELAY: f64 = 168.0;
impl Lowering {
    /// `delay(input, hours)`: what an input was so many hours ago. The delay depends on parameters alone, is
    /// never negative, and has a known limit, because that much of the past has to be there.
    pub(super) fn delay(
        &mut self,
        pointer: &str,
        at: TextPosition,
        arguments: &[Expr],
        indices: &mut Vec<(String, String)>,
    ) -> Value {
        let [input, hours] = arguments else {
            return self.wrong_arguments(pointer, at, &DELAY, arguments.len());
        };
        let faults = self.faults.len();
        let delayed = self.expr(pointer, input, indices);
        let hours_at = hours.at;
        let hours = self.expr(pointer, hours, indices);
        let Node::Input(index, point) = self.graph.node(delayed.node) else {
            // A name that does not exist has its fault already.
            if self.faults.len() == faults {
                self.fault(
                    pointer,
                    input.at,
                    "delay",
                    "only an input can be delayed: nothing else has a past that is known",
                );
                let inputs: Vec<&str> = self.inputs().collect();
                self.suggest(format!("the inputs are {}", inputs.join(", ")));
            }
            return self.zero();
        };
        if hours.unit.is_some_and(|unit| !unit.addable(&Unit::HOUR)) {
            self.fault(pointer, hours_at, "unit", "a delay must have the unit h");
        }
        let used = self.graph.reachable(&[hours.node]);
        let changes = |node: &Node| {
            matches!(node, Node::State(_) | Node::Input(..) | Node::Slope(_) | Node::Delayed(..))
        };
        if self.graph.nodes().iter().zip(used).any(|(node, used)| used && changes(node)) {
            self.fault(pointer, hours_at, "delay", "a delay depends on parameters and numbers alone");
        } else if !hours.nonnegative {
            self.fault(
                pointer,
                hours_at,
                "delay",
                "a delay cannot be negative; give its parameter a lower bound of 0, or write max(0[h], …)",
            );
        } else if !matches!(self.graph.node(hours.node), Node::Param(_)) {
            match limit(&self.graph, hours.node) {
                Some(limit) if limit <= MAX_DELAY => {}
                Some(_) => {
                    self.fault(pointer, hours_at, "limit", format!("a delay is at most {MAX_DELAY} h"))
                }
                None => {
                    self.fault(pointer, hours_at, "delay", "nothing says how long this delay can be");
                    self.suggest(
                        "take a parameter, whose upper bound says it, or write min(…, 6[h])".to_owned(),
                    );
                }
            }
        }
        let node = self.graph.intern(Node::Delayed(index, point, hours.node));
        Value { node, ..delayed }
    }

    /// A function of the values of its arguments.
    pub(super) fn call(&mut self, pointer: &str, at: TextPosition, name: &str, x: &[Value]) -> Value {
        let Some((function, builtin)) = FUNCTIONS.iter().find(|(known, _)| known.name == name) else {
            self.fault(pointer, at, "unknown-function", format!("there is no function `{name}`"));
            if let Some(near) = nearest(name, functions().map(|known| known.name)) {
                self.suggest(format!("did you mean `{near}`?"));
            }
            return self.zero();
        };
        if x.len() != function.arguments.len() {
            return self.wrong_arguments(pointer, at, function, x.len());
        }
        let unary = |lowering: &mut Self, op, unit, nonnegative| Value {
            node: lowering.graph.unary(op, x[0].node),
            unit,
            nonnegative,
        };
        match *builtin {
            Builtin::If => {
                let unit = self.alike(pointer, at, Binary::Add, x[1], x[2]);
                let nonnegative = x[1].nonnegative && x[2].nonnegative;
                Value { node: self.graph.choose(x[0].node, x[1].node, x[2].node), unit, nonnegative }
            }
            Builtin::Convert => self.convert(pointer, at, x[0], x[1]),
            Builtin::Alike(op) => self.binary(pointer, at, op, x[0], x[1], false),
            Builtin::Abs => unary(self, Unary::Abs, x[0].unit, true),
            Builtin::Sqrt => {
                let unit = x[0].unit.and_then(Unit::square_root);
                if x[0].unit.is_some() && unit.is_none() {
                    self.fault(pointer, at, "unit", "the root of this unit is no unit");
                }
                if !x[0].nonnegative {
                    self.fault(
                        pointer,
                        at,
                        "negative-base",
                        "sqrt needs an argument that cannot be negative; wrap it in abs() or max(0, …)",
                    );
                }
                unary(self, Unary::Sqrt, unit, true)
            }
            Builtin::Transcendental(op) => self.transcendental(pointer, at, name, op, x[0]),
        }
    }

    fn wrong_arguments(
        &mut self,
        pointer: &str,
        at: TextPosition,
        function: &LanguageFunction,
        found: usize,
    ) -> Value {
        let (name, wanted) = (function.name, function.arguments.len());
        self.fault(pointer, at, "arguments", format!("`{name}` takes {wanted} arguments, not {found}"));
        self.zero()
    }

    /// `convert(Q, 1[m3/h])`: the same quantity counted in another unit, which a one with that unit names.
    fn convert(&mut self, pointer: &str, at: TextPosition, x: Value, target: Value) -> Value {
        let Some(wanted) = target.unit.filter(|_| self.graph.constant_value(target.node) == Some(1.0)) else {
            self.fault(
                pointer,
                at,
                "unit",
                "the second argument of `convert` is a one with the unit that is wanted, such as 1[m3/h]",
            );
            return self.zero();
        };
        let Some(unit) = x.unit else { return Value { unit: Some(wanted), ..x } };
        let Some(factor) = unit.factor_to(&wanted) else {
            self.fault(pointer, at, "unit", format!("{unit} does not convert to {wanted}"));
            return self.zero();
        };
        let factor = self.graph.constant(factor);
        Value { node: self.graph.mul(x.node, factor), unit: Some(wanted), nonnegative: x.nonnegative }
    }

    /// Functions of a pure number. Angles in degrees and fractions in percent are scaled first.
    fn transcendental(&mut self, pointer: &str, at: TextPosition, name: &str, op: Unary, x: Value) -> Value {
        let scale = x.unit.map_or(Some(1.0), |unit| unit.number_scale());
        let Some(scale) = scale else {
            self.fault(pointer, at, "unit", format!("`{name}` needs a pure number"));
            return self.zero();
        };
        let factor = self.graph.constant(scale);
        let argument = self.graph.mul(x.node, factor);
        Value { node: self.graph.unary(op, argument), unit: Some(Unit::ONE), nonnegative: op == Unary::Exp }
    }
}

/// The number that an expression cannot exceed, where it is a number itself or `min(…, number)`.
fn limit(graph: &Graph, node: NodeId) -> Option<f64> {
    match graph.node(node) {
        Node::Binary(Binary::Min, a, b) => graph.constant_value(b).or(graph.constant_value(a)),
        _ => graph.constant_value(node),
    }
}

/// The delays of a graph with the longest time of each.
pub(super) fn delays(graph: &Graph, parameters: &[Parameter]) -> Vec<Delay> {
    let mut delays = Vec::new();
    for node in graph.nodes() {
        if let Node::Delayed(input, _, hours) = *node {
            let (parameter, longest) = match graph.node(hours) {
                Node::Param(i) => (Some(usize::from(i)), parameters[usize::from(i)].upper),
                _ => (None, limit(graph, hours).unwrap_or(0.0)),
            };
            delays.push(Delay { input: usize::from(input), parameter, longest });
        }
    }
    delays
}
