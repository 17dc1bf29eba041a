//! Numbers that carry their slopes: forward derivatives of whatever is computed with them.
//!
//! A filter is written once over [`Scalar`]. With plain numbers it gives the likelihood, with [`Dual`] ones
//! its exact derivatives as well, those of the discretisation included (forward mode; Griewank and Walther,
//! Evaluating Derivatives, 2008).

use crate::model::expr::{Binary, Unary};
use std::ops::{Add, Div, Mul, Neg, Sub};

/// What sums and products are made of: a number, with or without slopes, or one for each lane.
pub trait MatrixEntry: Copy + Add<Output = Self> + Mul<Output = Self> {
    /// A number that depends on nothing.
    fn constant(value: f64) -> Self;
    /// This number times one that depends on nothing.
    fn scaled(self, factor: f64) -> Self;
    /// Its largest absolute value, which is no number where one of them is none.
    fn magnitude(self) -> f64;
}

/// A number, with or without slopes.
pub trait Scalar:
    MatrixEntry + PartialEq + Sub<Output = Self> + Div<Output = Self> + Neg<Output = Self>
{
    /// The number alone.
    fn value(self) -> f64;
    /// The value of a function of two numbers, with its slopes there.
    fn chain(a: Self, b: Self, value: f64, by_a: f64, by_b: f64) -> Self;
}

impl MatrixEntry for f64 {
    #[inline(always)]
    fn constant(value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn scaled(self, factor: f64) -> Self {
        self * factor
    }

    #[inline(always)]
    fn magnitude(self) -> f64 {
        self.abs()
    }
}

impl Scalar for f64 {
    #[inline(always)]
    fn value(self) -> f64 {
        self
    }

    #[inline(always)]
    fn chain(_: Self, _: Self, value: f64, _: f64, _: f64) -> Self {
        value
    }
}

/// A number and its slopes in `W` directions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dual<const W: usize> {
    value: f64,
    slopes: [f64; W],
}

impl<const W: usize> Dual<W> {
    /// A variable: its slope is 1 in its own direction.
    pub fn variable(value: f64, direction: usize) -> Self {
        let mut slopes = [0.0; W];
        slopes[direction] = 1.0;
        Self { value, slopes }
    }

    /// The slopes.
    pub fn slopes(&self) -> &[f64; W] {
        &self.slopes
    }

    #[inline(always)]
    fn with(value: f64, slope: impl Fn(usize) -> f64) -> Self {
        let mut slopes = [0.0; W];
        for (lane, to) in slopes.iter_mut().enumerate() {
            *to = slope(lane);
        }
        Self { value, slopes }
    }
}

impl<const W: usize> MatrixEntry for Dual<W> {
    #[inline(always)]
    fn constant(value: f64) -> Self {
        Self { value, slopes: [0.0; W] }
    }

    #[inline(always)]
    fn scaled(self, factor: f64) -> Self {
        Self::with(self.value * factor, |lane| self.slopes[lane] * factor)
    }

    #[inline(always)]
    fn magnitude(self) -> f64 {
        self.value.abs()
    }
}

impl<const W: usize> Scalar for Dual<W> {
    #[inline(always)]
    fn value(self) -> f64 {
        self.value
    }

    #[inline(always)]
    fn chain(a: Self, b: Self, value: f64, by_a: f64, by_b: f64) -> Self {
        // What does not move takes no part in a slope, not even in one that is infinite.
        let part = |slope: f64, by: f64| if slope == 0.0 { 0.0 } else { slope * by };
        Self::with(value, |lane| part(a.slopes[lane], by_a) + part(b.slopes[lane], by_b))
    }
}

impl<const W: usize> Add for Dual<W> {
    type Output = Self;

    #[inline(always)]
    fn add(self, other: Self) -> Self {
        Self::with(self.value + other.value, |lane| self.slopes[lane] + other.slopes[lane])
    }
}

impl<const W: usize> Sub for Dual<W> {
    type Output = Self;

    #[inline(always)]
    fn sub(self, other: Self) -> Self {
        Self::with(self.value - other.value, |lane| self.slopes[lane] - other.slopes[lane])
    }
}

impl<const W: usize> Mul for Dual<W> {
    type Output = Self;

    #[inline(always)]
    #[allow(clippy::suspicious_arithmetic_impl, reason = "the slope of a product is a sum")]
    fn mul(self, other: Self) -> Self {
        Self::with(self.value * other.value, |lane| {
            self.slopes[lane] * other.value + self.value * other.slopes[lane]
        })
    }
}

impl<const W: usize> Div for Dual<W> {
    type Output = Self;

    #[inline(always)]
    fn div(self, other: Self) -> Self {
        let value = self.value / other.value;
        let inverse = 1.0 / other.value;
        Self::with(value, |lane| (self.slopes[lane] - value * other.slopes[lane]) * inverse)
    }
}

impl<const W: usize> Neg for Dual<W> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self::with(-self.value, |lane| -self.slopes[lane])
    }
}

/// An operation on one number: the canonical value and its slope.
#[inline(always)]
pub fn unary<T: Scalar>(op: Unary, x: T) -> T {
    let at = x.value();
    let value = op.apply(at);
    let slope = match op {
        Unary::Neg => return -x,
        Unary::Abs => 1f64.copysign(at),
        Unary::Exp => value,
        Unary::Log => 1.0 / at,
        Unary::Sqrt => 0.5 / value,
        Unary::Sin => Unary::Cos.apply(at),
        Unary::Cos => -Unary::Sin.apply(at),
        Unary::Tanh => 1.0 - value * value,
    };
    T::chain(x, T::constant(0.0), value, slope, 0.0)
}

/// An operation on two numbers: the canonical value and its slopes.
#[inline(always)]
pub fn binary<T: Scalar>(op: Binary, a: T, b: T) -> T {
    match op {
        Binary::Add => a + b,
        Binary::Sub => a - b,
        Binary::Mul => a * b,
        Binary::Div => a / b,
        Binary::Min if a.value() < b.value() => a,
        Binary::Max if a.value() > b.value() => a,
        Binary::Min | Binary::Max => b,
        Binary::Pow => {
            let (base, power) = (a.value(), b.value());
            let value = op.apply(base, power);
            // At a base of zero the logarithm is infinite but the power's own limit is zero.
            let by_power = if base > 0.0 { value * Unary::Log.apply(base) } else { 0.0 };
            T::chain(a, b, value, power * op.apply(base, power - 1.0), by_power)
        }
        Binary::Less | Binary::LessEqual | Binary::Equal => T::constant(op.apply(a.value(), b.value())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_equal_central_differences() {
        let unaries = [
            Unary::Neg,
            Unary::Abs,
            Unary::Exp,
            Unary::Log,
            Unary::Sqrt,
            Unary::Sin,
            Unary::Cos,
            Unary::Tanh,
        ];
        let binaries =
            [Binary::Add, Binary::Sub, Binary::Mul, Binary::Div, Binary::Min, Binary::Max, Binary::Pow];
        for (a, b) in [(0.4, 1.3), (2.2, 0.7)] {
            let (x, y) = (Dual::<2>::variable(a, 0), Dual::<2>::variable(b, 1));
            let near = |slope: f64, f: &dyn Fn(f64) -> f64| {
                let h = 1e-3;
                let difference = (8.0 * (f(h) - f(-h)) - (f(2.0 * h) - f(-2.0 * h))) / (12.0 * h);
                assert!((slope - difference).abs() < 1e-9 * (1.0 + slope.abs()), "{slope} {difference}");
            };
            for op in unaries {
                let found = unary(op, x * y);
                near(found.slopes[0], &|h| op.apply((a + h) * b));
                near(found.slopes[1], &|h| op.apply(a * (b + h)));
            }
            for op in binaries {
                let found = binary(op, x, y);
                assert_eq!(found.value.to_bits(), op.apply(a, b).to_bits());
                near(found.slopes[0], &|h| op.apply(a + h, b));
                near(found.slopes[1], &|h| op.apply(a, b + h));
            }
        }
        // A constant zero under a root has no slope, rather than one that is not a number.
        assert_eq!(unary(Unary::Sqrt, Dual::<1>::constant(0.0)).slopes, [0.0]);
    }
}
