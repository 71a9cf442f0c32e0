//! What objects rest on.

use crate::grid::{PointGrid, median, quantile};
use crate::views::Views;
use glamx::DVec3;
use rand::RngExt;
use sms_core::Seed;

/// Thinned surface points of the whole scene with normals and labels.
#[derive(Debug, Clone, Default)]
pub(crate) struct Surroundings {
    pub(crate) points: Vec<DVec3>,
    pub(crate) normals: Vec<DVec3>,
    pub(crate) labels: Vec<u16>,
}

/// A plane: points x with `normal · x = offset`; the normal points up, out of what carries.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Plane {
    pub(crate) normal: DVec3,
    pub(crate) offset: f64,
}

impl Plane {
    pub(crate) fn horizontal(height: f64) -> Self {
        Self { normal: DVec3::Z, offset: height }
    }

    pub(crate) fn height_over(&self, p: DVec3) -> f64 {
        self.normal.dot(p) - self.offset
    }

    pub(crate) fn project(&self, p: DVec3) -> DVec3 {
        p - self.normal * self.height_over(p)
    }
}

/// What carries an object.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Carrier {
    /// The dominant plane, a half space in the scene.
    Floor,
    /// Unlabelled surface.
    Environment,
    /// Another object.
    Object(u16),
    /// Nothing was seen below; a horizontal plane under the lowest point is assumed.
    Unseen,
}

/// The plane an object rests on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Rest {
    pub(crate) plane: Plane,
    pub(crate) carrier: Carrier,
}

/// Surface points of all frames about `spacing` apart, with the normals of the depth.
pub(crate) fn surroundings(views: &Views, spacing: f64) -> Surroundings {
    // Several measurements a cell, so that the kept mean is better than one pixel; both sides of a wall are apart.
    let mut cells: std::collections::BTreeMap<([i64; 3], u16, u8), (DVec3, DVec3, f64)> = Default::default();
    for (f, frame) in views.sequence.frames.iter().enumerate() {
        let map = &views.labels.maps[f];
        let stride = (map.width / 320).max(1);
        for y in (0..map.height).step_by(stride) {
            for x in (0..map.width).step_by(stride) {
                let depth = f64::from(frame.depth[(x, y)]);
                let n = frame.normal_c[(x, y)].map(f64::from);
                if depth <= 0.0 || n == [0.0; 3] {
                    continue;
                }
                let p = frame.camera.unproject_pixel(x, y, depth);
                let normal = frame.camera.x_wc.rotation * DVec3::from_array(n);
                let cell = (p / spacing).floor().to_array().map(|v| v as i64);
                let a = normal.abs();
                let axis = if a.z >= a.x && a.z >= a.y {
                    2
                } else if a.y >= a.x {
                    1
                } else {
                    0
                };
                let side = 2 * axis as u8 + u8::from(normal[axis] > 0.0);
                let entry = cells.entry((cell, map[(x, y)], side)).or_insert((DVec3::ZERO, DVec3::ZERO, 0.0));
                entry.0 += p;
                entry.1 += normal;
                entry.2 += 1.0;
            }
        }
    }
    let mut out = Surroundings::default();
    for ((_, label, _), (p, n, count)) in cells {
        // A cell hit once or twice is more often a flying pixel than a surface.
        if count >= 3.0 {
            out.points.push(p / count);
            out.normals.push(n.normalize_or(DVec3::Z));
            out.labels.push(label);
        }
    }
    out
}

/// Height of the dominant plane near the world's z = 0; `None` where no level unlabelled surface is seen there.
pub(crate) fn support_height(around: &Surroundings) -> Option<f64> {
    let level: Vec<f64> = (0..around.points.len())
        .filter(|&i| {
            around.labels[i] == sms_core::BACKGROUND
                && around.normals[i].z > 0.95
                && around.points[i].z.abs() < 0.03
        })
        .map(|i| around.points[i].z)
        .collect();
    let background = around.labels.iter().filter(|&&l| l == sms_core::BACKGROUND).count();
    if level.len() < 100 || level.len() * 20 < background {
        return None;
    }
    let mut center = median(level.clone());
    for band in [0.01, 0.006] {
        center = median(level.iter().copied().filter(|z| (z - center).abs() < band).collect());
    }
    Some(center)
}

/// The plane that carries the object with these surface points: the best level-ish plane through what was seen around
/// and below its lowest part.
pub(crate) fn find_rest(
    points: &[DVec3],
    label: u16,
    around: &Surroundings,
    support: Option<f64>,
    seed: Seed,
) -> Rest {
    let lowest = quantile(points.iter().map(|p| p.z).collect(), 0.02);
    let highest = quantile(points.iter().map(|p| p.z).collect(), 0.98);
    let height = (highest - lowest).max(0.01);
    let foot: Vec<DVec3> =
        points.iter().filter(|p| p.z < lowest + (0.3 * height).max(0.01)).map(|p| p.with_z(0.0)).collect();
    let center = foot.iter().sum::<DVec3>() / foot.len().max(1) as f64;
    let flat = PointGrid::new(&foot, 0.02);
    let candidates: Vec<usize> = (0..around.points.len())
        .filter(|&i| {
            let p = around.points[i];
            around.labels[i] != label
                && around.normals[i].z > 0.75
                && p.z > lowest - 0.04
                && p.z < lowest + (0.25 * height).clamp(0.008, 0.02)
                && flat.nearest(p.with_z(0.0)).is_some_and(|n| n.0 < 0.05)
        })
        .collect();
    let floor = |height: f64| Rest { plane: Plane::horizontal(height), carrier: Carrier::Floor };
    let Some((plane, members)) = fit_level_plane(&candidates, around, points, seed) else {
        return match support {
            Some(h) if lowest - h < 0.04 => floor(h),
            _ => Rest { plane: Plane::horizontal(lowest), carrier: Carrier::Unseen },
        };
    };
    if let Some(h) = support {
        let level = plane.normal.z > 4f64.to_radians().cos();
        if level && height_at(&plane, center).is_some_and(|here| (here - h).abs() < 0.005) {
            return floor(h);
        }
    }
    let mut votes: std::collections::BTreeMap<u16, usize> = Default::default();
    for &i in &members {
        *votes.entry(around.labels[i]).or_default() += 1;
    }
    let most = votes.iter().max_by_key(|v| (*v.1, std::cmp::Reverse(*v.0))).map_or(0, |v| *v.0);
    let carrier = if most == sms_core::BACKGROUND { Carrier::Environment } else { Carrier::Object(most) };
    Rest { plane, carrier }
}

/// Height of the plane over the horizontal position of `p`; `None` for a vertical plane.
pub(crate) fn height_at(plane: &Plane, p: DVec3) -> Option<f64> {
    (plane.normal.z.abs() > 1e-6)
        .then(|| (plane.offset - plane.normal.x * p.x - plane.normal.y * p.y) / plane.normal.z)
}

/// RANSAC for a plane within 40° of level that few of the object's points lie below.
fn fit_level_plane(
    candidates: &[usize],
    around: &Surroundings,
    object: &[DVec3],
    seed: Seed,
) -> Option<(Plane, Vec<usize>)> {
    if candidates.len() < 12 {
        return None;
    }
    let mut rng = seed.derive("rest").rng();
    let at = |i: usize| around.points[i];
    let stride = object.len().div_ceil(500).max(1);
    let mut best: Option<(f64, Plane)> = None;
    for _ in 0..300 {
        let [a, b, c]: [usize; 3] =
            std::array::from_fn(|_| candidates[rng.random_range(0..candidates.len())]);
        let normal = (at(b) - at(a)).cross(at(c) - at(a)).normalize_or_zero();
        let normal = if normal.z < 0.0 { -normal } else { normal };
        if normal.z < 0.766 {
            continue;
        }
        let plane = Plane { normal, offset: normal.dot(at(a)) };
        let near = candidates.iter().filter(|&&i| plane.height_over(at(i)).abs() < 0.003).count() as f64;
        let below = object.iter().step_by(stride).filter(|&&p| plane.height_over(p) < -0.004).count() as f64
            / object.len().div_ceil(stride) as f64;
        let score = near * (1.0 - 5.0 * below).max(0.0);
        if best.is_none_or(|b| score > b.0) {
            best = Some((score, plane));
        }
    }
    let (_, mut plane) = best.filter(|b| b.0 >= 10.0)?;
    let mut members = Vec::new();
    for reach in [0.004, 0.003] {
        members = candidates.iter().copied().filter(|&i| plane.height_over(at(i)).abs() < reach).collect();
        let points: Vec<DVec3> = members.iter().map(|&i| at(i)).collect();
        plane = least_squares_plane(&points).unwrap_or(plane);
    }
    Some((plane, members))
}

/// Total least squares, normal up.
pub(crate) fn least_squares_plane(points: &[DVec3]) -> Option<Plane> {
    if points.len() < 3 {
        return None;
    }
    let mean = points.iter().sum::<DVec3>() / points.len() as f64;
    let mut scatter = glamx::DMat3::ZERO;
    for p in points {
        let d = *p - mean;
        scatter += glamx::DMat3::from_cols(d * d.x, d * d.y, d * d.z);
    }
    let eigen = glamx::DSymmetricEigen3::new(scatter);
    let values = eigen.eigenvalues.to_array();
    let vectors = [eigen.eigenvectors.x_axis, eigen.eigenvectors.y_axis, eigen.eigenvectors.z_axis];
    let k = (0..3).min_by(|&a, &b| values[a].total_cmp(&values[b]))?;
    let normal = if vectors[k].z < 0.0 { -vectors[k] } else { vectors[k] };
    normal.is_finite().then(|| Plane { normal, offset: normal.dot(mean) })
}
