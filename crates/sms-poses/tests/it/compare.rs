//! Comparison of poses with the truth.

use glamx::{DPose3, DVec3};
use sms_poses::align_rigidly;

/// Errors of poses after rigid alignment with the truth.
#[derive(Debug)]
pub(crate) struct PoseErrors {
    /// Root mean square error of the positions of points that the cameras look at, metres.
    pub(crate) point_rms_m: f64,
    /// Root mean square error of the camera positions, metres.
    pub(crate) position_rms_m: f64,
    /// Root mean square error of the camera rotations, radians.
    pub(crate) rotation_rms_rad: f64,
}

/// Compares camera poses `X_WC` with the true ones of the same frames. The two worlds are aligned rigidly by points in
/// front of the cameras, at 0.6 to 1.4 times the distance `at_m` and up to 20° off the axis.
///
/// # Panics
/// If the numbers of poses differ.
pub(crate) fn compare_poses(given: &[DPose3], truth: &[DPose3], at_m: f64) -> PoseErrors {
    assert_eq!(given.len(), truth.len(), "one pose per frame");
    let probes: [DVec3; 8] = std::array::from_fn(|i| {
        let side = |bit: usize| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
        let z = 1.0 + 0.4 * side(2);
        DVec3::new(0.3 * side(0) * z, 0.2 * side(1) * z, z)
    });
    let points = |poses: &[DPose3]| -> Vec<DVec3> {
        poses.iter().flat_map(|x| probes.map(|p| x.transform_point(p * at_m))).collect()
    };
    let (from, to) = (points(given), points(truth));
    let x_true_given = align_rigidly(&from, &to);
    let n = given.len().max(1) as f64;
    let rms = |sum: f64, n: f64| (sum / n.max(1.0)).sqrt();
    let moved: Vec<DPose3> = given.iter().map(|x| x_true_given * *x).collect();
    PoseErrors {
        point_rms_m: rms(
            from.iter().zip(&to).map(|(p, q)| (x_true_given.transform_point(*p) - *q).length_squared()).sum(),
            from.len() as f64,
        ),
        position_rms_m: rms(
            moved.iter().zip(truth).map(|(a, b)| (a.translation - b.translation).length_squared()).sum(),
            n,
        ),
        rotation_rms_rad: rms(
            moved.iter().zip(truth).map(|(a, b)| a.rotation.angle_between(b.rotation).powi(2)).sum(),
            n,
        ),
    }
}
