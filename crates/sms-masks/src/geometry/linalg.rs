//! Eigenvectors of symmetric 3×3 matrices.

use glamx::{DMat3, DVec3};

/// Eigenvalues (increasing) and unit eigenvectors of a symmetric matrix, by cyclic Jacobi rotations.
pub(crate) fn symmetric_eigen(matrix: DMat3) -> ([f64; 3], [DVec3; 3]) {
    let (values, v) = sms_core::symmetric_eigen(matrix.to_cols_array_2d(), 12, 1e-30);
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| values[i].total_cmp(&values[j]));
    let vector = |i: usize| DVec3::new(v[0][i], v[1][i], v[2][i]).normalize_or(DVec3::Z);
    (order.map(|i| values[i]), order.map(vector))
}

/// Weighted mean and covariance of points, and the sum of weights; `None` when the weights sum to 0.
pub(crate) fn mean_and_covariance(points: impl Iterator<Item = (DVec3, f64)>) -> Option<(DVec3, DMat3, f64)> {
    // Moments about the first point: one pass, without cancellation far from the origin.
    let (mut origin, mut first, mut second, mut total) = (None, DVec3::ZERO, DMat3::ZERO, 0.0);
    for (p, w) in points {
        let d = p - *origin.get_or_insert(p);
        first += w * d;
        second += outer(d, w);
        total += w;
    }
    if total <= 0.0 {
        return None;
    }
    let mean = first / total;
    Some((origin? + mean, second * (1.0 / total) - outer(mean, 1.0), total))
}

/// `w d dᵀ`.
pub(crate) fn outer(d: DVec3, w: f64) -> DMat3 {
    DMat3::from_cols(d * (d.x * w), d * (d.y * w), d * (d.z * w))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn eigenvectors_satisfy_their_equation(m in proptest::array::uniform6(-5.0f64..5.0)) {
            let matrix = DMat3::from_cols(
                DVec3::new(m[0], m[1], m[2]), DVec3::new(m[1], m[3], m[4]), DVec3::new(m[2], m[4], m[5]),
            );
            let (values, vectors) = symmetric_eigen(matrix);
            prop_assert!(values[0] <= values[1] && values[1] <= values[2]);
            for k in 0..3 {
                prop_assert!((matrix * vectors[k] - vectors[k] * values[k]).length() < 1e-9);
                prop_assert!(vectors[k].dot(vectors[(k + 1) % 3]).abs() < 1e-9);
            }
        }
    }
}
