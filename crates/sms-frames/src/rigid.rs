//! Conversion of pose matrices to rigid poses.

use glamx::{DMat3, DPose3, DQuat, DVec3};

/// Reasons why a matrix is not a rigid transform.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum NotRigid {
    #[error("it must have 4 rows (or 3) of 4 numbers")]
    Shape,
    #[error("it holds a number that is not finite")]
    NotFinite,
    #[error("its last row is {0:?} instead of 0 0 0 1; is the matrix transposed?")]
    LastRow(Vec<f64>),
    #[error("its determinant is {0:.3}: the axes are mirrored or flat")]
    Determinant(f64),
    #[error("its rotation is scaled by {0:.4}")]
    Scaled(f64),
    #[error("its axes are not orthonormal: |RᵀR − I| reaches {0:.3}")]
    NotOrthonormal(f64),
}

/// Largest entry of RᵀR − I that counts as rounding: poses printed with three decimals reach 0.002.
const TOLERANCE: f64 = 5e-3;

/// Returns the rigid pose nearest to a 4 × 4 matrix (rows), and the largest entry of |RᵀR − I| that was removed.
///
/// # Errors
/// [`NotRigid`].
pub(crate) fn pose_from_rows(rows: &[Vec<f64>]) -> Result<(DPose3, f64), NotRigid> {
    if !(rows.len() == 4 || rows.len() == 3) || rows.iter().any(|r| r.len() != 4) {
        return Err(NotRigid::Shape);
    }
    if rows.iter().flatten().any(|v| !v.is_finite()) {
        return Err(NotRigid::NotFinite);
    }
    if let Some(last) = rows.get(3) {
        let ideal = [0.0, 0.0, 0.0, 1.0];
        if last.iter().zip(ideal).any(|(a, b)| (a - b).abs() > 1e-6) {
            return Err(NotRigid::LastRow(last.clone()));
        }
    }
    let column = |j: usize| DVec3::new(rows[0][j], rows[1][j], rows[2][j]);
    let matrix = DMat3::from_cols(column(0), column(1), column(2));
    let deviation = gram_deviation(&matrix);
    let determinant = matrix.determinant();
    if determinant <= 0.0 {
        return Err(NotRigid::Determinant(determinant));
    }
    if deviation > TOLERANCE {
        let scale = determinant.cbrt();
        let unscaled = gram_deviation(&(matrix * (1.0 / scale)));
        return Err(if unscaled < TOLERANCE {
            NotRigid::Scaled(scale)
        } else {
            NotRigid::NotOrthonormal(deviation)
        });
    }
    Ok((DPose3::from_parts(column(3), nearest_rotation(matrix)), deviation))
}

fn gram_deviation(m: &DMat3) -> f64 {
    let gram = m.transpose() * *m - DMat3::IDENTITY;
    gram.to_cols_array().iter().fold(0.0f64, |d, v| d.max(v.abs()))
}

/// Returns the rotation nearest to an almost orthonormal matrix: Newton's iteration for the polar factor.
pub(crate) fn nearest_rotation(matrix: DMat3) -> DQuat {
    let mut r = matrix;
    for _ in 0..6 {
        r = (r + r.inverse().transpose()) * 0.5;
    }
    DQuat::from_mat3(&r).normalize()
}

/// Returns the rows of the 4 × 4 matrix of a pose, for files.
pub(crate) fn pose_to_rows(pose: &DPose3) -> [[f64; 4]; 4] {
    let r = DMat3::from_quat(pose.rotation);
    let t = pose.translation;
    let row = |i: usize| [r.x_axis[i], r.y_axis[i], r.z_axis[i], t[i]];
    [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(pose: &DPose3) -> Vec<Vec<f64>> {
        pose_to_rows(pose).iter().map(|r| r.to_vec()).collect()
    }

    #[test]
    fn rounding_is_removed_and_faults_are_named() {
        let pose = DPose3::from_parts(
            DVec3::new(1.0, -2.0, 0.5),
            DQuat::from_euler(glamx::EulerRot::XYZ, 0.4, -1.1, 2.0),
        );
        let mut rounded = rows(&pose);
        for v in rounded.iter_mut().flatten() {
            *v = (*v * 1000.0).round() / 1000.0;
        }
        let (read, deviation) = pose_from_rows(&rounded).unwrap();
        assert!(deviation > 1e-5 && read.rotation.angle_between(pose.rotation) < 1e-3);
        assert!((read.rotation.length() - 1.0).abs() < 1e-12);

        let scaled: Vec<Vec<f64>> =
            rows(&pose).iter().map(|r| vec![r[0] * 1.1, r[1] * 1.1, r[2] * 1.1, r[3]]).collect();
        let scaled = [&scaled[..3], &[vec![0.0, 0.0, 0.0, 1.0]]].concat();
        assert!(matches!(pose_from_rows(&scaled), Err(NotRigid::Scaled(s)) if (s - 1.1).abs() < 1e-9));

        let mut mirrored = rows(&pose);
        mirrored.iter_mut().for_each(|r| r[0] = -r[0]);
        assert!(matches!(pose_from_rows(&mirrored), Err(NotRigid::Determinant(d)) if d < 0.0));

        let m = rows(&pose);
        let transposed: Vec<Vec<f64>> = (0..4).map(|i| (0..4).map(|j| m[j][i]).collect()).collect();
        assert!(matches!(pose_from_rows(&transposed), Err(NotRigid::LastRow(_))));
        assert_eq!(pose_from_rows(&m[..2]), Err(NotRigid::Shape));
    }
}
