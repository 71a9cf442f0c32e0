//! Comparison of poses with the truth.

use crate::linear::{Block, Six};
use glamx::{DPose3, DQuat, DVec3};
use sms_core::Cholesky;

/// Errors of poses after rigid alignment with the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseErrors {
    /// Root mean square error of the positions of points that the cameras look at, metres.
    pub point_rms_m: f64,
    /// Root mean square error of the camera positions, metres.
    pub position_rms_m: f64,
    /// Root mean square error of the camera rotations, radians.
    pub rotation_rms_rad: f64,
    /// Maps points of the given poses' world to the truth's.
    pub x_true_given: DPose3,
}

/// Compares camera poses `X_WC` with the true ones of the same frames. The two worlds are aligned rigidly by points in
/// front of the cameras, at 0.6 to 1.4 times the distance `at_m` and up to 20° off the axis.
///
/// # Panics
/// If the numbers of poses differ.
pub fn compare_poses(given: &[DPose3], truth: &[DPose3], at_m: f64) -> PoseErrors {
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
        x_true_given,
    }
}

/// Returns the least-squares rigid motion that maps `from` to `to`, by Gauss-Newton from the identity: for motions well
/// below half a turn.
pub fn align_rigidly(from: &[DVec3], to: &[DVec3]) -> DPose3 {
    let mut x = DPose3::identity();
    let n = from.len().min(to.len());
    if n == 0 {
        return x;
    }
    let center = to.iter().take(n).sum::<DVec3>() / n as f64;
    for _ in 0..30 {
        let (mut h, mut g): (Block, Six) = ([[0.0; 6]; 6], [0.0; 6]);
        for (p, q) in from.iter().zip(to) {
            let p = x.transform_point(*p);
            let (r, d) = (p - *q, p - center);
            for axis in 0..3 {
                let a = DVec3::AXES[axis];
                let turn = d.cross(a);
                let jacobian = [turn.x, turn.y, turn.z, a.x, a.y, a.z];
                for i in 0..6 {
                    g[i] += jacobian[i] * r[axis];
                    for j in 0..6 {
                        h[i][j] += jacobian[i] * jacobian[j];
                    }
                }
            }
        }
        // Points on a line leave one rotation undetermined: the damping keeps it unchanged.
        (0..3).for_each(|i| h[i][i] += 1e-12 * n as f64);
        let Some(l) = Cholesky::<6>::new(&h, 6) else { break };
        let mut step = g.map(|v| -v);
        l.solve(&mut step);
        x = moved_about(center, &step) * x;
        if step.iter().all(|v| v.abs() < 1e-14) {
            break;
        }
    }
    x
}

/// Returns the motion that turns by `step[0..3]` about `center` and shifts by `step[3..6]`.
pub(crate) fn moved_about(center: DVec3, step: &Six) -> DPose3 {
    let rotation = DQuat::from_scaled_axis(DVec3::new(step[0], step[1], step[2]));
    let shift = DVec3::new(step[3], step[4], step[5]);
    DPose3::from_parts(center + shift - rotation * center, rotation)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_common_motion_is_no_error(
            turn in prop::array::uniform3(-0.5..0.5f64), shift in prop::array::uniform3(-1.0..1.0f64)
        ) {
            let truth: Vec<DPose3> = (0..7)
                .map(|i| {
                    let angle = i as f64 * 0.6;
                    DPose3::from_parts(
                        DVec3::new(angle.cos(), angle.sin(), 0.3 + 0.05 * angle),
                        DQuat::from_rotation_z(angle) * DQuat::from_rotation_x(2.0),
                    )
                })
                .collect();
            let x = DPose3::from_parts(DVec3::from_array(shift), DQuat::from_scaled_axis(DVec3::from_array(turn)));
            let given: Vec<DPose3> = truth.iter().map(|t| x * *t).collect();
            let errors = compare_poses(&given, &truth, 0.8);
            prop_assert!(errors.point_rms_m < 1e-9 && errors.rotation_rms_rad < 1e-7, "{errors:?}");
        }
    }
}
