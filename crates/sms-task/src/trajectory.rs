//! What happened in a world.

use serde::{Deserialize, Serialize};
use sms_sim::BodyState;

/// The motion of one body.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BodyTrack {
    /// The body's name (the striker's is `striker`).
    pub name: String,
    /// One state per entry of [`Trajectory::times_s`].
    pub states: Vec<BodyState>,
}

/// Recorded motion of all bodies that moved, and of the striker.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Trajectory {
    /// Seconds from the start.
    pub times_s: Vec<f64>,
    /// The bodies.
    pub bodies: Vec<BodyTrack>,
}

impl Trajectory {
    /// The track of a body.
    pub fn body(&self, name: &str) -> Option<&BodyTrack> {
        self.bodies.iter().find(|b| b.name == name)
    }
}

/// A plan carried out in a target world: an observed trajectory that a calibrator can read.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Execution {
    /// Engine of the target, with its label ("rapier3d f64, quarter step (same engine)").
    pub engine: String,
    /// Realised objective, in the task's unit.
    pub objective: f64,
    /// Unit of the objective.
    pub objective_unit: String,
    /// Whether the task's success condition was met.
    pub success: bool,
    /// Largest |Δobjective| over runs with start positions disturbed by 1 µm: what no planner can beat.
    pub chaos_floor: f64,
    /// What moved. Names are those of the target's bodies.
    pub trajectory: Trajectory,
    /// Planner's body name → target's body name, for those that were matched.
    pub matches: Vec<(String, String)>,
}
