//! Covariances beside inverses that are written out.

use super::covariance::of_estimates;
use crate::optimise::{Dimension, DimensionScale};
use nalgebra::DMatrix;

fn dimension(name: &str, lower: f64, upper: f64, scale: DimensionScale) -> Dimension {
    Dimension { name: name.to_owned(), lower, upper, scale }
}

/// The inverse of the sum of what the data and what the bounds say.
fn with_bounds(cube: &DMatrix<f64>) -> DMatrix<f64> {
    let n = cube.nrows();
    (cube.clone().try_inverse().unwrap() + DMatrix::identity(n, n) * 12.0).try_inverse().unwrap()
}

#[test]
fn a_covariance_is_carried_to_the_estimates_by_their_slopes() {
    let dimensions = [
        dimension("gain", 0.0, 4.0, DimensionScale::Linear),
        dimension("lost", 0.0, 1.0, DimensionScale::Linear),
        dimension("rate", 0.01, 100.0, DimensionScale::Log),
    ];
    let cube = DMatrix::from_row_slice(3, 3, &[4e-4, 2e-4, 1e-4, 2e-4, 9.0, 0.0, 1e-4, 0.0, 9e-4]);
    let found = of_estimates(&cube, &[0, 1, 2], &dimensions, &[3.0, 0.2, 0.5]).unwrap();
    assert_eq!(found.parameters, ["gain", "lost", "rate"]);
    // Four units for the whole cube, and ln(1e4) times the value.
    let slopes = [4.0, 1.0, 0.5 * 1e4f64.ln()];
    let expected = with_bounds(&cube);
    for (i, row) in found.matrix.iter().enumerate() {
        for (j, found) in row.iter().enumerate() {
            let expected = expected[(i, j)] * slopes[i] * slopes[j];
            assert!((found - expected).abs() <= 1e-12 * slopes[i] * slopes[j], "{i} {j}: {found} {expected}");
        }
    }
    // What the data say nothing about is as uncertain as the bounds leave it.
    assert!((found.matrix[1][1] * 12.0 - 1.0).abs() < 0.02, "{found:?}");
    assert_eq!(found.rank, 2);
    assert_eq!(found.undetermined, [["lost"]]);
    assert_eq!(found.sentence().unwrap(), "the data have rank 2 of 3: fix lost");
}

#[test]
fn two_of_which_only_the_product_is_seen_are_one_combination() {
    let dimensions = ["a", "b", "c"].map(|name| dimension(name, 0.1, 10.0, DimensionScale::Log));
    // Their sum on the scale of logarithms is known to a hundredth, their difference is not at all.
    let (sum, difference) = (1e-4, 5e7);
    let (own, shared) = ((sum + difference) / 2.0, (sum - difference) / 2.0);
    let cube = DMatrix::from_row_slice(3, 3, &[own, shared, 0.0, shared, own, 0.0, 0.0, 0.0, 1e-4]);
    let found = of_estimates(&cube, &[0, 1, 2], &dimensions, &[1.0; 3]).unwrap();
    assert_eq!((found.rank, found.undetermined.clone()), (2, vec![vec!["a".to_owned(), "b".to_owned()]]));
    assert_eq!(found.sentence().unwrap(), "the data have rank 2 of 3: fix one of a, b");
    // Each alone is open, both together are not: their sum has the variance of what the data see.
    let slope = 100f64.ln();
    let variance = |a: f64, b: f64| {
        a * a * found.matrix[0][0] + 2.0 * a * b * found.matrix[0][1] + b * b * found.matrix[1][1]
    };
    assert!((variance(1.0, -1.0) / (slope * slope / 6.0) - 1.0).abs() < 1e-3, "{found:?}");
    assert!(variance(1.0, 1.0) < 1e-2 * variance(1.0, -1.0), "{found:?}");
    // The coordinates that the matrix is about need not be all.
    let part = DMatrix::from_row_slice(1, 1, &[1e-4]);
    let found = of_estimates(&part, &[2], &dimensions, &[1.0; 3]).unwrap();
    assert_eq!(
        (found.parameters.as_slice(), found.rank, found.sentence()),
        (["c".to_owned()].as_slice(), 1, None)
    );
    assert_eq!(of_estimates(&DMatrix::zeros(0, 0), &[], &dimensions, &[1.0; 3]), None);
}
