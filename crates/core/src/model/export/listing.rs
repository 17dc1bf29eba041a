//! A graph as lines of a program: definitions of what is used more than once, and the roots.

use super::dialect::{Dialect, Phrase};
use super::names::Names;
use crate::model::expr::{Graph, Node, NodeId, operands};

/// A text of more characters gets a name of its own.
const LONG: usize = 240;
/// So many symbols in a formula are too many for people.
const CROWDED: usize = 24;
/// What has no more symbols is written again wherever people meet it.
const PLAIN: usize = 4;

/// Lines of a program.
#[derive(Debug, Default)]
pub struct Listing {
    /// Names and what they stand for, each before its use.
    pub definitions: Vec<(String, String)>,
    /// The roots.
    pub roots: Vec<String>,
}

/// Writes `roots` of a graph in a dialect. Definitions are called by their number, from one on.
pub fn listing(
    graph: &Graph,
    roots: &[NodeId],
    names: &Names,
    dialect: Dialect,
    called: impl Fn(usize) -> String,
) -> Listing {
    let used = graph.reachable(roots);
    let nodes = graph.nodes();
    let mut uses = vec![0_usize; nodes.len()];
    roots.iter().for_each(|root| uses[root.0 as usize] += 1);
    for (node, _) in nodes.iter().zip(&used).filter(|(_, used)| **used) {
        operands(*node).for_each(|operand| uses[operand.0 as usize] += 1);
    }
    let mut written: Vec<Option<Phrase>> = vec![None; nodes.len()];
    let mut symbols = vec![1_usize; nodes.len()];
    let mut listing = Listing::default();
    let missing = Phrase::whole("0");
    for (index, node) in nodes.iter().enumerate().filter(|(index, _)| used[*index]) {
        let of = |id: NodeId| written[id.0 as usize].as_ref().unwrap_or(&missing);
        let (text, is_leaf) = match *node {
            Node::Const(bits) => (dialect.number(f64::from_bits(bits)), true),
            Node::Unary(op, x) => (dialect.unary(op, of(x)), false),
            Node::Binary(op, a, b) => (dialect.binary(op, of(a), of(b)), false),
            Node::Select(c, a, b) => (dialect.select(of(c), of(a), of(b)), false),
            leaf => (Phrase::whole(names.leaf(leaf)), true),
        };
        if !is_leaf {
            symbols[index] = operands(*node).map(|operand| symbols[operand.0 as usize]).sum();
        }
        let is_repeated = uses[index] > 1;
        let is_large = if dialect.is_typeset() {
            symbols[index] > CROWDED || is_repeated && symbols[index] > PLAIN
        } else {
            is_repeated || text.text.len() > LONG
        };
        written[index] = Some(if !is_leaf && is_large {
            symbols[index] = 1;
            let name = called(listing.definitions.len() + 1);
            listing.definitions.push((name.clone(), text.text));
            Phrase::whole(name)
        } else {
            text
        });
    }
    let root = |root: &NodeId| written[root.0 as usize].as_ref().unwrap_or(&missing).text.clone();
    listing.roots = roots.iter().map(root).collect();
    listing
}

/// How definitions are called: by a word that begins no name of the model, and their number.
pub fn numbered(names: &Names) -> impl Fn(usize) -> String + use<> {
    let mut prefix = "v".to_owned();
    let all = || {
        let parts = [&names.states, &names.parameters, &names.inputs, &names.outputs];
        parts.into_iter().flatten().chain(names.entrances.iter().map(|(_, name)| name))
    };
    let clashes = |prefix: &str| {
        let is_number = |rest: &str| rest.chars().all(|c| c.is_ascii_digit());
        all().any(|name| name.strip_prefix(prefix).is_some_and(is_number))
    };
    while clashes(&prefix) {
        prefix.push('v');
    }
    move |number| format!("{prefix}{number}")
}
