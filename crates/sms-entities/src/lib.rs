//! From Gaussians to objects: grouping, meshing, contact repair, textures (paper, Section "Materialize").
//!
//! [`build_entities`] takes the trained model, the frames it was trained on and their labels, and returns one dynamic
//! [`sms_core::Entity`] per label and a static one for all surface without a body. Object by object:
//!
//! 1. `cloud`: the Gaussians classified as the object, without islands and contradictions to the frames, become an
//!    even, oriented surface cloud.
//! 2. `support`, `underside`: find its support, correct labels that bleed over the edge between the two, and close the
//!    unseen contact area.
//! 3. `recognise`: round objects become spheres; boxes and cylinders that explain the points replace the mesh.
//! 4. `mesher`: the rest become closed meshes.
//! 5. Crate `sms-mesh` splits meshes into convex parts for physics.
//! 6. `level`, `contact`, `stack`, `lid`: where one object stands on another, both get the level face that was seen or
//!    that follows from the seen sides; overlapping parts of different objects are cut apart, gaps are closed.
//! 7. `fused`, `statics`, `environment`: bodies that are kept fixed, and surface without a body, become open static meshes of the fused surface
//!    of all frames (crate `sms-surface`).
//! 8. `texture` ([`bake_textures`]): meshes get textures from the frames.

mod body;
mod build;
mod cloud;
#[cfg(test)]
#[path = "../tests/it/common.rs"]
mod common;
mod config;
mod contact;
mod draft;
mod environment;
mod error;
#[cfg(test)]
mod fixtures;
mod foot;
mod frame_cells;
mod fused;
mod hollow;
mod level;
mod lid;
mod mesher;
#[cfg(test)]
mod mesher_tests;
mod piece;
mod places;
mod queries;
mod recognise;
mod relabel;
mod save;
mod stack;
mod standing;
mod statics;
mod support;
mod texel_colors;
mod texture;
mod underside;
mod views;

pub use build::build_entities;
pub use cloud::object_gaussians;
pub use config::{EntitiesConfig, EnvironmentConfig, MeshRule, TextureConfig};
pub use error::EntitiesError;
pub use queries::material_queries;
pub use save::{load_entities, save_entities};
pub use sms_mesh::{ConvexConfig, PrimitiveConfig, SphereConfig};
pub use texture::bake_textures;

use sms_core::{Entity, Labels};
use sms_gaussians::GaussianModel;

/// The stage's result.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EntitySet {
    /// Objects in the order of their labels, then the environment.
    pub entities: Vec<Entity>,
    /// Height of the level plane that carries the scene, metres, if one was seen near the world's z = 0. It replaces
    /// the flat part of the environment, which the environment's mesh leaves out.
    pub support_height: Option<f64>,
    /// Label of each joined piece with the label of its host, in the order of joining.
    pub joined: Vec<(u16, u16)>,
}

impl EntitySet {
    /// Relabels the pixels of joined pieces with the label of their host.
    pub fn relabel(&self, labels: &mut Labels) {
        relabel::relabel(labels, &self.joined);
    }

    /// Relabels the Gaussians of joined pieces with the label of their host.
    pub fn relabel_model(&self, model: &mut GaussianModel) {
        for label in &mut model.labels {
            *label = relabel::host_of(*label, &self.joined);
        }
    }
}
