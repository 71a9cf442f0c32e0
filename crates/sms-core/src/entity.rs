//! Reconstructed objects.

use crate::{Mesh, MeshTexture};
use glamx::{DPose3, DVec3};
use serde::{Deserialize, Serialize};

/// Whether an entity is dynamic or static.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EntityKind {
    /// A free rigid body.
    Dynamic,
    /// A fixed collider: floor, bin, wall, everything without a label.
    Static,
}

/// The collision shape, in the world frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum EntityShape {
    /// A sphere.
    Sphere {
        /// Centre in the world, metres.
        center_w: DVec3,
        /// Radius, metres.
        radius: f64,
    },
    /// A box.
    Box {
        /// Pose of the shape's frame `S` (origin at the centre, axes along the edges) in the world.
        x_ws: DPose3,
        /// Half of the edge lengths along the axes of `S`, metres.
        half_extents: DVec3,
    },
    /// A cylinder with flat ends.
    Cylinder {
        /// Pose of the shape's frame `S` (origin at the centre, z along the axis) in the world.
        x_ws: DPose3,
        /// Radius, metres.
        radius: f64,
        /// Half of the length along the axis, metres.
        half_length: f64,
    },
    /// Convex parts (see [`Entity::parts`]).
    Convex,
    /// The triangle mesh itself; for static entities only.
    TriMesh,
}

impl EntityShape {
    /// Returns whether the shape is one exact solid (sphere, box or cylinder).
    pub fn is_primitive(&self) -> bool {
        matches!(self, Self::Sphere { .. } | Self::Box { .. } | Self::Cylinder { .. })
    }
}

/// Oriented, coloured surface points in the world frame.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct PointCloud {
    /// Positions, metres.
    pub points_w: Vec<DVec3>,
    /// Unit normals facing outwards (towards the cameras that saw them).
    pub normals_w: Vec<DVec3>,
    /// sRGB.
    pub colors: Vec<[u8; 3]>,
}

/// One reconstructed object (or the static environment), with its geometry in the world frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Entity {
    /// Label id in the label maps; 0 for the environment.
    pub label: u16,
    /// Unique name, usable as a file name.
    pub name: String,
    /// The labeller's description; may be empty.
    pub description: String,
    /// Whether it is dynamic or static.
    pub kind: EntityKind,
    /// Collision shape.
    pub shape: EntityShape,
    /// Densified surface points.
    pub cloud: PointCloud,
    /// Closed surface (for dynamic entities) or open surface (for static ones), world frame.
    pub mesh: Mesh,
    /// Texture of the mesh, baked from the frames; `None` if it has vertex colours only.
    pub texture: Option<MeshTexture>,
    /// Convex parts, world frame; empty for spheres, boxes, cylinders and static triangle meshes.
    pub parts: Vec<Mesh>,
    /// Share of the mesh's surface area that cameras observed, 0 to 1.
    pub observed_share: f64,
    /// Median distance of the cloud to the mesh (or sphere), metres.
    pub residual_m: f64,
    /// Mean sRGB colour of the observed surface.
    pub mean_color: [u8; 3],
}
