//! Whether what strikes is about to touch something.

use glamx::{DPose3, DVec3};
use sms_core::{Aabb, Mesh};
use sms_scene::BodyShape;
use sms_sim::KinematicShape;

/// Spheres that hold a body, in its frame; `None` for a half space.
pub(super) struct Bounds(Option<Vec<(DVec3, f64)>>);

impl Bounds {
    pub(super) fn of(shape: &BodyShape) -> Self {
        Self(match shape {
            BodyShape::HalfSpace => None,
            BodyShape::Sphere { radius } => Some(vec![(DVec3::ZERO, *radius)]),
            BodyShape::Box { half_extents } => Some(vec![(DVec3::ZERO, half_extents.length())]),
            BodyShape::Cylinder { radius, half_length } => {
                Some(vec![(DVec3::ZERO, radius.hypot(*half_length))])
            }
            BodyShape::Hulls { hulls } => Some(hulls.iter().map(around).collect()),
            BodyShape::TriMesh { mesh } => Some(vec![around(mesh)]),
        })
    }

    /// Whether a box about the origin of `x_wt` comes within `margin` metres of the body at `x_wb`. Never false where it does.
    pub(super) fn is_near(&self, x_wb: &DPose3, shape: KinematicShape, x_wt: &DPose3, margin: f64) -> bool {
        let half = match shape {
            KinematicShape::Cuboid { half } => half,
            KinematicShape::Capsule { half_length, radius } => {
                DVec3::new(radius, radius, half_length + radius)
            }
        };
        let Some(spheres) = &self.0 else {
            let up_t = x_wt.rotation.inverse() * (x_wb.rotation * DVec3::Z);
            let above = x_wb.inverse_transform_point(x_wt.translation).z;
            return above < up_t.abs().dot(half) + margin;
        };
        spheres.iter().any(|&(center, radius)| {
            let p = x_wt.inverse_transform_point(x_wb.transform_point(center));
            p.distance(p.clamp(-half, half)) < radius + margin
        })
    }
}

fn around(mesh: &Mesh) -> (DVec3, f64) {
    let center = Aabb::of_points(mesh.vertices.iter().copied()).map_or(DVec3::ZERO, |b| b.center());
    (center, mesh.vertices.iter().map(|p| p.distance(center)).fold(0.0, f64::max))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_is_near_what_its_faces_are_near() {
        let body = |shape| Bounds::of(&shape);
        let shape = KinematicShape::Cuboid { half: DVec3::new(0.01, 0.02, 0.03) };
        let at = |x: f64, y: f64, z: f64| DPose3::from_translation(DVec3::new(x, y, z));
        let (ball, tool) = (body(BodyShape::Sphere { radius: 0.03 }), at(0.0, 0.0, 0.0));
        assert!(ball.is_near(&at(0.0405, 0.015, 0.0), shape, &tool, 1e-3));
        assert!(!ball.is_near(&at(0.0415, 0.015, 0.0), shape, &tool, 1e-3));
        let slab = Mesh::cuboid(DVec3::splat(0.02));
        let hulls = vec![slab.transformed(&at(0.2, 0.0, 0.0)), slab];
        let pair = body(BodyShape::Hulls { hulls });
        assert!(pair.is_near(&at(-0.2, 0.0, 0.0), shape, &tool, 0.0), "the second part is there");
        assert!(!pair.is_near(&at(0.2, 0.0, 0.0), shape, &tool, 0.0));
        let floor = body(BodyShape::HalfSpace);
        assert!(floor.is_near(&DPose3::IDENTITY, shape, &at(0.0, 0.0, 0.0305), 1e-3));
        assert!(!floor.is_near(&DPose3::IDENTITY, shape, &at(0.0, 0.0, 0.0315), 1e-3));
    }
}
