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

/// Computes every lane of a result from those of its operands. It is no function, because one that is handed
/// over may stay a call for every lane, without wide vectors, where it is long. Operands are copied and the
/// result is stored at once: the compiler cannot tell that it overlaps none of them, and would otherwise do
/// eight lanes one by one.
macro_rules! lanes {
    ($out:ident, $below:ident, |$($operand:ident),+| $value:expr) => {{
        $(let $operand = $below[$operand as usize].0;)+
        let mut result = [0.0; W];
        for lane in 0..W {
            $(let $operand = $operand[lane];)+
            result[lane] = $value;
        }
        $out.0 = result;
    }};
}

/// Runs code whose first result goes to register `first`. Results lie above their operands, so the file
/// splits at each result without overlap.
#[inline(always)]
pub(super) fn interpret<const W: usize>(code: &[Opcode], registers: &mut [Lane<W>], first: usize) {
    for (offset, opcode) in code.iter().enumerate() {
        let (below, above) = registers.split_at_mut(first + offset);
        let Some(out) = above.first_mut() else { return };
        match *opcode {
            Opcode::Neg(x) => lanes!(out, below, |x| -x),
            Opcode::Abs(x) => lanes!(out, below, |x| x.abs()),
            Opcode::Exp(x) => lanes!(out, below, |x| math::exp(x)),
            Opcode::Log(x) => lanes!(out, below, |x| math::log(x)),
            Opcode::Sqrt(x) => lanes!(out, below, |x| x.sqrt()),
            Opcode::Sin(x) => lanes!(out, below, |x| math::sin(x)),
            Opcode::Cos(x) => lanes!(out, below, |x| math::cos(x)),
            Opcode::Tanh(x) => lanes!(out, below, |x| math::tanh(x)),
            Opcode::Add(a, b) => lanes!(out, below, |a, b| a + b),
            Opcode::Sub(a, b) => lanes!(out, below, |a, b| a - b),
            Opcode::Mul(a, b) => lanes!(out, below, |a, b| a * b),
            Opcode::Div(a, b) => lanes!(out, below, |a, b| a / b),
            Opcode::Min(a, b) => lanes!(out, below, |a, b| Binary::Min.apply(a, b)),
            Opcode::Max(a, b) => lanes!(out, below, |a, b| Binary::Max.apply(a, b)),
            Opcode::Pow(a, b) => lanes!(out, below, |a, b| math::pow(a, b)),
            Opcode::Less(a, b) => lanes!(out, below, |a, b| Binary::Less.apply(a, b)),
            Opcode::LessEqual(a, b) => lanes!(out, below, |a, b| Binary::LessEqual.apply(a, b)),
            Opcode::Equal(a, b) => lanes!(out, below, |a, b| Binary::Equal.apply(a, b)),
            Opcode::Select(c, a, b) => lanes!(out, below, |c, a, b| select(c, a, b)),
            Opcode::MulAdd(a, b, c) => lanes!(out, below, |a, b, c| Pair::MulAdd.apply(a, b, c)),
            Opcode::MulSub(a, b, c) => lanes!(out, below, |a, b, c| Pair::MulSub.apply(a, b, c)),
            Opcode::SubMul(a, b, c) => lanes!(out, below, |a, b, c| Pair::SubMul.apply(a, b, c)),
            Opcode::MulMul(a, b, c) => lanes!(out, below, |a, b, c| Pair::MulMul.apply(a, b, c)),
            Opcode::AddMul(a, b, c) => lanes!(out, below, |a, b, c| Pair::AddMul.apply(a, b, c)),
            Opcode::DifferenceMul(a, b, c) => {
                lanes!(out, below, |a, b, c| Pair::DifferenceMul.apply(a, b, c))
            }
            Opcode::AddAdd(a, b, c) => lanes!(out, below, |a, b, c| Pair::AddAdd.apply(a, b, c)),
            Opcode::DifferenceAdd(a, b, c) => {
                lanes!(out, below, |a, b, c| Pair::DifferenceAdd.apply(a, b, c))
            }
            Opcode::AddSub(a, b, c) => lanes!(out, below, |a, b, c| Pair::AddSub.apply(a, b, c)),
            Opcode::SubAdd(a, b, c) => lanes!(out, below, |a, b, c| Pair::SubAdd.apply(a, b, c)),
            Opcode::DifferenceSub(a, b, c) => {
                lanes!(out, below, |a, b, c| Pair::DifferenceSub.apply(a, b, c))
            }
            Opcode::SubDifference(a, b, c) => {
                lanes!(out, below, |a, b, c| Pair::SubDifference.apply(a, b, c))
            }
            Opcode::Conduct(a, b, c, d) => lanes!(out, below, |a, b, c, d| (a - b) * c + d),
        }
    }
}
