//! Decompositions that end: those of the library go on until they converge, and some matrices never let them.

use nalgebra::{DMatrix, DVector, Dyn, SVD, Schur, SymmetricEigen};

/// Most iterations of one decomposition; a healthy one takes a few for each row.
const MOST: usize = 10_000;
/// What counts as nothing beside the largest entry, in turn: some eigenvalues converge no further.
const NOTHING: [f64; 4] = [f64::EPSILON, 1e-14, 1e-12, 1e-9];

/// Turns of a matrix that are tried where its eigenvalues do not converge.
const TURNS: usize = 8;

/// Real parts of the eigenvalues; `None` where they are not found.
pub fn eigenvalues(matrix: &DMatrix<f64>) -> Option<Vec<f64>> {
    let turned = (0..TURNS).map(|turn| if turn == 0 { matrix.clone() } else { turned(matrix, turn) });
    let found = turned.into_iter().find_map(|matrix| Schur::try_new(matrix, f64::EPSILON, MOST))?;
    Some(found.complex_eigenvalues().iter().map(|value| value.re).collect())
}

/// The same matrix in other coordinates, which have its eigenvalues and not the symmetry that keeps steps of
/// the QR method going in a circle: mirrored at a plane that stands askew.
fn turned(matrix: &DMatrix<f64>, turn: usize) -> DMatrix<f64> {
    let n = matrix.nrows();
    let normal = DVector::from_fn(n, |i, _| (1.0 + (turn * (i + 1)) as f64).sqrt()).normalize();
    let mirror = DMatrix::identity(n, n) - 2.0 * &normal * normal.transpose();
    &mirror * matrix * &mirror
}

/// Eigenvalues and vectors of a symmetric matrix.
pub fn symmetric(matrix: DMatrix<f64>) -> Option<SymmetricEigen<f64, Dyn>> {
    NOTHING.iter().find_map(|nothing| SymmetricEigen::try_new(matrix.clone(), *nothing, MOST))
}

/// Singular values with both bases.
pub fn singular(matrix: DMatrix<f64>) -> Option<SVD<f64, Dyn, Dyn>> {
    NOTHING.iter().find_map(|nothing| SVD::try_new(matrix.clone(), true, true, *nothing, MOST))
}

#[cfg(test)]
mod tests {
    use super::eigenvalues;
    use nalgebra::DMatrix;

    /// The water of a store whose layers exchange what flows through: the library's own search for its
    /// eigenvalues never ends.
    #[test]
    fn a_matrix_that_never_converges_has_eigenvalues() {
        let (down, up) = (0.453_583_618_895_926_35, 0.397_877_275_628_472_25);
        let (end, middle) = (-0.715_449_311_701_964_6, -0.870_182_791_184_348_7);
        let matrix = DMatrix::from_column_slice(3, 3, &[end, down, 0.0, up, middle, down, 0.0, up, end]);
        let mut found = eigenvalues(&matrix).unwrap();
        found.sort_by(f64::total_cmp);
        // In closed form: (1, 0, -1) has the end's, and the two others share trace and determinant.
        let (half, root) = (0.5 * (end + middle), (0.25 * (end - middle).powi(2) + 2.0 * up * down).sqrt());
        for (found, known) in found.into_iter().zip([half - root, end, half + root]) {
            assert!((found - known).abs() < 1e-8, "{found} {known}");
        }
    }
}
