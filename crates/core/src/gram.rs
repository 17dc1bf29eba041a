//! Inner products of series, and of many with each other: what normal equations are made of.
//!
//! A product has eight partial sums of fixed places, so that it fills vectors and has the same bits on every
//! machine, alone or beside others.

use crate::cpu::{Cpu, Kernel, dispatch};

/// Partial sums of a product.
const SUMS: usize = 8;
/// Rows that are gone through together: those of a dozen series stay in the nearest cache.
const ROWS: usize = 256;
/// Products with one series that are summed side by side, so that none waits for its own last sum.
const ABREAST: usize = 4;

/// The inner product of two series, over as many rows as both have.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    let rows = a.len().min(b.len());
    dispatch(Cpu::detect(), Product { a: &a[..rows], b: &b[..rows] })
}

/// The inner products of all series with each other, row by row: a symmetric matrix. Rows that the first
/// series does not have, or another one, do not count.
pub fn gram(series: &[&[f64]]) -> Vec<f64> {
    let rows = series.iter().map(|one| one.len()).min().unwrap_or(0);
    let series: Vec<&[f64]> = series.iter().map(|one| &one[..rows]).collect();
    dispatch(Cpu::detect(), Gram { series: &series, rows })
}

/// Takes from a series what lies along the series of an orthonormal basis.
///
/// # Panics
/// Where one of those is shorter than the series.
pub fn take_out(basis: &[Vec<f64>], series: &mut [f64]) {
    dispatch(Cpu::detect(), TakeOut { basis, series });
}

struct TakeOut<'a> {
    basis: &'a [Vec<f64>],
    series: &'a mut [f64],
}

impl Kernel for TakeOut<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Self { basis, series } = self;
        let rows = series.len();
        let mut shares = vec![0.0; basis.len()];
        for place in 0..basis.len() {
            let along = &basis[place][..rows];
            let mut sums = [[0.0; SUMS]];
            add_products(along, [&*series], &mut sums);
            shares[place] = total(&sums[0], along, series);
        }
        for place in 0..basis.len() {
            let (along, share) = (&basis[place][..rows], shares[place]);
            for row in 0..rows {
                series[row] -= share * along[row];
            }
        }
    }
}

struct Product<'a> {
    a: &'a [f64],
    b: &'a [f64],
}

impl Kernel for Product<'_> {
    type Output = f64;

    #[inline(always)]
    fn run(self) -> f64 {
        let Self { a, b } = self;
        let mut sums = [[0.0; SUMS]];
        add_products(a, [b], &mut sums);
        total(&sums[0], a, b)
    }
}

struct Gram<'a> {
    series: &'a [&'a [f64]],
    rows: usize,
}

impl Kernel for Gram<'_> {
    type Output = Vec<f64>;

    #[inline(always)]
    fn run(self) -> Vec<f64> {
        let Self { series, rows } = self;
        let d = series.len();
        let mut sums = vec![[0.0; SUMS]; d * d];
        let mut from = 0;
        while from < rows {
            let to = (from + ROWS).min(rows);
            for i in 0..d {
                let a = &series[i][from..to];
                let sums = &mut sums[i * d..i * d + i + 1];
                let mut j = 0;
                while j + ABREAST <= sums.len() {
                    let mut four = [sums[j], sums[j + 1], sums[j + 2], sums[j + 3]];
                    let others = [
                        &series[j][from..to],
                        &series[j + 1][from..to],
                        &series[j + 2][from..to],
                        &series[j + 3][from..to],
                    ];
                    add_products(a, others, &mut four);
                    sums[j..j + ABREAST].copy_from_slice(&four);
                    j += ABREAST;
                }
                while j < sums.len() {
                    let mut one = [sums[j]];
                    add_products(a, [&series[j][from..to]], &mut one);
                    sums[j] = one[0];
                    j += 1;
                }
            }
            from = to;
        }
        let mut products = vec![0.0; d * d];
        for i in 0..d {
            for j in 0..=i {
                let product = total(&sums[i * d + j], series[i], series[j]);
                products[i * d + j] = product;
                products[j * d + i] = product;
            }
        }
        products
    }
}

/// Adds the products of one series with some others, in whole blocks of rows.
#[inline(always)]
fn add_products<const N: usize>(a: &[f64], others: [&[f64]; N], sums: &mut [[f64; SUMS]; N]) {
    let (a, _) = a.as_chunks::<SUMS>();
    let mut blocks = [a; N];
    for n in 0..N {
        blocks[n] = &others[n].as_chunks::<SUMS>().0[..a.len()];
    }
    for row in 0..a.len() {
        for n in 0..N {
            for place in 0..SUMS {
                sums[n][place] += a[row][place] * blocks[n][row][place];
            }
        }
    }
}

/// What the partial sums come to, with the rows that fill no block.
#[inline(always)]
fn total(sums: &[f64; SUMS], a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (a.as_chunks::<SUMS>().1, b.as_chunks::<SUMS>().1);
    let mut rest = 0.0;
    for row in 0..a.len() {
        rest += a[row] * b[row];
    }
    let mut all = 0.0;
    for place in 0..SUMS {
        all += sums[place];
    }
    all + rest
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_are_those_of_the_definition_and_alike_alone_and_beside_others() {
        for rows in [0, 3, 8, 255, 256, 257, 1003] {
            let series: Vec<Vec<f64>> =
                (0..7).map(|i| (0..rows).map(|k| ((k * (i + 3)) as f64 * 0.7).sin()).collect()).collect();
            let slices: Vec<&[f64]> = series.iter().map(Vec::as_slice).collect();
            let all = gram(&slices);
            for i in 0..7 {
                for j in 0..7 {
                    let plain: f64 = series[i].iter().zip(&series[j]).map(|(a, b)| a * b).sum();
                    assert!((all[i * 7 + j] - plain).abs() < 1e-10, "{rows} rows: {i} and {j}");
                    assert_eq!(all[i * 7 + j].to_bits(), dot(&series[i], &series[j]).to_bits());
                }
            }
        }
    }

    #[test]
    fn what_lies_along_a_basis_is_taken_out_and_nothing_else() {
        let rows = 203;
        let tone = |cycles: usize| -> Vec<f64> {
            let turn = std::f64::consts::TAU * cycles as f64 / rows as f64;
            (0..rows).map(|k| (turn * k as f64).sin() * (2.0 / rows as f64).sqrt()).collect()
        };
        let (basis, other) = ([tone(1), tone(2), tone(5)], tone(3));
        let mut series: Vec<f64> =
            (0..rows).map(|k| 4.0 * basis[0][k] - basis[1][k] + 0.5 * basis[2][k] + 2.0 * other[k]).collect();
        take_out(&basis, &mut series);
        for (left, other) in series.iter().zip(&other) {
            assert!((left - 2.0 * other).abs() < 1e-12);
        }
    }

    #[test]
    fn as_many_rows_count_as_all_have() {
        assert_eq!(dot(&[1.0, 2.0, 3.0], &[4.0, 5.0]), 14.0);
        assert_eq!(gram(&[&[1.0, 2.0, 3.0], &[4.0, 5.0]]), [5.0, 14.0, 14.0, 41.0]);
        assert!(gram(&[]).is_empty());
    }
}
