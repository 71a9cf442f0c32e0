//! Eigenvalues and eigenvectors of small symmetric matrices.

/// Diagonalises a symmetric matrix by cyclic Jacobi rotations (Jacobi 1846). Returns the eigenvalues, unsorted, and the
/// matrix whose column k is the unit eigenvector of eigenvalue k. Stops after `sweeps`, or once the squares of the
/// entries above the diagonal sum to at most `tolerance` times the square of the sum of the diagonal's magnitudes.
///
/// ```
/// let (values, vectors) = sms_core::symmetric_eigen([[2.0, 1.0], [1.0, 2.0]], 12, 1e-30);
/// assert!((values[0] - 1.0).abs() < 1e-15 && (values[1] - 3.0).abs() < 1e-15);
/// assert!((vectors[0][0] + vectors[1][0]).abs() < 1e-15);
/// ```
pub fn symmetric_eigen<const N: usize>(
    mut a: [[f64; N]; N],
    sweeps: usize,
    tolerance: f64,
) -> ([f64; N], [[f64; N]; N]) {
    /// Smaller entries are 0: their rotation would overflow.
    const NEGLIGIBLE: f64 = 1e-300;
    let mut v = [[0.0; N]; N];
    (0..N).for_each(|i| v[i][i] = 1.0);
    for _ in 0..sweeps {
        let off: f64 =
            (0..N).flat_map(|p| (p + 1..N).map(move |q| (p, q))).map(|(p, q)| a[p][q] * a[p][q]).sum();
        let scale: f64 = (0..N).map(|i| a[i][i].abs()).sum();
        if off <= tolerance * scale * scale {
            break;
        }
        for p in 0..N {
            for q in p + 1..N {
                if a[p][q].abs() < NEGLIGIBLE {
                    continue;
                }
                let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
                let c = 1.0 / (t * t + 1.0).sqrt();
                let s = t * c;
                for row in &mut a {
                    (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
                }
                for k in 0..N {
                    (a[p][k], a[q][k]) = (c * a[p][k] - s * a[q][k], s * a[p][k] + c * a[q][k]);
                }
                for row in &mut v {
                    (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
                }
            }
        }
    }
    (std::array::from_fn(|i| a[i][i]), v)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Seed;
    use rand::RngExt;

    #[test]
    fn vectors_are_orthonormal_and_rebuild_the_matrix() {
        let mut rng = Seed(3).rng();
        for _ in 0..50 {
            let mut m = [[0.0; 4]; 4];
            for i in 0..4 {
                for j in 0..=i {
                    m[i][j] = rng.random_range(-2.0..2.0);
                    m[j][i] = m[i][j];
                }
            }
            let (values, v) = symmetric_eigen(m, 30, 0.0);
            for i in 0..4 {
                for j in 0..4 {
                    let rebuilt: f64 = (0..4).map(|k| values[k] * v[i][k] * v[j][k]).sum();
                    assert!((rebuilt - m[i][j]).abs() < 1e-12);
                    let product: f64 = (0..4).map(|k| v[k][i] * v[k][j]).sum();
                    assert!((product - f64::from(u8::from(i == j))).abs() < 1e-12);
                }
            }
        }
    }
}
