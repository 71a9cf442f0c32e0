//! Construction of a scene from entities and materials.

use crate::{Body, BodyKind, BodyShape, SCENE_VERSION, Scene};
use glamx::{DPose3, DVec3};
use sms_core::{
    Entity, EntityKind, EntityShape, InertiaError, Interval, MassProperties, Material, Mesh, Property,
    PropertySource, box_mass_properties, cylinder_mass_properties, polyhedron_mass_properties,
    sphere_mass_properties,
};

/// Standard gravity, m/s².
pub const GRAVITY: f64 = 9.806_65;

/// Errors of building a scene.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// The numbers of materials and entities differ.
    #[error("{entities} entities but {materials} materials")]
    Count {
        /// Number of entities.
        entities: usize,
        /// Number of materials.
        materials: usize,
    },
    /// An entity has impossible mass properties.
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

/// Creates the static half space of the support plane at height `z_w` metres.
pub fn floor_body(z_w: f64, material: Material) -> Body {
    Body {
        name: "floor".into(),
        label: 0,
        description: "support plane".into(),
        kind: BodyKind::Static,
        x_wb: DPose3::from_translation(DVec3::new(0.0, 0.0, z_w)),
        shape: BodyShape::HalfSpace,
        visual: Mesh::default(),
        texture: None,
        mass: None,
        material,
        color: [170, 165, 155],
        observed_share: 1.0,
        fit_se_m: 0.0,
    }
}

/// Builds a scene from reconstructed entities; `materials` is parallel to `entities`. With a support height the floor
/// becomes a half space named `floor`.
///
/// A dynamic body's frame `B` has its origin at the centre of mass; its axes are those of the box or cylinder, else
/// parallel to the world's.
///
/// # Errors
/// [`BuildError`] when an entity encloses no volume or has no collision geometry.
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
        size_sigma: 0.0,
        x_world_recording,
        bodies,
    })
}

fn dynamic_body(entity: &Entity, material: Material) -> Result<Body, BuildError> {
    let mass_error = |source| BuildError::Mass { name: entity.name.clone(), source };
    let primitive = primitive(&entity.shape);
    if primitive.is_none() && entity.parts.is_empty() {
        return Err(BuildError::NoParts(entity.name.clone()));
    }
    let density = material.density.value.best;
    let solid = solid(primitive.as_ref(), &entity.mesh, density).map_err(mass_error)?;
    let x_wb = frame_w(&entity.shape) * DPose3::from_translation(solid.com());
    let x_bw = x_wb.inverse();
    let mass = hollowed(&solid, material.fill_factor.value.best).map_err(mass_error)?;
    let shape = primitive.unwrap_or_else(|| BodyShape::Hulls {
        hulls: entity.parts.iter().map(|h| h.transformed(&x_bw)).collect(),
    });
    Ok(body_of(entity, material, x_wb, shape, Some(mass)))
}

/// Creates the body of an entity: a dynamic one if it has a mass.
fn body_of(
    entity: &Entity,
    material: Material,
    x_wb: DPose3,
    shape: BodyShape,
    mass: Option<MassProperties>,
) -> Body {
    Body {
        name: entity.name.clone(),
        label: entity.label,
        description: entity.description.clone(),
        kind: if mass.is_some() { BodyKind::Dynamic } else { BodyKind::Static },
        x_wb,
        shape,
        visual: entity.mesh.transformed(&x_wb.inverse()),
        texture: entity.texture.clone(),
        mass,
        material,
        color: entity.mean_color,
        observed_share: entity.observed_share,
        fit_se_m: fit_se_m(entity),
    }
}

/// Computes the mass properties of a homogeneous primitive, or else of the volume that `surface` encloses.
fn solid(shape: Option<&BodyShape>, surface: &Mesh, density: f64) -> Result<MassProperties, InertiaError> {
    match shape {
        Some(BodyShape::Sphere { radius }) => sphere_mass_properties(DVec3::ZERO, *radius, density),
        Some(BodyShape::Box { half_extents }) => box_mass_properties(*half_extents, density),
        Some(BodyShape::Cylinder { radius, half_length }) => {
            cylinder_mass_properties(*radius, *half_length, density)
        }
        _ => polyhedron_mass_properties(surface, density),
    }
}

/// The frame of an entity's primitive in the world; else the world's.
fn frame_w(shape: &EntityShape) -> DPose3 {
    match shape {
        EntityShape::Sphere { center_w, .. } => DPose3::from_translation(*center_w),
        EntityShape::Box { x_ws, .. } | EntityShape::Cylinder { x_ws, .. } => *x_ws,
        EntityShape::Convex | EntityShape::TriMesh => DPose3::identity(),
    }
}

/// Largest distance of a static body's frame from its centre of mass, where a dynamic body has its frame, metres.
const CENTERED_M: f64 = 1e-3;

/// Returns the mass properties that a static body would have as a dynamic one: those of its shape with its material, as in
/// [`build_scene`]. A body that was fixed because it did not rest gets its earlier mass. `None` for half spaces, open surfaces,
/// and bodies with a frame off their centre of mass.
pub fn loose_mass(body: &Body) -> Option<MassProperties> {
    if matches!(body.shape, BodyShape::HalfSpace | BodyShape::TriMesh { .. }) {
        return None;
    }
    let solid = solid(Some(&body.shape), &body.visual, body.material.density.value.best);
    let solid = solid.ok().filter(|s| s.com().length() <= CENTERED_M)?;
    hollowed(&solid, body.material.fill_factor.value.best).ok()
}

impl Scene {
    /// Makes every solid body dynamic: static ones keep their mass, or get that of their shape (see [`loose_mass`]).
    pub fn loosened(&self) -> Self {
        let mut loose = self.clone();
        for body in loose.bodies.iter_mut().filter(|b| b.kind == BodyKind::Static) {
            if let Some(mass) = body.mass.or_else(|| loose_mass(body)) {
                (body.kind, body.mass) = (BodyKind::Dynamic, Some(mass));
            }
        }
        loose
    }
}

/// Returns the mass properties of a homogeneous body with a void of its own shape, scaled by `s` about its centre of mass, such
/// that `1 − s³` is the filled share of its volume: the moments scale with `1 − s⁵`. A filled body is the solid itself. The
/// result is about the centre of mass.
fn hollowed(solid: &MassProperties, fill_factor: f64) -> Result<MassProperties, InertiaError> {
    let scale = (1.0 - fill_factor.clamp(0.0, 1.0)).cbrt();
    MassProperties::new(solid.mass() * fill_factor, DVec3::ZERO, solid.inertia() * (1.0 - scale.powi(5)))
}

fn primitive(shape: &EntityShape) -> Option<BodyShape> {
    match shape {
        EntityShape::Sphere { radius, .. } => Some(BodyShape::Sphere { radius: *radius }),
        EntityShape::Box { half_extents, .. } => Some(BodyShape::Box { half_extents: *half_extents }),
        EntityShape::Cylinder { radius, half_length, .. } => {
            Some(BodyShape::Cylinder { radius: *radius, half_length: *half_length })
        }
        EntityShape::Convex | EntityShape::TriMesh => None,
    }
}

/// Estimates the standard error of a coordinate of an entity's position from the scatter of its surface points. Errors of
/// neighbouring points are correlated: each patch counts once, and a third of the patches faces either way along an axis.
fn fit_se_m(entity: &Entity) -> f64 {
    const PATCH_M2: f64 = 1e-4;
    // Ratio of the standard deviation to the median absolute value of a normal distribution.
    let deviation = 1.4826 * entity.residual_m.max(0.0);
    let patches = (entity.mesh.area() * entity.observed_share / PATCH_M2).max(1.0);
    deviation * (3.0 / patches).min(1.0).sqrt()
}

fn static_body(entity: &Entity, material: Material) -> Body {
    let shape = match primitive(&entity.shape) {
        Some(shape) => shape,
        None if entity.shape == EntityShape::Convex && !entity.parts.is_empty() => {
            BodyShape::Hulls { hulls: entity.parts.clone() }
        }
        // Without the colours.
        None => BodyShape::TriMesh {
            mesh: Mesh::new(entity.mesh.vertices.clone(), entity.mesh.triangles.clone()),
        },
    };
    body_of(entity, material, frame_w(&entity.shape), shape, None)
}

/// Returns a plain material for examples and tests: wood-like, every value from a prior with ±20 %.
pub fn example_material() -> Material {
    let prior = |best: f64| Property::new(Interval::new(best, 0.8 * best, 1.2 * best), PropertySource::Prior);
    Material {
        class: "example".into(),
        density: prior(700.0),
        fill_factor: Property::new(Interval::exact(1.0), PropertySource::Prior),
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
    use glamx::{DQuat, EulerRot};
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
            texture: None,
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
    fn primitives_are_aligned_with_their_body_and_hollow_ones_weigh_less() {
        let turned = DQuat::from_euler(EulerRot::ZYX, 0.4, 0.2, -0.3);
        let x_ws = DPose3::from_parts(DVec3::new(0.1, 0.2, 0.3), turned);
        let half_extents = DVec3::new(0.02, 0.03, 0.05);
        let of_box = EntityShape::Box { x_ws, half_extents };
        let of_tube = EntityShape::Cylinder { x_ws, radius: 0.03, half_length: 0.06 };
        let entities = [
            entity("box", Mesh::cuboid(half_extents).transformed(&x_ws), of_box),
            entity("tube", Mesh::cylinder(0.03, 0.06, 64).transformed(&x_ws), of_tube),
        ];
        let mut hollow = example_material();
        hollow.fill_factor = Property::new(Interval::new(0.271, 0.1, 0.5), PropertySource::Table);
        let materials = [example_material(), hollow];
        let scene = build_scene("t", &entities, &materials, None, DPose3::identity()).unwrap();
        assert_eq!(scene.validate(), Vec::new());
        let (cuboid, tube) = (&scene.bodies[0], &scene.bodies[1]);
        assert_eq!((cuboid.x_wb, tube.x_wb), (x_ws, x_ws));
        assert!((cuboid.visual.aabb().unwrap().max - half_extents).length() < 1e-12);
        let mass = tube.mass.unwrap();
        let volume = std::f64::consts::PI * 9e-4 * 0.12;
        assert!((mass.mass() / (700.0 * 0.271 * volume) - 1.0).abs() < 1e-12);
        // A void of 0.9 of the size: outer minus inner moment, about the axis.
        let axial = 0.5 * 700.0 * volume * 9e-4 * (1.0 - 0.9f64.powi(5));
        assert!((mass.inertia().z_axis.z / axial - 1.0).abs() < 1e-12);
    }

    #[test]
    fn loose_mass_is_the_mass_of_the_dynamic_body() {
        let x_ws = DPose3::from_parts(DVec3::new(0.4, -0.1, 0.05), DQuat::from_rotation_z(0.3));
        let half_extents = DVec3::new(0.02, 0.03, 0.05);
        let mesh = Mesh::cuboid(half_extents).transformed(&x_ws);
        let entities = [
            entity("hulls", mesh.clone(), EntityShape::Convex),
            entity("box", mesh.clone(), EntityShape::Box { x_ws, half_extents }),
            Entity { kind: EntityKind::Static, ..entity("wall", mesh.clone(), EntityShape::Convex) },
            Entity { kind: EntityKind::Static, ..entity("surface", mesh, EntityShape::TriMesh) },
        ];
        let mut material = example_material();
        material.fill_factor = Property::new(Interval::exact(0.3), PropertySource::Table);
        let floor = Some((0.0, example_material()));
        let scene = build_scene("t", &entities, &vec![material; 4], floor, DPose3::identity()).unwrap();
        for name in ["hulls", "box"] {
            let body = scene.body(name).unwrap();
            let fixed = Body { kind: BodyKind::Static, mass: None, ..body.clone() };
            let (was, is) = (body.mass.unwrap(), loose_mass(&fixed).unwrap());
            assert!((is.mass() / was.mass() - 1.0).abs() < 1e-9, "{name}: {} {}", is.mass(), was.mass());
            let off = is.inertia() - was.inertia();
            assert!(off.to_cols_array().iter().all(|v| v.abs() < 1e-9), "{name}: {off}");
        }
        for name in ["floor", "wall", "surface"] {
            assert_eq!(loose_mass(scene.body(name).unwrap()), None, "{name}");
        }
    }

    #[test]
    fn poor_fits_and_few_observations_increase_the_standard_error() {
        let se = |half: f64, residual_m: f64, observed_share: f64| {
            let mesh = Mesh::cuboid(DVec3::splat(half));
            fit_se_m(&Entity { residual_m, observed_share, ..entity("box", mesh, EntityShape::Convex) })
        };
        // A cube of 4 cm has 96 patches of a square centimetre.
        let expected = 1.4826e-3 * (3.0f64 / 48.0).sqrt();
        assert!((se(0.02, 1e-3, 0.5) - expected).abs() < 1e-9);
        assert!(se(0.02, 1e-3, 0.1) > se(0.02, 1e-3, 0.5) && se(0.02, 2e-3, 0.5) > se(0.02, 1e-3, 0.5));
        assert_eq!((se(0.02, 0.0, 0.5), se(0.001, 1e-3, 0.5)), (0.0, 1.4826e-3));
    }

    #[test]
    fn an_inside_out_mesh_is_refused_by_name() {
        let mut mesh = Mesh::cuboid(DVec3::splat(0.02));
        mesh.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        let entities = [entity("bad", mesh, EntityShape::Convex)];
        let built = build_scene("t", &entities, &[example_material()], None, DPose3::identity());
        assert!(matches!(built, Err(BuildError::Mass { name, .. }) if name == "bad"));
    }
}
