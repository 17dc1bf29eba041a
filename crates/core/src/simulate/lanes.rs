//! The lane evaluator: one instruction works on a whole block of candidates, in loops that the compiler
//! turns into vector code for the CPU it finds at start.
//!
//! There is one interpreter, `opcode::interpret`, written once and instantiated per instruction set. No fused
//! multiply-add is used, so every CPU gives the same bits, and those of the canonical operations.

use super::lane::Lane;
use super::opcode::{Opcode, interpret};
use crate::cpu::{Cpu, Kernel, dispatch};
use crate::model::tape::{Instruction, Tape};

/// Candidates in a block.
pub const LANES: usize = 32;

/// A register file that evaluates one tape for `W` candidates.
#[derive(Debug, Clone)]
pub struct LaneFile<'t, const W: usize> {
    tape: &'t Tape,
    candidate: Vec<Opcode>,
    step: Vec<Opcode>,
    registers: Vec<Lane<W>>,
    cpu: Cpu,
}

impl<'t, const W: usize> LaneFile<'t, W> {
    /// A file for a tape, with its constants in place.
    pub fn new(tape: &'t Tape) -> Self {
        let mut registers = vec![Lane([0.0; W]); tape.registers()];
        for (register, constant) in registers[tape.parameters + 1..].iter_mut().zip(&tape.constants) {
            *register = Lane([*constant; W]);
        }
        let flat = |code: &[Instruction]| code.iter().copied().map(Opcode::from).collect();
        let (candidate, step) = (flat(&tape.candidate), flat(&tape.step));
        Self { tape, candidate, step, registers, cpu: Cpu::detect() }
    }

    /// Loads parameter vectors and the step length in hours, and computes what depends on them alone. A
    /// block with fewer candidates than lanes repeats its last one.
    pub fn load(&mut self, thetas: &[&[f64]], hours: f64) {
        for parameter in 0..self.tape.parameters {
            for lane in 0..W {
                self.registers[parameter].0[lane] = thetas[lane.min(thetas.len() - 1)][parameter];
            }
        }
        self.registers[self.tape.step_register()] = Lane([hours; W]);
        run(self.cpu, &self.candidate, &mut self.registers, self.tape.candidate_start());
    }

    /// Loads the values that all candidates share in this step.
    #[inline]
    pub fn share(&mut self, row: &[f64]) {
        let start = self.tape.shared_start();
        let registers = &mut self.registers[start..start + row.len()];
        // By place: the parts of `zip` are calls where a crate has several units.
        for (place, value) in row.iter().enumerate() {
            registers[place].0 = [*value; W];
        }
    }

    /// Loads the values that one lane's candidate has for itself in this step.
    #[inline]
    pub fn share_lane(&mut self, lane: usize, row: &[f64]) {
        let start = self.tape.shared_start();
        for (register, value) in self.registers[start..].iter_mut().zip(row) {
            register.0[lane] = *value;
        }
    }

    /// Loads the values that every lane's candidate has for itself in this step.
    #[inline]
    pub fn share_lanes(&mut self, rows: [&[f64]; W]) {
        let start = self.tape.shared_start();
        for (column, register) in self.registers[start..].iter_mut().take(rows[0].len()).enumerate() {
            for (value, row) in register.0.iter_mut().zip(&rows) {
                *value = row[column];
            }
        }
    }

    /// Looks the delayed inputs up: `past` gives the value of the input behind the numbered one of the tape
    /// so many hours ago.
    #[inline]
    pub fn delay(&mut self, past: impl Fn(usize, f64) -> f64) {
        let start = self.tape.delayed_start();
        for (index, delayed) in self.tape.delayed.iter().enumerate() {
            let hours = self.registers[delayed.hours as usize].0;
            self.registers[start + index].0 = hours.map(|hours| past(index, hours));
        }
    }

    /// Looks the delayed inputs of one lane up, as [`LaneFile::delay`] does for all.
    #[inline]
    pub fn delay_lane(&mut self, lane: usize, past: impl Fn(usize, f64) -> f64) {
        let start = self.tape.delayed_start();
        for (index, delayed) in self.tape.delayed.iter().enumerate() {
            let hours = self.registers[delayed.hours as usize].0[lane];
            self.registers[start + index].0[lane] = past(index, hours);
        }
    }

    /// A state, for reading and writing.
    #[inline]
    pub fn state(&mut self, index: usize) -> &mut [f64; W] {
        &mut self.registers[self.tape.state_start() + index].0
    }

    /// Loads all states.
    #[inline(always)]
    pub fn set_states(&mut self, states: &[Lane<W>]) {
        let start = self.tape.state_start();
        self.registers[start..start + states.len()].copy_from_slice(states);
    }

    /// The instruction set that it runs on.
    #[inline]
    pub fn cpu(&self) -> Cpu {
        self.cpu
    }

    /// Evaluates the step.
    #[inline]
    pub fn step(&mut self) {
        run(self.cpu, &self.step, &mut self.registers, self.tape.step_start());
    }

    /// A root of the tape, after [`LaneFile::step`].
    #[inline(always)]
    pub fn root(&self, index: usize) -> &[f64; W] {
        &self.registers[self.tape.roots[index] as usize].0
    }

    /// Copies the first roots, one per state, back into the states: the step is done.
    #[inline]
    pub fn advance(&mut self) {
        // Roots may be states themselves (a constant state), so all are read before one is written; rates
        // never permute states, because an unchanged state is its own root.
        let start = self.tape.state_start();
        for index in 0..self.tape.states {
            self.registers[start + index] = self.registers[self.tape.roots[index] as usize];
        }
    }
}

/// Code whose first result goes to register `first`.
struct Run<'a, const W: usize> {
    code: &'a [Opcode],
    registers: &'a mut [Lane<W>],
    first: usize,
}

impl<const W: usize> Kernel for Run<'_, W> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        interpret(self.code, self.registers, self.first);
    }
}

#[inline]
fn run<const W: usize>(cpu: Cpu, code: &[Opcode], registers: &mut [Lane<W>], first: usize) {
    dispatch(cpu, Run { code, registers, first });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::expr::{Binary, Graph, Node, Unary};
    use crate::model::tape::schedule;

    /// Every operation, on arguments that include the awkward ones, on every instruction set.
    #[test]
    fn lanes_equal_the_canonical_operations_bit_for_bit() {
        let mut g = Graph::default();
        let (x, y) = (g.intern(Node::State(0)), g.intern(Node::State(1)));
        let mut roots = Vec::new();
        for op in
            [Unary::Neg, Unary::Abs, Unary::Exp, Unary::Log, Unary::Sqrt, Unary::Sin, Unary::Cos, Unary::Tanh]
        {
            roots.push(g.unary(op, x));
        }
        for op in [
            Binary::Add,
            Binary::Sub,
            Binary::Mul,
            Binary::Div,
            Binary::Min,
            Binary::Max,
            Binary::Pow,
            Binary::Less,
            Binary::LessEqual,
            Binary::Equal,
        ] {
            roots.push(g.binary(op, x, y));
        }
        roots.push(g.choose(x, y, roots[0]));
        let tape = schedule(&g, &roots, 0, 2);
        let awkward = [
            0.0,
            -0.0,
            1.0,
            -1.0,
            0.3,
            1e-310,
            1e300,
            -745.0,
            709.0,
            f64::INFINITY,
            f64::NEG_INFINITY,
            f64::NAN,
            std::f64::consts::PI,
            2.5,
            21.7,
            -3e-5,
        ];
        for cpu in [Cpu::for_lanes(1), Cpu::detect()] {
            for shift in 0..awkward.len() {
                let mut file = LaneFile::<LANES>::new(&tape);
                file.cpu = cpu;
                file.load(&[&[]], 0.0);
                for lane in 0..LANES {
                    file.state(0)[lane] = awkward[lane % awkward.len()];
                    file.state(1)[lane] = awkward[(lane + shift) % awkward.len()];
                }
                file.step();
                for (index, root) in roots.iter().enumerate() {
                    for lane in 0..LANES {
                        let leaf = |node: Node| match node {
                            Node::State(0) => awkward[lane % awkward.len()],
                            _ => awkward[(lane + shift) % awkward.len()],
                        };
                        let canonical = g.evaluate(&[*root], leaf)[0];
                        let ours = file.root(index)[lane];
                        let same =
                            ours.to_bits() == canonical.to_bits() || (ours.is_nan() && canonical.is_nan());
                        assert!(
                            same,
                            "{:?} at {}, {}: {ours} {canonical}",
                            g.node(*root),
                            leaf(Node::State(0)),
                            leaf(Node::State(1))
                        );
                    }
                }
            }
        }
    }
}
