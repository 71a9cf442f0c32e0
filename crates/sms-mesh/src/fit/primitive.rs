//! Boxes and cylinders fitted to a cloud within its noise.
//!
//! A frame is guessed from normals (RANSAC; Fischler and Bolles 1981, on oriented points as in Schnabel et al. 2007).
//! It is refined by iteratively reweighted least squares on the distances of points to their face.

use crate::fit::config::PrimitiveConfig;
use crate::fit::linear::{normal_equations, solve, tukey};
use crate::statistics::{median, quantile};
use glamx::{DMat3, DPose3, DQuat, DVec3};
use rand::RngExt;
use rayon::prelude::*;
use sms_core::{EntityShape, Mesh, PointCloud, Seed};

/// A box or a cylinder fitted to an oriented cloud.
#[derive(Debug, Clone, PartialEq)]
pub struct PrimitiveFit {
    /// [`EntityShape::Box`] or [`EntityShape::Cylinder`], in the cloud's frame.
    pub shape: EntityShape,
    /// Median distance of the points to its surface, metres.
    pub residual_median_m: f64,
    /// 90 % quantile of these distances, metres.
    pub residual_p90_m: f64,
    /// Share of the points within [`PrimitiveConfig::inlier_distance`] whose normals agree with the surface's.
    pub inlier_share: f64,
}

/// Number of random frames.
const TRIALS: usize = 160;
/// Number of points that score a trial.
const SAMPLE: usize = 1500;
/// Smallest cosine between the normal of a point and that of its face.
const ON_FACE: f64 = 0.9;
/// Rounds of refinement.
const ROUNDS: usize = 40;

/// Fits a box and a cylinder and returns the better one, even if the fit is poor; `None` if the cloud is too small or
/// degenerate. `upright` is tried as an axis besides random directions: objects tend to stand upright.
///
/// ```
/// use sms_core::{EntityShape, Mesh, PointCloud, Seed, glamx::DVec3};
/// // A can: side and ends.
/// let (r, h) = (0.033, 0.05);
/// let mut cloud = PointCloud::default();
/// for i in 0..900 {
///     let angle = 2.4 * f64::from(i);
///     let side = DVec3::new(angle.cos(), angle.sin(), 0.0);
///     let end = if i % 2 == 0 { DVec3::Z } else { DVec3::NEG_Z };
///     cloud.points_w.push(side * r + DVec3::Z * h * (f64::from(i) / 450.0 - 1.0));
///     cloud.points_w.push(side * r * (f64::from(i) / 900.0).sqrt() + end * h);
///     cloud.normals_w.extend([side, end]);
/// }
/// let fit = sms_mesh::fit_primitive(&cloud, Some(DVec3::Z), &Default::default(), Seed(1)).unwrap();
/// let EntityShape::Cylinder { radius, half_length, .. } = fit.shape else { panic!("a can is a cylinder") };
/// assert!((radius - r).abs() < 1e-6 && (half_length - h).abs() < 1e-6 && fit.inlier_share > 0.99);
/// ```
pub fn fit_primitive(
    cloud: &PointCloud,
    upright: Option<DVec3>,
    config: &PrimitiveConfig,
    seed: Seed,
) -> Option<PrimitiveFit> {
    let n = cloud.points_w.len();
    if n < 40 || cloud.normals_w.len() != n {
        return None;
    }
    let stride = n.div_ceil(SAMPLE).max(1);
    let some = PointCloud {
        points_w: cloud.points_w.iter().copied().step_by(stride).collect(),
        normals_w: cloud.normals_w.iter().copied().step_by(stride).collect(),
        ..PointCloud::default()
    };
    let seeds = (seed.derive("box"), seed.derive("cylinder"));
    [guess::<true>(&some, upright, config, seeds.0), guess::<false>(&some, upright, config, seeds.1)]
        .into_iter()
        .flatten()
        .map(|guess| {
            let solid = settled(cloud, refine(cloud, refine(&some, guess, config), config));
            describe(cloud, &solid, config)
        })
        .filter(|fit| fit.inlier_share.is_finite())
        .max_by(|a, b| {
            a.inlier_share.total_cmp(&b.inlier_share).then(b.residual_p90_m.total_cmp(&a.residual_p90_m))
        })
}

/// A box (`size` = half extents) or a cylinder along z (`size` = radius, radius, half length).
#[derive(Debug, Clone, Copy)]
struct FittedSolid {
    is_box: bool,
    x_ws: DPose3,
    size: DVec3,
}

/// Signed distance to the surface of a face (positive outside), its normal, and the index of the size that moves the
/// face.
struct NearestFace {
    distance: f64,
    normal: DVec3,
    size: usize,
}

impl FittedSolid {
    /// Returns the face of a point with normal `n` (both in `S`): the best agreement of normals, weighted by the
    /// distance of the point from the face.
    fn face(&self, p: DVec3, n: DVec3) -> NearestFace {
        let reach = 0.3 * self.size.min_element();
        let mut best = (f64::NEG_INFINITY, NearestFace { distance: 0.0, normal: DVec3::Z, size: 2 });
        let mut offer = |distance: f64, normal: DVec3, size: usize| {
            let score = normal.dot(n) - distance.abs() / reach;
            if score > best.0 {
                best = (score, NearestFace { distance, normal, size });
            }
        };
        let first = if self.is_box { 0 } else { 2 };
        if !self.is_box {
            let out = p.with_z(0.0).try_normalize().unwrap_or(DVec3::X);
            offer(p.dot(out) - self.size.x, out, 0);
        }
        for k in first..3 {
            for sign in [-1.0, 1.0] {
                let normal = DVec3::AXES[k] * sign;
                offer(p.dot(normal) - self.size[k], normal, k);
            }
        }
        best.1
    }

    fn shape(&self) -> EntityShape {
        let x_ws = self.x_ws;
        if self.is_box {
            EntityShape::Box { x_ws, half_extents: self.size }
        } else {
            EntityShape::Cylinder { x_ws, radius: self.size.x, half_length: self.size.z }
        }
    }

    /// Returns the points and normals of a cloud in `S`.
    fn local(&self, cloud: &PointCloud) -> impl Iterator<Item = (DVec3, DVec3)> {
        let x_sw = self.x_ws.inverse();
        let of = move |(&p, &n): (&DVec3, &DVec3)| (x_sw.transform_point(p), x_sw.rotation * n);
        cloud.points_w.iter().zip(&cloud.normals_w).map(of)
    }

    fn mean_cost(&self, cloud: &PointCloud, reach: f64) -> f64 {
        let costs = self.local(cloud).map(|(p, n)| {
            let face = self.face(p, n);
            let agrees = face.normal.dot(n) > 0.5;
            if agrees { (surface_distance(self, p) / reach).powi(2).min(1.0) } else { 1.0 }
        });
        costs.sum::<f64>() / cloud.points_w.len() as f64
    }
}

/// Returns the distance of `p` (in `S`) to the surface of the solid, metres.
fn surface_distance(solid: &FittedSolid, p: DVec3) -> f64 {
    let q = if solid.is_box {
        p.abs() - solid.size
    } else {
        DVec3::new(p.x.hypot(p.y) - solid.size.x, f64::NEG_INFINITY, p.z.abs() - solid.size.z)
    };
    (q.max(DVec3::ZERO).length() + q.max_element().min(0.0)).abs()
}

/// Returns the best of random frames, with sizes from the extent of the points.
fn guess<const BOX: bool>(
    cloud: &PointCloud,
    upright: Option<DVec3>,
    config: &PrimitiveConfig,
    seed: Seed,
) -> Option<FittedSolid> {
    let mut rng = seed.rng();
    let count = cloud.points_w.len();
    let mut frames = Vec::with_capacity(TRIALS);
    for trial in 0..TRIALS {
        let (a, b) =
            (cloud.normals_w[rng.random_range(0..count)], cloud.normals_w[rng.random_range(0..count)]);
        // The first axis of a box is the normal of a face. The axis of a cylinder is perpendicular to the normals of
        // its side, or parallel to those of its ends.
        let axis = match upright.filter(|_| trial % 2 == 0) {
            Some(axis) => axis,
            None if BOX || trial % 4 == 1 => a,
            None => a.cross(b),
        };
        let Some(z) = axis.try_normalize() else { continue };
        let across = (b - z * b.dot(z)).try_normalize();
        let x = match across {
            Some(x) if b.dot(z).abs() < 0.8 => x,
            _ if BOX => continue,
            _ => z.any_orthonormal_vector(),
        };
        frames.push(DQuat::from_mat3(&DMat3::from_cols(x, z.cross(x), z)).normalize());
    }
    // Scores come back in the order of the frames, independent of threads.
    let solids: Vec<Option<(f64, FittedSolid)>> = frames
        .par_iter()
        .map(|&rotation| {
            let solid = sized::<BOX>(cloud, rotation)?;
            Some((solid.mean_cost(cloud, 2.0 * config.inlier_distance), solid))
        })
        .collect();
    solids.into_iter().flatten().min_by(|a, b| a.0.total_cmp(&b.0)).map(|best| best.1)
}

/// Returns the solid of this orientation around the points.
fn sized<const BOX: bool>(cloud: &PointCloud, rotation: DQuat) -> Option<FittedSolid> {
    let inverse = rotation.inverse();
    let local: Vec<(DVec3, DVec3)> =
        cloud.points_w.iter().zip(&cloud.normals_w).map(|(&p, &n)| (inverse * p, inverse * n)).collect();
    let (mut center, mut size) = (DVec3::ZERO, DVec3::ZERO);
    for k in if BOX { 0..3 } else { 2..3 } {
        let (low, high) = (end(&local, k, -1.0), end(&local, k, 1.0));
        center[k] = 0.5 * (low + high);
        size[k] = 0.5 * (high - low);
    }
    if !BOX {
        let side: Vec<DVec3> =
            local.iter().filter(|(_, n)| n.z.abs() < 0.4).map(|(p, _)| p.with_z(0.0)).collect();
        let (middle, radius) = circle_through(&side)?;
        center += middle;
        size.x = radius;
        size.y = radius;
    }
    let usable = size.is_finite() && size.min_element() > 1e-4 && size.max_element() < 10.0;
    usable.then(|| FittedSolid { is_box: BOX, x_ws: DPose3::from_parts(rotation * center, rotation), size })
}

/// Returns the end of points with normals along an axis: at the face if it was seen, else at the edges of neighbouring
/// faces.
fn end(local: &[(DVec3, DVec3)], axis: usize, sign: f64) -> f64 {
    let on_face: Vec<f64> =
        local.iter().filter(|(_, n)| n[axis] * sign > ON_FACE).map(|(p, _)| p[axis]).collect();
    if on_face.len() * 50 > local.len() {
        return median(on_face);
    }
    // Extrapolates evenly seen sides: the end is as far beyond the last percent as the last percent is beyond the last
    // two.
    let all: Vec<f64> = local.iter().map(|(p, _)| p[axis] * sign).collect();
    sign * (2.0 * quantile(all.clone(), 0.99) - quantile(all, 0.98))
}

/// Recomputes unseen ends: the guessed frame was slightly rotated.
fn settled(cloud: &PointCloud, mut solid: FittedSolid) -> FittedSolid {
    let local: Vec<(DVec3, DVec3)> = solid.local(cloud).collect();
    let mut shift = DVec3::ZERO;
    for k in if solid.is_box { 0..3 } else { 2..3 } {
        let ends = [-1.0, 1.0].map(|sign| {
            let on_face = local.iter().filter(|(_, n)| n[k] * sign > ON_FACE).count();
            if on_face * 50 > local.len() { sign * solid.size[k] } else { end(&local, k, sign) }
        });
        if ends[1] > ends[0] {
            shift[k] = 0.5 * (ends[0] + ends[1]);
            solid.size[k] = 0.5 * (ends[1] - ends[0]);
        }
    }
    solid.x_ws *= DPose3::from_translation(shift);
    solid
}

/// Algebraic least-squares circle (Kåsa 1976) through points of the plane z = 0.
fn circle_through(points: &[DVec3]) -> Option<(DVec3, f64)> {
    if points.len() < 8 {
        return None;
    }
    let mean = points.iter().sum::<DVec3>() / points.len() as f64;
    let (mut m, mut b) = (DMat3::ZERO, DVec3::ZERO);
    for &p in points {
        let row = (p - mean).with_z(1.0);
        m += DMat3::from_cols(row * row.x, row * row.y, row * row.z);
        b += row * (p - mean).length_squared();
    }
    let solution = m.inverse() * b;
    let center = 0.5 * solution.with_z(0.0);
    let radius = (solution.z + center.length_squared()).sqrt();
    (radius.is_finite() && center.is_finite()).then(|| (mean + center, radius))
}

/// Refines rotation, translation and sizes by reweighted least squares.
fn refine(cloud: &PointCloud, mut solid: FittedSolid, config: &PrimitiveConfig) -> FittedSolid {
    let wide = 4.0 * config.inlier_distance;
    let mut scale = wide;
    for round in 0..ROUNDS {
        let mut rows = Vec::with_capacity(cloud.points_w.len());
        let mut residuals = Vec::with_capacity(cloud.points_w.len());
        for (p, n) in solid.local(cloud) {
            let face = solid.face(p, n);
            if face.normal.dot(n) < 0.5 {
                continue;
            }
            residuals.push(face.distance.abs());
            let weight = tukey(face.distance, scale);
            if weight == 0.0 {
                continue;
            }
            let turn = face.normal.cross(p);
            let mut row = [0.0; 9];
            for k in 0..3 {
                row[k] = turn[k];
                row[3 + k] = -face.normal[k];
            }
            row[6 + face.size] = -1.0;
            rows.push((row, face.distance, weight));
        }
        if residuals.len() < 30 {
            return solid;
        }
        if round >= 6 {
            scale = (4.685 * 1.4826 * median(residuals)).clamp(2e-4, wide);
        }
        let Some(step) = solve_damped(normal_equations(rows.into_iter())) else { return solid };
        let turn = DQuat::from_scaled_axis(DVec3::new(step[0], step[1], step[2]));
        let shift = DVec3::new(step[3], step[4], step[5]);
        solid.x_ws *= DPose3::from_parts(shift, turn);
        solid.x_ws.rotation = solid.x_ws.rotation.normalize();
        solid.size += DVec3::new(step[6], step[7], step[8]);
        if !solid.is_box {
            solid.size.y = solid.size.x;
        }
        solid.size = solid.size.max(DVec3::splat(1e-4));
        if round > 8 && step.iter().all(|s| s.abs() < 1e-9) {
            break;
        }
    }
    solid
}

/// Solves the damped normal equations: undetermined unknowns keep their value.
fn solve_damped((mut a, b): ([[f64; 9]; 9], [f64; 9])) -> Option<[f64; 9]> {
    // Rotations are in radians and sizes in metres, so each kind has its own damping.
    let largest = |of: std::ops::Range<usize>| of.map(|k| a[k][k]).fold(0.0, f64::max);
    let (turns, lengths) = (largest(0..3), largest(3..9));
    for (k, row) in a.iter_mut().enumerate() {
        row[k] += 1e-6 * if k < 3 { turns } else { lengths } + f64::MIN_POSITIVE;
    }
    solve(a, b, 0.0)
}

fn describe(cloud: &PointCloud, solid: &FittedSolid, config: &PrimitiveConfig) -> PrimitiveFit {
    let mut inliers = 0usize;
    let distance = |(p, n)| {
        let distance = surface_distance(solid, p);
        inliers += usize::from(distance <= config.inlier_distance && agrees(solid, p, n));
        distance
    };
    let residuals: Vec<f64> = solid.local(cloud).map(distance).collect();
    PrimitiveFit {
        shape: solid.shape(),
        residual_median_m: median(residuals.clone()),
        residual_p90_m: quantile(residuals, 0.9),
        inlier_share: inliers as f64 / cloud.points_w.len() as f64,
    }
}

/// Returns whether a normal agrees with the surface at a point. Near an edge, any normal does.
fn agrees(solid: &FittedSolid, p: DVec3, n: DVec3) -> bool {
    const ROUNDED_M: f64 = 0.004;
    let edge = if solid.is_box {
        (0..3).filter(|&k| p[k].abs() > solid.size[k] - ROUNDED_M).count() > 1
    } else {
        p.x.hypot(p.y) > solid.size.x - ROUNDED_M && p.z.abs() > solid.size.z - ROUNDED_M
    };
    edge || solid.face(p, n).normal.dot(n) > 0.7
}

/// Returns the surface of a primitive as a mesh that is fine enough for vertex colours: edges are at most `pitch` long,
/// unless this needs more than about 4000 triangles.
pub fn primitive_mesh(shape: &EntityShape, pitch: f64) -> Option<Mesh> {
    match shape {
        EntityShape::Box { x_ws, half_extents } => {
            let pitch = pitch.max((half_extents.length_squared() * 8.0 / 1500.0).sqrt());
            Some(grid_box(*half_extents, pitch).transformed(x_ws))
        }
        EntityShape::Cylinder { x_ws, radius, half_length } => {
            Some(grid_cylinder(*radius, *half_length, pitch).transformed(x_ws))
        }
        EntityShape::Sphere { .. } | EntityShape::Convex | EntityShape::TriMesh => None,
    }
}

/// A box with a grid on each face.
fn grid_box(half: DVec3, pitch: f64) -> Mesh {
    let steps = (2.0 * half / pitch).ceil().clamp(DVec3::ONE, DVec3::splat(40.0));
    let counts = steps.to_array().map(|n| n as u32);
    let mut index = std::collections::BTreeMap::new();
    let mut mesh = Mesh::default();
    for axis in 0..3 {
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        for side in [0, counts[axis]] {
            let mut at = |i: u32, j: u32| {
                let mut cell = [0u32; 3];
                (cell[axis], cell[u], cell[v]) = (side, i, j);
                *index.entry(cell).or_insert_with(|| {
                    let share = DVec3::from_array(cell.map(f64::from)) / steps;
                    mesh.vertices.push((2.0 * share - 1.0) * half);
                    (mesh.vertices.len() - 1) as u32
                })
            };
            for i in 0..counts[u] {
                for j in 0..counts[v] {
                    let quad = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                    let [a, b, c, d] = if side == 0 { [quad[0], quad[3], quad[2], quad[1]] } else { quad };
                    mesh.triangles.extend([[a, b, c], [a, c, d]]);
                }
            }
        }
    }
    mesh
}

/// A cylinder with rings along its side and on its ends, with the volume of the exact cylinder.
fn grid_cylinder(radius: f64, half_length: f64, pitch: f64) -> Mesh {
    let around = ((std::f64::consts::TAU * radius / pitch).ceil() as u32).clamp(32, 64);
    let along = ((2.0 * half_length / pitch).ceil() as u32).clamp(1, 24);
    let inward = ((radius / pitch).ceil() as u32).clamp(1, 8);
    // A polygon with the area of the circle, so that mass and appearance do not shrink.
    let angle = std::f64::consts::TAU / f64::from(around);
    let outer = radius * (angle / angle.sin()).sqrt();
    // Rings from the middle of the lower end to the middle of the upper end.
    let mut rings: Vec<(f64, f64)> = Vec::new();
    rings.extend((1..=inward).map(|k| (outer * f64::from(k) / f64::from(inward), -half_length)));
    rings.extend((1..along).map(|k| (outer, half_length * (2.0 * f64::from(k) / f64::from(along) - 1.0))));
    rings.extend((1..=inward).rev().map(|k| (outer * f64::from(k) / f64::from(inward), half_length)));
    let mut mesh = Mesh::default();
    mesh.vertices.push(DVec3::NEG_Z * half_length);
    for &(r, z) in &rings {
        for k in 0..around {
            let (sin, cos) = (angle * f64::from(k)).sin_cos();
            mesh.vertices.push(DVec3::new(r * cos, r * sin, z));
        }
    }
    mesh.vertices.push(DVec3::Z * half_length);
    let last = mesh.vertices.len() as u32 - 1;
    let at = |ring: u32, k: u32| 1 + ring * around + k % around;
    for k in 0..around {
        mesh.triangles.push([0, at(0, k + 1), at(0, k)]);
        for ring in 0..rings.len() as u32 - 1 {
            let (a, b) = (at(ring, k), at(ring, k + 1));
            let (c, d) = (at(ring + 1, k + 1), at(ring + 1, k));
            mesh.triangles.extend([[a, b, c], [a, c, d]]);
        }
        let top = rings.len() as u32 - 1;
        mesh.triangles.push([last, at(top, k), at(top, k + 1)]);
    }
    mesh
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn gauss(rng: &mut sms_core::StageRng) -> f64 {
        (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0
    }

    /// Even samples of a mesh with noise along the normals. Faces with a normal rejected by `keep` are hidden.
    fn samples(mesh: &Mesh, n: usize, noise: f64, keep: impl Fn(DVec3) -> bool, seed: u64) -> PointCloud {
        let mut rng = Seed(seed).rng();
        let areas: Vec<f64> = (0..mesh.triangles.len())
            .map(|t| {
                let [a, b, c] = mesh.corners(t);
                (b - a).cross(c - a).length()
            })
            .collect();
        let total: f64 = areas.iter().sum();
        let mut cloud = PointCloud::default();
        for (t, area) in areas.iter().enumerate() {
            let [a, b, c] = mesh.corners(t);
            let normal = (b - a).cross(c - a).normalize();
            let count = (n as f64 * area / total + rng.random::<f64>()) as usize;
            for _ in 0..count {
                let (r, s) = (rng.random::<f64>().sqrt(), rng.random::<f64>());
                let p = a * (1.0 - r) + b * (r * (1.0 - s)) + c * (r * s);
                if keep(normal) {
                    cloud.points_w.push(p + normal * (noise * gauss(&mut rng)));
                    let rough = DVec3::new(gauss(&mut rng), gauss(&mut rng), gauss(&mut rng));
                    cloud.normals_w.push((normal + 0.1 * rough).normalize());
                }
            }
        }
        cloud
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        /// The fit recovers the sizes of noisy boxes and cylinders in any pose, with one side unseen.
        #[test]
        fn noisy_solids_come_back(
            x in 0.02..0.1f64, y in 0.02..0.1f64, z in 0.02..0.1f64,
            turn in prop::array::uniform3(-3.0..3.0f64), is_box: bool, seed in 0u64..100,
        ) {
            let pose = DPose3::from_parts(
                DVec3::new(0.4, -0.2, 0.3),
                DQuat::from_scaled_axis(DVec3::from_array(turn)),
            );
            let half = DVec3::new(x, y, z);
            let shape = if is_box {
                EntityShape::Box { x_ws: pose, half_extents: half }
            } else {
                EntityShape::Cylinder { x_ws: pose, radius: x, half_length: z }
            };
            let mesh = primitive_mesh(&shape, 0.005).unwrap();
            let hidden = pose.rotation * DVec3::NEG_Z;
            let cloud = samples(&mesh, 3000, 0.0005, |n| n.dot(hidden) < 0.9, seed);
            let fit = fit_primitive(&cloud, None, &PrimitiveConfig::default(), Seed(seed)).unwrap();
            prop_assert!(fit.inlier_share > 0.95, "{fit:?}");
            let mut found = match fit.shape {
                EntityShape::Box { half_extents, .. } if is_box => half_extents.to_array(),
                EntityShape::Cylinder { radius, half_length, .. } if !is_box => [radius, radius, half_length],
                other => return Err(TestCaseError::fail(format!("{other:?}"))),
            };
            let mut wanted = if is_box { [x, y, z] } else { [x, x, z] };
            if is_box {
                found.sort_by(f64::total_cmp);
                wanted.sort_by(f64::total_cmp);
            }
            for (a, b) in found.iter().zip(wanted) {
                // The hidden end is known only from the ends of the sides.
                prop_assert!((a - b).abs() < 0.0015, "{found:?} {wanted:?}");
            }
        }

        #[test]
        fn meshes_of_primitives_are_closed_and_have_their_volume(
            x in 0.01..0.3f64, y in 0.01..0.3f64, z in 0.01..0.3f64,
        ) {
            let x_ws = DPose3::IDENTITY;
            let mesh = primitive_mesh(&EntityShape::Box { x_ws, half_extents: DVec3::new(x, y, z) }, 0.006).unwrap();
            prop_assert!(mesh.is_closed_oriented() && mesh.triangles.len() < 5000);
            prop_assert!((mesh.volume() / (8.0 * x * y * z) - 1.0).abs() < 1e-9);
            let can = EntityShape::Cylinder { x_ws, radius: x, half_length: z };
            let mesh = primitive_mesh(&can, 0.006).unwrap();
            prop_assert!(mesh.is_closed_oriented() && mesh.triangles.len() < 6000);
            prop_assert!((mesh.volume() / (2.0 * std::f64::consts::PI * x * x * z) - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn what_is_neither_box_nor_cylinder_is_explained_by_neither() {
        let mut egg = Mesh::icosphere(0.05, 4);
        egg.vertices.iter_mut().for_each(|v| v.z *= 1.5);
        let cloud = samples(&egg, 3000, 0.0003, |_| true, 1);
        let fit = fit_primitive(&cloud, Some(DVec3::Z), &PrimitiveConfig::default(), Seed(1)).unwrap();
        assert!(fit.inlier_share < 0.6, "{fit:?}");
        assert!(fit_primitive(&PointCloud::default(), None, &PrimitiveConfig::default(), Seed(1)).is_none());
        let line = PointCloud {
            points_w: (0..100).map(|i| DVec3::X * f64::from(i)).collect(),
            normals_w: vec![DVec3::Z; 100],
            colors: Vec::new(),
        };
        let fit = fit_primitive(&line, None, &PrimitiveConfig::default(), Seed(1));
        assert!(fit.is_none_or(|f| f.residual_p90_m.is_finite()));
    }
}
