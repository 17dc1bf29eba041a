//! Syntax tree to graph: names are resolved, families expanded, units checked, every fault collected.

use super::builtin::{CONSTANTS, DELAY};
use super::expr::{Binary, Graph, Node, NodeId, Unary};
use super::parse::{Expr, ExprKind, parse};
use super::spec::Definition;
use super::token::{SyntaxError, TextPosition};
use crate::fault::{Fault, nearest};
use crate::units::Unit;
use indexmap::IndexMap;
use std::collections::{BTreeMap, BTreeSet};

/// Most nodes of an expanded model.
pub const MAX_NODES: usize = 50_000;
/// Most levels of expressions in definitions in expressions: recursion takes up to 1.5 KiB of stack for each.
pub(super) const MAX_NESTED: usize = 3_000;
/// Most faults at which a name that was meant is looked for, among all that there are.
const MAX_SUGGESTED: usize = 20;
/// Largest integer exponent that becomes a chain of products.
pub(super) const MAX_INTEGER_POWER: f64 = 16.0;

/// Behind the name of something that an effect has replaced.
const BEFORE: char = '~';

/// What a name stands for.
#[derive(Debug, Clone)]
pub(super) struct Symbol {
    /// The leaf of the graph.
    pub node: Node,
    /// Its unit; `None` where that could not be read, so that one fault does not make others.
    pub unit: Option<Unit>,
    /// Whether it is known never to be negative.
    pub nonnegative: bool,
    /// The channel, where it is an input whose channel is not there.
    pub missing: Option<String>,
}

/// What an expression came to: a node, its unit, and whether it can be negative.
#[derive(Debug, Clone, Copy)]
pub(super) struct Value {
    pub node: NodeId,
    /// `None` for the number zero, which is zero of any unit.
    pub unit: Option<Unit>,
    pub nonnegative: bool,
}

/// A definition on its way to a value.
enum Named {
    Text(Definition),
    /// What an effect says instead; its own name stands for `before` in it.
    Instead {
        text: String,
        pointer: String,
        before: String,
    },
    Busy,
    Done(Value),
}

/// The names of a model, and the graph that grows from them.
pub(super) struct Lowering {
    pub graph: Graph,
    pub faults: Vec<Fault>,
    /// Channels that were used although they are not there.
    pub missing: BTreeSet<String>,
    /// What the chosen variants leave out.
    pub dropped: BTreeSet<String>,
    symbols: IndexMap<String, Symbol>,
    families: BTreeMap<String, String>,
    sets: BTreeMap<String, Vec<String>>,
    defines: IndexMap<String, Named>,
    /// Terms of sums expanded so far: nested sums multiply without adding a node.
    expanded: usize,
    /// Expressions around the one that is walked now.
    nested: usize,
}

impl Lowering {
    pub fn new(sets: BTreeMap<String, Vec<String>>) -> Self {
        Self {
            graph: Graph::default(),
            faults: Vec::new(),
            missing: BTreeSet::new(),
            dropped: BTreeSet::new(),
            symbols: IndexMap::new(),
            families: BTreeMap::new(),
            sets,
            defines: IndexMap::new(),
            expanded: 0,
            nested: 0,
        }
    }

    /// The members of a set.
    pub fn members(&self, set: &str) -> Option<&[String]> {
        self.sets.get(set).map(Vec::as_slice)
    }

    pub fn add_family(&mut self, name: &str, set: &str) {
        self.families.insert(name.to_owned(), set.to_owned());
    }

    /// Declares a name; false where it is taken.
    pub fn add_symbol(&mut self, name: String, symbol: Symbol) -> bool {
        if self.symbols.contains_key(&name) || self.defines.contains_key(&name) {
            return false;
        }
        self.symbols.insert(name, symbol);
        true
    }

    pub fn symbol(&self, name: &str) -> Option<&Symbol> {
        self.symbols.get(name)
    }

    /// Declares a definition; false where the name is taken.
    pub fn add_define(&mut self, name: &str, definition: Definition) -> bool {
        if self.symbols.contains_key(name) || self.defines.contains_key(name) {
            return false;
        }
        self.defines.insert(name.to_owned(), Named::Text(definition));
        true
    }

    /// Gives a name another meaning; in `text` it stands for what it meant before. False where nothing has
    /// the name.
    pub fn replace(&mut self, pointer: String, name: &str, text: String) -> bool {
        let is_state = |symbol: &Symbol| matches!(symbol.node, Node::State(_));
        if !self.defines.contains_key(name) && self.symbols.get(name).is_none_or(is_state) {
            return false;
        }
        // No text can write such a name, so nobody else takes it. What a parameter or an input meant before
        // the first of several replacements is not among the definitions: the name of that one counts, too.
        let mut before = match self.defines.get(name) {
            Some(Named::Instead { before, .. }) => before.clone(),
            _ => name.to_owned(),
        };
        before.push(BEFORE);
        if let Some(named) = self.defines.shift_remove(name) {
            self.defines.insert(before.clone(), named);
        }
        self.defines.insert(name.to_owned(), Named::Instead { text, pointer, before });
        true
    }

    /// Lowers the text of one expression; the faults name `pointer`.
    pub fn text(&mut self, pointer: &str, text: &str) -> Value {
        self.parsed(pointer, parse(text))
    }

    fn parsed(&mut self, pointer: &str, parsed: Result<Expr, SyntaxError>) -> Value {
        let value = match parsed {
            Ok(expr) => self.expr(pointer, &expr, &mut Vec::new()),
            Err(error) => {
                self.fault(pointer, error.at, "syntax", error.message);
                self.zero()
            }
        };
        if self.graph.nodes().len() > MAX_NODES || self.expanded > MAX_NODES {
            let at = TextPosition { line: 1, column: 1 };
            self.fault(
                pointer,
                at,
                "too-large",
                format!("the model has more than {MAX_NODES} nodes or terms after its families are expanded"),
            );
        }
        value
    }

    /// Lowers the definitions that nothing uses, for their faults alone.
    pub fn judge_unused(&mut self) {
        let unused = |(name, named): (&String, &Named)| {
            matches!(named, Named::Text(_) | Named::Instead { .. }).then(|| name.clone())
        };
        let names: Vec<String> = self.defines.iter().filter_map(unused).collect();
        let (missing, dropped) = (self.missing.clone(), self.dropped.clone());
        for name in names {
            self.name(&format!("/define/{name}"), TextPosition { line: 1, column: 1 }, &name);
        }
        (self.missing, self.dropped) = (missing, dropped);
    }

    /// Demands a unit of a value.
    pub fn demand(&mut self, pointer: &str, value: Value, unit: Unit, what: &str) {
        if let Some(found) = value.unit.filter(|found| !found.addable(&unit)) {
            let at = TextPosition { line: 1, column: 1 };
            self.fault(pointer, at, "unit", format!("{what} must have the unit {unit}, this has {found}"));
        }
    }

    /// Zero, of any unit.
    pub(super) fn zero(&mut self) -> Value {
        Value { node: self.graph.constant(0.0), unit: None, nonnegative: true }
    }

    pub(super) fn fault(
        &mut self,
        pointer: &str,
        at: TextPosition,
        code: &str,
        detail: impl std::fmt::Display,
    ) {
        self.faults.push(Fault::new(
            pointer,
            code,
            format!("line {}, column {}: {detail}", at.line, at.column),
        ));
    }

    /// Says what would probably have been right about the last fault.
    pub(super) fn suggest(&mut self, suggestion: String) {
        if let Some(last) = self.faults.last_mut() {
            last.suggestion = Some(suggestion);
        }
    }

    /// The names of the inputs.
    pub(super) fn inputs(&self) -> impl Iterator<Item = &str> {
        self.symbols
            .iter()
            .filter(|(_, symbol)| matches!(symbol.node, Node::Input(..)))
            .map(|(name, _)| name.as_str())
    }

    pub(super) fn expr(&mut self, pointer: &str, expr: &Expr, indices: &mut Vec<(String, String)>) -> Value {
        // Later nodes would only repeat the message that the model is too large.
        if self.graph.nodes().len() > MAX_NODES || self.expanded > MAX_NODES {
            return self.zero();
        }
        if self.nested >= MAX_NESTED {
            let detail = format!("definitions stand in each other more than {MAX_NESTED} levels deep");
            self.fault(pointer, expr.at, "too-deep", detail);
            return self.zero();
        }
        self.nested += 1;
        let value = self.kind(pointer, expr, indices);
        self.nested -= 1;
        value
    }

    fn kind(&mut self, pointer: &str, expr: &Expr, indices: &mut Vec<(String, String)>) -> Value {
        match &expr.kind {
            ExprKind::Number(value, unit) => self.number(pointer, expr.at, *value, unit.as_deref()),
            ExprKind::Name(name) => self.name(pointer, expr.at, name),
            ExprKind::Member(family, index) => {
                match self.member_name(pointer, expr.at, family, index, indices) {
                    Some(name) => self.name(pointer, expr.at, &name),
                    None => self.zero(),
                }
            }
            ExprKind::Negate(inner) => {
                let x = self.expr(pointer, inner, indices);
                Value { node: self.graph.unary(Unary::Neg, x.node), unit: x.unit, nonnegative: false }
            }
            ExprKind::Binary(op, a, b) => {
                let left = self.expr(pointer, a, indices);
                let right = self.expr(pointer, b, indices);
                self.binary(pointer, expr.at, *op, left, right, a == b)
            }
            ExprKind::Call(name, arguments) if name == DELAY.name => {
                self.delay(pointer, expr.at, arguments, indices)
            }
            ExprKind::Call(name, arguments) => {
                let values: Vec<Value> =
                    arguments.iter().map(|argument| self.expr(pointer, argument, indices)).collect();
                self.call(pointer, expr.at, name, &values)
            }
            ExprKind::Sum { variable, set, body } => {
                let Some(members) = self.sets.get(set).cloned() else {
                    self.fault(pointer, expr.at, "unknown-set", format!("there is no set `{set}`"));
                    return self.zero();
                };
                let mut total = self.zero();
                for member in members {
                    self.expanded += 1;
                    if self.expanded > MAX_NODES {
                        break;
                    }
                    indices.push((variable.clone(), member));
                    let term = self.expr(pointer, body, indices);
                    indices.pop();
                    total = self.binary(pointer, expr.at, Binary::Add, total, term, false);
                }
                total
            }
        }
    }

    fn number(&mut self, pointer: &str, at: TextPosition, value: f64, unit: Option<&str>) -> Value {
        let node = self.graph.constant(value);
        let unit = match unit.map(Unit::parse) {
            None if value == 0.0 => None,
            None => Some(Unit::ONE),
            Some(Ok(unit)) => Some(unit),
            Some(Err(error)) => {
                self.fault(pointer, at, "unit", error);
                None
            }
        };
        Value { node, unit, nonnegative: value >= 0.0 }
    }

    fn member_name(
        &mut self,
        pointer: &str,
        at: TextPosition,
        family: &str,
        index: &str,
        indices: &[(String, String)],
    ) -> Option<String> {
        let member = format!("{family}[{index}]");
        let bound = indices.iter().any(|(variable, _)| variable == index);
        if !bound && (self.symbols.contains_key(&member) || self.defines.contains_key(&member)) {
            return Some(member);
        }
        let Some(set) = self.families.get(family) else {
            self.fault(pointer, at, "unknown-name", format!("there is no family `{family}`"));
            return None;
        };
        let Some((_, member)) = indices.iter().rev().find(|(variable, _)| variable == index) else {
            self.fault(
                pointer,
                at,
                "unknown-index",
                format!("`{index}` is not the index of a sum around `{family}[{index}]`"),
            );
            return None;
        };
        if self.sets.get(set).is_some_and(|members| members.contains(member)) {
            return Some(format!("{family}[{member}]"));
        }
        self.fault(
            pointer,
            at,
            "unknown-index",
            format!("`{family}` runs over `{set}`, which has no `{member}`"),
        );
        None
    }

    fn name(&mut self, pointer: &str, at: TextPosition, name: &str) -> Value {
        // What an effect has put in the place of a parameter or an input comes first.
        let symbol = if self.defines.contains_key(name) {
            None
        } else {
            self.symbols.get(name.trim_end_matches(BEFORE))
        };
        if let Some(symbol) = symbol {
            self.missing.extend(symbol.missing.clone());
            let (unit, nonnegative) = (symbol.unit, symbol.nonnegative);
            return Value { node: self.graph.intern(symbol.node), unit, nonnegative };
        }
        match self.defines.get_mut(name).map(|named| std::mem::replace(named, Named::Busy)) {
            Some(Named::Done(value)) => {
                self.defines.insert(name.to_owned(), Named::Done(value));
                value
            }
            Some(Named::Text(definition)) => {
                let text = self.choose(&definition);
                let value = self.text(&format!("/define/{}", name.trim_end_matches(BEFORE)), &text);
                self.defines.insert(name.to_owned(), Named::Done(value));
                value
            }
            Some(Named::Instead { text, pointer, before }) => {
                let own = name.trim_end_matches(BEFORE);
                let was = self.name(&pointer, at, &before);
                let value = self.parsed(&pointer, parse(&text).map(|expr| expr.renamed(own, &before)));
                if let Some(unit) = was.unit {
                    self.demand(&pointer, value, unit, &format!("what takes the place of `{own}`"));
                }
                // The unit stays, so that one fault does not make others.
                let value = Value { unit: was.unit, ..value };
                self.defines.insert(name.to_owned(), Named::Done(value));
                value
            }
            Some(Named::Busy) => {
                self.fault(pointer, at, "cycle", format!("`{name}` is defined by itself"));
                self.zero()
            }
            None => {
                if let Some(constant) = CONSTANTS.iter().find(|constant| constant.name == name) {
                    let node = self.graph.constant(constant.value);
                    return Value { node, unit: Some(Unit::ONE), nonnegative: constant.value >= 0.0 };
                }
                self.fault(
                    pointer,
                    at,
                    "unknown-name",
                    format!("`{name}` is not a state, input, parameter or definition"),
                );
                let known = self.symbols.keys().chain(self.defines.keys()).map(String::as_str);
                if self.faults.len() <= MAX_SUGGESTED
                    && let Some(near) = nearest(name, known).map(str::to_owned)
                {
                    self.suggest(format!("did you mean `{near}`?"));
                }
                self.zero()
            }
        }
    }

    /// The first variant whose inputs are all there; the last one where none is.
    fn choose(&mut self, definition: &Definition) -> String {
        match definition {
            Definition::Text(text) => text.clone(),
            Definition::Variants(variants) => {
                let there =
                    |input: &String| self.symbols.get(input).is_some_and(|symbol| symbol.missing.is_none());
                let chosen =
                    variants.iter().find(|variant| variant.needs.iter().all(there)).or(variants.last());
                self.dropped.extend(chosen.and_then(|variant| variant.drops.clone()));
                chosen.map_or_else(|| "0".to_owned(), |variant| variant.expr.clone())
            }
        }
    }

    pub(super) fn binary(
        &mut self,
        pointer: &str,
        at: TextPosition,
        op: Binary,
        a: Value,
        b: Value,
        same: bool,
    ) -> Value {
        let both = a.nonnegative && b.nonnegative;
        let (unit, nonnegative) = match op {
            Binary::Pow => return self.power(pointer, at, a, b),
            Binary::Mul => (a.unit.zip(b.unit).map(|(a, b)| a.times(b)), both || same),
            Binary::Div => (a.unit.zip(b.unit).map(|(a, b)| a.divided_by(b)), both),
            Binary::Add | Binary::Min => (self.alike(pointer, at, op, a, b), both),
            Binary::Sub => (self.alike(pointer, at, op, a, b), false),
            Binary::Max => (self.alike(pointer, at, op, a, b), a.nonnegative || b.nonnegative),
            Binary::Less | Binary::LessEqual | Binary::Equal => {
                self.alike(pointer, at, op, a, b);
                (Some(Unit::ONE), true)
            }
        };
        if op == Binary::Div && self.graph.constant_value(b.node) == Some(0.0) {
            self.fault(pointer, at, "division-by-zero", "the divisor is zero");
        }
        Value { node: self.graph.binary(op, a.node, b.node), unit, nonnegative }
    }

    /// The common unit of two operands that must be like quantities.
    pub(super) fn alike(
        &mut self,
        pointer: &str,
        at: TextPosition,
        op: Binary,
        a: Value,
        b: Value,
    ) -> Option<Unit> {
        if let Some((left, right)) = a.unit.zip(b.unit).filter(|(left, right)| !left.addable(right)) {
            self.fault(pointer, at, "unit", format!("{op:?} of {left} and {right}: not like quantities"));
        }
        a.unit.or(b.unit)
    }

    fn power(&mut self, pointer: &str, at: TextPosition, base: Value, exponent: Value) -> Value {
        if exponent.unit.is_some_and(|unit| !unit.is_number()) {
            self.fault(pointer, at, "unit", "an exponent must be a pure number");
        }
        match self.graph.constant_value(exponent.node) {
            Some(n) if n == n.trunc() && n.abs() <= MAX_INTEGER_POWER => {
                let (mut node, mut unit) = (self.graph.constant(1.0), Some(Unit::ONE));
                for _ in 0..n.abs() as i8 {
                    node = self.graph.mul(node, base.node);
                    unit =
                        unit.zip(base.unit).map(|(a, b)| if n < 0.0 { a.divided_by(b) } else { a.times(b) });
                }
                if n < 0.0 {
                    let one = self.graph.constant(1.0);
                    node = self.graph.div(one, node);
                }
                Value { node, unit, nonnegative: base.nonnegative || n.rem_euclid(2.0) == 0.0 }
            }
            _ => {
                if !base.nonnegative {
                    self.fault(
                        pointer,
                        at,
                        "negative-base",
                        "a real exponent needs a base that cannot be negative; wrap the base in abs() or \
                        max(0, …)",
                    );
                }
                if base.unit.is_some_and(|unit| !unit.is_number()) {
                    self.fault(pointer, at, "unit", "the base of a real exponent must be a pure number");
                }
                Value {
                    node: self.graph.binary(Binary::Pow, base.node, exponent.node),
                    unit: Some(Unit::ONE),
                    nonnegative: true,
                }
            }
        }
    }
}
