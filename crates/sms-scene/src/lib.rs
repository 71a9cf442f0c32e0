//! The simulation-ready scene: manifest and validation.
//!
//! [`build_scene`] combines reconstructed entities and their materials; [`Scene::validate`] checks the result for physics
//! engines; [`save_scene`] writes `scene.json` with its meshes. `sms-export` writes it for other simulators.
//!
//! ```
//! use sms_core::{Interval, glamx::{DPose3, DVec3}};
//! use sms_scene::{Scene, floor_body};
//! let scene = Scene {
//!     version: sms_scene::SCENE_VERSION,
//!     name: "empty desk".into(),
//!     gravity_w: DVec3::new(0.0, 0.0, -9.81),
//!     size_sigma: 0.0,
//!     x_world_recording: DPose3::identity(),
//!     bodies: vec![floor_body(0.0, sms_scene::example_material())],
//! };
//! assert!(scene.validate().is_empty());
//! ```

mod build;
mod manifest;
mod scene;
mod schema;
mod validate;

pub use build::{BuildError, GRAVITY, build_scene, example_material, floor_body, loose_mass};
pub use manifest::{SceneError, hull_file, load_scene, save_scene, trimesh_file, visual_file, write_meshes};
pub use scene::{Body, BodyKind, BodyShape, SCENE_VERSION, Scene};
pub use schema::SCENE_SCHEMA;
pub use validate::{MOST_SIZE_SIGMA, Problem};
