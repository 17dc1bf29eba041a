//! A graph becomes a straight-line tape in four stages, by how often a value changes.
//!
//! - constant: folded into the graph already;
//! - candidate: depends on parameters and the step length only, computed once per candidate;
//! - shared: depends on inputs only, computed once per step for all candidates together;
//! - step: depends on states or delayed inputs, computed per candidate and step.
//!
//! The registers of a lane file follow in this order: parameters, step length, constants, candidate values,
//! shared values, delayed inputs, states, step values. An instruction writes the next register, so its
//! operands always lie below its result. Tapes are data; the workspace belongs to the evaluator.

use super::expr::{Binary, Graph, Node, NodeId, Point, Unary, operands};

/// One instruction; operands are register numbers, the result is the next register.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Instruction {
    /// An operation on one register.
    Unary(Unary, u32),
    /// An operation on two registers.
    Binary(Binary, u32, u32),
    /// A choice by the first register between the other two.
    Select(u32, u32, u32),
    /// Two operations at once, where nobody else needs the result of the first.
    Pair(Pair, u32, u32, u32),
    /// `(a - b) c + d`: a conductance times a difference, added to a balance. It is what networks of heat
    /// and mass are made of.
    Conduct(u32, u32, u32, u32),
}

/// Two operations in one instruction, each rounded by itself: it saves a register and a dispatch, and
/// changes no bit. The first operation is in parentheses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pair {
    /// (a b) + c
    MulAdd,
    /// (a b) - c
    MulSub,
    /// c - (a b)
    SubMul,
    /// (a b) c
    MulMul,
    /// (a + b) c
    AddMul,
    /// (a - b) c
    DifferenceMul,
    /// (a + b) + c
    AddAdd,
    /// (a - b) + c
    DifferenceAdd,
    /// (a + b) - c
    AddSub,
    /// c - (a + b)
    SubAdd,
    /// (a - b) - c
    DifferenceSub,
    /// c - (a - b)
    SubDifference,
}

impl Pair {
    /// The canonical meaning.
    #[inline(always)]
    pub fn apply(self, a: f64, b: f64, c: f64) -> f64 {
        match self {
            Pair::MulAdd => a * b + c,
            Pair::MulSub => a * b - c,
            Pair::SubMul => c - a * b,
            Pair::MulMul => a * b * c,
            Pair::AddMul => (a + b) * c,
            Pair::DifferenceMul => (a - b) * c,
            Pair::AddAdd => a + b + c,
            Pair::DifferenceAdd => a - b + c,
            Pair::AddSub => a + b - c,
            Pair::SubAdd => c - (a + b),
            Pair::DifferenceSub => a - b - c,
            Pair::SubDifference => c - (a - b),
        }
    }

    /// The pair of an inner operation that is the first or the second operand of an outer one.
    fn of(inner: Binary, outer: Binary, first: bool) -> Option<Pair> {
        Some(match (inner, outer, first) {
            (Binary::Mul, Binary::Add, _) => Pair::MulAdd,
            (Binary::Mul, Binary::Sub, true) => Pair::MulSub,
            (Binary::Mul, Binary::Sub, false) => Pair::SubMul,
            (Binary::Mul, Binary::Mul, _) => Pair::MulMul,
            (Binary::Add, Binary::Mul, _) => Pair::AddMul,
            (Binary::Sub, Binary::Mul, _) => Pair::DifferenceMul,
            (Binary::Add, Binary::Add, _) => Pair::AddAdd,
            (Binary::Sub, Binary::Add, _) => Pair::DifferenceAdd,
            (Binary::Add, Binary::Sub, true) => Pair::AddSub,
            (Binary::Add, Binary::Sub, false) => Pair::SubAdd,
            (Binary::Sub, Binary::Sub, true) => Pair::DifferenceSub,
            (Binary::Sub, Binary::Sub, false) => Pair::SubDifference,
            _ => return None,
        })
    }
}

impl Instruction {
    /// The same operation on other registers.
    #[must_use]
    pub fn with_operands(self, moved: impl Fn(u32) -> u32) -> Self {
        match self {
            Instruction::Unary(op, x) => Instruction::Unary(op, moved(x)),
            Instruction::Binary(op, a, b) => Instruction::Binary(op, moved(a), moved(b)),
            Instruction::Select(c, a, b) => Instruction::Select(moved(c), moved(a), moved(b)),
            Instruction::Pair(pair, a, b, c) => Instruction::Pair(pair, moved(a), moved(b), moved(c)),
            Instruction::Conduct(a, b, c, d) => Instruction::Conduct(moved(a), moved(b), moved(c), moved(d)),
        }
    }
}

/// A leaf of the shared stage: an input at a point of the step, or its slope.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum SharedLeaf {
    /// An input at a point of the step.
    Input(usize, Point),
    /// The slope of an input, per hour.
    Slope(usize),
}

/// A leaf of the step stage: the past of an input, looked up for each candidate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DelayedInput {
    /// The input.
    pub input: usize,
    /// Where in the step the delay is counted back from.
    pub point: Point,
    /// The register that holds the delay in hours.
    pub hours: u32,
}

/// The shared stage: leaves and constants, then instructions, then the columns that the lanes read.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SharedStage {
    /// The first registers, one per leaf.
    pub sources: Vec<SharedLeaf>,
    /// The next registers.
    pub constants: Vec<f64>,
    /// What computes the rest.
    pub code: Vec<Instruction>,
    /// The registers that the lanes read, in the order of the lanes' shared registers.
    pub columns: Vec<u32>,
}

/// A staged tape for a set of roots.
#[derive(Debug, Clone, PartialEq)]
pub struct Tape {
    /// How many parameters come first.
    pub parameters: usize,
    /// Numbers that follow the step length.
    pub constants: Vec<f64>,
    /// Once per candidate.
    pub candidate: Vec<Instruction>,
    /// Once per step for all candidates.
    pub shared: SharedStage,
    /// Looked up once per candidate and step.
    pub delayed: Vec<DelayedInput>,
    /// How many states.
    pub states: usize,
    /// Once per candidate and step.
    pub step: Vec<Instruction>,
    /// Where the roots stand, in the order asked for.
    pub roots: Vec<u32>,
}

impl Tape {
    /// The register of the step length.
    #[inline]
    pub fn step_register(&self) -> usize {
        self.parameters
    }

    /// The first candidate value.
    #[inline]
    pub fn candidate_start(&self) -> usize {
        self.parameters + 1 + self.constants.len()
    }

    /// The first shared value.
    #[inline]
    pub fn shared_start(&self) -> usize {
        self.candidate_start() + self.candidate.len()
    }

    /// The first delayed input.
    #[inline]
    pub fn delayed_start(&self) -> usize {
        self.shared_start() + self.shared.columns.len()
    }

    /// The first state.
    #[inline]
    pub fn state_start(&self) -> usize {
        self.delayed_start() + self.delayed.len()
    }

    /// The first step value.
    #[inline]
    pub fn step_start(&self) -> usize {
        self.state_start() + self.states
    }

    /// All registers of a lane file.
    pub fn registers(&self) -> usize {
        self.step_start() + self.step.len()
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Stage {
    Constant,
    Candidate,
    Shared,
    Step,
}

/// Schedules `roots` of `graph` for a model with so many parameters and states.
pub fn schedule(graph: &Graph, roots: &[NodeId], parameters: usize, states: usize) -> Tape {
    let used = graph.reachable(roots);
    let nodes = graph.nodes();
    let mut stages = vec![Stage::Constant; nodes.len()];
    for (i, node) in nodes.iter().enumerate() {
        stages[i] = match node {
            Node::Const(_) => Stage::Constant,
            Node::Param(_) | Node::Step => Stage::Candidate,
            Node::Input(..) | Node::Slope(_) => Stage::Shared,
            Node::State(_) | Node::Delayed(..) => Stage::Step,
            _ => operands(*node).map(|x| stages[x.0 as usize]).fold(Stage::Constant, meet),
        };
    }
    // The lanes need whatever a lane instruction or a root refers to.
    let mut for_lanes = vec![false; nodes.len()];
    for root in roots {
        for_lanes[root.0 as usize] = true;
    }
    for (_, node) in nodes
        .iter()
        .enumerate()
        .filter(|(i, _)| used[*i] && matches!(stages[*i], Stage::Candidate | Stage::Step))
    {
        operands(*node).for_each(|x| for_lanes[x.0 as usize] = true);
    }
    let of_stage =
        |stage: Stage| (0..nodes.len()).filter(|i| used[*i] && stages[*i] == stage).collect::<Vec<_>>();
    let is_delayed = |i: &usize| matches!(nodes[*i], Node::Delayed(..));
    let is_leaf = |i: &usize| is_delayed(i) || operands(nodes[*i]).next().is_none();
    let shared = shared_stage(nodes, &of_stage(Stage::Shared), &for_lanes);
    let constants: Vec<usize> = of_stage(Stage::Constant).into_iter().filter(|i| for_lanes[*i]).collect();
    let candidate: Vec<usize> = of_stage(Stage::Candidate).into_iter().filter(|i| !is_leaf(i)).collect();
    let columns: Vec<usize> = of_stage(Stage::Shared).into_iter().filter(|i| for_lanes[*i]).collect();
    let delayed: Vec<usize> = of_stage(Stage::Step).into_iter().filter(is_delayed).collect();
    let every: Vec<usize> = of_stage(Stage::Step).into_iter().filter(|i| !is_leaf(i)).collect();
    let inner = pair_up(nodes, &every, roots);
    let mut absorbed = vec![false; nodes.len()];
    inner.iter().flatten().for_each(|i| absorbed[*i] = true);
    let step: Vec<usize> = every.into_iter().filter(|i| !absorbed[*i]).collect();

    let mut register = vec![u32::MAX; nodes.len()];
    for (i, node) in nodes.iter().enumerate() {
        match node {
            Node::Param(p) => register[i] = u32::from(*p),
            Node::Step => register[i] = parameters as u32,
            _ => {}
        }
    }
    let mut next = parameters as u32 + 1;
    for i in constants.iter().chain(&candidate).chain(&columns).chain(&delayed) {
        register[*i] = next;
        next += 1;
    }
    for (i, node) in nodes.iter().enumerate() {
        if let Node::State(s) = node {
            register[i] = next + u32::from(*s);
        }
    }
    next += states as u32;
    for i in &step {
        register[*i] = next;
        next += 1;
    }
    let code =
        |list: &[usize]| list.iter().filter_map(|i| instruction(nodes, *i, &inner, &register)).collect();
    Tape {
        parameters,
        constants: constants.iter().filter_map(|i| constant(nodes[*i])).collect(),
        candidate: code(&candidate),
        shared,
        delayed: delayed.iter().filter_map(|i| delayed_input(nodes[*i], &register)).collect(),
        states,
        step: code(&step),
        roots: roots.iter().map(|root| register[root.0 as usize]).collect(),
    }
}

/// The stage of an operation on values of two stages: a mix of candidate and shared changes per both.
fn meet(a: Stage, b: Stage) -> Stage {
    match (a, b) {
        (Stage::Candidate, Stage::Shared) | (Stage::Shared, Stage::Candidate) => Stage::Step,
        _ => a.max(b),
    }
}

fn constant(node: Node) -> Option<f64> {
    match node {
        Node::Const(bits) => Some(f64::from_bits(bits)),
        _ => None,
    }
}

/// For each node the operand that its instruction absorbs: a sum, difference or product of the same stage
/// that nobody else needs.
fn pair_up(nodes: &[Node], step: &[usize], roots: &[NodeId]) -> Vec<Option<usize>> {
    let mut uses = vec![0usize; nodes.len()];
    roots.iter().for_each(|root| uses[root.0 as usize] += 2);
    step.iter().flat_map(|i| operands(nodes[*i])).for_each(|id| uses[id.0 as usize] += 1);
    let mut in_step = vec![false; nodes.len()];
    step.iter().for_each(|i| in_step[*i] = true);
    let mut inner: Vec<Option<usize>> = vec![None; nodes.len()];
    for i in step {
        let Node::Binary(outer, a, b) = nodes[*i] else {
            continue;
        };
        // A node that absorbed another one is no plain operation any more, except a product of a difference.
        let free = |id: NodeId, first: bool| {
            let index = id.0 as usize;
            let Node::Binary(op, ..) = nodes[index] else {
                return None;
            };
            if !in_step[index] || uses[index] != 1 {
                return None;
            }
            let rank = match inner[index] {
                None if op == Binary::Mul => 1,
                None => 2,
                Some(_) if conduct(nodes, outer, index, &inner).is_some() => 0,
                Some(_) => return None,
            };
            Pair::of(op, outer, first).map(|_| (rank, index))
        };
        // A product is absorbed rather than a sum: sums go on to absorb products themselves.
        inner[*i] = [free(a, true), free(b, false)].into_iter().flatten().min().map(|(_, index)| index);
    }
    inner
}

/// The operands a, b and c of a product `(a - b) c` that a sum may absorb as a whole.
fn conduct(nodes: &[Node], outer: Binary, product: usize, inner: &[Option<usize>]) -> Option<[NodeId; 3]> {
    let (Binary::Add, Node::Binary(Binary::Mul, x, y), Some(difference)) =
        (outer, nodes[product], inner[product])
    else {
        return None;
    };
    let Node::Binary(Binary::Sub, a, b) = nodes[difference] else {
        return None;
    };
    Some([a, b, if x.0 as usize == difference { y } else { x }])
}

fn instruction(
    nodes: &[Node],
    index: usize,
    inner: &[Option<usize>],
    register: &[u32],
) -> Option<Instruction> {
    let of = |id: NodeId| register[id.0 as usize];
    let absorbed = inner.get(index).copied().flatten();
    if let (Node::Binary(outer, a, b), Some(absorbed)) = (nodes[index], absorbed)
        && let Node::Binary(op, x, y) = nodes[absorbed]
    {
        let first = a.0 as usize == absorbed;
        let other = if first { b } else { a };
        if let Some([a, b, c]) = conduct(nodes, outer, absorbed, inner) {
            return Some(Instruction::Conduct(of(a), of(b), of(c), of(other)));
        }
        return Some(Instruction::Pair(Pair::of(op, outer, first)?, of(x), of(y), of(other)));
    }
    match nodes[index] {
        Node::Unary(op, x) => Some(Instruction::Unary(op, of(x))),
        Node::Binary(op, a, b) => Some(Instruction::Binary(op, of(a), of(b))),
        Node::Select(c, a, b) => Some(Instruction::Select(of(c), of(a), of(b))),
        _ => None,
    }
}

fn delayed_input(node: Node, register: &[u32]) -> Option<DelayedInput> {
    match node {
        Node::Delayed(input, point, hours) => {
            Some(DelayedInput { input: usize::from(input), point, hours: register[hours.0 as usize] })
        }
        _ => None,
    }
}

fn shared_stage(nodes: &[Node], members: &[usize], for_lanes: &[bool]) -> SharedStage {
    let mut register = vec![u32::MAX; nodes.len()];
    let mut stage = SharedStage::default();
    let mut next = 0;
    let mut place = |i: usize, register: &mut Vec<u32>| {
        register[i] = next;
        next += 1;
    };
    for i in members {
        let source = match nodes[*i] {
            Node::Input(input, point) => SharedLeaf::Input(usize::from(input), point),
            Node::Slope(input) => SharedLeaf::Slope(usize::from(input)),
            _ => continue,
        };
        stage.sources.push(source);
        place(*i, &mut register);
    }
    for i in members.iter().flat_map(|i| operands(nodes[*i])).map(|id| id.0 as usize) {
        if let (Some(value), u32::MAX) = (constant(nodes[i]), register[i]) {
            stage.constants.push(value);
            place(i, &mut register);
        }
    }
    for i in members {
        if operands(nodes[*i]).next().is_some() {
            stage.code.extend(instruction(nodes, *i, &[], &register));
            place(*i, &mut register);
        }
    }
    stage.columns = members.iter().filter(|i| for_lanes[**i]).map(|i| register[*i]).collect();
    stage
}
