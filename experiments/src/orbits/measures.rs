//! Errors of scale and of the distances between faces, which residuals between frames do not show.

use super::Orbit;
use glamx::{DPose3, DVec3};
use sms_core::Camera;
use sms_frames::{DepthNoise, normals_from_depth};
use sms_poses::align_rigidly;
use std::collections::BTreeMap;

/// Distance of the used points from the edges of a face, metres: depth beside edges is mixed.
const MARGIN_M: f64 = 0.02;
/// Largest distance of a true point from the face that it belongs to, metres.
const ON_FACE_M: f64 = 1e-4;

/// Errors of the extents of the box in the middle, metres.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct BoxErrors {
    /// Of the distance between the faces across x.
    pub width_m: f64,
    /// Of the distance between the faces across y.
    pub depth_m: f64,
}

/// Returns the scale of the camera centres relative to the true ones, by the similarity that fits best.
pub fn center_scale(poses: &[DPose3], truth: &[DPose3]) -> f64 {
    let centers = |poses: &[DPose3]| poses.iter().map(|x| x.translation).collect::<Vec<_>>();
    let (from, to) = (centers(truth), centers(poses));
    let mean = |points: &[DVec3]| points.iter().sum::<DVec3>() / points.len().max(1) as f64;
    let (from_mean, to_mean) = (mean(&from), mean(&to));
    let x = align_rigidly(&from, &to);
    let (mut along, mut square) = (0.0, 0.0);
    for (a, b) in from.iter().zip(&to) {
        let a = x.rotation * (*a - from_mean);
        along += a.dot(*b - to_mean);
        square += a.length_squared();
    }
    along / square.max(1e-12)
}

/// Fuses the measured points of each upright face of the box with these cameras and compares the distances between
/// opposite faces with the true extents. The points of a face are known by the truth, so that only poses and noise count.
pub fn box_errors(orbit: &Orbit, cameras: &[Camera]) -> BoxErrors {
    let extents = orbit.kind.extents_m();
    let half = 0.5 * extents;
    // Points of each face: across x, across y; low, high.
    let mut faces: [[Vec<DVec3>; 2]; 2] = Default::default();
    let (mut all, mut all_true) = (Vec::new(), Vec::new());
    for ((frame, camera), (true_depth, labels)) in
        orbit.sequence.frames.iter().zip(cameras).zip(orbit.true_depth.iter().zip(&orbit.labels))
    {
        for y in (0..true_depth.height).step_by(2) {
            for x in (0..true_depth.width).step_by(2) {
                let (measured, z) = (f64::from(frame.depth[(x, y)]), f64::from(true_depth[(x, y)]));
                if measured <= 0.0 || z <= 0.0 || (measured - z).abs() > 0.05 * z {
                    continue;
                }
                let true_w = frame.camera.unproject_pixel(x, y, z);
                let p_w = camera.unproject_pixel(x, y, measured);
                if (x + y) % 8 == 0 {
                    all.push(p_w);
                    all_true.push(true_w);
                }
                if labels[(x, y)] != 1 || true_w.z < MARGIN_M || true_w.z > extents.z - MARGIN_M {
                    continue;
                }
                for axis in 0..2 {
                    let is_on = (true_w[axis].abs() - half[axis]).abs() < ON_FACE_M;
                    if is_on && true_w[1 - axis].abs() < half[1 - axis] - MARGIN_M {
                        faces[axis][usize::from(true_w[axis] > 0.0)].push(p_w);
                    }
                }
            }
        }
    }
    let x_true_moved = align_rigidly(&all, &all_true);
    let middle = |points: &[DVec3], axis: usize| {
        let sum: f64 = points.iter().map(|p| x_true_moved.transform_point(*p)[axis]).sum();
        sum / points.len() as f64
    };
    let error = |axis: usize| middle(&faces[axis][1], axis) - middle(&faces[axis][0], axis) - extents[axis];
    BoxErrors { width_m: error(0), depth_m: error(1) }
}

/// Edge of the cells in which measurements are averaged, metres, and fewest measurements of a cell.
const CELL_M: f64 = 0.01;
const LEAST_IN_CELL: usize = 20;

/// Fuses the measurements of all frames with these cameras in small cells of the true surface, and returns the distance of their means
/// from it: root mean square over the cells, after the rigid motion that fits best.
pub(super) fn surface_error_m(orbit: &Orbit, cameras: &[Camera]) -> f64 {
    let mut points: Vec<(DVec3, DVec3, DVec3)> = Vec::new();
    for ((frame, camera), true_depth) in orbit.sequence.frames.iter().zip(cameras).zip(&orbit.true_depth) {
        let k = &frame.camera.intrinsics;
        let normals = normals_from_depth(true_depth, k, &DepthNoise { a_m: 1e-4, b_per_m: 1e-4 }, 2);
        for y in (0..true_depth.height).step_by(2) {
            for x in (0..true_depth.width).step_by(2) {
                let (measured, z) = (f64::from(frame.depth[(x, y)]), f64::from(true_depth[(x, y)]));
                let normal_c = DVec3::from_array(normals[(x, y)].map(f64::from));
                if measured > 0.0 && z > 0.0 && (measured - z).abs() < 0.05 * z && normal_c != DVec3::ZERO {
                    let true_w = frame.camera.unproject_pixel(x, y, z);
                    let normal_w = frame.camera.x_wc.rotation * normal_c;
                    points.push((camera.unproject_pixel(x, y, measured), true_w, normal_w));
                }
            }
        }
    }
    let some = || points.iter().step_by(8);
    let from: Vec<DVec3> = some().map(|p| p.0).collect();
    let to: Vec<DVec3> = some().map(|p| p.1).collect();
    let x = align_rigidly(&from, &to);
    let mut cells: BTreeMap<[i64; 3], (f64, usize)> = BTreeMap::new();
    for (p_w, true_w, normal_w) in &points {
        let cell = (*true_w / CELL_M).to_array().map(|v| v.floor() as i64);
        let (sum, count) = cells.entry(cell).or_default();
        *sum += normal_w.dot(x.transform_point(*p_w) - *true_w);
        *count += 1;
    }
    let means: Vec<f64> =
        cells.values().filter(|c| c.1 >= LEAST_IN_CELL).map(|(sum, count)| sum / *count as f64).collect();
    (means.iter().map(|m| m * m).sum::<f64>() / means.len().max(1) as f64).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::orbits::{OrbitKind, cameras_of, poses_of};
    use sms_core::Seed;

    #[test]
    fn true_poses_have_no_errors_but_noise_and_enlarged_ones_have_that_of_their_scale() {
        let orbit = Orbit::record(OrbitKind::Desk, Seed(1));
        let truth = cameras_of(&orbit.sequence);
        let poses = poses_of(&orbit.sequence);
        assert!((center_scale(&poses, &poses) - 1.0).abs() < 1e-12);
        let exact = box_errors(&orbit, &truth);
        assert!(exact.width_m.abs() < 5e-4 && exact.depth_m.abs() < 5e-4, "{exact:?}");
        // Every camera one millimetre further from the middle: both faces of a pair move outwards.
        let outwards = |camera: &Camera| {
            let x = camera.x_wc;
            let out = x.translation.with_z(0.0).normalize();
            Camera { x_wc: DPose3::from_parts(x.translation + 1e-3 * out, x.rotation), ..*camera }
        };
        let moved: Vec<Camera> = truth.iter().map(outwards).collect();
        let moved_poses: Vec<DPose3> = moved.iter().map(|camera| camera.x_wc).collect();
        assert!(center_scale(&moved_poses, &poses) > 1.0008);
        let found = box_errors(&orbit, &moved);
        let surfaces = [&truth, &moved].map(|cameras| surface_error_m(&orbit, cameras));
        assert!(surfaces[0] < 6e-4 && surfaces[1] > 1.2 * surfaces[0], "{surfaces:?}");
        let larger = [found.width_m - exact.width_m, found.depth_m - exact.depth_m];
        assert!(larger.iter().all(|e| (0.0012..0.0021).contains(e)), "{larger:?}");
    }
}
