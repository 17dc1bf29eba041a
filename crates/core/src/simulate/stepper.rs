//! The steppers, written as expression graphs: one step of ROS2 or RK4 becomes a tape like any other
//! expression, so that the evaluator hoists what does not change and shares what is common.

use crate::model::expr::{Graph, Node, NodeId, Point};
use crate::model::tape::{Tape, schedule};
use crate::model::{InputHold, Model, Stepper};

/// The tape of one step: its first roots are the states at the end of the step, or their rates where the
/// stages are loops over lanes.
pub fn step_tape(model: &Model, stepper: Stepper) -> Tape {
    let mut graph = Graph::default();
    let roots = match stepper {
        Stepper::Ros2 => ros2(&mut graph, model),
        Stepper::Rk4 => rk4(&mut graph, model),
        Stepper::Rkc => {
            return schedule(model.graph(), model.rhs(), model.parameters().len(), model.states().len());
        }
    };
    schedule(&graph, &roots, model.parameters().len(), model.states().len())
}

/// The tape of the outputs at a sample.
pub fn output_tape(model: &Model) -> Tape {
    let nodes: Vec<NodeId> = model.outputs().iter().map(|output| output.node).collect();
    schedule(model.graph(), &nodes, model.parameters().len(), model.states().len())
}

/// The tape of the equations, of their explicit time derivatives, and of the Jacobian, row by row: what an
/// exact step of a linear model needs.
pub fn field_tape(model: &Model) -> Tape {
    let mut nodes = model.rhs().to_vec();
    nodes.extend(model.rate());
    nodes.extend(model.jacobian().iter().flatten());
    schedule(model.graph(), &nodes, model.parameters().len(), model.states().len())
}

/// The tape of each output with its gradient.
pub fn observation_tape(model: &Model) -> Tape {
    let nodes: Vec<NodeId> = model
        .outputs()
        .iter()
        .flat_map(|output| [output.node].into_iter().chain(output.gradient.clone()))
        .collect();
    schedule(model.graph(), &nodes, model.parameters().len(), model.states().len())
}

/// The tape of the Jacobian, row by row.
pub fn jacobian_tape(model: &Model) -> Tape {
    let nodes: Vec<NodeId> = model.jacobian().iter().flatten().copied().collect();
    schedule(model.graph(), &nodes, model.parameters().len(), model.states().len())
}

/// Expressions of the model at other states and another point of the step.
fn at(graph: &mut Graph, model: &Model, nodes: &[NodeId], states: &[NodeId], point: Point) -> Vec<NodeId> {
    graph.import(model.graph(), nodes, |graph, leaf| match leaf {
        Node::State(i) => states[usize::from(i)],
        // A held input is the same throughout the step.
        Node::Input(i, _) if model.inputs()[usize::from(i)].hold == InputHold::Linear => {
            graph.intern(Node::Input(i, point))
        }
        // The slope of a delayed input speaks of both ends already.
        Node::Delayed(i, Point::Start, hours) if model.inputs()[usize::from(i)].hold == InputHold::Linear => {
            graph.intern(Node::Delayed(i, point, hours))
        }
        other => graph.intern(other),
    })
}

/// One step of ROS2: the states at its end, as nodes of `g`.
pub fn ros2(g: &mut Graph, model: &Model) -> Vec<NodeId> {
    let n = model.states().len();
    let x: Vec<NodeId> = (0..n).map(|i| g.intern(Node::State(i as u16))).collect();
    let f = at(g, model, model.rhs(), &x, Point::Start);
    let rate = at(g, model, model.rate(), &x, Point::Start);
    let flat: Vec<NodeId> = model.jacobian().iter().flatten().copied().collect();
    let jacobian = at(g, model, &flat, &x, Point::Start);

    let h = g.intern(Node::Step);
    let gamma = g.constant(1.0 - std::f64::consts::FRAC_1_SQRT_2);
    let gamma_h = g.mul(gamma, h);
    let one = g.constant(1.0);
    let mut matrix = vec![vec![one; n]; n];
    for i in 0..n {
        for j in 0..n {
            let scaled = g.mul(gamma_h, jacobian[i * n + j]);
            let identity = g.constant(f64::from(i == j));
            matrix[i][j] = g.sub(identity, scaled);
        }
    }
    let lu = Factors::new(g, matrix);
    let first: Vec<NodeId> = f
        .iter()
        .zip(&rate)
        .map(|(f, rate)| {
            let drift = g.mul(gamma_h, *rate);
            g.add(*f, drift)
        })
        .collect();
    let k1 = lu.solve(g, first);
    let moved: Vec<NodeId> = x
        .iter()
        .zip(&k1)
        .map(|(x, k)| {
            let step = g.mul(h, *k);
            g.add(*x, step)
        })
        .collect();
    let f2 = at(g, model, model.rhs(), &moved, Point::End);
    // The second stage is W k2 = f2 - 2 k1 - gamma h f_t with W = I - gamma h J. Adding the first, W k1 =
    // f + gamma h f_t, gives W (k1 + k2) = f + f2 - 2 k1, and the sum is all that the step needs:
    // x + 3/2 h k1 + 1/2 h k2 = x + h k1 + h/2 (k1 + k2).
    let second: Vec<NodeId> = (0..n)
        .map(|i| {
            let both = g.add(f[i], f2[i]);
            let twice = g.add(k1[i], k1[i]);
            g.sub(both, twice)
        })
        .collect();
    let sum = lu.solve(g, second);
    let half = g.constant(0.5);
    let half_h = g.mul(half, h);
    (0..n)
        .map(|i| {
            let step = g.mul(half_h, sum[i]);
            g.add(moved[i], step)
        })
        .collect()
}

fn rk4(g: &mut Graph, model: &Model) -> Vec<NodeId> {
    let n = model.states().len();
    let x: Vec<NodeId> = (0..n).map(|i| g.intern(Node::State(i as u16))).collect();
    let h = g.intern(Node::Step);
    let half = g.constant(0.5);
    let half_h = g.mul(half, h);
    let moved = |g: &mut Graph, k: &[NodeId], step: NodeId| -> Vec<NodeId> {
        x.iter()
            .zip(k)
            .map(|(x, k)| {
                let change = g.mul(step, *k);
                g.add(*x, change)
            })
            .collect()
    };
    let k1 = at(g, model, model.rhs(), &x, Point::Start);
    let x2 = moved(g, &k1, half_h);
    let k2 = at(g, model, model.rhs(), &x2, Point::Middle);
    let x3 = moved(g, &k2, half_h);
    let k3 = at(g, model, model.rhs(), &x3, Point::Middle);
    let x4 = moved(g, &k3, h);
    let k4 = at(g, model, model.rhs(), &x4, Point::End);
    let sixth = g.constant(1.0 / 6.0);
    let sixth_h = g.mul(sixth, h);
    let total: Vec<NodeId> = (0..n)
        .map(|i| {
            let middle = g.add(k2[i], k3[i]);
            let twice = g.add(middle, middle);
            let ends = g.add(k1[i], k4[i]);
            g.add(ends, twice)
        })
        .collect();
    moved(g, &total, sixth_h)
}

/// Symbolic LU factors without pivoting: the matrix I - gamma h J of a dissipative system is dominated by
/// its diagonal. Rows with few entries go first, which keeps the factors sparse; zeros cost nothing.
struct Factors {
    order: Vec<usize>,
    matrix: Vec<Vec<NodeId>>,
    inverse_pivots: Vec<NodeId>,
    zero: NodeId,
}

impl Factors {
    fn new(g: &mut Graph, a: Vec<Vec<NodeId>>) -> Self {
        let n = a.len();
        let (zero, one) = (g.constant(0.0), g.constant(1.0));
        let entries = |i: usize| {
            (0..n).filter(|j| a[i][*j] != zero).count() + (0..n).filter(|j| a[*j][i] != zero).count()
        };
        let mut order: Vec<usize> = (0..n).collect();
        order.sort_by_key(|i| (entries(*i), *i));
        let mut matrix: Vec<Vec<NodeId>> =
            order.iter().map(|i| order.iter().map(|j| a[*i][*j]).collect()).collect();
        let mut inverse_pivots = Vec::with_capacity(n);
        for k in 0..n {
            let inverse = g.div(one, matrix[k][k]);
            inverse_pivots.push(inverse);
            for i in k + 1..n {
                if matrix[i][k] == zero {
                    continue;
                }
                let factor = g.mul(matrix[i][k], inverse);
                matrix[i][k] = factor;
                for j in k + 1..n {
                    let product = g.mul(factor, matrix[k][j]);
                    matrix[i][j] = g.sub(matrix[i][j], product);
                }
            }
        }
        Self { order, matrix, inverse_pivots, zero }
    }

    fn solve(&self, g: &mut Graph, right: Vec<NodeId>) -> Vec<NodeId> {
        let n = self.order.len();
        let mut y: Vec<NodeId> = self.order.iter().map(|i| right[*i]).collect();
        for i in 0..n {
            for k in (0..i).filter(|k| self.matrix[i][*k] != self.zero) {
                let product = g.mul(self.matrix[i][k], y[k]);
                y[i] = g.sub(y[i], product);
            }
        }
        for i in (0..n).rev() {
            for k in (i + 1..n).filter(|k| self.matrix[i][*k] != self.zero) {
                let product = g.mul(self.matrix[i][k], y[k]);
                y[i] = g.sub(y[i], product);
            }
            y[i] = g.mul(y[i], self.inverse_pivots[i]);
        }
        let mut x = right;
        for (place, value) in self.order.iter().zip(y) {
            x[*place] = value;
        }
        x
    }
}
