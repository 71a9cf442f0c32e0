//! Targets: an engine and the time step at which it is accurate.

use sms_scene::Scene;
use sms_sim::{NamedRapier, SimError, Simulation, WorldFactory, WorldOptions};

/// A simulation in which plans are executed.
pub trait Target: Sync {
    /// Returns the factory of its worlds.
    fn factory(&self) -> &dyn WorldFactory;

    /// Returns the options of its worlds, given the planner's options.
    fn world_options(&self, planner: &WorldOptions) -> WorldOptions;

    /// Returns the name of the engine and its label, for tables.
    fn label(&self) -> &'static str {
        self.factory().engine()
    }

    /// Builds a simulation of the true scene; `planner` are the options of the planner's worlds.
    ///
    /// # Errors
    /// [`SimError`] if the engine refuses a body.
    fn simulation(&self, scene: &Scene, planner: &WorldOptions) -> Result<Simulation, SimError> {
        Simulation::new(self.factory(), scene, &self.world_options(planner))
    }
}

/// Rapier at a quarter of the planner's step. It is the planner's own engine: plan and execution differ in the scene and
/// the step, not in the contact model. The label in tables and pages states this.
#[derive(Debug, Clone, Copy, Default)]
pub struct SameEngineTarget;

/// The label of [`SameEngineTarget`].
pub const SAME_ENGINE: &str = "rapier3d f32, quarter step (same engine)";

impl Target for SameEngineTarget {
    fn factory(&self) -> &dyn WorldFactory {
        &NamedRapier { name: SAME_ENGINE }
    }

    fn world_options(&self, planner: &WorldOptions) -> WorldOptions {
        WorldOptions { dt: 0.25 * planner.dt, ..*planner }
    }
}
