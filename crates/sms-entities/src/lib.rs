//! s without islands and without those that the frames contradict, become an even, oriented surface cloud. => without
//! islands and contradictions to the frames, become an even, oriented surface cloud. its support is found, labels that
//! bled over the edge between the two are corrected, and the contact area that no camera saw is closed. => find its
//! support, correct labels that bleed over the edge between the two, and close the unseen contact area. round objects
//! become spheres, whatever they are called; boxes => round objects become spheres; boxes where one object stands on
//! another, both get the level face that was seen or follows from the sides that were seen; overlapping => where one
//! object stands on another, both get the level face that was seen or that follows from the seen sides; overlapping the
//! unlabelled rest becomes => unlabelled surface becomes meshes get pictures from the frames => meshes get textures
//! from the frames

mod body;
mod build;
mod cloud;
mod config;
mod contact;
mod draft;
mod environment;
mod error;
#[cfg(test)]
mod fixtures;
mod foot;
mod hollow;
mod level;
mod lid;
mod mesher;
mod piece;
mod queries;
mod recognise;
mod relabel;
mod save;
mod stack;
mod standing;
mod support;
mod texture;
mod underside;
mod views;

pub use build::build_entities;
pub use cloud::object_gaussians;
pub use config::{EntitiesConfig, EnvironmentConfig, MeshRule, TextureConfig};
pub use error::EntitiesError;
pub use mesher::mesh_cloud;
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
