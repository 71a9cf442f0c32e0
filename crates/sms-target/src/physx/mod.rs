//! NVIDIA PhysX 5.1.3 (feature `physx`), the engine family of Isaac Sim: another contact code than the planner's.
//!
//! - [`PhysxFactory::Precise`]: small contact offsets, no damping, more iterations, steps split at the balls' impacts.
//!   The nearest to a real table; the judge of the published tables.
//! - [`PhysxFactory::Stock`]: the engine's defaults apart from the threshold of bouncing, in whole steps, with the errors
//!   that come of that.
//!
//! Both can have a robot's arm as an articulation of their own ([`sms_sim::ArmKind`]).
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

/// Builds worlds of PhysX.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PhysxFactory {
    /// As near to a real table as the engine comes.
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

/// Scenes, shapes, meshes and materials of PhysX that live in this process, for tests of leaks.
pub fn physx_live_objects() -> usize {
    sdk::Sdk::get().live_objects()
}
