//! Targets: an engine with the step at which it is to be believed.

use sms_scene::Scene;
use sms_sim::{NamedRapierF64, SimError, Simulation, WorldFactory, WorldOptions};

/// A world in which plans are carried out.
pub trait Target: Sync {
    /// Builds its worlds.
    fn factory(&self) -> &dyn WorldFactory;

    /// How its worlds are built where the planner's are built as `planner` says.
    fn world_options(&self, planner: &WorldOptions) -> WorldOptions;

    /// Name of the engine with its label, as every table shows it.
    fn label(&self) -> &'static str {
        self.factory().engine()
    }

    /// Builds a simulation of the true scene; `planner` says how the planner's worlds are built.
    ///
    /// # Errors
    /// [`SimError`] when the engine refuses a body.
    fn simulation(&self, scene: &Scene, planner: &WorldOptions) -> Result<Simulation, SimError> {
        Simulation::new(self.factory(), scene, &self.world_options(planner))
    }
}

/// Rapier in double precision at a quarter of the planner's step. It is the planner's own engine: what differs
/// between plan and execution are the scene, the precision and the step, not the contact model. Every table and
/// page says so.
#[derive(Debug, Clone, Copy, Default)]
pub struct SameEngineTarget;

/// The label of [`SameEngineTarget`].
pub const SAME_ENGINE: &str = "rapier3d f64, quarter step (same engine)";

impl Target for SameEngineTarget {
    fn factory(&self) -> &dyn WorldFactory {
        &NamedRapierF64 { name: SAME_ENGINE }
    }

    fn world_options(&self, planner: &WorldOptions) -> WorldOptions {
        WorldOptions { dt: 0.25 * planner.dt, ..*planner }
    }
}
