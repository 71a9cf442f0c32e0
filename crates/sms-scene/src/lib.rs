//! The simulation-ready scene: manifest, validation, export.

mod scene;

pub use scene::{Body, BodyKind, BodyShape, SCENE_VERSION, Scene};
