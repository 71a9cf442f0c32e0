//! NVIDIA PhysX 5.1.3 (feature `physx`), the engine family of Isaac Sim: a contact solver independent of the planner's.
//!
//! - [`PhysxFactory::Precise`]: small contact offsets, no damping, more iterations, steps split at the balls' impacts.
//!   It agrees best with closed forms and is the target of the published tables.
//! - [`PhysxFactory::Stock`]: the engine's defaults except for the bounce threshold, in whole steps, with the resulting
//!   errors.
//!
//! Both can simulate a robot's arm as an articulation of the engine ([`sms_sim::ArmKind`]).
#![allow(unsafe_code, reason = "PhysX is C++; every call is wrapped in the modules below")]

mod arm;
mod contacts;
mod instance;
mod rest;
mod sdk;
mod shapes;
mod tuning;
mod world;

use sms_scene::Scene;
use sms_sim::{SimError, World, WorldFactory, WorldOptions};
use tuning::{PRECISE, STOCK, Tuning};

/// A factory of PhysX worlds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PhysxFactory {
    /// Parameters with the best agreement with closed forms.
    Precise,
    /// The engine's defaults.
    Stock,
}

impl PhysxFactory {
    fn tuning(self) -> &'static Tuning {
        match self {
            Self::Precise => &PRECISE,
            Self::Stock => &STOCK,
        }
    }
}

impl WorldFactory for PhysxFactory {
    fn engine(&self) -> &'static str {
        self.tuning().engine
    }

    fn build(&self, scene: &Scene, options: &WorldOptions) -> Result<Box<dyn World>, SimError> {
        Ok(Box::new(world::PhysxWorld::build(self.tuning(), scene, options)?))
    }

    fn splits_steps(&self) -> bool {
        self.tuning().splits_steps
    }
}

/// Counts the live scenes, shapes, meshes and materials of PhysX in this process, for leak tests.
pub fn physx_live_objects() -> usize {
    sdk::Sdk::get().live_objects()
}
