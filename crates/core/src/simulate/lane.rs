//! One register of a block of candidates.

use super::dual::MatrixEntry;
use std::ops::{Add, Mul};

/// One register: a value for each candidate of the block.
#[derive(Debug, Clone, Copy)]
#[repr(C, align(64))]
pub struct Lane<const W: usize>(pub [f64; W]);

impl<const W: usize> Add for Lane<W> {
    type Output = Self;

    #[inline(always)]
    fn add(mut self, other: Self) -> Self {
        for lane in 0..W {
            self.0[lane] += other.0[lane];
        }
        self
    }
}

impl<const W: usize> Mul for Lane<W> {
    type Output = Self;

    #[inline(always)]
    fn mul(mut self, other: Self) -> Self {
        for lane in 0..W {
            self.0[lane] *= other.0[lane];
        }
        self
    }
}

impl<const W: usize> MatrixEntry for Lane<W> {
    #[inline(always)]
    fn constant(value: f64) -> Self {
        Self([value; W])
    }

    #[inline(always)]
    fn scaled(mut self, factor: f64) -> Self {
        for lane in 0..W {
            self.0[lane] *= factor;
        }
        self
    }

    #[inline(always)]
    fn magnitude(self) -> f64 {
        let mut largest = 0.0;
        for value in self.0 {
            // What is no number is not below any, and nothing is above it.
            largest = if value.abs() <= largest || f64::is_nan(largest) { largest } else { value.abs() };
        }
        largest
    }
}
