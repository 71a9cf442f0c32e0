//! The Rapier engine: one source, compiled for both precisions.

use crate::{SimError, World, WorldFactory, WorldOptions};
use sms_scene::Scene;

mod double;
mod single;

/// Rapier in single precision: the engine of the planner.
#[derive(Debug, Clone, Copy, Default)]
pub struct RapierFactory;

/// Rapier in double precision: the reference, and the target if no other engine is built in.
#[derive(Debug, Clone, Copy, Default)]
pub struct RapierF64Factory;

/// Rapier in double precision under another name, for a target that must be distinguishable.
#[derive(Debug, Clone, Copy)]
pub struct NamedRapierF64 {
    /// Result of [`WorldFactory::engine`].
    pub name: &'static str,
}

impl WorldFactory for NamedRapierF64 {
    fn engine(&self) -> &'static str {
        self.name
    }

    fn build(&self, scene: &Scene, options: &WorldOptions) -> Result<Box<dyn World>, SimError> {
        Ok(Box::new(double::adapter::RapierWorld::build(self.name, scene, options)?))
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

impl WorldFactory for RapierF64Factory {
    fn engine(&self) -> &'static str {
        "rapier3d f64"
    }

    fn build(&self, scene: &Scene, options: &WorldOptions) -> Result<Box<dyn World>, SimError> {
        Ok(Box::new(double::adapter::RapierWorld::build(self.engine(), scene, options)?))
    }
}
