//! From entities and materials to a scene.

use crate::{Body, BodyKind, BodyShape, SCENE_VERSION, Scene};
use glamx::{DPose3, DVec3};
use sms_core::{
    Entity, EntityKind, EntityShape, InertiaError, Interval, MassProperties, Material, Mesh, Property,
    PropertySource, polyhedron_mass_properties, sphere_mass_properties,
};

/// Standard gravity, m/s².
pub const GRAVITY: f64 = 9.806_65;

/// Subdivision of the icosphere that pictures a fitted sphere: 1280 triangles.
const SPHERE_PICTURE_LEVELS: usize = 3;

/// Why a scene could not be built.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// Materials are not parallel to entities.
    #[error("{entities} entities but {materials} materials")]
    Count {
        /// Number of entities.
        entities: usize,
        /// Number of materials.
        materials: usize,
    },
    /// An entity has no possible mass properties.
    #[error("`{name}` cannot be a rigid body: {source}")]
    Mass {
        /// The entity.
        name: String,
        /// Why.
        source: InertiaError,
    },
    /// A dynamic entity has no collision geometry.
    #[error("`{0}` has no convex parts to collide with")]
    NoParts(String),
}

/// The static half space that stands for the support plane at height `z_w` metres.
pub fn floor_body(z_w: f64, material: Material) -> Body {
    Body {
        name: "floor".into(),
        label: 0,
        description: "support plane".into(),
        kind: BodyKind::Static,
        x_wb: DPose3::from_translation(DVec3::new(0.0, 0.0, z_w)),
        shape: BodyShape::HalfSpace,
        visual: Mesh::default(),
        mass: None,
        material,
        color: [170, 165, 155],
        observed_share: 1.0,
    }
}

/// Puts reconstructed entities together; `materials` is parallel to `entities`. With a support height the floor
/// becomes a half space named `floor`.
///
/// A dynamic body's frame `B` has its origin at the centre of mass and its axes parallel to the world's.
///
/// # Errors
/// [`BuildError`] when an entity encloses no volume or has nothing to collide with.
pub fn build_scene(
    name: &str,
    entities: &[Entity],
    materials: &[Material],
    support: Option<(f64, Material)>,
    x_world_recording: DPose3,
) -> Result<Scene, BuildError> {
    if entities.len() != materials.len() {
        return Err(BuildError::Count { entities: entities.len(), materials: materials.len() });
    }
    let mut bodies = Vec::with_capacity(entities.len() + 1);
    if let Some((z_w, material)) = support {
        bodies.push(floor_body(z_w, material));
    }
    for (entity, material) in entities.iter().zip(materials) {
        bodies.push(match entity.kind {
            EntityKind::Dynamic => dynamic_body(entity, material.clone())?,
            EntityKind::Static => static_body(entity, material.clone()),
        });
    }
    Ok(Scene {
        version: SCENE_VERSION,
        name: name.to_owned(),
        gravity_w: DVec3::new(0.0, 0.0, -GRAVITY),
        x_world_recording,
        bodies,
    })
}

fn dynamic_body(entity: &Entity, material: Material) -> Result<Body, BuildError> {
    let density = material.density.value.best;
    let mass_error = |source| BuildError::Mass { name: entity.name.clone(), source };
    let (mass_w, shape, visual_w) = match &entity.shape {
        EntityShape::Sphere { center_w, radius } => {
            let mass = sphere_mass_properties(*center_w, *radius, density).map_err(mass_error)?;
            let mut visual = Mesh::icosphere(*radius, SPHERE_PICTURE_LEVELS)
                .transformed(&DPose3::from_translation(*center_w));
            visual.colors = vec![entity.mean_color; visual.vertices.len()];
            (mass, BodyShape::Sphere { radius: *radius }, visual)
        }
        EntityShape::Convex | EntityShape::TriMesh => {
            if entity.parts.is_empty() {
                return Err(BuildError::NoParts(entity.name.clone()));
            }
            let mass = polyhedron_mass_properties(&entity.mesh, density).map_err(mass_error)?;
            (mass, BodyShape::Hulls { hulls: entity.parts.clone() }, entity.mesh.clone())
        }
    };
    let x_wb = DPose3::from_translation(mass_w.com());
    let x_bw = x_wb.inverse();
    let shape = match shape {
        BodyShape::Hulls { hulls } => {
            BodyShape::Hulls { hulls: hulls.iter().map(|h| h.transformed(&x_bw)).collect() }
        }
        other => other,
    };
    let mass = MassProperties::new(mass_w.mass(), DVec3::ZERO, mass_w.inertia()).map_err(mass_error)?;
    Ok(Body {
        name: entity.name.clone(),
        label: entity.label,
        description: entity.description.clone(),
        kind: BodyKind::Dynamic,
        x_wb,
        shape,
        visual: visual_w.transformed(&x_bw),
        mass: Some(mass),
        material,
        color: entity.mean_color,
        observed_share: entity.observed_share,
    })
}

fn static_body(entity: &Entity, material: Material) -> Body {
    let (x_wb, shape) = match &entity.shape {
        EntityShape::Sphere { center_w, radius } => {
            (DPose3::from_translation(*center_w), BodyShape::Sphere { radius: *radius })
        }
        EntityShape::Convex if !entity.parts.is_empty() => {
            (DPose3::identity(), BodyShape::Hulls { hulls: entity.parts.clone() })
        }
        _ => (DPose3::identity(), BodyShape::TriMesh { mesh: without_colors(&entity.mesh) }),
    };
    Body {
        name: entity.name.clone(),
        label: entity.label,
        description: entity.description.clone(),
        kind: BodyKind::Static,
        x_wb,
        shape,
        visual: entity.mesh.transformed(&x_wb.inverse()),
        mass: None,
        material,
        color: entity.mean_color,
        observed_share: entity.observed_share,
    }
}

fn without_colors(mesh: &Mesh) -> Mesh {
    Mesh::new(mesh.vertices.clone(), mesh.triangles.clone())
}

/// A plain material for examples and tests: wood-like, every value from a prior with ±20 %.
pub fn example_material() -> Material {
    let prior = |best: f64| Property::new(Interval::new(best, 0.8 * best, 1.2 * best), PropertySource::Prior);
    Material {
        class: "example".into(),
        density: prior(700.0),
        friction: prior(0.5),
        restitution: prior(0.5),
        rolling_m: prior(1e-4),
        youngs_modulus_pa: prior(1e10),
        poissons_ratio: prior(0.3),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::PointCloud;

    fn entity(name: &str, mesh: Mesh, shape: EntityShape) -> Entity {
        Entity {
            label: 1,
            name: name.into(),
            description: String::new(),
            kind: EntityKind::Dynamic,
            shape,
            cloud: PointCloud::default(),
            parts: vec![mesh.clone()],
            mesh,
            observed_share: 0.8,
            residual_m: 0.0,
            mean_color: [10, 20, 30],
        }
    }

    #[test]
    fn bodies_are_centred_at_their_centre_of_mass() {
        let at = DVec3::new(0.4, -0.1, 0.05);
        let half = DVec3::new(0.02, 0.03, 0.05);
        let mesh = Mesh::cuboid(half).transformed(&DPose3::from_translation(at));
        let sphere = EntityShape::Sphere { center_w: DVec3::new(0.0, 0.0, 0.03), radius: 0.03 };
        let entities =
            [entity("box", mesh, EntityShape::Convex), entity("ball", Mesh::icosphere(0.03, 2), sphere)];
        let materials = vec![example_material(); 2];
        let scene =
            build_scene("t", &entities, &materials, Some((0.0, example_material())), DPose3::identity())
                .unwrap();
        assert_eq!(scene.validate(), Vec::new());
        let body = scene.body("box").unwrap();
        assert!((body.x_wb.translation - at).length() < 1e-12);
        let mass = body.mass.unwrap();
        assert!((mass.mass() - 700.0 * 8.0 * half.x * half.y * half.z).abs() < 1e-9);
        assert!(mass.com().length() < 1e-12);
        let BodyShape::Hulls { hulls } = &body.shape else { panic!("a box has hulls") };
        assert!(hulls[0].aabb().unwrap().center().length() < 1e-12);
        assert!(matches!(scene.body("ball").unwrap().shape, BodyShape::Sphere { radius } if radius == 0.03));
    }

    #[test]
    fn an_inside_out_mesh_is_refused_by_name() {
        let mut mesh = Mesh::cuboid(DVec3::splat(0.02));
        mesh.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        let entities = [entity("bad", mesh, EntityShape::Convex)];
        let error = build_scene("t", &entities, &[example_material()], None, DPose3::identity()).unwrap_err();
        assert!(error.to_string().contains("bad"));
    }
}
