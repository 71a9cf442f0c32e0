//! Rigid-body scenes.

use glamx::{DPose3, DVec3};
use serde::{Deserialize, Serialize};
use sms_core::{Aabb, MassProperties, Material, Mesh, MeshTexture};

/// Version of the manifest's schema; readers refuse newer ones.
pub const SCENE_VERSION: u32 = 1;

/// A rigid-body scene in the world `W`: metres, kilograms, z up.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// Schema version.
    pub version: u32,
    /// Name.
    pub name: String,
    /// Gravity in the world, m/s².
    pub gravity_w: DVec3,
    /// Standard deviation of sizes and distances, as a share, from the uncertainty of the camera poses: of the scale of the camera
    /// positions, or of the least certain distance between opposite faces. 0 if unknown.
    pub size_sigma: f64,
    /// `X_world_recording` of the scan this came from.
    pub x_world_recording: DPose3,
    /// The bodies; names are unique.
    pub bodies: Vec<Body>,
}

/// Whether a body is dynamic or static.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BodyKind {
    /// Free.
    Dynamic,
    /// Fixed.
    Static,
}

/// Collision shape in the body frame `B`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum BodyShape {
    /// A sphere centred at the body's origin.
    Sphere {
        /// Radius in metres.
        radius: f64,
    },
    /// A box centred at the body's origin, edges along the axes of `B`.
    Box {
        /// Half of the edge lengths, metres.
        half_extents: DVec3,
    },
    /// A cylinder with flat ends, centred at the body's origin, axis along z of `B`.
    Cylinder {
        /// Radius in metres.
        radius: f64,
        /// Half of the length along the axis, metres.
        half_length: f64,
    },
    /// The half space below the plane z = 0 of the body frame (static only).
    HalfSpace,
    /// Convex hulls, each a closed mesh whose vertices are its corners.
    Hulls {
        /// The hulls, in `B`.
        hulls: Vec<Mesh>,
    },
    /// A triangle mesh (static only).
    TriMesh {
        /// The mesh, in `B`.
        mesh: Mesh,
    },
}

/// Corners of the polygon of a cylinder's end in mesh form.
const CYLINDER_SEGMENTS: usize = 48;

impl BodyShape {
    fn scale(&mut self, factor: f64) {
        let scale = |mesh: &mut Mesh| mesh.vertices.iter_mut().for_each(|v| *v *= factor);
        match self {
            Self::Sphere { radius } => *radius *= factor,
            Self::Box { half_extents } => *half_extents *= factor,
            Self::Cylinder { radius, half_length } => {
                *radius *= factor;
                *half_length *= factor;
            }
            Self::HalfSpace => {}
            Self::Hulls { hulls } => hulls.iter_mut().for_each(scale),
            Self::TriMesh { mesh } => scale(mesh),
        }
    }

    /// Returns the surface as meshes in `B`; spheres and cylinders are approximated, a half space has none.
    pub fn meshes(&self) -> Vec<Mesh> {
        match self {
            Self::Sphere { radius } => vec![Mesh::icosphere(*radius, 2)],
            Self::Box { half_extents } => vec![Mesh::cuboid(*half_extents)],
            Self::Cylinder { radius, half_length } => {
                vec![Mesh::cylinder(*radius, *half_length, CYLINDER_SEGMENTS)]
            }
            Self::HalfSpace => Vec::new(),
            Self::Hulls { hulls } => hulls.clone(),
            Self::TriMesh { mesh } => vec![mesh.clone()],
        }
    }
}

/// A rigid body. For dynamic bodies the origin of `B` is the centre of mass. At scan time the axes of `B` are parallel to
/// those of `W`, but for boxes and cylinders, which are aligned with `B`.
#[derive(Debug, Clone, PartialEq)]
pub struct Body {
    /// Unique name, usable as a file name.
    pub name: String,
    /// Label id of the entity this came from; 0 for the environment.
    pub label: u16,
    /// The labeller's description; may be empty.
    pub description: String,
    /// Whether it is dynamic or static.
    pub kind: BodyKind,
    /// Pose of the body in the world, `X_WB`.
    pub x_wb: DPose3,
    /// Collision shape in `B`.
    pub shape: BodyShape,
    /// Visual surface, in `B`.
    pub visual: Mesh,
    /// Image texture of `visual`; `None` if it has vertex colours only.
    pub texture: Option<MeshTexture>,
    /// Mass, centre of mass and inertia in `B`; `None` for static bodies.
    pub mass: Option<MassProperties>,
    /// Material, with intervals.
    pub material: Material,
    /// Mean sRGB colour.
    pub color: [u8; 3],
    /// Share of the surface that cameras observed.
    pub observed_share: f64,
    /// Standard error of a coordinate of its position from the residuals of its reconstruction, metres; 0 if unknown. Excludes
    /// errors common to all bodies (scale, the recording's pose).
    pub fit_se_m: f64,
}

impl Body {
    /// Returns the axis-aligned bounding box of the collision shape in the world; `None` for a half space.
    pub fn aabb_w(&self) -> Option<Aabb> {
        if let BodyShape::Sphere { radius } = self.shape {
            let center = self.x_wb.translation;
            return Some(Aabb { min: center - radius, max: center + radius });
        }
        let vertices = self.shape.meshes().into_iter().flat_map(|m| m.vertices);
        Aabb::of_points(vertices.map(|p| self.x_wb.transform_point(p)))
    }
}

impl Scene {
    /// Returns the body of this name.
    pub fn body(&self, name: &str) -> Option<&Body> {
        self.bodies.iter().find(|b| b.name == name)
    }

    /// Returns the scene without visual meshes and textures: those of a hundred perturbed scenes would fill the memory.
    pub fn without_pictures(&self) -> Self {
        let mut bare = self.clone();
        for body in &mut bare.bodies {
            (body.visual, body.texture) = (Mesh::default(), None);
        }
        bare
    }

    /// Returns the scene with all sizes and distances multiplied by `factor`, about the mean position of the dynamic bodies.
    /// Bodies keep their contacts and their densities. Visual meshes and textures are not kept.
    pub fn scaled(&self, factor: f64) -> Self {
        let mut scaled = self.without_pictures();
        let dynamic = || scaled.bodies.iter().filter(|b| b.kind == BodyKind::Dynamic);
        let sum: DVec3 = dynamic().map(|b| b.x_wb.translation).sum();
        let center_w = sum / dynamic().count().max(1) as f64;
        for body in &mut scaled.bodies {
            body.x_wb.translation = center_w + (body.x_wb.translation - center_w) * factor;
            body.shape.scale(factor);
            body.mass = body.mass.map(|was| {
                let (mass, com) = (was.mass() * factor.powi(3), was.com() * factor);
                // A positive multiple of a valid inertia is valid.
                MassProperties::new(mass, com, was.inertia() * factor.powi(5)).unwrap_or(was)
            });
        }
        scaled
    }

    /// Returns the index of the body of this name.
    pub fn body_index(&self, name: &str) -> Option<usize> {
        self.bodies.iter().position(|b| b.name == name)
    }
}
