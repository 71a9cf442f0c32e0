//! Recognition of spheres, boxes and cylinders.

use crate::config::EntitiesConfig;
use crate::draft::{Draft, SceneInputs};
use crate::support::{Carrier, RestingPlane, Surroundings, height_below_ball};
use crate::views::{Views, depth_sigma, depth_tolerance};
use glamx::{DPose3, DQuat, DVec3};
use sms_core::{EntityShape, Mesh, PointCloud, Seed, even_directions};
use sms_mesh::{Plane, RaySample, SphereFit, fit_primitive, fit_sphere, primitive_mesh, refine_on_rays};

/// Returns labelled depth pixels away from depth and mask edges, as rays.
fn object_rays(views: &Views, label: u16) -> Vec<RaySample> {
    let mut rays = Vec::new();
    for (f, frame) in views.sequence.frames.iter().enumerate() {
        let map = &views.labels.maps[f];
        for y in 1..map.height.saturating_sub(1) {
            for x in 1..map.width.saturating_sub(1) {
                let depth = f64::from(frame.depth[(x, y)]);
                if map[(x, y)] != label || depth <= 0.0 {
                    continue;
                }
                let inner = [(x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)].iter().all(|&at| {
                    let next = f64::from(frame.depth[at]);
                    map[at] == label && (next <= 0.0 || (next - depth).abs() < 4.0 * depth_tolerance(depth))
                });
                if !inner {
                    continue;
                }
                let origin = frame.camera.center_w();
                let p = frame.camera.unproject_pixel(x, y, depth);
                let distance = p.distance(origin);
                rays.push(RaySample {
                    origin,
                    direction: (p - origin) / distance,
                    distance,
                    sigma: depth_sigma(depth) * distance / depth,
                });
            }
        }
    }
    let stride = rays.len().div_ceil(40_000).max(1);
    rays.into_iter().step_by(stride).collect()
}

/// Fits a sphere to an object's cloud. Returns `None` if the object has another shape or the frames contradict a
/// sphere.
pub(crate) fn recognise_sphere(
    cloud: &PointCloud,
    label: u16,
    rest: &RestingPlane,
    scene: SceneInputs<'_>,
    seed: Seed,
) -> Option<SphereFit> {
    let SceneInputs { views, config, .. } = scene;
    let points = &cloud.points_w;
    let first = fit_sphere(points, &config.sphere, seed)?;
    if !first.explains(points, &config.sphere) {
        return None;
    }
    // A ball on the level floor touches it, which constrains the hidden lower half.
    let gap = first.center.z - first.radius - rest.plane.offset;
    let floor = (rest.carrier == Carrier::Floor && gap.abs() < 0.004).then_some((rest.plane.offset, 0.0005));
    let rays = object_rays(views, label);
    let best = match refine_on_rays(&rays, first.center, first.radius, floor) {
        Some((center, radius)) => {
            let refined = SphereFit::of_sphere(points, center, radius, first.sigma, &config.sphere);
            // The rays may include pixels of neighbours, so the inliers of the cloud decide whether the rays improved
            // the fit.
            if refined.inlier_share + 0.05 >= first.inlier_share { refined } else { first }
        }
        None => first,
    };
    (!is_contradicted(&best, label, rest, scene)).then_some(best)
}

/// Largest share of a sphere's seen directions with free space behind the surface. Mask and depth edges cost a few
/// percent; a bowl, which is the cap of a sphere, has over a half.
const SEEN_THROUGH: f64 = 0.12;
/// Largest depth of a ball below its support, metres.
const SUNK_M: f64 = 0.003;

/// Returns the depth of a ball below its support, metres. In a hollow the support is the carrier's surface instead of
/// the plane.
pub(crate) fn sunk(fit: &SphereFit, around: &Surroundings, rest: &RestingPlane) -> f64 {
    let hollow = match rest.carrier {
        Carrier::Object(carrier) => height_below_ball(around, carrier, fit.center, fit.radius),
        _ => None,
    };
    match hollow {
        Some(height) => height - (fit.center.z - fit.radius),
        None => fit.radius - rest.plane.height(fit.center),
    }
}

/// Returns whether the cameras or the floor contradict a whole sphere. The wall of a round bowl also lies on a sphere.
fn is_contradicted(fit: &SphereFit, label: u16, rest: &RestingPlane, scene: SceneInputs<'_>) -> bool {
    if sunk(fit, scene.around, rest) > SUNK_M {
        return true;
    }
    let (mut seen, mut through) = (0, 0);
    for direction in even_directions(400) {
        // Slightly inside, so that a noisy surface does not count as free space.
        let count = scene.views.count(fit.center + direction * (0.97 * fit.radius), label);
        if count.own + count.free >= 2 {
            seen += 1;
            through += usize::from(count.free > count.own);
        }
    }
    through as f64 > SEEN_THROUGH * f64::from(seen.max(1))
}

/// Smallest cosine between a solid's axis and the vertical for which the solid is set exactly upright: 3°.
const UPRIGHT: f64 = 0.9986;
/// Largest gap or overlap with the carrier that counts as an error of the scan, metres.
const GAP_M: f64 = 0.004;

/// Fits a box or a cylinder to the object's points and its contact points, and places it on its support. Returns `None`
/// if neither fits the points, if the volume differs from that of `mesh`, which has the same points, or if cameras see
/// through the solid.
pub(crate) fn recognise_primitive(
    draft: &Draft,
    contact: &[DVec3],
    mesh: &Mesh,
    views: &Views,
    config: &EntitiesConfig,
    seed: Seed,
) -> Option<EntityShape> {
    let settings = &config.primitive;
    if !settings.enabled {
        return None;
    }
    let plane = &draft.rest.plane;
    let mut cloud = draft.cloud.clone();
    // Contact points constrain the extent of the solid, but do not count as inliers.
    cloud.points_w.extend_from_slice(contact);
    cloud.normals_w.extend(std::iter::repeat_n(-plane.normal, contact.len()));
    let fit = fit_primitive(&cloud, Some(plane.normal), settings, seed)?;
    if fit.inlier_share < settings.min_inlier_share || fit.residual_median_m > 0.5 * settings.inlier_distance
    {
        return None;
    }
    let shape = if draft.rest.carrier == Carrier::Unseen { fit.shape } else { stood_on(fit.shape, plane) };
    let surface = primitive_mesh(&shape, 0.01)?;
    let same_volume = (surface.volume() / mesh.volume() - 1.0).abs() <= settings.max_volume_error;
    (same_volume && !is_looked_through(&surface, views, draft.info.id)).then_some(shape)
}

/// Returns the solid after a small rotation that sets it upright (or lays a cylinder flat), and a shift onto the plane.
fn stood_on(shape: EntityShape, plane: &Plane) -> EntityShape {
    let n = plane.normal;
    let turned = |x_ws: DPose3, axis: DVec3, onto: DVec3| -> DPose3 {
        DPose3::from_parts(x_ws.translation, DQuat::from_rotation_arc(axis, onto) * x_ws.rotation)
    };
    let upright = |x_ws: DPose3, axes: &[DVec3]| -> Option<DPose3> {
        let world = axes.iter().map(|&a| x_ws.rotation * a).map(|a| a * a.dot(n).signum());
        let best = world.max_by(|a, b| a.dot(n).total_cmp(&b.dot(n)))?;
        (best.dot(n) > UPRIGHT).then(|| turned(x_ws, best, n))
    };
    let lowered = |x_ws: DPose3, reach: f64| -> DPose3 {
        let gap = plane.height(x_ws.translation) - reach;
        let shift = if gap.abs() < GAP_M { -n * gap } else { DVec3::ZERO };
        DPose3::from_parts(x_ws.translation + shift, x_ws.rotation)
    };
    match shape {
        EntityShape::Box { x_ws, half_extents } => {
            let x_ws = upright(x_ws, &DVec3::AXES).unwrap_or(x_ws);
            let reach = (0..3).map(|k| half_extents[k] * (x_ws.rotation * DVec3::AXES[k]).dot(n).abs()).sum();
            EntityShape::Box { x_ws: lowered(x_ws, reach), half_extents }
        }
        EntityShape::Cylinder { x_ws, radius, half_length } => {
            let axis = x_ws.rotation * DVec3::Z;
            let x_ws = upright(x_ws, &[DVec3::Z]).unwrap_or_else(|| {
                let level = (axis - n * axis.dot(n)).normalize_or(axis);
                if level.dot(axis) > UPRIGHT { turned(x_ws, axis, level) } else { x_ws }
            });
            let along = (x_ws.rotation * DVec3::Z).dot(n).abs();
            let reach = half_length * along + radius * (1.0 - along * along).max(0.0).sqrt();
            EntityShape::Cylinder { x_ws: lowered(x_ws, reach), radius, half_length }
        }
        other => other,
    }
}

/// Returns whether cameras see through the solid just below its surface, at more places than mask and depth edges
/// explain.
fn is_looked_through(surface: &Mesh, views: &Views, label: u16) -> bool {
    /// Depth below the surface, metres, so that a noisy surface does not count as free space.
    const UNDER_M: f64 = 0.002;
    let (mut seen, mut through) = (0.0, 0.0);
    for t in 0..surface.triangles.len() {
        let [a, b, c] = surface.corners(t);
        let cross = (b - a).cross(c - a);
        let middle = (a + b + c) / 3.0 - cross.normalize_or_zero() * UNDER_M;
        let count = views.count(middle, label);
        if count.own + count.free >= 2 {
            seen += cross.length();
            through += if count.free > count.own { cross.length() } else { 0.0 };
        }
    }
    through > SEEN_THROUGH * seen
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solids_that_nearly_stand_are_set_upright_on_the_plane() {
        let plane = Plane { normal: DVec3::new(0.1, 0.0, 1.0).normalize(), offset: 0.02 };
        let tilt = DQuat::from_rotation_arc(DVec3::Z, plane.normal) * DQuat::from_rotation_x(0.03);
        let at = |height: f64| DPose3::from_parts(plane.normal * (plane.offset + height), tilt);
        let size = DVec3::new(0.02, 0.03, 0.05);
        let EntityShape::Box { x_ws, .. } =
            stood_on(EntityShape::Box { x_ws: at(0.052), half_extents: size }, &plane)
        else {
            panic!()
        };
        assert!((x_ws.rotation * DVec3::Z).dot(plane.normal) > 1.0 - 1e-12);
        assert!((plane.height(x_ws.translation) - 0.05).abs() < 1e-12);
        // A lying cylinder touches the plane along its whole length.
        let lying = DPose3::from_parts(
            plane.normal * (plane.offset + 0.031),
            tilt * DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2),
        );
        let can = EntityShape::Cylinder { x_ws: lying, radius: 0.03, half_length: 0.06 };
        let EntityShape::Cylinder { x_ws, .. } = stood_on(can, &plane) else { panic!() };
        assert!((x_ws.rotation * DVec3::Z).dot(plane.normal).abs() < 1e-12);
        assert!((plane.height(x_ws.translation) - 0.03).abs() < 1e-12);
        // An object that leans by 10° keeps its pose, and so does one 2 cm above the plane.
        let leaning = DPose3::from_parts(DVec3::Z, DQuat::from_rotation_x(0.17));
        let shape = EntityShape::Box { x_ws: leaning, half_extents: size };
        assert_eq!(stood_on(shape.clone(), &Plane::horizontal(0.9)), shape);
    }
}
