//! Shapes of links and obstacles, and distances between them.

use glamx::{DPose3, DVec3};
use parry3d_f64::query;
use parry3d_f64::shape::{Ball, Capsule, ConvexPolyhedron, Cuboid, Cylinder, Shape, TriMesh};
use serde::{Deserialize, Serialize};
use sms_core::{Aabb, Mesh};
use std::sync::Arc;

/// A convex collision shape about its own origin, with lengths along z, in metres.
#[derive(Debug, Clone)]
pub enum LinkShape {
    /// A sphere.
    Sphere {
        /// Radius.
        radius: f64,
    },
    /// A capsule.
    Capsule {
        /// Half the length of its segment.
        half_length: f64,
        /// Radius.
        radius: f64,
    },
    /// A cylinder.
    Cylinder {
        /// Half the height.
        half_length: f64,
        /// Radius.
        radius: f64,
    },
    /// A box.
    Box {
        /// Half extents.
        half: DVec3,
    },
    /// A convex hull.
    Convex(Arc<ConvexPolyhedron>),
}

impl LinkShape {
    /// The convex hull of points; `None` when they are coplanar.
    pub fn convex(points: &[DVec3]) -> Option<Self> {
        if !spans_volume(points) {
            return None;
        }
        ConvexPolyhedron::from_convex_hull(points).map(|hull| Self::Convex(Arc::new(hull)))
    }

    /// The half segment and the radius of a sphere or capsule.
    fn rounded(&self) -> Option<(DVec3, f64)> {
        match self {
            Self::Sphere { radius } => Some((DVec3::ZERO, *radius)),
            Self::Capsule { half_length, radius } => Some((DVec3::new(0.0, 0.0, *half_length), *radius)),
            _ => None,
        }
    }

    /// Radius of the bounding sphere about the shape's origin, metres.
    pub fn bounding_radius(&self) -> f64 {
        match self {
            Self::Sphere { radius } => *radius,
            Self::Capsule { half_length, radius } => half_length + radius,
            Self::Cylinder { half_length, radius } => half_length.hypot(*radius),
            Self::Box { half } => half.length(),
            Self::Convex(hull) => hull.points().iter().map(|p| p.length()).fold(0.0, f64::max),
        }
    }

    /// A bounding sphere: centre in the shape's frame, and radius.
    fn bounds(&self) -> (DVec3, f64) {
        match self {
            Self::Convex(hull) => sphere_around(hull.points()),
            _ => (DVec3::ZERO, self.bounding_radius()),
        }
    }

    /// Support distance along `direction` (a unit vector in the shape's frame), metres from the origin.
    pub fn support(&self, direction: DVec3) -> f64 {
        let across = || direction.x.hypot(direction.y);
        match self {
            Self::Sphere { radius } => *radius,
            Self::Capsule { half_length, radius } => radius + half_length * direction.z.abs(),
            Self::Cylinder { half_length, radius } => radius * across() + half_length * direction.z.abs(),
            Self::Box { half } => half.dot(direction.abs()),
            Self::Convex(hull) => {
                hull.points().iter().map(|p| p.dot(direction)).fold(f64::NEG_INFINITY, f64::max)
            }
        }
    }

    fn with_parry<T>(&self, use_shape: impl FnOnce(&dyn Shape) -> T) -> T {
        match self {
            Self::Sphere { radius } => use_shape(&Ball::new(*radius)),
            Self::Capsule { half_length, radius } => use_shape(&Capsule::new_z(*half_length, *radius)),
            // Parry's cylinder is aligned with y; `distance` rotates the pose.
            Self::Cylinder { half_length, radius } => use_shape(&Cylinder::new(*half_length, *radius)),
            Self::Box { half } => use_shape(&Cuboid::new(*half)),
            Self::Convex(hull) => use_shape(hull.as_ref()),
        }
    }

    /// The pose of Parry's counterpart of this shape.
    fn parry_pose(&self, x: &DPose3) -> DPose3 {
        match self {
            Self::Cylinder { .. } => DPose3::from_parts(
                x.translation,
                x.rotation * glamx::DQuat::from_rotation_x(std::f64::consts::FRAC_PI_2),
            ),
            _ => *x,
        }
    }
}

/// Whether the points span a volume, to a millionth of their extent.
fn spans_volume(points: &[DVec3]) -> bool {
    let farthest = |measure: &dyn Fn(DVec3) -> f64| {
        points.iter().copied().max_by(|&a, &b| measure(a).total_cmp(&measure(b)))
    };
    let Some(&a) = points.first() else { return false };
    let span = || {
        let b = farthest(&|p| p.distance(a))?;
        let along = (b - a).try_normalize()?;
        let c = farthest(&|p| along.cross(p - a).length())?;
        let normal = along.cross(c - a).try_normalize()?;
        let height = farthest(&|p| normal.dot(p - a).abs()).map(|p| normal.dot(p - a).abs())?;
        Some(height > 1e-6 * b.distance(a) && height > 1e-9)
    };
    span().unwrap_or(false)
}

/// A body that the robot must not touch.
#[derive(Debug, Clone)]
pub struct Obstacle {
    /// Name, for messages.
    pub name: String,
    /// Pose `X_WO` in the world.
    pub x_wo: DPose3,
    /// Shape.
    pub shape: ObstacleShape,
    /// Bounding spheres in the obstacle's frame, of the whole and of each part: centre and radius.
    bounds: (DVec3, f64),
    part_bounds: Vec<(DVec3, f64)>,
    /// Whether the strike touches it: it is an obstacle only before the sweep.
    pub(crate) is_struck: bool,
}

impl Obstacle {
    /// Creates an obstacle of `shape` at `x_wo` in the world.
    pub fn new(name: impl Into<String>, x_wo: DPose3, shape: ObstacleShape) -> Self {
        let (bounds, part_bounds) = match &shape {
            ObstacleShape::HalfSpace => ((DVec3::ZERO, f64::INFINITY), Vec::new()),
            ObstacleShape::Link(part) => (part.bounds(), Vec::new()),
            ObstacleShape::Hulls(parts) => {
                let each: Vec<(DVec3, f64)> = parts.iter().map(LinkShape::bounds).collect();
                let center = each.iter().map(|b| b.0).sum::<DVec3>() / each.len().max(1) as f64;
                let radius = each.iter().map(|b| b.0.distance(center) + b.1).fold(0.0, f64::max);
                ((center, radius), each)
            }
            ObstacleShape::Surface(mesh) => (sphere_around(mesh.vertices()), Vec::new()),
        };
        Self { name: name.into(), x_wo, shape, bounds, part_bounds, is_struck: false }
    }

    /// Marks the obstacle as the body to strike: the approach keeps its distance from it, the sweep does not.
    pub fn struck(self) -> Self {
        Self { is_struck: true, ..self }
    }

    /// A bounding sphere: centre in the world, and radius.
    pub(crate) fn sphere_w(&self) -> (DVec3, f64) {
        (self.x_wo.transform_point(self.bounds.0), self.bounds.1)
    }
}

/// The bounding sphere of points about the middle of their bounding box.
fn sphere_around(points: &[DVec3]) -> (DVec3, f64) {
    let center = Aabb::of_points(points.iter().copied()).map_or(DVec3::ZERO, |b| b.center());
    (center, points.iter().map(|p| p.distance(center)).fold(0.0, f64::max))
}

/// The shape of an [`Obstacle`].
#[derive(Debug, Clone)]
pub enum ObstacleShape {
    /// Everything below the plane z = 0 of its frame.
    HalfSpace,
    /// One convex shape.
    Link(LinkShape),
    /// Several convex parts in one frame.
    Hulls(Vec<LinkShape>),
    /// A triangle surface, open or closed; only the surface counts, not the interior.
    Surface(Arc<TriMesh>),
}

impl ObstacleShape {
    /// A surface from a mesh; `None` when it has no triangles.
    pub fn surface(mesh: &Mesh) -> Option<Self> {
        TriMesh::new(mesh.vertices.clone(), mesh.triangles.clone()).ok().map(|m| Self::Surface(Arc::new(m)))
    }
}

/// Distance of two convex shapes, metres; negative by the penetration depth.
pub(crate) fn distance(a: &LinkShape, x_wa: &DPose3, b: &LinkShape, x_wb: &DPose3) -> f64 {
    if let (Some((half_a, ra)), Some((half_b, rb))) = (a.rounded(), b.rounded()) {
        let axis_a = x_wa.rotation * half_a;
        let axis_b = x_wb.rotation * half_b;
        return segment_distance(x_wa.translation, axis_a, x_wb.translation, axis_b) - ra - rb;
    }
    a.with_parry(|sa| b.with_parry(|sb| general_distance(sa, &a.parry_pose(x_wa), sb, &b.parry_pose(x_wb))))
}

/// Distance of a link's shape to an obstacle, metres; negative by the penetration depth. Beyond `enough`, any value
/// above `enough` may be returned.
pub(crate) fn obstacle_distance(
    (a, a_radius): (&LinkShape, f64),
    x_wa: &DPose3,
    obstacle: &Obstacle,
    enough: f64,
) -> f64 {
    let gap_to = |(center, radius): (DVec3, f64)| {
        obstacle.x_wo.transform_point(center).distance(x_wa.translation) - radius - a_radius
    };
    let gap = gap_to(obstacle.bounds);
    if gap > enough {
        return gap;
    }
    match &obstacle.shape {
        ObstacleShape::HalfSpace => {
            let normal_w = obstacle.x_wo.rotation * DVec3::Z;
            let down_a = x_wa.rotation.inverse() * -normal_w;
            normal_w.dot(x_wa.translation - obstacle.x_wo.translation) - a.support(down_a)
        }
        ObstacleShape::Link(b) => distance(a, x_wa, b, &obstacle.x_wo),
        ObstacleShape::Hulls(parts) => {
            let mut nearest = f64::INFINITY;
            for (b, &bounds) in parts.iter().zip(&obstacle.part_bounds) {
                let most = enough.min(nearest);
                let gap = gap_to(bounds);
                // A cheap lower bound comes before the iterations of the exact distance.
                let far = |gap: f64| gap > most;
                let gap = if far(gap) { gap } else { gap_between(a, x_wa, b, &obstacle.x_wo, bounds.0) };
                nearest = nearest.min(if far(gap) { gap } else { distance(a, x_wa, b, &obstacle.x_wo) });
            }
            nearest
        }
        ObstacleShape::Surface(mesh) => {
            a.with_parry(|sa| general_distance(sa, &a.parry_pose(x_wa), mesh.as_ref(), &obstacle.x_wo))
        }
    }
}

/// A lower bound of the distance of two convex shapes, metres: the gap between their supporting planes perpendicular to
/// the line through their centres. `center_b` is the centre of `b` in its frame.
fn gap_between(a: &LinkShape, x_wa: &DPose3, b: &LinkShape, x_wb: &DPose3, center_b: DVec3) -> f64 {
    let Some(to_b_w) = (x_wb.transform_point(center_b) - x_wa.translation).try_normalize() else {
        return f64::NEG_INFINITY;
    };
    let in_a = x_wa.rotation.inverse() * to_b_w;
    let in_b = x_wb.rotation.inverse() * -to_b_w;
    to_b_w.dot(x_wb.translation - x_wa.translation) - a.support(in_a) - b.support(in_b)
}

fn general_distance(a: &dyn Shape, x_wa: &DPose3, b: &dyn Shape, x_wb: &DPose3) -> f64 {
    // Parry supports all pairs of the shapes above.
    let apart = query::distance(x_wa, a, x_wb, b).map_or(f64::INFINITY, |d| d.distance);
    if apart > 0.0 {
        return apart;
    }
    let contact = query::contact(x_wa, a, x_wb, b, 0.0).ok().flatten();
    contact.map_or(0.0, |contact| contact.dist.min(0.0))
}

/// Distance of two segments, each centre ± half (Ericson, "Real-Time Collision Detection", 5.1.9).
fn segment_distance(ca: DVec3, ha: DVec3, cb: DVec3, hb: DVec3) -> f64 {
    let r = ca - cb;
    let (aa, bb, ab) = (ha.length_squared(), hb.length_squared(), ha.dot(hb));
    let (ra, rb) = (ha.dot(r), hb.dot(r));
    let denominator = aa * bb - ab * ab;
    let unit = |x: f64| x.clamp(-1.0, 1.0);
    let mut s = if denominator > 1e-14 * aa * bb { unit((ab * rb - ra * bb) / denominator) } else { 0.0 };
    let mut t = if bb > 0.0 { unit((rb + s * ab) / bb) } else { 0.0 };
    s = if aa > 0.0 { unit((t * ab - ra) / aa) } else { s };
    t = if bb > 0.0 { unit((rb + s * ab) / bb) } else { t };
    (r + s * ha - t * hb).length()
}

/// A half space below the plane z = `height_m` of the world.
pub fn floor(height_m: f64) -> Obstacle {
    Obstacle::new("floor", DPose3::from_translation(DVec3::new(0.0, 0.0, height_m)), ObstacleShape::HalfSpace)
}

/// A pair of links, or a link and an obstacle, and their distance.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Clearance {
    /// Link of the robot.
    pub link: String,
    /// The other link or the obstacle.
    pub other: String,
    /// Distance, metres; negative by the penetration depth.
    pub distance_m: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DQuat;
    use proptest::prelude::*;

    fn pose(v: [f64; 6]) -> DPose3 {
        DPose3::from_parts(
            DVec3::new(v[0], v[1], v[2]) * 0.3,
            DQuat::from_scaled_axis(3.0 * DVec3::new(v[3], v[4], v[5])),
        )
    }

    proptest! {
        /// No two points of the axes are closer than the closed form says, and some are nearly as close. (Parry's
        /// iteration stops up to 13 µm too far away.)
        #[test]
        fn capsules_are_as_far_apart_as_their_nearest_points(
            a in prop::array::uniform6(-1.0..1.0f64), b in prop::array::uniform6(-1.0..1.0f64),
        ) {
            let (x_wa, x_wb) = (pose(a), pose(b));
            let ours = distance(
                &LinkShape::Capsule { half_length: 0.1, radius: 0.03 }, &x_wa,
                &LinkShape::Capsule { half_length: 0.07, radius: 0.02 }, &x_wb,
            );
            let steps = || (0..=200).map(|i| f64::from(i) / 100.0 - 1.0);
            let at = |x: &DPose3, z: f64| x.transform_point(DVec3::new(0.0, 0.0, z));
            let sampled = steps()
                .flat_map(|s| steps().map(move |t| (s, t)))
                .map(|(s, t)| at(&x_wa, 0.1 * s).distance(at(&x_wb, 0.07 * t)))
                .fold(f64::INFINITY, f64::min) - 0.05;
            prop_assert!(ours <= sampled + 1e-12 && ours > sampled - 1e-3, "{ours} {sampled}");
        }

        /// The height of a shape above the floor is that of its lowest point.
        #[test]
        fn the_floor_is_as_far_as_the_lowest_point(
            a in prop::array::uniform6(-1.0..1.0f64), kind in 0..4usize, height in -0.5..0.5f64,
        ) {
            let ends = [DVec3::new(0.0, 0.0, 0.1), DVec3::new(0.0, 0.0, -0.1)];
            let half = DVec3::new(0.1, 0.02, 0.05);
            let ball = Mesh::icosphere(0.1, 1).vertices;
            let (shape, points, radius) = match kind {
                0 => (LinkShape::Capsule { half_length: 0.1, radius: 0.03 }, ends.to_vec(), 0.03),
                1 => (
                    LinkShape::Cylinder { half_length: 0.1, radius: 0.03 },
                    Mesh::cylinder(0.03, 0.1, 3000).vertices,
                    0.0,
                ),
                2 => (LinkShape::Box { half }, Mesh::cuboid(half).vertices, 0.0),
                _ => (LinkShape::convex(&ball).unwrap(), ball, 0.0),
            };
            let x_wa = pose(a);
            let lowest = points.iter().map(|&p| x_wa.transform_point(p).z).fold(f64::INFINITY, f64::min) - radius;
            let ours = obstacle_distance((&shape, shape.bounding_radius()), &x_wa, &floor(height), 1.0);
            prop_assert!((ours - (lowest - height)).abs() < 1e-7, "{ours} {lowest}");
        }
    }

    proptest! {
        /// The gap of the planes is never larger than the distance of the shapes.
        #[test]
        fn the_gap_of_planes_is_a_lower_bound(
            a in prop::array::uniform6(-1.0..1.0f64), b in prop::array::uniform6(-1.0..1.0f64), kind in 0..4usize,
        ) {
            let hull = LinkShape::convex(&Mesh::icosphere(0.08, 1).vertices).unwrap();
            let shapes = [
                LinkShape::Capsule { half_length: 0.1, radius: 0.03 },
                LinkShape::Cylinder { half_length: 0.1, radius: 0.03 },
                LinkShape::Box { half: DVec3::new(0.1, 0.02, 0.05) },
                LinkShape::Sphere { radius: 0.05 },
            ];
            let (x_wa, x_wb) = (pose(a), pose(b));
            let apart = distance(&shapes[kind], &x_wa, &hull, &x_wb);
            let gap = gap_between(&shapes[kind], &x_wa, &hull, &x_wb, DVec3::new(0.01, 0.0, -0.02));
            prop_assert!(apart <= 0.0 || gap <= apart + 1e-9, "{gap} {apart}");
            prop_assert!(apart > 0.0 || gap <= 1e-9, "{gap} {apart}");
        }
    }

    #[test]
    fn cylinders_stand_along_z() {
        let cylinder = LinkShape::Cylinder { half_length: 0.2, radius: 0.01 };
        let ball = LinkShape::Sphere { radius: 0.01 };
        let at = |p: DVec3| distance(&cylinder, &DPose3::IDENTITY, &ball, &DPose3::from_translation(p));
        assert!((at(DVec3::new(0.0, 0.0, 0.25)) - 0.04).abs() < 1e-6);
        assert!((at(DVec3::new(0.0, 0.05, 0.1)) - 0.03).abs() < 1e-6);
    }

    #[test]
    fn overlap_has_a_depth() {
        let a = LinkShape::Box { half: DVec3::splat(0.1) };
        let b = LinkShape::Sphere { radius: 0.1 };
        let d = distance(&a, &DPose3::IDENTITY, &b, &DPose3::from_translation(DVec3::new(0.15, 0.0, 0.0)));
        assert!((d + 0.05).abs() < 1e-6, "{d}");
    }
}
