//! Planes in the fused points of several frames, by RANSAC.

use crate::{DepthNoise, Frame};
use glamx::DVec3;
use rand::RngExt;
use sms_core::Seed;
use std::collections::BTreeMap;

/// Number of frames to fuse.
const FRAMES: usize = 16;
/// Number of planes to search.
const PLANES: usize = 10;
/// Random triples tried for each plane.
const TRIALS: usize = 4000;
/// Minimum cosine between an inlier's normal and the plane's.
const NORMAL_COS: f64 = 0.92;

/// Fused surface: one point and normal per occupied cell, so that the number of cells measures area, independent
/// of the number and distance of the views.
pub(crate) struct FusedCells {
    /// Mean position in each cell, relative to the origin given.
    pub(crate) points: Vec<DVec3>,
    /// Mean normal in each cell, towards the cameras.
    pub(crate) normals: Vec<DVec3>,
    /// Median depth of the points, metres.
    pub(crate) depth: f64,
}

/// A plane with its support.
#[derive(Debug, Clone)]
pub(crate) struct SupportCandidate {
    /// Unit normal towards the cameras.
    pub(crate) normal: DVec3,
    /// Median position of the inliers, on the plane.
    pub(crate) center: DVec3,
    /// Cells on the plane.
    pub(crate) support: usize,
    /// Distance up to which a cell counts as on the plane, metres.
    pub(crate) tolerance: f64,
}

impl SupportCandidate {
    /// Returns the signed distance, positive towards the cameras.
    pub(crate) fn height(&self, p: DVec3) -> f64 {
        (p - self.center).dot(self.normal)
    }
}

impl FusedCells {
    /// Fuses evenly spread frames; positions are relative to `origin_r`.
    pub(crate) fn gather(views: &[Frame], origin_r: DVec3) -> Self {
        let step = views.len().div_ceil(FRAMES).max(1);
        let used: Vec<&Frame> = views.iter().step_by(step).collect();
        let mut depths: Vec<f32> =
            used.iter().flat_map(|v| v.depth.data.iter().step_by(7).copied()).filter(|&z| z > 0.0).collect();
        depths.sort_by(f32::total_cmp);
        let depth = depths.get(depths.len() / 2).map_or(1.0, |&z| f64::from(z));
        let size = (0.012 * depth).max(0.002);
        let mut cells: BTreeMap<[i32; 3], (DVec3, DVec3, f64)> = BTreeMap::new();
        for view in used {
            // About 20,000 points per frame are enough.
            let stride = ((view.depth.data.len() as f64 / 20_000.0).sqrt().floor() as usize).max(1);
            for y in (0..view.depth.height).step_by(stride) {
                for x in (0..view.depth.width).step_by(stride) {
                    let (z, n) = (view.depth[(x, y)], view.normal_c[(x, y)]);
                    if z <= 0.0 || n == [0.0; 3] {
                        continue;
                    }
                    let p = view.camera.unproject_pixel(x, y, f64::from(z)) - origin_r;
                    let n = view.camera.x_wc.rotation * DVec3::new(n[0].into(), n[1].into(), n[2].into());
                    let key = (p / size).floor().to_array().map(|v| v as i32);
                    let cell = cells.entry(key).or_insert((DVec3::ZERO, DVec3::ZERO, 0.0));
                    cell.0 += p;
                    cell.1 += n;
                    cell.2 += 1.0;
                }
            }
        }
        let mut out = Self { points: Vec::new(), normals: Vec::new(), depth };
        for (p, n, count) in cells.into_values() {
            // Cells with contradicting directions are edges.
            if n.length() > 0.7 * count {
                out.points.push(p / count);
                out.normals.push(n.normalize());
            }
        }
        out
    }
}

/// Finds the largest planes one after the other; each leaves out the cells of the earlier ones.
pub(crate) fn find_planes(cells: &FusedCells, noise: &DepthNoise, seed: Seed) -> Vec<SupportCandidate> {
    let tolerance = noise.tolerance_m(cells.depth, 0.01);
    let mut rng = seed.rng();
    let mut left: Vec<usize> = (0..cells.points.len()).collect();
    let least = (cells.points.len() / 100).max(20);
    let mut planes = Vec::new();
    while planes.len() < PLANES && left.len() >= least {
        let mut best: Option<(usize, DVec3, DVec3)> = None;
        for _ in 0..TRIALS {
            let pick = [(); 3].map(|()| left[rng.random_range(0..left.len())]);
            let [a, b, c] = pick.map(|i| cells.points[i]);
            let Some(mut normal) = (b - a).cross(c - a).try_normalize() else { continue };
            if normal.dot(cells.normals[pick[0]]) < 0.0 {
                normal = -normal;
            }
            if pick.iter().any(|&i| normal.dot(cells.normals[i]) < NORMAL_COS) {
                continue;
            }
            let count = left.iter().filter(|&&i| is_on(cells, i, normal, a, tolerance)).count();
            if best.is_none_or(|(most, ..)| count > most) {
                best = Some((count, normal, a));
            }
        }
        let Some((_, mut normal, mut center)) = best else { break };
        for _ in 0..4 {
            let on: Vec<usize> =
                left.iter().copied().filter(|&i| is_on(cells, i, normal, center, tolerance)).collect();
            let Some((n, c)) = fit(cells, &on, normal) else { break };
            (normal, center) = (n, c);
        }
        let (on, off): (Vec<usize>, Vec<usize>) =
            left.iter().partition(|&&i| is_on(cells, i, normal, center, tolerance));
        if on.len() < least {
            break;
        }
        let plane = SupportCandidate { normal, center, support: on.len(), tolerance };
        planes.push(SupportCandidate { center: median_foot(cells, &on, &plane), ..plane });
        left = off;
    }
    planes
}

fn is_on(cells: &FusedCells, i: usize, normal: DVec3, point: DVec3, tolerance: f64) -> bool {
    (cells.points[i] - point).dot(normal).abs() < tolerance && cells.normals[i].dot(normal) > NORMAL_COS
}

/// Fits a plane by least squares along the present normal: the noise is in the heights.
fn fit(cells: &FusedCells, on: &[usize], normal: DVec3) -> Option<(DVec3, DVec3)> {
    if on.len() < 3 {
        return None;
    }
    let n = on.len() as f64;
    let mean = on.iter().fold(DVec3::ZERO, |s, &i| s + cells.points[i]) / n;
    let (ex, ey) = normal.any_orthonormal_pair();
    let (mut xx, mut xy, mut yy, mut xh, mut yh) = (0.0, 0.0, 0.0, 0.0, 0.0);
    for &i in on {
        let d = cells.points[i] - mean;
        let (x, y, h) = (d.dot(ex), d.dot(ey), d.dot(normal));
        xx += x * x;
        xy += x * y;
        yy += y * y;
        xh += x * h;
        yh += y * h;
    }
    let det = xx * yy - xy * xy;
    if det <= 1e-9 * (xx + yy).powi(2) {
        return None;
    }
    let (gx, gy) = ((yy * xh - xy * yh) / det, (xx * yh - xy * xh) / det);
    Some(((normal - ex * gx - ey * gy).normalize(), mean))
}

/// Projects the median of the inliers onto the plane.
fn median_foot(cells: &FusedCells, on: &[usize], plane: &SupportCandidate) -> DVec3 {
    let (ex, ey) = plane.normal.any_orthonormal_pair();
    let median = |axis: DVec3| {
        let mut v: Vec<f64> = on.iter().map(|&i| (cells.points[i] - plane.center).dot(axis)).collect();
        v.sort_by(f64::total_cmp);
        v[v.len() / 2]
    };
    plane.center + ex * median(ex) + ey * median(ey)
}
