//! Collision shapes for contact timing and rolling resistance, independent of the engine.

use crate::{BodyState, SimError, StrikerMotion};
use glamx::{DPose3, DQuat, DVec3};
use parry3d_f64::query::PointQuery;
use parry3d_f64::shape::{ConvexPolyhedron, Cuboid, TriMesh};
use sms_core::{Aabb, Mesh};
use sms_scene::{Body, BodyShape};

/// A convex part, half space or mesh in its body's frame.
pub(crate) enum CollisionPart {
    /// The half space z < 0.
    HalfSpace,
    Sphere(f64),
    Convex(ConvexPolyhedron),
    Mesh(TriMesh),
    Cuboid(Cuboid),
    /// A cylinder along z.
    Cylinder {
        radius: f64,
        half_length: f64,
    },
}

impl CollisionPart {
    /// The point of the surface nearest to `p`, and whether `p` is inside.
    pub(crate) fn nearest(&self, p: DVec3) -> (DVec3, bool) {
        match self {
            Self::HalfSpace => (DVec3::new(p.x, p.y, 0.0), p.z < 0.0),
            Self::Sphere(radius) => {
                let out = p.try_normalize().unwrap_or(DVec3::Z);
                // The sum has no negative zeros.
                (DVec3::ZERO + *radius * out, p.length() < *radius)
            }
            Self::Convex(s) => projected(s.project_local_point(p, true)),
            Self::Mesh(s) => (s.project_local_point(p, false).point, false),
            Self::Cuboid(s) => projected(s.project_local_point(p, true)),
            Self::Cylinder { radius, half_length } => nearest_on_cylinder(p, *radius, *half_length),
        }
    }

    /// Depth of `p` below the surface, negative outside. A mesh has no inside.
    pub(crate) fn depth(&self, p: DVec3) -> f64 {
        // `nearest` returns a point inside of a hull or a box unchanged.
        let (nearest, inside) = match self {
            Self::Convex(s) => projected(s.project_local_point(p, false)),
            Self::Cuboid(s) => projected(s.project_local_point(p, false)),
            _ => self.nearest(p),
        };
        if inside { p.distance(nearest) } else { -p.distance(nearest) }
    }

    /// Returns whether the plane through a nearest point bounds the whole shape.
    pub(crate) fn is_convex(&self) -> bool {
        !matches!(self, Self::Mesh(_))
    }

    /// Corners of the part, for inside tests against other bodies; none for round parts.
    fn corners(&self) -> Vec<DVec3> {
        match self {
            Self::HalfSpace | Self::Sphere(_) | Self::Mesh(_) => Vec::new(),
            Self::Convex(s) => s.points().to_vec(),
            Self::Cuboid(s) => Mesh::cuboid(s.half_extents).vertices,
            Self::Cylinder { radius, half_length } => Mesh::cylinder(*radius, *half_length, 12).vertices,
        }
    }

    /// A ball inside the part: centre and radius. `None` for meshes and half spaces.
    fn inner_ball(&self) -> Option<(DVec3, f64)> {
        let center = match self {
            Self::HalfSpace | Self::Mesh(_) => return None,
            Self::Sphere(radius) => return Some((DVec3::ZERO, *radius)),
            Self::Convex(s) => s.points().iter().copied().sum::<DVec3>() / s.points().len() as f64,
            Self::Cuboid(_) | Self::Cylinder { .. } => DVec3::ZERO,
        };
        let radius = self.depth(center);
        (radius > 0.0).then_some((center, radius))
    }

    /// A bounding sphere of the part: centre and radius.
    fn bounds(&self) -> (DVec3, f64) {
        let around = |points: &[DVec3]| {
            let center = Aabb::of_points(points.iter().copied()).map_or(DVec3::ZERO, |b| b.center());
            (center, points.iter().map(|p| p.distance(center)).fold(0.0, f64::max))
        };
        match self {
            Self::HalfSpace => (DVec3::ZERO, f64::INFINITY),
            Self::Sphere(radius) => (DVec3::ZERO, *radius),
            Self::Convex(s) => around(s.points()),
            Self::Mesh(s) => around(s.vertices()),
            Self::Cuboid(s) => (DVec3::ZERO, s.half_extents.length()),
            Self::Cylinder { radius, half_length } => (DVec3::ZERO, radius.hypot(*half_length)),
        }
    }
}

/// The point of a cylinder's surface (centred, axis along z) nearest to `p`, and whether `p` is inside.
fn nearest_on_cylinder(p: DVec3, radius: f64, half_length: f64) -> (DVec3, bool) {
    let out = p.with_z(0.0).try_normalize().unwrap_or(DVec3::X);
    let across = p.dot(out);
    let (to_side, to_end) = (radius - across, half_length - p.z.abs());
    if to_side > 0.0 && to_end > 0.0 {
        let end = half_length.copysign(p.z);
        return (if to_side < to_end { (out * radius).with_z(p.z) } else { p.with_z(end) }, true);
    }
    ((out * across.min(radius)).with_z(p.z.clamp(-half_length, half_length)), false)
}

fn projected(p: parry3d_f64::query::PointProjection) -> (DVec3, bool) {
    (p.point, p.is_inside)
}

/// Distance of a world point from a body, metres; negative inside, but not of meshes; infinite without a usable shape.
pub fn signed_distance(body: &Body, p_w: DVec3) -> f64 {
    let p = body.x_wb.inverse_transform_point(p_w);
    BodyGeometry::of_body(body)
        .map_or(f64::INFINITY, |g| g.parts.iter().map(|b| -b.part.depth(p)).fold(f64::INFINITY, f64::min))
}

/// The shapes of a body.
pub(crate) struct BodyGeometry {
    parts: Vec<BoundedPart>,
    /// Radius of the bounding sphere about the body's origin; infinite for a half space.
    pub(crate) bounding_radius: f64,
    /// Bounding box in the body's frame.
    pub(crate) low: DVec3,
    pub(crate) high: DVec3,
    /// Corners of the convex parts, in the body's frame.
    pub(crate) corners: Vec<DVec3>,
    /// A ball inside each convex part: centre in the body's frame, and radius.
    pub(crate) inner_balls: Vec<(DVec3, f64)>,
}

struct BoundedPart {
    part: CollisionPart,
    center: DVec3,
    radius: f64,
}

impl BodyGeometry {
    fn new(parts: Vec<CollisionPart>) -> Self {
        let bounded = |part: CollisionPart| {
            let (center, radius) = part.bounds();
            BoundedPart { part, center, radius }
        };
        let parts: Vec<BoundedPart> = parts.into_iter().map(bounded).collect();
        let bounding_radius = parts.iter().map(|p| p.center.length() + p.radius).fold(0.0, f64::max);
        let corners = parts.iter().flat_map(|p| p.part.corners()).collect();
        let inner_balls = parts.iter().filter_map(|p| p.part.inner_ball()).collect();
        let ends = |sign: f64| parts.iter().map(move |p| p.center + DVec3::splat(sign * p.radius));
        let (low, high) =
            (ends(-1.0).fold(DVec3::INFINITY, DVec3::min), ends(1.0).fold(DVec3::NEG_INFINITY, DVec3::max));
        Self { parts, bounding_radius, low, high, corners, inner_balls }
    }

    /// The parts that may come within `reach` of a point `p` of the body's frame.
    pub(crate) fn parts_near(&self, p: DVec3, reach: f64) -> impl Iterator<Item = &CollisionPart> {
        self.parts
            .iter()
            .filter(move |b| b.center.distance_squared(p) <= (b.radius + reach) * (b.radius + reach))
            .map(|b| &b.part)
    }

    pub(crate) fn of_body(body: &Body) -> Result<Self, SimError> {
        let refuse = |why: String| SimError::Body { body: body.name.clone(), why };
        let convex = |(i, mesh): (usize, &Mesh)| {
            Some(&mesh.vertices)
                .filter(|v| v.len() >= 4)
                .and_then(|v| ConvexPolyhedron::from_convex_hull(v))
                .map(CollisionPart::Convex)
                .ok_or_else(|| refuse(format!("hull {i} has no volume")))
        };
        Ok(Self::new(match &body.shape {
            BodyShape::Sphere { radius } => vec![CollisionPart::Sphere(*radius)],
            BodyShape::Box { half_extents } => vec![CollisionPart::Cuboid(Cuboid::new(*half_extents))],
            BodyShape::Cylinder { radius, half_length } => {
                vec![CollisionPart::Cylinder { radius: *radius, half_length: *half_length }]
            }
            BodyShape::HalfSpace => vec![CollisionPart::HalfSpace],
            BodyShape::Hulls { hulls } => hulls.iter().enumerate().map(convex).collect::<Result<_, _>>()?,
            BodyShape::TriMesh { mesh } => {
                let mesh = TriMesh::new(mesh.vertices.clone(), mesh.triangles.clone())
                    .map_err(|e| refuse(format!("its mesh cannot be used: {e}")))?;
                vec![CollisionPart::Mesh(mesh)]
            }
        }))
    }

    /// A box about the origin with these half extents.
    pub(crate) fn of_box(half: DVec3) -> Self {
        Self::new(vec![CollisionPart::Cuboid(Cuboid::new(half))])
    }
}

/// Predicted motion of a body without contacts.
pub(crate) enum Path<'a> {
    /// Constant acceleration and constant spin.
    Free { state: &'a BodyState, acceleration_w: DVec3 },
    /// A sweep, `start_s` seconds into it.
    Sweep { motion: &'a StrikerMotion, start_s: f64 },
}

impl Path<'_> {
    pub(crate) fn position_at(&self, t: f64) -> DVec3 {
        match self {
            Self::Free { state, acceleration_w } => {
                state.x_wb.translation + t * state.v_w + 0.5 * t * t * acceleration_w
            }
            Self::Sweep { motion, start_s } => motion.pose_at(start_s + t).translation,
        }
    }

    pub(crate) fn pose_at(&self, t: f64) -> DPose3 {
        match self {
            Self::Free { state, .. } => DPose3::from_parts(
                self.position_at(t),
                DQuat::from_scaled_axis(t * state.w_w) * state.x_wb.rotation,
            ),
            Self::Sweep { motion, start_s } => motion.pose_at(start_s + t),
        }
    }

    pub(crate) fn velocity_at(&self, t: f64) -> DVec3 {
        match self {
            Self::Free { state, acceleration_w } => state.v_w + t * acceleration_w,
            Self::Sweep { motion, start_s } => motion.velocity_at(start_s + t),
        }
    }

    pub(crate) fn spin_w(&self) -> DVec3 {
        match self {
            Self::Free { state, .. } => state.w_w,
            Self::Sweep { .. } => DVec3::ZERO,
        }
    }

    /// Largest change of speed per second, m/s².
    pub(crate) fn acceleration_bound(&self) -> f64 {
        match self {
            Self::Free { acceleration_w, .. } => acceleration_w.length(),
            Self::Sweep { motion, .. } => motion.largest_acceleration(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::sync::LazyLock;

    const CYLINDER: (f64, f64) = (0.05, 0.08);

    /// A fine prism as a solid, and its surface: the nearest points of triangles are exact, those of a solid are iterated.
    fn fine_prism() -> &'static (ConvexPolyhedron, TriMesh) {
        static PRISM: LazyLock<(ConvexPolyhedron, TriMesh)> = LazyLock::new(|| {
            let prism = Mesh::cylinder(CYLINDER.0, CYLINDER.1, 720);
            let solid = ConvexPolyhedron::from_convex_hull(&prism.vertices).unwrap();
            (solid, TriMesh::new(prism.vertices, prism.triangles).unwrap())
        });
        &PRISM
    }

    proptest! {
        /// Compares the closed form with a fine prism.
        #[test]
        fn nearest_points_of_a_cylinder_are_those_of_a_fine_prism(
            x in -0.2..0.2f64, y in -0.2..0.2f64, z in -0.2..0.2f64,
        ) {
            let (radius, half_length) = CYLINDER;
            let p = DVec3::new(x, y, z);
            let (solid, surface) = fine_prism();
            let (_, inside_prism) = projected(solid.project_local_point(p, false));
            let (expected, _) = projected(surface.project_local_point(p, false));
            let (q, inside) = nearest_on_cylinder(p, radius, half_length);
            let gap = q.distance(p) - expected.distance(p);
            prop_assert!(gap.abs() < 2e-6, "{p}: {q} {expected}");
            prop_assert!(inside == inside_prism || q.distance(p) < 2e-6);
        }

        /// A box gives the same result as a hull, a cuboid and a mesh.
        #[test]
        fn nearest_points_do_not_depend_on_how_a_box_is_written(
            x in -0.3..0.3f64, y in -0.3..0.3f64, z in -0.3..0.3f64,
        ) {
            let half = DVec3::new(0.05, 0.1, 0.02);
            let p = DVec3::new(x, y, z);
            prop_assume!((p.abs() - half).max_element() > 1e-3);
            let mesh = Mesh::cuboid(half);
            let expected = p.clamp(-half, half);
            for part in [
                CollisionPart::Cuboid(Cuboid::new(half)),
                CollisionPart::Convex(ConvexPolyhedron::from_convex_hull(&mesh.vertices).unwrap()),
                CollisionPart::Mesh(TriMesh::new(mesh.vertices.clone(), mesh.triangles.clone()).unwrap()),
            ] {
                let (q, inside) = part.nearest(p);
                prop_assert!(!inside);
                prop_assert!(q.distance(expected) < 1e-9, "{q} {expected}");
            }
        }
    }
}
