//! MuJoCo (feature `mujoco`), an independent target: soft contacts, solved implicitly, in double precision.
//!
//! The library is loaded at run time from [`MUJOCO_VARIABLE`]; the PyPI wheel `mujoco` contains it. Versions from 3.2
//! on are supported. Steps are split into substeps of at most 50 µs, so that the impact of a ball takes several.
//! Sleeping bodies are not in the model until another body comes near.
#![allow(unsafe_code, reason = "MuJoCo is C; every call is wrapped in `library`")]

mod library;
mod model;
mod near;
mod world;

pub use library::MUJOCO_VARIABLE;

use library::Library;
use sms_core::InputError;
use sms_scene::Scene;
use sms_sim::{SimError, World, WorldFactory, WorldOptions};
use std::sync::OnceLock;

/// A factory of MuJoCo worlds.
#[derive(Clone, Copy)]
pub struct MujocoFactory {
    library: &'static Library,
    engine: &'static str,
}

impl MujocoFactory {
    /// Loads the library.
    ///
    /// # Errors
    /// [`InputError`] if [`MUJOCO_VARIABLE`] does not lead to a usable library.
    pub fn new() -> Result<Self, InputError> {
        static NAME: OnceLock<String> = OnceLock::new();
        let library = Library::get()?;
        let engine = NAME.get_or_init(|| format!("mujoco {}", library.version()));
        Ok(Self { library, engine })
    }
}

impl WorldFactory for MujocoFactory {
    fn engine(&self) -> &'static str {
        self.engine
    }

    fn build(&self, scene: &Scene, options: &WorldOptions) -> Result<Box<dyn World>, SimError> {
        Ok(Box::new(world::MujocoWorld::build(self.engine, self.library, scene, options)?))
    }
}
