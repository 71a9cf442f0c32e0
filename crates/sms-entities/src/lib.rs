//! From Gaussians to objects: grouping, meshing, spheres, convex parts (paper, Section "Materialize").
//!
//! [`build_entities`] takes the trained model, the frames it was trained on and their labels, and gives one dynamic
//! [`sms_core::Entity`] per label and a static one for everything that no label explains. Object by object:
//!
//! 1. `cloud`: the Gaussians classified as the object, without islands and without what the frames contradict, become
//!    an even, oriented surface cloud.
//! 2. `support`, `underside`: what it rests on is found, labels that bled over the edge between the two are put right, and the contact
//!    area that no camera saw is closed.
//! 3. `sphere`: round objects become spheres, whatever they are called.
//! 4. `delaunay`, `inside`, `surface`, `refine`, `mesher`: the rest become closed meshes; `primitive`: boxes and
//!    cylinders that explain what was seen take the place of theirs.
//! 5. crate `sms-mesh`: meshes are split into convex parts for physics.
//! 6. `level`, `contact`, `stack`, `lid`: where one stands on another, both get the level face that was seen or follows from the sides
//!    that were seen; parts of different objects that overlap are cut apart, gaps are closed.
//! 7. `environment`: the unlabelled rest becomes a static triangle mesh.
//! 8. `texture` ([`bake_textures`]): meshes get pictures from the frames.
//!
//! ```
//! use sms_core::{Mesh, Seed, glamx::DVec3};
//! use sms_entities::{ConvexConfig, SphereConfig, convex_parts, delaunay, fit_sphere};
//! // A ball is recognised by its shape …
//! let ball = Mesh::icosphere(0.03, 3);
//! let fit = fit_sphere(&ball.vertices, &SphereConfig::default(), Seed(0)).unwrap();
//! assert!((fit.radius - 0.03).abs() < 1e-4);
//! // … and a box is one convex part that its tetrahedra fill.
//! let cube = Mesh::cuboid(DVec3::splat(0.05));
//! assert_eq!(convex_parts(&cube, &ConvexConfig::default()).len(), 1);
//! let solid = delaunay(&cube.vertices);
//! let volume: f64 = (0..solid.tetrahedra.len()).map(|t| solid.volume(t)).sum();
//! assert!((volume - 1e-3).abs() < 1e-12);
//! ```

mod body;
mod build;
mod cloud;
mod config;
mod contact;
mod decimate;
mod delaunay;
mod environment;
mod error;
mod foot;
mod grid;
mod hilbert;
mod hollow;
mod inside;
mod level;
mod lid;
mod maxflow;
mod mesher;
mod outline;
mod pca;
mod predicates;
mod primitive;
mod queries;
mod recognise;
mod refine;
mod save;
mod sphere;
mod stack;
mod support;
mod surface;
mod texture;
mod tsdf;
mod underside;
mod views;

pub use build::build_entities;
pub use cloud::object_gaussians;
pub use config::{EntitiesConfig, EnvironmentConfig, MeshRule, PrimitiveConfig, SphereConfig, TextureConfig};
pub use delaunay::{FACES, NONE, Tetrahedralization, delaunay};
pub use error::EntitiesError;
pub use mesher::mesh_cloud;
pub use primitive::{PrimitiveFit, fit_primitive};
pub use queries::material_queries;
pub use save::{load_entities, save_entities};
pub use sms_mesh::{ConvexConfig, convex_hull, convex_parts};
pub use sphere::{SphereFit, fit_sphere};
pub use texture::bake_textures;

use sms_core::{Entity, Labels};
use sms_gaussians::GaussianModel;

/// The stage's result.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct EntitySet {
    /// Objects in the order of their labels, then the environment.
    pub entities: Vec<Entity>,
    /// Height of the level plane that carries the scene, metres, where one was seen near the world's z = 0; it stands
    /// for the flat part of the environment, which the environment's mesh leaves out.
    pub support_height: Option<f64>,
    /// Labels of pieces with the labels of the objects they were joined to, in the order of joining.
    pub joined: Vec<(u16, u16)>,
}

impl EntitySet {
    /// Gives the pixels of joined pieces the label of the object they belong to now.
    pub fn relabel(&self, labels: &mut Labels) {
        build::relabel(labels, &self.joined);
    }

    /// Gives the Gaussians of joined pieces the label of the object they belong to now.
    pub fn relabel_model(&self, model: &mut GaussianModel) {
        for label in &mut model.labels {
            *label = build::host_of(*label, &self.joined);
        }
    }
}
