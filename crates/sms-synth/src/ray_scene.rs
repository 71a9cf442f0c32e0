//! A scene prepared for ray tracing: nearest hits and lamp visibility.

use crate::bvh::{Bvh, Ray};
use crate::scene::TruthScene;
use crate::shading::{LAMPS, Lamp, lamps};
use glamx::{DPose3, Mat3, Vec3};
use std::collections::BTreeMap;

/// Geometry of a scene and its lamps.
#[derive(Debug)]
pub(crate) struct RayScene {
    half_floor: f32,
    bvh: Bvh,
    pub(crate) facets: Vec<Facet>,
    pub(crate) bodies: Vec<TracedBody>,
    pub(crate) lamps: [Lamp; LAMPS],
}

/// A triangle with the data for shading.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Facet {
    pub(crate) object: usize,
    /// Index in the object's mesh.
    pub(crate) triangle: usize,
    pub(crate) corners: [Vec3; 3],
    pub(crate) normals: [Vec3; 3],
}

#[derive(Debug)]
pub(crate) struct TracedBody {
    /// Centre in the world and radius of an exact sphere.
    pub(crate) sphere: Option<(Vec3, f32)>,
    /// Bounding sphere.
    pub(crate) center: Vec3,
    pub(crate) radius: f32,
    /// World to asset frame.
    pub(crate) rotation_aw: Mat3,
    pub(crate) translation_aw: Vec3,
}

/// The nearest surface along a ray.
pub(crate) struct RayHit {
    pub(crate) t: f32,
    /// Facet and weights of its corners; `None` for the floor and spheres.
    pub(crate) facet: Option<(usize, [f32; 3])>,
    /// `None` for the floor.
    pub(crate) object: Option<usize>,
    pub(crate) point: Vec3,
    pub(crate) normal: Vec3,
    /// Normal of the facet itself.
    pub(crate) flat_normal: Vec3,
    /// Origin of shadow rays that hides facets at the shadow's edge (Hanika 2021).
    pub(crate) shadow_origin: Vec3,
}

impl RayHit {
    /// A hit of the floor or of a sphere, which have no facets.
    fn smooth(t: f32, object: Option<usize>, point: Vec3, normal: Vec3) -> Self {
        let shadow_origin = point + normal * 1e-4;
        Self { t, facet: None, object, point, normal, flat_normal: normal, shadow_origin }
    }
}

/// Facets that meet at less than this angle (38°) are shaded as one smooth surface.
const CREASE_COS: f64 = 0.79;

impl RayScene {
    pub(crate) fn new(scene: &TruthScene) -> Self {
        let mut facets = Vec::new();
        for (index, object) in scene.objects.iter().enumerate() {
            if object.sphere_radius.is_none() {
                let mesh = object.mesh_w();
                let normals = smooth_normals(&mesh);
                facets.extend((0..mesh.triangles.len()).map(|t| Facet {
                    object: index,
                    triangle: t,
                    corners: mesh.corners(t).map(|p| p.as_vec3()),
                    normals: normals[t],
                }));
            }
        }
        let corners: Vec<[Vec3; 3]> = facets.iter().map(|f| f.corners).collect();
        let bodies = scene
            .objects
            .iter()
            .map(|object| {
                let bounds = object.aabb_w();
                let x_aw: DPose3 = object.x_ab * object.x_wb.inverse();
                let around = object.sphere_radius.unwrap_or(0.5 * bounds.extents().length());
                TracedBody {
                    sphere: object.sphere_radius.map(|r| (object.x_wb.translation.as_vec3(), r as f32)),
                    center: bounds.center().as_vec3(),
                    radius: around as f32,
                    rotation_aw: Mat3::from_quat(x_aw.rotation.as_quat()),
                    translation_aw: x_aw.translation.as_vec3(),
                }
            })
            .collect();
        let half_floor = scene.floor.half_size_m as f32;
        Self { half_floor, bvh: Bvh::build(&corners), facets, bodies, lamps: lamps() }
    }

    /// Returns the first surface along a ray, at least 1 mm away; distances are in units of `direction`.
    pub(crate) fn nearest(&self, origin: Vec3, direction: Vec3) -> Option<RayHit> {
        const START: f32 = 1e-3;
        let mut limit = f32::INFINITY;
        let mut hit = None;
        if direction.z < 0.0 && origin.z > 0.0 {
            let t = -origin.z / direction.z;
            let point = origin + direction * t;
            if point.x.abs() <= self.half_floor && point.y.abs() <= self.half_floor {
                limit = t;
                hit = Some(RayHit::smooth(t, None, point.with_z(0.0), Vec3::Z));
            }
        }
        for (index, body) in self.bodies.iter().enumerate() {
            let Some((center, radius)) = body.sphere else { continue };
            if let Some(t) = sphere_distance(origin, direction, center, radius, START).filter(|&t| t < limit)
            {
                limit = t;
                let normal = (origin + direction * t - center).normalize();
                hit = Some(RayHit::smooth(t, Some(index), center + normal * radius, normal));
            }
        }
        let ray = Ray::new(origin, direction, START);
        if let Some(found) = self.bvh.nearest(&ray, limit) {
            let facet = &self.facets[found.triangle as usize];
            let weights = [1.0 - found.u - found.v, found.u, found.v];
            let blend = |v: [Vec3; 3]| v[0] * weights[0] + v[1] * weights[1] + v[2] * weights[2];
            let point = blend(facet.corners);
            let normal = blend(facet.normals).normalize_or_zero();
            let [a, b, c] = facet.corners;
            let flat_normal = (b - a).cross(c - a).normalize_or_zero();
            // The point lifted towards the smooth surface that the corner normals describe.
            let lifted: [Vec3; 3] = std::array::from_fn(|i| {
                let above = (point - facet.corners[i]).dot(facet.normals[i]).min(0.0);
                point - facet.normals[i] * above
            });
            let shadow_origin = blend(lifted) + flat_normal * 1e-4;
            let object = Some(facet.object);
            let facet = Some((found.triangle as usize, weights));
            hit = Some(RayHit { t: found.t, facet, object, point, normal, flat_normal, shadow_origin });
        }
        hit
    }

    /// Returns whether a body's bounding sphere intersects the cone from `origin` around the unit `direction` with this tangent
    /// of its half-angle.
    fn in_cone(body: &TracedBody, origin: Vec3, direction: Vec3, tangent: f32) -> bool {
        let along = (body.center - origin).dot(direction);
        let beside = (body.center - origin - direction * along).length();
        along > -body.radius && beside < body.radius + tangent * along.max(0.0)
    }

    /// Returns whether rays of such a cone may hit any body but `own`.
    pub(crate) fn may_hit(&self, origin: Vec3, direction: Vec3, tangent: f32, own: Option<usize>) -> bool {
        self.bodies
            .iter()
            .enumerate()
            .any(|(i, b)| Some(i) != own && Self::in_cone(b, origin, direction, tangent))
    }

    /// Returns the visible share of a lamp; `to_lamp` is the unit direction to its centre. Rays are traced only past bodies near
    /// the line of sight, and more than four only if the first four disagree.
    pub(crate) fn lamp_visibility(&self, origin: Vec3, lamp: &Lamp, to_lamp: Vec3, jitter: f32) -> f32 {
        const RING: usize = 4;
        const SAMPLES: usize = 16;
        let reach = (lamp.center - origin).length();
        let (mut spheres, mut meshes) = (false, false);
        for body in &self.bodies {
            if Self::in_cone(body, origin, to_lamp, lamp.radius / reach) {
                if body.sphere.is_some() { spheres = true } else { meshes = true }
            }
        }
        if !spheres && !meshes {
            return 1.0;
        }
        let (side, other) = to_lamp.any_orthonormal_pair();
        let blocked = |radius: f32, angle: f32| {
            let aim = lamp.center + (side * angle.cos() + other * angle.sin()) * (radius * lamp.radius);
            let direction = aim - origin;
            let hits_sphere = || {
                self.bodies
                    .iter()
                    .filter_map(|b| b.sphere)
                    .any(|(c, r)| sphere_distance(origin, direction, c, r, 1e-4).is_some_and(|t| t < 1.0))
            };
            (spheres && hits_sphere()) || (meshes && self.bvh.any(&Ray::new(origin, direction, 1e-4), 1.0))
        };
        let turn = jitter * std::f32::consts::TAU;
        let quarter = std::f32::consts::FRAC_PI_2;
        let dark = (0..RING).filter(|&i| blocked(0.95, turn + i as f32 * quarter)).count();
        if dark == 0 || dark == RING {
            return 1.0 - (dark / RING) as f32;
        }
        // Vogel's spiral covers the disc evenly.
        let lit = (0..SAMPLES)
            .filter(|&i| !blocked(((i as f32 + 0.5) / SAMPLES as f32).sqrt(), turn + i as f32 * 2.399_963))
            .count();
        lit as f32 / SAMPLES as f32
    }
}

/// Returns the distance to a sphere in units of `direction`, computed without cancellation (Haines et al. 2019, "Precision
/// Improvements for Ray/Sphere Intersection").
fn sphere_distance(origin: Vec3, direction: Vec3, center: Vec3, radius: f32, t_min: f32) -> Option<f32> {
    let f = origin - center;
    let a = direction.length_squared();
    let b = -f.dot(direction);
    let off_axis = f + direction * (b / a);
    let discriminant = radius * radius - off_axis.length_squared();
    if discriminant < 0.0 {
        return None;
    }
    let q = b + b.signum() * (a * discriminant).sqrt();
    let c = f.length_squared() - radius * radius;
    let (near, far) = if b > 0.0 { (c / q, q / a) } else { (q / a, c / q) };
    [near, far].into_iter().find(|&t| t > t_min)
}

/// Computes the corner normals of each triangle: the area-weighted mean of the facets around the corner that bend by less than the
/// crease angle.
fn smooth_normals(mesh: &sms_core::Mesh) -> Vec<[Vec3; 3]> {
    let area_normals: Vec<glamx::DVec3> = (0..mesh.triangles.len())
        .map(|t| {
            let [a, b, c] = mesh.corners(t);
            (b - a).cross(c - a)
        })
        .collect();
    let mut around: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for (t, corners) in mesh.triangles.iter().enumerate() {
        corners.iter().for_each(|&i| around.entry(i).or_default().push(t));
    }
    mesh.triangles
        .iter()
        .zip(&area_normals)
        .map(|(corners, own)| {
            let own_unit = own.normalize_or_zero();
            corners.map(|i| {
                let sum: glamx::DVec3 = around[&i]
                    .iter()
                    .map(|&t| area_normals[t])
                    .filter(|n| n.normalize_or_zero().dot(own_unit) > CREASE_COS)
                    .sum();
                sum.try_normalize().unwrap_or(own_unit).as_vec3()
            })
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BilliardsSettings, generate_billiards};
    use sms_core::Seed;

    #[test]
    fn a_half_shadow_is_as_wide_as_the_lamp_seen_past_the_ball() {
        let settings = BilliardsSettings { objects: 0, ..BilliardsSettings::default() };
        let mut scene = generate_billiards(Seed(1), &settings);
        scene.objects.truncate(1);
        let mut stage = RayScene::new(&scene);
        let (ball, radius) = stage.bodies[0].sphere.unwrap();
        // A lamp right above: across the floor through the point below the ball, the shadow is dark up to where the lamp's
        // far rim comes out behind the ball and light from where its near rim does.
        let (height, size) = (1.5f32, 0.4f32);
        stage.lamps[0].center = ball.with_z(height);
        stage.lamps[0].radius = size;
        let lamp = stage.lamps[0];
        let share = |x: f32| {
            let p = (ball + Vec3::X * x).with_z(1e-4);
            let shares = (0..64)
                .map(|k| stage.lamp_visibility(p, &lamp, (lamp.center - p).normalize(), k as f32 / 64.0));
            shares.sum::<f32>() / 64.0
        };
        // The rays past a ball at height r that start at the lamp's rim: tangents of a circle in the plane.
        let touch = |rim: f32| {
            let (up, across) = (height - ball.z, -rim);
            let distance = up.hypot(across);
            let angle = across.atan2(up) + (radius / distance).asin();
            rim + height * angle.tan()
        };
        let (inner, outer) = (touch(size), touch(-size));
        assert!(inner > 0.01 && outer - inner > 0.015, "{inner} {outer}");
        assert_eq!(share(inner - 0.0025), 0.0);
        assert_eq!(share(outer + 0.0025), 1.0);
        let middle = share(0.5 * (inner + outer));
        assert!((0.35..0.7).contains(&middle), "{middle}");
        let steps: Vec<f32> = (0..=10).map(|i| share(inner + (outer - inner) * i as f32 / 10.0)).collect();
        assert!(steps.windows(2).all(|w| w[1] >= w[0] - 0.03), "{steps:?}");
    }
}
