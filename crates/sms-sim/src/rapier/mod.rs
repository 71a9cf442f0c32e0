//! The Rapier engine: one source, compiled for single precision and, with the feature `f64`, for double precision too.

use crate::{SimError, World, WorldFactory, WorldOptions};
use sms_scene::Scene;

#[cfg(feature = "f64")]
mod double;
mod single;

/// Rapier in single precision: the engine of the planner.
#[derive(Debug, Clone, Copy, Default)]
pub struct RapierFactory;

/// Rapier in single precision under another name, for a target that must be distinguishable.
#[derive(Debug, Clone, Copy)]
pub struct NamedRapier {
    /// Result of [`WorldFactory::engine`].
    pub name: &'static str,
}

/// Rapier in double precision: the reference of tests and experiments.
#[cfg(feature = "f64")]
#[derive(Debug, Clone, Copy, Default)]
pub struct RapierF64Factory;

impl WorldFactory for NamedRapier {
    fn engine(&self) -> &'static str {
        self.name
    }

    fn build(&self, scene: &Scene, options: &WorldOptions) -> Result<Box<dyn World>, SimError> {
        Ok(Box::new(single::adapter::RapierWorld::build(self.name, scene, options)?))
    }
}

impl WorldFactory for RapierFactory {
    fn engine(&self) -> &'static str {
        "rapier3d f32"
    }

    fn build(&self, scene: &Scene, options: &WorldOptions) -> Result<Box<dyn World>, SimError> {
        Ok(Box::new(single::adapter::RapierWorld::build(self.engine(), scene, options)?))
    }
}

#[cfg(feature = "f64")]
impl WorldFactory for RapierF64Factory {
    fn engine(&self) -> &'static str {
        "rapier3d f64"
    }

    fn build(&self, scene: &Scene, options: &WorldOptions) -> Result<Box<dyn World>, SimError> {
        Ok(Box::new(double::adapter::RapierWorld::build(self.engine(), scene, options)?))
    }
}
