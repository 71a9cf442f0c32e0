//! Rigid alignment of a result to the truth, for recordings with disturbed poses.

use glamx::{DPose3, DQuat, DVec3};
use rayon::prelude::*;
use sms_eval::TrueSurface;

/// Improves `x_tw` by moving points (in `W`, each with the index of its surface) onto true surfaces: iterated
/// point-to-plane steps on the nearest 90 % of at most 20 000 points.
pub(crate) fn refine_on_surfaces(
    points_w: &[(DVec3, usize)],
    surfaces: &[TrueSurface],
    x_tw: DPose3,
) -> DPose3 {
    const MOST: usize = 20_000;
    const ROUNDS: usize = 40;
    const TRIM: f64 = 0.9;
    let stride = points_w.len().div_ceil(MOST).max(1);
    let chosen: Vec<(DVec3, usize)> = points_w.iter().copied().step_by(stride).collect();
    if chosen.len() < 6 {
        return x_tw;
    }
    let mut pose = x_tw;
    for _ in 0..ROUNDS {
        let mut pairs: Vec<(DVec3, DVec3, f64)> = chosen
            .par_iter()
            .map(|&(p_w, surface)| {
                let p = pose.transform_point(p_w);
                let (closest, normal) = surfaces[surface].closest(p);
                // Away from edges the offset is along the normal. At an edge, the direction of the offset gives a
                // better plane.
                let off = p - closest;
                let along = off.dot(normal);
                let normal = if along.abs() > 0.9 * off.length() { normal } else { off.normalize_or(normal) };
                (p, normal, off.dot(normal))
            })
            .collect();
        pairs.sort_by(|a, b| a.2.abs().total_cmp(&b.2.abs()));
        pairs.truncate((pairs.len() as f64 * TRIM) as usize);
        let center = pairs.iter().map(|p| p.0).sum::<DVec3>() / pairs.len() as f64;
        let (mut a, mut b) = ([[0.0; 6]; 6], [0.0; 6]);
        for (p, n, residual) in &pairs {
            let turn = (*p - center).cross(*n);
            let row = [turn.x, turn.y, turn.z, n.x, n.y, n.z];
            for i in 0..6 {
                b[i] -= row[i] * residual;
                (0..6).for_each(|j| a[i][j] += row[i] * row[j]);
            }
        }
        // Directions that no point constrains stay unchanged.
        let trace: f64 = (0..6).map(|i| a[i][i]).sum();
        (0..6).for_each(|i| a[i][i] += 1e-9 * trace);
        let Some(x) = solve(a, b) else { break };
        let turn = DQuat::from_scaled_axis(DVec3::new(x[0], x[1], x[2]));
        let shift = DVec3::new(x[3], x[4], x[5]);
        let step = DPose3::from_parts(center + shift - turn * center, turn);
        pose = step * pose;
        pose.rotation = pose.rotation.normalize();
        if x.iter().all(|v| v.abs() < 1e-9) {
            break;
        }
    }
    pose
}

/// Solves a symmetric positive definite system; `None` if it is not positive definite.
fn solve(mut a: [[f64; 6]; 6], mut b: [f64; 6]) -> Option<[f64; 6]> {
    for k in 0..6 {
        if a[k][k] <= 0.0 || !a[k][k].is_finite() {
            return None;
        }
        for i in k + 1..6 {
            let factor = a[i][k] / a[k][k];
            (k..6).for_each(|j| a[i][j] -= factor * a[k][j]);
            b[i] -= factor * b[k];
        }
    }
    for k in (0..6).rev() {
        b[k] = (b[k] - (k + 1..6).map(|j| a[k][j] * b[j]).sum::<f64>()) / a[k][k];
    }
    b.iter().all(|v| v.is_finite()).then_some(b)
}

/// Angle (radians) and shift (metres, at the origin) between two poses.
pub(crate) fn pose_difference(a: &DPose3, b: &DPose3) -> (f64, f64) {
    let d = a.inverse() * *b;
    (d.rotation.to_scaled_axis().length(), d.translation.length())
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::{Mesh, Seed};
    use sms_eval::sample_true_surface;

    #[test]
    fn surfaces_pull_a_result_into_place_in_spite_of_outliers() {
        let cuboid = |x: f64, half: DVec3| {
            let mesh = Mesh::cuboid(half).transformed(&DPose3::from_translation(DVec3::new(x, 0.05, 0.0)));
            TrueSurface::new("box", mesh, None).unwrap()
        };
        let surfaces = [cuboid(0.0, DVec3::new(0.05, 0.03, 0.02)), cuboid(0.3, DVec3::splat(0.03))];
        let x_wt = DPose3::from_parts(
            DVec3::new(0.004, -0.003, 0.002),
            DQuat::from_scaled_axis(DVec3::new(0.01, 0.006, -0.012)),
        );
        let mut points: Vec<(DVec3, usize)> = Vec::new();
        for (i, surface) in surfaces.iter().enumerate() {
            let samples = sample_true_surface(surface, 0.002, Seed(i as u64));
            points.extend(samples.iter().map(|s| (x_wt.transform_point(s.point), i)));
        }
        let outliers: Vec<(DVec3, usize)> =
            points.iter().step_by(20).map(|p| (p.0 + DVec3::new(0.0, 0.0, 0.05), p.1)).collect();
        points.extend(outliers);
        let found = refine_on_surfaces(&points, &surfaces, DPose3::identity());
        let (turn, shift) = pose_difference(&found, &x_wt.inverse());
        assert!(turn < 1e-6 && shift < 1e-6, "{turn} {shift}");
    }
}
