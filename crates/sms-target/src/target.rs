//! Targets: an engine with the step at which it is to be believed.

use sms_scene::Scene;
use sms_sim::SimError;
use sms_sim::{NamedRapierF64, Simulation, WorldFactory, WorldOptions};

/// A world in which plans are carried out.
pub trait Target: Sync {
    /// Name of the engine with its label, as every table shows it.
    fn label(&self) -> &'static str;

    /// Builds a simulation of the true scene; `planner` says how the planner's worlds are built.
    ///
    /// # Errors
    /// [`SimError`] when the engine refuses a body.
    fn simulation(&self, scene: &Scene, planner: &WorldOptions) -> Result<Simulation, SimError>;
}

/// Rapier in double precision at a quarter of the planner's step. It is the planner's own engine: what differs
/// between plan and execution are the scene, the precision and the step, not the contact model. Every table and
/// page says so.
#[derive(Debug, Clone, Copy, Default)]
pub struct SameEngineTarget;

/// The label of [`SameEngineTarget`].
pub const SAME_ENGINE: &str = "rapier3d f64, quarter step (same engine)";

impl Target for SameEngineTarget {
    fn label(&self) -> &'static str {
        SAME_ENGINE
    }

    fn simulation(&self, scene: &Scene, planner: &WorldOptions) -> Result<Simulation, SimError> {
        let factory = NamedRapierF64 { name: SAME_ENGINE };
        debug_assert_eq!(factory.engine(), self.label());
        Simulation::new(&factory, scene, &WorldOptions { dt: 0.25 * planner.dt, ..*planner })
    }
}
