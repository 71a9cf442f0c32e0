//! Rigid alignment of points.

use crate::linear::{Block, Six};
use glamx::{DPose3, DQuat, DVec3};
use sms_core::Cholesky;

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
                add_row(&mut h, &mut g, &lever(d, DVec3::AXES[axis]), r[axis], 1.0);
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

/// Returns the derivative of `a · p` with respect to a rotation about a point and a shift; `arm` leads from the point to p.
pub(crate) fn lever(arm: DVec3, a: DVec3) -> Six {
    let turn = arm.cross(a);
    [turn.x, turn.y, turn.z, a.x, a.y, a.z]
}

/// Adds a weighted linear residual to the normal equations.
pub(crate) fn add_row(h: &mut Block, g: &mut Six, jacobian: &Six, residual: f64, weight: f64) {
    for i in 0..6 {
        let wj = weight * jacobian[i];
        g[i] += wj * residual;
        for j in 0..6 {
            h[i][j] += wj * jacobian[j];
        }
    }
}

/// Returns the motion that turns by `step[0..3]` about `center` and shifts by `step[3..6]`.
pub(crate) fn moved_about(center: DVec3, step: &Six) -> DPose3 {
    let rotation = DQuat::from_scaled_axis(DVec3::new(step[0], step[1], step[2]));
    let shift = DVec3::new(step[3], step[4], step[5]);
    DPose3::from_parts(center + shift - rotation * center, rotation)
}
