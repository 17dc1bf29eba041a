//! A tape on numbers that may carry slopes: one candidate, with its derivatives where they are wanted.

use super::dual::{Scalar, binary, unary};
use crate::model::expr::{Binary, select};
use crate::model::tape::{Instruction, Pair, Tape};

/// The registers of one tape.
#[derive(Debug, Clone)]
pub struct Registers<'t, T> {
    tape: &'t Tape,
    values: Vec<T>,
}

impl<'t, T: Scalar> Registers<'t, T> {
    /// A file for a tape, with a parameter vector and the step length in hours, and what depends on them
    /// alone.
    pub fn new(tape: &'t Tape, theta: &[T], hours: f64) -> Self {
        let mut values = vec![T::constant(0.0); tape.registers()];
        values[..tape.parameters].copy_from_slice(&theta[..tape.parameters]);
        values[tape.step_register()] = T::constant(hours);
        for (register, constant) in values[tape.parameters + 1..].iter_mut().zip(&tape.constants) {
            *register = T::constant(*constant);
        }
        interpret(&tape.candidate, &mut values, tape.candidate_start());
        Self { tape, values }
    }

    /// Loads the values that come from inputs alone.
    pub fn share(&mut self, row: &[f64]) {
        let start = self.tape.shared_start();
        for (register, value) in self.values[start..].iter_mut().zip(row) {
            *register = T::constant(*value);
        }
    }

    /// Looks the delayed inputs up: `past` gives the value of the input behind the numbered one of the tape
    /// so many hours ago, and its slope by these hours.
    pub fn delay(&mut self, past: impl Fn(usize, f64) -> (f64, f64)) {
        let start = self.tape.delayed_start();
        for (index, delayed) in self.tape.delayed.iter().enumerate() {
            let hours = self.values[delayed.hours as usize];
            let (value, slope) = past(index, hours.value());
            self.values[start + index] = T::chain(hours, T::constant(0.0), value, slope, 0.0);
        }
    }

    /// Evaluates the step at these states.
    pub fn step(&mut self, states: &[T]) {
        let start = self.tape.state_start();
        self.values[start..start + states.len()].copy_from_slice(states);
        interpret(&self.tape.step, &mut self.values, self.tape.step_start());
    }

    /// A root of the tape, after [`Registers::step`].
    #[inline]
    pub fn root(&self, index: usize) -> T {
        self.values[self.tape.roots[index] as usize]
    }
}

/// The interpreter; results lie above their operands. Pairs round each operation by itself, as the lanes do.
fn interpret<T: Scalar>(code: &[Instruction], registers: &mut [T], first: usize) {
    for (offset, instruction) in code.iter().enumerate() {
        let at = |register: u32| registers[register as usize];
        registers[first + offset] = match *instruction {
            Instruction::Unary(op, x) => unary(op, at(x)),
            Instruction::Binary(op, a, b) => binary(op, at(a), at(b)),
            Instruction::Pair(pair, a, b, c) => paired(pair, at(a), at(b), at(c)),
            Instruction::Conduct(a, b, c, d) => (at(a) - at(b)) * at(c) + at(d),
            Instruction::Select(c, a, b) => at(if select(at(c).value(), 1.0, 0.0) == 1.0 { a } else { b }),
        };
    }
}

#[inline(always)]
fn paired<T: Scalar>(pair: Pair, a: T, b: T, c: T) -> T {
    let (inner, outer) = match pair {
        Pair::MulAdd => (a * b, Binary::Add),
        Pair::MulSub => (a * b, Binary::Sub),
        Pair::SubMul => return c - a * b,
        Pair::MulMul => (a * b, Binary::Mul),
        Pair::AddMul => (a + b, Binary::Mul),
        Pair::DifferenceMul => (a - b, Binary::Mul),
        Pair::AddAdd => (a + b, Binary::Add),
        Pair::DifferenceAdd => (a - b, Binary::Add),
        Pair::AddSub => (a + b, Binary::Sub),
        Pair::SubAdd => return c - (a + b),
        Pair::DifferenceSub => (a - b, Binary::Sub),
        Pair::SubDifference => return c - (a - b),
    };
    binary(outer, inner, c)
}
