//! Rigid alignment of points.

use crate::linear::{Block, Six};
use glamx::{DPose3, DQuat, DVec3};
use sms_core::{Cholesky, symmetric_eigen};

/// Returns the least-squares rigid motion that maps `from` to `to`.
pub fn align_rigidly(from: &[DVec3], to: &[DVec3]) -> DPose3 {
    let n = from.len().min(to.len());
    if n == 0 {
        return DPose3::identity();
    }
    // The closed form has the rounding errors of squares; steps of Gauss-Newton remove them.
    let mut x = absolute_orientation(from, to);
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

/// Returns the rigid motion that moves points closest to their partners in the least-squares sense (Horn 1987, "Closed-form
/// solution of absolute orientation using unit quaternions"), up to rounding.
fn absolute_orientation(from: &[DVec3], to: &[DVec3]) -> DPose3 {
    let n = from.len().min(to.len());
    let mean = |p: &[DVec3]| p[..n].iter().sum::<DVec3>() / n as f64;
    let (a0, b0) = (mean(to), mean(from));
    let mut s = [[0.0; 3]; 3];
    for (a, b) in to.iter().zip(from) {
        let (a, b) = ((*a - a0).to_array(), (*b - b0).to_array());
        (0..3).for_each(|i| (0..3).for_each(|j| s[i][j] += b[i] * a[j]));
    }
    let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = s;
    let matrix = [
        [xx + yy + zz, yz - zy, zx - xz, xy - yx],
        [yz - zy, xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, yy - xx - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, zz - xx - yy],
    ];
    let (values, vectors) = symmetric_eigen(matrix, 30, 0.0);
    // Of equal ones the first, which turns least: a single point determines no rotation.
    let best = (0..4).rev().max_by(|&a, &b| values[a].total_cmp(&values[b])).unwrap_or(0);
    let q = vectors.map(|row| row[best]);
    let rotation = DQuat::from_xyzw(q[1], q[2], q[3], q[0]).normalize();
    DPose3::from_parts(a0 - rotation * b0, rotation)
}

/// Returns the rigid motion that moves the cameras `from` closest to `to`, from their centres and from points 1 m along their axes,
/// which add the rotations.
pub fn align_cameras(from: &[DPose3], to: &[DPose3]) -> DPose3 {
    let corners = |poses: &[DPose3]| -> Vec<DVec3> {
        let of = |x: &DPose3| {
            let x = *x;
            std::iter::once(x.translation).chain(DVec3::AXES.map(|axis| x.transform_point(axis)))
        };
        poses.iter().flat_map(of).collect()
    };
    align_rigidly(&corners(from), &corners(to))
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

#[cfg(test)]
mod tests {
    use super::*;

    fn motion() -> DPose3 {
        DPose3::from_parts(DVec3::new(0.3, -0.2, 0.1), DQuat::from_scaled_axis(DVec3::new(0.4, -2.0, 1.0)))
    }

    fn difference(a: &DPose3, b: &DPose3) -> (f64, f64) {
        let d = a.inverse() * *b;
        (d.rotation.to_scaled_axis().length(), d.translation.length())
    }

    #[test]
    fn partners_give_the_motion_exactly() {
        let from: Vec<DVec3> =
            (0..20).map(|i| DVec3::new((i as f64).sin(), (2.0 * i as f64).cos(), 0.1 * i as f64)).collect();
        let to: Vec<DVec3> = from.iter().map(|&p| motion().transform_point(p)).collect();
        let (turn, shift) = difference(&align_rigidly(&from, &to), &motion());
        assert!(turn < 1e-12 && shift < 1e-12, "{turn} {shift}");
        // Centres on a line do not determine the rotation about it; the axes of the cameras do.
        let from: Vec<DPose3> = (0..5)
            .map(|i| DPose3::from_parts(DVec3::X * i as f64, DQuat::from_rotation_x(0.2 * i as f64)))
            .collect();
        let to: Vec<DPose3> = from.iter().map(|x| motion() * *x).collect();
        let (turn, shift) = difference(&align_cameras(&from, &to), &motion());
        assert!(turn < 1e-12 && shift < 1e-12, "{turn} {shift}");
        // Neither do those of a camera that moves straight ahead, or not at all.
        for step_m in [0.1, 0.0] {
            let from: Vec<DPose3> =
                (0..5).map(|i| DPose3::from_translation(step_m * i as f64 * DVec3::Z)).collect();
            let to: Vec<DPose3> = from.iter().map(|x| motion() * *x).collect();
            let (turn, shift) = difference(&align_cameras(&from, &to), &motion());
            assert!(turn < 1e-12 && shift < 1e-12, "{turn} {shift}");
        }
        let shifted = align_rigidly(&[DVec3::X], &[DVec3::Y]);
        assert_eq!(shifted.transform_point(DVec3::X), DVec3::Y);
        assert!(shifted.rotation.angle_between(DQuat::IDENTITY) < 1e-12, "{shifted:?}");
    }
}
