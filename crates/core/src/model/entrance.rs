//! What enters the equations from outside: inputs as they are, and inputs as they were some time ago.

use super::Model;
use super::expr::{Graph, Node, NodeId, Point};

/// An input in the equations, present or delayed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Entrance {
    /// The input.
    pub input: usize,
    /// Its leaf in the graph.
    pub leaf: Node,
}

impl Entrance {
    /// The node that says how many hours ago it counts; `None` where it is the present input.
    pub fn hours(&self) -> Option<NodeId> {
        match self.leaf {
            Node::Delayed(_, _, hours) => Some(hours),
            _ => None,
        }
    }

    /// How many hours ago it counts with these parameters.
    pub fn delay(&self, graph: &Graph, theta: &[f64]) -> f64 {
        let leaf = |node: Node| match node {
            Node::Param(index) => theta[usize::from(index)],
            _ => 0.0,
        };
        self.hours().map_or(0.0, |hours| graph.evaluate(&[hours], leaf)[0])
    }
}

/// All entrances of equations and outputs, by input, each present one before its delayed ones.
pub fn entrances(model: &Model) -> Vec<Entrance> {
    let outputs = model.outputs().iter().map(|output| output.node);
    let roots: Vec<NodeId> = model.rhs().iter().copied().chain(outputs).collect();
    let used = model.graph().reachable(&roots);
    let entrance = |(node, used): (&Node, bool)| match *node {
        Node::Input(input, _) | Node::Delayed(input, Point::Start, _) if used => {
            Some(Entrance { input: usize::from(input), leaf: *node })
        }
        _ => None,
    };
    let mut found: Vec<Entrance> = model.graph().nodes().iter().zip(used).filter_map(entrance).collect();
    // Stable: delayed ones of one input stay in the order of the graph.
    found.sort_by_key(|entrance| (entrance.input, entrance.hours().is_some()));
    found
}
