//! Volume, centre of mass and inertia of reconstructed solids, compared with true ones at equal density.

use glamx::{DMat3, DPose3, DVec3};
use serde::{Deserialize, Serialize};
use sms_core::metrics::Metrics;
use sms_core::{
    Entity, EntityShape, InertiaError, MassProperties, Mesh, box_mass_properties, cylinder_mass_properties,
    polyhedron_mass_properties, sphere_mass_properties,
};

/// Difference between a reconstructed solid and the true one, both homogeneous.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct SolidScores {
    /// Reconstructed over true volume.
    pub volume_ratio: f64,
    /// Distance between the centres of mass, metres.
    pub mass_center_error_m: f64,
    /// Frobenius norm of the difference of the inertias per mass (m²) about the centres of mass, relative to the norm
    /// of the true one: 0 for equal shapes.
    pub inertia_error: f64,
}

impl SolidScores {
    /// Compares mass properties of two solids of the same density, in one frame.
    pub fn new(found: &MassProperties, truth: &MassProperties) -> Self {
        let per_mass = |m: &MassProperties| m.inertia() * (1.0 / m.mass());
        let norm = |m: DMat3| m.to_cols_array().iter().map(|v| v * v).sum::<f64>().sqrt();
        Self {
            volume_ratio: found.mass() / truth.mass(),
            mass_center_error_m: (found.com() - truth.com()).length(),
            inertia_error: norm(per_mass(found) - per_mass(truth)) / norm(per_mass(truth)),
        }
    }

    /// Returns the scores as `evaluate.<name>.*` metrics.
    pub fn metrics(&self, name: &str) -> Metrics {
        Metrics::of_fields(&format!("evaluate.{name}"), self)
    }
}

/// Returns the mass properties at 1 kg/m³ of an entity's solid in the world: its sphere, box or cylinder, else its
/// mesh.
///
/// # Errors
/// [`InertiaError`] when it encloses no volume, as an open surface.
pub fn entity_solid(entity: &Entity) -> Result<MassProperties, InertiaError> {
    match &entity.shape {
        EntityShape::Sphere { center_w, radius } => sphere_mass_properties(*center_w, *radius, 1.0),
        EntityShape::Box { x_ws, half_extents } => placed(&box_mass_properties(*half_extents, 1.0)?, x_ws),
        EntityShape::Cylinder { x_ws, radius, half_length } => {
            placed(&cylinder_mass_properties(*radius, *half_length, 1.0)?, x_ws)
        }
        EntityShape::TriMesh if !entity.mesh.is_closed_oriented() => Err(InertiaError::Volume(0.0)),
        EntityShape::Convex | EntityShape::TriMesh => polyhedron_mass_properties(&entity.mesh, 1.0),
    }
}

/// Returns the mass properties at 1 kg/m³ of a known solid in the world; `None` if the mesh is not closed.
pub fn known_solid(mesh_w: &Mesh, sphere: Option<(DVec3, f64)>) -> Option<MassProperties> {
    match sphere {
        Some((center_w, radius)) => sphere_mass_properties(center_w, radius, 1.0).ok(),
        None if mesh_w.is_closed_oriented() => polyhedron_mass_properties(mesh_w, 1.0).ok(),
        None => None,
    }
}

/// Transforms mass properties from a frame `S` to the world.
fn placed(mass: &MassProperties, x_ws: &DPose3) -> Result<MassProperties, InertiaError> {
    let turn = DMat3::from_quat(x_ws.rotation);
    MassProperties::new(
        mass.mass(),
        x_ws.transform_point(mass.com()),
        turn * mass.inertia() * turn.transpose(),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::DQuat;
    use sms_core::{EntityKind, PointCloud};

    fn entity(shape: EntityShape, mesh: Mesh) -> Entity {
        Entity {
            label: 1,
            name: "a".into(),
            description: String::new(),
            kind: EntityKind::Dynamic,
            shape,
            cloud: PointCloud::default(),
            mesh,
            texture: None,
            parts: Vec::new(),
            observed_share: 1.0,
            residual_m: 0.0,
            mean_color: [0; 3],
        }
    }

    #[test]
    fn errors_are_their_closed_forms() {
        let half = DVec3::new(0.03, 0.05, 0.02);
        let x_ws = DPose3::from_parts(
            DVec3::new(0.4, -0.2, 0.1),
            DQuat::from_scaled_axis(DVec3::new(0.3, 1.0, -0.4)),
        );
        let mesh = Mesh::cuboid(half).transformed(&x_ws);
        let truth = known_solid(&mesh, None).unwrap();
        // A box as primitive and the same box as mesh are the same solid.
        for shape in [EntityShape::Box { x_ws, half_extents: half }, EntityShape::Convex] {
            let found = entity_solid(&entity(shape, mesh.clone())).unwrap();
            let s = SolidScores::new(&found, &truth);
            assert!((s.volume_ratio - 1.0).abs() < 1e-12 && s.mass_center_error_m < 1e-12);
            assert!(s.inertia_error < 1e-9, "{s:?}");
        }
        // Ten percent larger and moved by 3 mm: volume × 1.331, inertia per mass × 1.21.
        let moved = DPose3::from_parts(x_ws.translation + DVec3::X * 0.003, x_ws.rotation);
        let larger = EntityShape::Box { x_ws: moved, half_extents: half * 1.1 };
        let s = SolidScores::new(&entity_solid(&entity(larger, Mesh::default())).unwrap(), &truth);
        assert!((s.volume_ratio - 1.331).abs() < 1e-9 && (s.mass_center_error_m - 0.003).abs() < 1e-12);
        assert!((s.inertia_error - 0.21).abs() < 1e-9, "{s:?}");
        assert_eq!(s.metrics("a").number("evaluate.a.volume_ratio"), Some(s.volume_ratio));
    }

    #[test]
    fn spheres_and_cylinders_are_exact_and_open_meshes_have_no_volume() {
        let center_w = DVec3::new(0.1, 0.2, 0.3);
        let sphere = entity(EntityShape::Sphere { center_w, radius: 0.04 }, Mesh::default());
        let truth = known_solid(&Mesh::default(), Some((center_w, 0.04))).unwrap();
        let s = SolidScores::new(&entity_solid(&sphere).unwrap(), &truth);
        assert_eq!((s.volume_ratio, s.mass_center_error_m, s.inertia_error), (1.0, 0.0, 0.0));
        let x_ws = DPose3::from_parts(center_w, DQuat::from_rotation_x(0.7));
        let shape = EntityShape::Cylinder { x_ws, radius: 0.03, half_length: 0.06 };
        let fine = known_solid(&Mesh::cylinder(0.03, 0.06, 720).transformed(&x_ws), None).unwrap();
        let s = SolidScores::new(&entity_solid(&entity(shape, Mesh::default())).unwrap(), &fine);
        assert!((s.volume_ratio - 1.0).abs() < 1e-4 && s.inertia_error < 1e-4, "{s:?}");
        let mut open = Mesh::cuboid(DVec3::ONE);
        open.triangles.pop();
        assert!(known_solid(&open, None).is_none());
    }
}
