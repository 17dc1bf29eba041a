//! The interpreter of a tape, for a block of candidates.
//!
//! An instruction is a family and a member, which would be two jumps; beside few lanes a jump takes longer
//! than the arithmetic. So the code of a register file is flat: a tag, a jump, and the loop over the lanes.

use super::lane::Lane;
use crate::model::expr::{Binary, Unary, select};
use crate::model::math;
use crate::model::tape::{Instruction, Pair};

/// An [`Instruction`] under one tag. Operands are register numbers, the result is the next register.
#[derive(Debug, Clone, Copy)]
pub(super) enum Opcode {
    Neg(u32),
    Abs(u32),
    Exp(u32),
    Log(u32),
    Sqrt(u32),
    Sin(u32),
    Cos(u32),
    Tanh(u32),
    Add(u32, u32),
    Sub(u32, u32),
    Mul(u32, u32),
    Div(u32, u32),
    Min(u32, u32),
    Max(u32, u32),
    Pow(u32, u32),
    Less(u32, u32),
    LessEqual(u32, u32),
    Equal(u32, u32),
    Select(u32, u32, u32),
    MulAdd(u32, u32, u32),
    MulSub(u32, u32, u32),
    SubMul(u32, u32, u32),
    MulMul(u32, u32, u32),
    AddMul(u32, u32, u32),
    DifferenceMul(u32, u32, u32),
    AddAdd(u32, u32, u32),
    DifferenceAdd(u32, u32, u32),
    AddSub(u32, u32, u32),
    SubAdd(u32, u32, u32),
    DifferenceSub(u32, u32, u32),
    SubDifference(u32, u32, u32),
    Conduct(u32, u32, u32, u32),
}

impl From<Instruction> for Opcode {
    fn from(instruction: Instruction) -> Self {
        match instruction {
            Instruction::Unary(op, x) => match op {
                Unary::Neg => Self::Neg(x),
                Unary::Abs => Self::Abs(x),
                Unary::Exp => Self::Exp(x),
                Unary::Log => Self::Log(x),
                Unary::Sqrt => Self::Sqrt(x),
                Unary::Sin => Self::Sin(x),
                Unary::Cos => Self::Cos(x),
                Unary::Tanh => Self::Tanh(x),
            },
            Instruction::Binary(op, a, b) => match op {
                Binary::Add => Self::Add(a, b),
                Binary::Sub => Self::Sub(a, b),
                Binary::Mul => Self::Mul(a, b),
                Binary::Div => Self::Div(a, b),
                Binary::Min => Self::Min(a, b),
                Binary::Max => Self::Max(a, b),
                Binary::Pow => Self::Pow(a, b),
                Binary::Less => Self::Less(a, b),
                Binary::LessEqual => Self::LessEqual(a, b),
                Binary::Equal => Self::Equal(a, b),
            },
            Instruction::Select(c, a, b) => Self::Select(c, a, b),
            Instruction::Pair(pair, a, b, c) => match pair {
                Pair::MulAdd => Self::MulAdd(a, b, c),
                Pair::MulSub => Self::MulSub(a, b, c),
                Pair::SubMul => Self::SubMul(a, b, c),
                Pair::MulMul => Self::MulMul(a, b, c),
                Pair::AddMul => Self::AddMul(a, b, c),
                Pair::DifferenceMul => Self::DifferenceMul(a, b, c),
                Pair::AddAdd => Self::AddAdd(a, b, c),
                Pair::DifferenceAdd => Self::DifferenceAdd(a, b, c),
                Pair::AddSub => Self::AddSub(a, b, c),
                Pair::SubAdd => Self::SubAdd(a, b, c),
                Pair::DifferenceSub => Self::DifferenceSub(a, b, c),
                Pair::SubDifference => Self::SubDifference(a, b, c),
            },
            Instruction::Conduct(a, b, c, d) => Self::Conduct(a, b, c, d),
        }
    }
}

/// Runs code whose first result goes to register `first`. Results lie above their operands, so the file
/// splits at each result without overlap.
#[inline(always)]
pub(super) fn interpret<const W: usize>(code: &[Opcode], registers: &mut [Lane<W>], first: usize) {
    for (offset, opcode) in code.iter().enumerate() {
        let (below, above) = registers.split_at_mut(first + offset);
        let Some(out) = above.first_mut() else { return };
        match *opcode {
            Opcode::Neg(x) => one(out, below, x, |x| -x),
            Opcode::Abs(x) => one(out, below, x, |x| x.abs()),
            Opcode::Sqrt(x) => one(out, below, x, |x| x.sqrt()),
            // What is long is called here and not handed over: a function that is handed over may stay a call
            // for every lane, without wide vectors.
            Opcode::Exp(x) => {
                let x = &below[x as usize];
                for lane in 0..W {
                    out.0[lane] = math::exp(x.0[lane]);
                }
            }
            Opcode::Log(x) => {
                let x = &below[x as usize];
                for lane in 0..W {
                    out.0[lane] = math::log(x.0[lane]);
                }
            }
            Opcode::Sin(x) => {
                let x = &below[x as usize];
                for lane in 0..W {
                    out.0[lane] = math::sin(x.0[lane]);
                }
            }
            Opcode::Cos(x) => {
                let x = &below[x as usize];
                for lane in 0..W {
                    out.0[lane] = math::cos(x.0[lane]);
                }
            }
            Opcode::Tanh(x) => {
                let x = &below[x as usize];
                for lane in 0..W {
                    out.0[lane] = math::tanh(x.0[lane]);
                }
            }
            Opcode::Pow(a, b) => {
                let (a, b) = (&below[a as usize], &below[b as usize]);
                for lane in 0..W {
                    out.0[lane] = math::pow(a.0[lane], b.0[lane]);
                }
            }
            Opcode::Add(a, b) => two(out, below, a, b, |x, y| x + y),
            Opcode::Sub(a, b) => two(out, below, a, b, |x, y| x - y),
            Opcode::Mul(a, b) => two(out, below, a, b, |x, y| x * y),
            Opcode::Div(a, b) => two(out, below, a, b, |x, y| x / y),
            Opcode::Min(a, b) => two(out, below, a, b, |x, y| Binary::Min.apply(x, y)),
            Opcode::Max(a, b) => two(out, below, a, b, |x, y| Binary::Max.apply(x, y)),
            Opcode::Less(a, b) => two(out, below, a, b, |x, y| Binary::Less.apply(x, y)),
            Opcode::LessEqual(a, b) => two(out, below, a, b, |x, y| Binary::LessEqual.apply(x, y)),
            Opcode::Equal(a, b) => two(out, below, a, b, |x, y| Binary::Equal.apply(x, y)),
            Opcode::MulAdd(a, b, c) => three(out, below, [a, b, c], |a, b, c| Pair::MulAdd.apply(a, b, c)),
            Opcode::MulSub(a, b, c) => three(out, below, [a, b, c], |a, b, c| Pair::MulSub.apply(a, b, c)),
            Opcode::SubMul(a, b, c) => three(out, below, [a, b, c], |a, b, c| Pair::SubMul.apply(a, b, c)),
            Opcode::MulMul(a, b, c) => three(out, below, [a, b, c], |a, b, c| Pair::MulMul.apply(a, b, c)),
            Opcode::AddMul(a, b, c) => three(out, below, [a, b, c], |a, b, c| Pair::AddMul.apply(a, b, c)),
            Opcode::DifferenceMul(a, b, c) => {
                three(out, below, [a, b, c], |a, b, c| Pair::DifferenceMul.apply(a, b, c))
            }
            Opcode::AddAdd(a, b, c) => three(out, below, [a, b, c], |a, b, c| Pair::AddAdd.apply(a, b, c)),
            Opcode::DifferenceAdd(a, b, c) => {
                three(out, below, [a, b, c], |a, b, c| Pair::DifferenceAdd.apply(a, b, c))
            }
            Opcode::AddSub(a, b, c) => three(out, below, [a, b, c], |a, b, c| Pair::AddSub.apply(a, b, c)),
            Opcode::SubAdd(a, b, c) => three(out, below, [a, b, c], |a, b, c| Pair::SubAdd.apply(a, b, c)),
            Opcode::DifferenceSub(a, b, c) => {
                three(out, below, [a, b, c], |a, b, c| Pair::DifferenceSub.apply(a, b, c))
            }
            Opcode::SubDifference(a, b, c) => {
                three(out, below, [a, b, c], |a, b, c| Pair::SubDifference.apply(a, b, c))
            }
            Opcode::Select(c, a, b) => three(out, below, [c, a, b], select),
            Opcode::Conduct(a, b, c, d) => {
                let (a, b, c, d) =
                    (&below[a as usize], &below[b as usize], &below[c as usize], &below[d as usize]);
                for lane in 0..W {
                    out.0[lane] = (a.0[lane] - b.0[lane]) * c.0[lane] + d.0[lane];
                }
            }
        }
    }
}

#[inline(always)]
fn one<const W: usize>(out: &mut Lane<W>, below: &[Lane<W>], x: u32, f: impl Fn(f64) -> f64) {
    let x = &below[x as usize];
    for lane in 0..W {
        out.0[lane] = f(x.0[lane]);
    }
}

#[inline(always)]
fn two<const W: usize>(out: &mut Lane<W>, below: &[Lane<W>], a: u32, b: u32, f: impl Fn(f64, f64) -> f64) {
    let (a, b) = (&below[a as usize], &below[b as usize]);
    for lane in 0..W {
        out.0[lane] = f(a.0[lane], b.0[lane]);
    }
}

#[inline(always)]
fn three<const W: usize>(
    out: &mut Lane<W>,
    below: &[Lane<W>],
    operands: [u32; 3],
    f: impl Fn(f64, f64, f64) -> f64,
) {
    let [a, b, c] =
        [&below[operands[0] as usize], &below[operands[1] as usize], &below[operands[2] as usize]];
    for lane in 0..W {
        out.0[lane] = f(a.0[lane], b.0[lane], c.0[lane]);
    }
}
