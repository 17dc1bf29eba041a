//! The expression graph: interned nodes, folded while they are built, with symbolic derivatives on top.
//!
//! Equal subexpressions are one node, so a derivative shares everything it can with its function. The
//! meaning of each operation is [`Unary::apply`] and [`Binary::apply`]; every evaluator must agree with
//! them bit for bit.

use super::math;
use std::collections::HashMap;

/// A node of a [`Graph`]. Operands always have smaller numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct NodeId(pub u32);

/// Operations on one value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Unary {
    /// Change of sign.
    Neg,
    /// Absolute value.
    Abs,
    /// Exponential.
    Exp,
    /// Natural logarithm.
    Log,
    /// Square root.
    Sqrt,
    /// Sine of an angle in radians.
    Sin,
    /// Cosine of an angle in radians.
    Cos,
    /// Hyperbolic tangent.
    Tanh,
}

impl Unary {
    /// The canonical meaning.
    #[inline(always)]
    pub fn apply(self, x: f64) -> f64 {
        match self {
            Unary::Neg => -x,
            Unary::Abs => x.abs(),
            Unary::Exp => math::exp(x),
            Unary::Log => math::log(x),
            Unary::Sqrt => x.sqrt(),
            Unary::Sin => math::sin(x),
            Unary::Cos => math::cos(x),
            Unary::Tanh => math::tanh(x),
        }
    }
}

/// Operations on two values. Comparisons give 1 or 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Binary {
    /// Sum.
    Add,
    /// Difference.
    Sub,
    /// Product.
    Mul,
    /// Quotient.
    Div,
    /// The smaller one; the second where the first is not a number.
    Min,
    /// The larger one; the second where the first is not a number.
    Max,
    /// Power of a base that is not negative.
    Pow,
    /// 1 where the first is less, else 0.
    Less,
    /// 1 where the first is less or equal, else 0.
    LessEqual,
    /// 1 where both are equal, else 0.
    Equal,
}

impl Binary {
    /// The canonical meaning.
    #[inline(always)]
    pub fn apply(self, a: f64, b: f64) -> f64 {
        match self {
            Binary::Add => a + b,
            Binary::Sub => a - b,
            Binary::Mul => a * b,
            Binary::Div => a / b,
            Binary::Min => {
                if a < b {
                    a
                } else {
                    b
                }
            }
            Binary::Max => {
                if a > b {
                    a
                } else {
                    b
                }
            }
            Binary::Pow => math::pow(a, b),
            Binary::Less => f64::from(a < b),
            Binary::LessEqual => f64::from(a <= b),
            Binary::Equal => f64::from(a == b),
        }
    }

    fn commutes(self) -> bool {
        matches!(self, Binary::Add | Binary::Mul | Binary::Equal)
    }
}

/// `condition` where it is not zero chooses `a`, else `b`.
#[inline(always)]
pub fn select(condition: f64, a: f64, b: f64) -> f64 {
    if condition == 0.0 { b } else { a }
}

/// Where in a step an input is taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Point {
    /// At the start of the step; in a model's own equations: now.
    Start,
    /// In its middle.
    Middle,
    /// At its end.
    End,
}

/// What a node is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Node {
    /// A number, by its bits.
    Const(u64),
    /// A state of the model, by index.
    State(u16),
    /// A parameter, by index.
    Param(u16),
    /// An input, by index, at a point of the step.
    Input(u16, Point),
    /// The slope of an input over the present sample interval, per hour.
    Slope(u16),
    /// What an input was, at a point of the step, as many hours ago as the node says. That node depends on
    /// parameters alone, so the past of the input is looked up once per candidate and step.
    Delayed(u16, Point, NodeId),
    /// The length of the step in hours.
    Step,
    /// An operation on one node.
    Unary(Unary, NodeId),
    /// An operation on two nodes.
    Binary(Binary, NodeId, NodeId),
    /// A choice: condition, value if it is not zero, value if it is.
    Select(NodeId, NodeId, NodeId),
}

/// An interned expression graph in topological order.
#[derive(Debug, Clone, Default)]
pub struct Graph {
    nodes: Vec<Node>,
    known: HashMap<Node, NodeId>,
}

impl Graph {
    /// All nodes, operands before their users.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// The node behind an id.
    pub fn node(&self, id: NodeId) -> Node {
        self.nodes[id.0 as usize]
    }

    /// The value, where the node is a number.
    pub fn constant_value(&self, id: NodeId) -> Option<f64> {
        match self.node(id) {
            Node::Const(bits) => Some(f64::from_bits(bits)),
            _ => None,
        }
    }

    /// Interns a leaf or an operation without simplifying it.
    pub fn intern(&mut self, node: Node) -> NodeId {
        if let Some(id) = self.known.get(&node) {
            return *id;
        }
        let id = NodeId(u32::try_from(self.nodes.len()).unwrap_or(u32::MAX));
        self.nodes.push(node);
        self.known.insert(node, id);
        id
    }

    /// A number.
    pub fn constant(&mut self, value: f64) -> NodeId {
        // Minus zero and zero are one node; no model can tell them apart in a sum.
        self.intern(Node::Const((value + 0.0).to_bits()))
    }

    /// An operation on one value, folded where the value is known.
    pub fn unary(&mut self, op: Unary, x: NodeId) -> NodeId {
        if let Some(value) = self.constant_value(x) {
            return self.constant(op.apply(value));
        }
        match (op, self.node(x)) {
            (Unary::Neg, Node::Unary(Unary::Neg, inner)) => inner,
            (Unary::Neg, Node::Binary(Binary::Sub, a, b)) => self.binary(Binary::Sub, b, a),
            _ => self.intern(Node::Unary(op, x)),
        }
    }

    /// An operation on two values, folded and simplified. States and inputs are finite, so a product with
    /// zero is zero.
    pub fn binary(&mut self, op: Binary, a: NodeId, b: NodeId) -> NodeId {
        let (left, right) = (self.constant_value(a), self.constant_value(b));
        if let (Some(x), Some(y)) = (left, right) {
            return self.constant(op.apply(x, y));
        }
        let negated = |graph: &Self, id: NodeId| match graph.node(id) {
            Node::Unary(Unary::Neg, inner) => Some(inner),
            _ => None,
        };
        match op {
            Binary::Add => match (left, right) {
                (Some(0.0), _) => return b,
                (_, Some(0.0)) => return a,
                _ => {
                    if let Some(inner) = negated(self, b) {
                        return self.binary(Binary::Sub, a, inner);
                    }
                    if let Some(inner) = negated(self, a) {
                        return self.binary(Binary::Sub, b, inner);
                    }
                }
            },
            Binary::Sub => match (left, right) {
                (_, Some(0.0)) => return a,
                (Some(0.0), _) => return self.unary(Unary::Neg, b),
                _ if a == b => return self.constant(0.0),
                _ => {
                    if let Some(inner) = negated(self, b) {
                        return self.binary(Binary::Add, a, inner);
                    }
                }
            },
            Binary::Mul => match (left, right) {
                (Some(0.0), _) | (_, Some(0.0)) => return self.constant(0.0),
                (Some(1.0), _) => return b,
                (_, Some(1.0)) => return a,
                (Some(-1.0), _) => return self.unary(Unary::Neg, b),
                (_, Some(-1.0)) => return self.unary(Unary::Neg, a),
                _ => {
                    if let Some(inner) = negated(self, a) {
                        let product = self.binary(Binary::Mul, inner, b);
                        return self.unary(Unary::Neg, product);
                    }
                    if let Some(inner) = negated(self, b) {
                        let product = self.binary(Binary::Mul, a, inner);
                        return self.unary(Unary::Neg, product);
                    }
                }
            },
            Binary::Div => match (left, right) {
                (Some(0.0), _) => return self.constant(0.0),
                (_, Some(1.0)) => return a,
                _ => {}
            },
            Binary::Pow if right == Some(1.0) => return a,
            _ => {}
        }
        let (a, b) = if op.commutes() && b < a { (b, a) } else { (a, b) };
        self.intern(Node::Binary(op, a, b))
    }

    /// A choice, folded where the condition is known or both branches are the same.
    pub fn choose(&mut self, condition: NodeId, a: NodeId, b: NodeId) -> NodeId {
        match self.constant_value(condition) {
            Some(value) => {
                if value == 0.0 {
                    b
                } else {
                    a
                }
            }
            None if a == b => a,
            None => self.intern(Node::Select(condition, a, b)),
        }
    }

    /// The sum of two nodes.
    pub fn add(&mut self, a: NodeId, b: NodeId) -> NodeId {
        self.binary(Binary::Add, a, b)
    }

    /// The difference of two nodes.
    pub fn sub(&mut self, a: NodeId, b: NodeId) -> NodeId {
        self.binary(Binary::Sub, a, b)
    }

    /// The product of two nodes.
    pub fn mul(&mut self, a: NodeId, b: NodeId) -> NodeId {
        self.binary(Binary::Mul, a, b)
    }

    /// The quotient of two nodes.
    pub fn div(&mut self, a: NodeId, b: NodeId) -> NodeId {
        self.binary(Binary::Div, a, b)
    }

    /// Which nodes `roots` need, as a mask over all nodes.
    pub fn reachable(&self, roots: &[NodeId]) -> Vec<bool> {
        let mut used = vec![false; self.nodes.len()];
        for root in roots {
            used[root.0 as usize] = true;
        }
        for index in (0..self.nodes.len()).rev() {
            if !used[index] {
                continue;
            }
            for operand in operands(self.nodes[index]) {
                used[operand.0 as usize] = true;
            }
        }
        used
    }

    /// Rebuilds `roots` of `source` in this graph with every leaf replaced by what `leaf` returns for it. The
    /// delay of a delayed input comes to `leaf` as a node of this graph.
    pub fn import(
        &mut self,
        source: &Graph,
        roots: &[NodeId],
        mut leaf: impl FnMut(&mut Graph, Node) -> NodeId,
    ) -> Vec<NodeId> {
        let used = source.reachable(roots);
        let mut image: Vec<Option<NodeId>> = vec![None; source.nodes.len()];
        let mut last = self.constant(0.0);
        for (index, node) in source.nodes.iter().enumerate().filter(|(index, _)| used[*index]) {
            // Operands come first in topological order, so their images exist.
            let of = |id: NodeId| image[id.0 as usize].unwrap_or(last);
            last = match *node {
                Node::Unary(op, x) => {
                    let x = of(x);
                    self.unary(op, x)
                }
                Node::Binary(op, a, b) => {
                    let (a, b) = (of(a), of(b));
                    self.binary(op, a, b)
                }
                Node::Select(c, a, b) => {
                    let (c, a, b) = (of(c), of(a), of(b));
                    self.choose(c, a, b)
                }
                Node::Delayed(input, point, hours) => {
                    let hours = of(hours);
                    leaf(self, Node::Delayed(input, point, hours))
                }
                other => leaf(self, other),
            };
            image[index] = Some(last);
        }
        roots.iter().map(|root| image[root.0 as usize].unwrap_or(last)).collect()
    }

    /// Evaluates nodes one by one by the canonical meanings: slow, for folding checks and as the oracle of
    /// the tapes.
    pub fn evaluate(&self, roots: &[NodeId], leaf: impl Fn(Node) -> f64) -> Vec<f64> {
        let used = self.reachable(roots);
        let mut values = vec![0.0; self.nodes.len()];
        for (index, node) in self.nodes.iter().enumerate().filter(|(index, _)| used[*index]) {
            let of = |id: NodeId| values[id.0 as usize];
            values[index] = match *node {
                Node::Const(bits) => f64::from_bits(bits),
                Node::Unary(op, x) => op.apply(of(x)),
                Node::Binary(op, a, b) => op.apply(of(a), of(b)),
                Node::Select(c, a, b) => select(of(c), of(a), of(b)),
                other => leaf(other),
            };
        }
        roots.iter().map(|root| values[root.0 as usize]).collect()
    }
}

/// The operands of a node, none for a leaf.
pub fn operands(node: Node) -> impl Iterator<Item = NodeId> {
    let (a, b, c) = match node {
        Node::Unary(_, x) | Node::Delayed(_, _, x) => (Some(x), None, None),
        Node::Binary(_, a, b) => (Some(a), Some(b), None),
        Node::Select(c, a, b) => (Some(c), Some(a), Some(b)),
        _ => (None, None, None),
    };
    a.into_iter().chain(b).chain(c)
}
