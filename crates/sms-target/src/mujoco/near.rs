//! Proximity tests of moving bodies and strikers.

use glamx::{DPose3, DVec3};
use sms_core::{Aabb, Mesh};
use sms_scene::BodyShape;

/// Bounding spheres and boxes of the parts of a body, in its frame; `None` for a half space.
pub(super) struct Bounds(Option<Vec<PartBounds>>);

struct PartBounds {
    center: DVec3,
    radius: f64,
    /// Half extents of the box along the axes of the body's frame, metres.
    half: DVec3,
}

impl Bounds {
    pub(super) fn of(shape: &BodyShape) -> Self {
        let centred = |radius: f64, half: DVec3| PartBounds { center: DVec3::ZERO, radius, half };
        Self(match shape {
            BodyShape::HalfSpace => None,
            BodyShape::Sphere { radius } => Some(vec![centred(*radius, DVec3::splat(*radius))]),
            BodyShape::Box { half_extents } => Some(vec![centred(half_extents.length(), *half_extents)]),
            BodyShape::Cylinder { radius, half_length } => {
                Some(vec![centred(radius.hypot(*half_length), DVec3::new(*radius, *radius, *half_length))])
            }
            BodyShape::Hulls { hulls } => Some(hulls.iter().map(around).collect()),
            BodyShape::TriMesh { mesh } => Some(vec![around(mesh)]),
        })
    }

    /// Returns the radius of the bounding sphere about the body's origin; infinite for a half space.
    pub(super) fn reach(&self) -> f64 {
        self.0.as_ref().map_or(f64::INFINITY, |parts| {
            parts.iter().map(|p| p.center.length() + p.radius).fold(0.0, f64::max)
        })
    }

    /// Returns whether two bodies may be within `margin` metres of each other, by the spheres of each and the boxes of
    /// the other. Has false positives only; always true for a half space.
    pub(super) fn meets(&self, x_wb: &DPose3, other: &Self, x_wo: &DPose3, margin: f64) -> bool {
        let (Some(own), Some(theirs)) = (&self.0, &other.0) else { return true };
        let x_bo = x_wb.inv_mul(x_wo);
        let x_ob = x_bo.inverse();
        own.iter().any(|a| {
            let a_in_o = x_ob.transform_point(a.center);
            theirs.iter().any(|b| {
                b.is_within(a_in_o, a.radius + margin)
                    && a.is_within(x_bo.transform_point(b.center), b.radius + margin)
            })
        })
    }

    /// Returns whether a box with these half extents about the origin of `x_wt` may be within `margin` metres of the
    /// body at `x_wb`. Has false positives only.
    pub(super) fn is_near(&self, x_wb: &DPose3, half: DVec3, x_wt: &DPose3, margin: f64) -> bool {
        let Some(parts) = &self.0 else {
            let up_t = x_wt.rotation.inverse() * (x_wb.rotation * DVec3::Z);
            let above = x_wb.inverse_transform_point(x_wt.translation).z;
            return above < up_t.abs().dot(half) + margin;
        };
        parts.iter().any(|part| {
            let p = x_wt.inverse_transform_point(x_wb.transform_point(part.center));
            p.distance(p.clamp(-half, half)) < part.radius + margin
        })
    }
}

impl PartBounds {
    /// Returns whether a point in the body's frame is within `reach` of the box.
    fn is_within(&self, p: DVec3, reach: f64) -> bool {
        let from_center = p - self.center;
        from_center.distance_squared(from_center.clamp(-self.half, self.half)) < reach * reach
    }
}

fn around(mesh: &Mesh) -> PartBounds {
    let (center, half) = Aabb::of_points(mesh.vertices.iter().copied())
        .map_or((DVec3::ZERO, DVec3::ZERO), |b| (b.center(), 0.5 * b.extents()));
    PartBounds { center, radius: mesh.vertices.iter().map(|p| p.distance(center)).fold(0.0, f64::max), half }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ball_meets_a_box_at_its_face_and_passes_beside_it() {
        let wall = Bounds::of(&BodyShape::Box { half_extents: DVec3::new(0.01, 0.2, 0.1) });
        let ball = Bounds::of(&BodyShape::Sphere { radius: 0.03 });
        let turned = DPose3::from_parts(DVec3::new(1.0, 0.0, 0.1), glamx::DQuat::from_rotation_z(0.5));
        let at = |x: f64, y: f64| turned * DPose3::from_translation(DVec3::new(x, y, -0.07));
        // Margin 1 mm.
        for (x, y, meets) in
            [(0.0405, 0.1, true), (0.0415, 0.1, false), (0.0, 0.2305, true), (0.0, 0.2315, false)]
        {
            assert_eq!(wall.meets(&turned, &ball, &at(x, y), 1e-3), meets, "{x} {y}");
            assert_eq!(ball.meets(&at(x, y), &wall, &turned, 1e-3), meets, "{x} {y}");
        }
        assert!(Bounds::of(&BodyShape::HalfSpace).meets(&turned, &ball, &at(5.0, 5.0), 0.0));
        assert!((wall.reach() - DVec3::new(0.01, 0.2, 0.1).length()).abs() < 1e-12);
    }

    #[test]
    fn a_box_is_near_what_its_faces_are_near() {
        let body = |shape| Bounds::of(&shape);
        let half = DVec3::new(0.01, 0.02, 0.03);
        let at = |x: f64, y: f64, z: f64| DPose3::from_translation(DVec3::new(x, y, z));
        let (ball, tool) = (body(BodyShape::Sphere { radius: 0.03 }), at(0.0, 0.0, 0.0));
        assert!(ball.is_near(&at(0.0405, 0.015, 0.0), half, &tool, 1e-3));
        assert!(!ball.is_near(&at(0.0415, 0.015, 0.0), half, &tool, 1e-3));
        let slab = Mesh::cuboid(DVec3::splat(0.02));
        let hulls = vec![slab.transformed(&at(0.2, 0.0, 0.0)), slab];
        let pair = body(BodyShape::Hulls { hulls });
        assert!(pair.is_near(&at(-0.2, 0.0, 0.0), half, &tool, 0.0), "the second part is near");
        assert!(!pair.is_near(&at(0.2, 0.0, 0.0), half, &tool, 0.0));
        let floor = body(BodyShape::HalfSpace);
        assert!(floor.is_near(&DPose3::IDENTITY, half, &at(0.0, 0.0, 0.0305), 1e-3));
        assert!(!floor.is_near(&DPose3::IDENTITY, half, &at(0.0, 0.0, 0.0315), 1e-3));
    }
}
