//! Symbolic derivatives of an expression graph: the Jacobian of the implicit stepper and the Kalman filter.

use super::Input;
use super::expr::{Binary, Graph, Node, NodeId, Point, Unary};
use super::spec::InputHold;
use std::collections::HashMap;

/// The derivative of `root` with respect to the leaf `variable`, as a node of the same graph.
///
/// `abs`, `min`, `max` and `if` are differentiated branch by branch; a comparison has derivative zero. A
/// delayed input is a leaf: it follows its own past, neither the states nor the present input.
pub fn derivative(graph: &mut Graph, root: NodeId, variable: Node) -> NodeId {
    derivatives(graph, &[root], variable)[0]
}

/// The derivatives of several nodes with respect to the leaf `variable`, in the order of `roots`.
pub fn derivatives(graph: &mut Graph, roots: &[NodeId], variable: Node) -> Vec<NodeId> {
    let mut memo = HashMap::new();
    let used = graph.reachable(roots);
    // Operands precede their users, so one pass upwards suffices and no recursion can overflow the stack.
    for index in 0..used.len() {
        if used[index] {
            let id = NodeId(u32::try_from(index).unwrap_or(u32::MAX));
            let slope = node_derivative(graph, id, variable, &memo);
            memo.insert(id, slope);
        }
    }
    let zero = graph.constant(0.0);
    roots.iter().map(|root| memo.get(root).copied().unwrap_or(zero)).collect()
}

/// The explicit time derivative of an equation: its linear-hold inputs move along their slopes, delayed ones
/// along the line between their values at both ends of the step.
pub(super) fn time_derivative(graph: &mut Graph, f: NodeId, inputs: &[Input]) -> NodeId {
    let linear =
        |input: u16| inputs.get(usize::from(input)).is_some_and(|input| input.hold == InputHold::Linear);
    let mut moving: Vec<(Node, NodeId)> = Vec::new();
    for i in (0..inputs.len() as u16).filter(|i| linear(*i)) {
        moving.push((Node::Input(i, Point::Start), graph.intern(Node::Slope(i))));
    }
    let used = graph.reachable(&[f]);
    let leaves: Vec<Node> =
        graph.nodes().iter().zip(used).filter_map(|(node, used)| used.then_some(*node)).collect();
    for leaf in leaves {
        if let Node::Delayed(i, _, hours) = leaf
            && linear(i)
        {
            let (start, end) = (graph.intern(leaf), graph.intern(Node::Delayed(i, Point::End, hours)));
            let (change, step) = (graph.sub(end, start), graph.intern(Node::Step));
            moving.push((leaf, graph.div(change, step)));
        }
    }
    let mut total = graph.constant(0.0);
    for (leaf, slope) in moving {
        let by_leaf = derivative(graph, f, leaf);
        let term = graph.mul(by_leaf, slope);
        total = graph.add(total, term);
    }
    total
}

fn node_derivative(g: &mut Graph, id: NodeId, variable: Node, memo: &HashMap<NodeId, NodeId>) -> NodeId {
    let zero = g.constant(0.0);
    let slope = |x: NodeId| memo.get(&x).copied().unwrap_or(zero);
    match g.node(id) {
        node if node == variable => g.constant(1.0),
        Node::Unary(op, x) => {
            let dx = slope(x);
            if dx == zero { zero } else { unary(g, op, id, x, dx) }
        }
        Node::Binary(op, a, b) => {
            let (da, db) = (slope(a), slope(b));
            if da == zero && db == zero { zero } else { binary(g, op, id, (a, da), (b, db)) }
        }
        Node::Select(c, a, b) => {
            let (da, db) = (slope(a), slope(b));
            g.choose(c, da, db)
        }
        _ => zero,
    }
}

fn unary(g: &mut Graph, op: Unary, value: NodeId, x: NodeId, dx: NodeId) -> NodeId {
    let one = g.constant(1.0);
    match op {
        Unary::Neg => g.unary(Unary::Neg, dx),
        Unary::Abs => {
            let zero = g.constant(0.0);
            let negative = g.binary(Binary::Less, x, zero);
            let minus = g.unary(Unary::Neg, dx);
            g.choose(negative, minus, dx)
        }
        Unary::Exp => g.mul(value, dx),
        Unary::Log => g.div(dx, x),
        Unary::Sqrt => {
            let twice = g.add(value, value);
            g.div(dx, twice)
        }
        Unary::Sin => {
            let cosine = g.unary(Unary::Cos, x);
            g.mul(cosine, dx)
        }
        Unary::Cos => {
            let sine = g.unary(Unary::Sin, x);
            let product = g.mul(sine, dx);
            g.unary(Unary::Neg, product)
        }
        Unary::Tanh => {
            let square = g.mul(value, value);
            let rest = g.sub(one, square);
            g.mul(rest, dx)
        }
    }
}

fn binary(
    g: &mut Graph,
    op: Binary,
    value: NodeId,
    (a, da): (NodeId, NodeId),
    (b, db): (NodeId, NodeId),
) -> NodeId {
    let zero = g.constant(0.0);
    match op {
        Binary::Add => g.add(da, db),
        Binary::Sub => g.sub(da, db),
        Binary::Mul => {
            let left = g.mul(da, b);
            let right = g.mul(a, db);
            g.add(left, right)
        }
        Binary::Div => {
            // d(a/b) = (da - (a/b) db) / b reuses the quotient, and for 1/b the reciprocal as well.
            let one = g.constant(1.0);
            let reciprocal = g.div(one, b);
            let moved = g.mul(value, db);
            let numerator = g.sub(da, moved);
            g.mul(numerator, reciprocal)
        }
        Binary::Min => {
            let less = g.binary(Binary::Less, a, b);
            g.choose(less, da, db)
        }
        Binary::Max => {
            let less = g.binary(Binary::Less, b, a);
            g.choose(less, da, db)
        }
        Binary::Pow => {
            let one = g.constant(1.0);
            let lower = g.sub(b, one);
            let power = g.binary(Binary::Pow, a, lower);
            let factor = g.mul(b, power);
            let by_base = g.mul(factor, da);
            if db == zero {
                return by_base;
            }
            // At a base of zero the logarithm is infinite but the power's own limit is zero.
            let logarithm = g.unary(Unary::Log, a);
            let product = g.mul(value, logarithm);
            let positive = g.binary(Binary::Less, zero, a);
            let safe = g.choose(positive, product, zero);
            let by_exponent = g.mul(safe, db);
            g.add(by_base, by_exponent)
        }
        Binary::Less | Binary::LessEqual | Binary::Equal => zero,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Eighth-order central difference.
    fn difference(f: impl Fn(f64) -> f64, x: f64) -> f64 {
        let h = 2e-2;
        let d = |k: f64| f(x + k * h) - f(x - k * h);
        (d(1.0) * 672.0 - d(2.0) * 168.0 + d(3.0) * 32.0 - d(4.0) * 3.0) / (840.0 * h)
    }

    #[test]
    fn derivatives_equal_high_order_differences() {
        let mut g = Graph::default();
        let x = g.intern(Node::State(0));
        let half = g.constant(0.5);
        let mut functions = Vec::new();
        for op in
            [Unary::Neg, Unary::Abs, Unary::Exp, Unary::Log, Unary::Sqrt, Unary::Sin, Unary::Cos, Unary::Tanh]
        {
            functions.push(g.unary(op, x));
        }
        for op in [Binary::Add, Binary::Sub, Binary::Mul, Binary::Div, Binary::Min, Binary::Max, Binary::Pow]
        {
            let shifted = g.add(x, half);
            let inner = g.unary(Unary::Exp, x);
            functions.push(g.binary(op, shifted, inner));
            functions.push(g.binary(op, inner, half));
        }
        for f in functions {
            let slope = derivative(&mut g, f, Node::State(0));
            for at in [0.4, 0.9, 1.7] {
                let leaf = |value: f64| move |_: Node| value;
                let exact = g.evaluate(&[slope], leaf(at))[0];
                let approximate = difference(|value| g.evaluate(&[f], leaf(value))[0], at);
                assert!(
                    (exact - approximate).abs() < 1e-8 * (1.0 + exact.abs()),
                    "{:?} at {at}: {exact} {approximate}",
                    g.node(f)
                );
            }
        }
    }
}
