//! The interface to physics engines. A world exchanges `f64` values, whatever its own precision.

use glamx::{DPose3, DVec3};
use serde::{Deserialize, Serialize};
use sms_robots::{ArmStrike, StrikeError};
use sms_scene::Scene;
use sms_wash::BodyState;

/// Index of a body: scene bodies first, in the scene's order, then kinematic bodies and tools in order of insertion.
pub type BodyId = usize;

/// Selects who simulates the joints of the arm.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ArmKind {
    /// The shared arm, identical in every engine; the engine simulates only the tool.
    #[default]
    Shared,
    /// The engine, by an articulation with the same controller, if the engine supports this ([`World::add_arm`]).
    Articulation,
}

/// Settings of a world.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WorldOptions {
    /// Nominal time step in seconds (paper: 0.0025).
    pub dt: f64,
    /// Whether resting bodies may sleep.
    pub sleep: bool,
    /// Whether steps are split at the time of impact of fast balls.
    pub contact_timing: bool,
    /// Selects who simulates the joints of the arm.
    pub arm: ArmKind,
}

impl Default for WorldOptions {
    fn default() -> Self {
        Self { dt: 0.0025, sleep: true, contact_timing: true, arm: ArmKind::Shared }
    }
}

/// Errors of building or running a world.
#[derive(Debug, thiserror::Error)]
pub enum SimError {
    /// A body cannot be simulated.
    #[error("body `{body}` cannot be simulated: {why}")]
    Body {
        /// Its name.
        body: String,
        /// The fault.
        why: String,
    },
    /// A state is no longer finite.
    #[error("the simulation in {engine} diverged at t = {time_s:.4} s (body `{body}`)")]
    Diverged {
        /// Engine.
        engine: &'static str,
        /// Time.
        time_s: f64,
        /// Body.
        body: String,
    },
    /// The robot cannot execute the strike; nothing was simulated.
    #[error("the robot cannot execute this strike: {0}")]
    Refused(Box<StrikeError>),
    /// The motion is physically impossible.
    #[error("the simulation in {engine} is physically impossible from t = {time_s:.4} s: {why}")]
    Unphysical {
        /// Engine.
        engine: &'static str,
        /// Time.
        time_s: f64,
        /// The violation.
        why: PhysicsViolation,
    },
}

/// A violation of physics in a simulation.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PhysicsViolation {
    /// One body penetrates another.
    #[error("`{body}` penetrates `{other}` by {:.1} mm", 1e3 * .depth_m)]
    Inside {
        /// The moving body.
        body: String,
        /// The penetrated body.
        other: String,
        /// Penetration depth, metres.
        depth_m: f64,
    },
    /// The bodies have more energy than the robot gave them.
    #[error(
        "the bodies have {has_j:.3} J, of which the robot gave at most {given_j:.3} J; `{body}` has the most"
    )]
    MoreThanGiven {
        /// The body with the most kinetic energy.
        body: String,
        /// Energy beyond that at rest, joules.
        has_j: f64,
        /// Upper bound of the energy given by the robot, joules.
        given_j: f64,
    },
    /// The bodies gained energy after the strike.
    #[error("the bodies gained {gain_j:.3} J after the strike; `{body}` has the most")]
    Gained {
        /// The body with the most kinetic energy.
        body: String,
        /// Gain, joules.
        gain_j: f64,
    },
    /// Another violation.
    #[error("{0}")]
    Other(String),
}

impl SimError {
    /// Returns the reason of the failure without numbers, for counting; `None` for other errors.
    pub fn failure_reason(&self) -> Option<String> {
        match self {
            Self::Diverged { body, .. } => Some(format!("`{body}` diverged (non-finite state)")),
            Self::Unphysical { why: PhysicsViolation::Inside { body, other, .. }, .. } => {
                Some(format!("`{body}` penetrated `{other}`"))
            }
            Self::Unphysical { why: PhysicsViolation::MoreThanGiven { body, .. }, .. } => {
                Some(format!("`{body}` had more energy than the robot gave"))
            }
            Self::Unphysical { why: PhysicsViolation::Gained { body, .. }, .. } => {
                Some(format!("`{body}` gained energy after the strike"))
            }
            Self::Unphysical { why: PhysicsViolation::Other(why), .. } => Some(why.clone()),
            Self::Body { .. } | Self::Refused(_) => None,
        }
    }

    /// Returns whether the rollout is invalid or was refused. The scene itself is valid, so another motion may succeed.
    pub fn is_invalid_rollout(&self) -> bool {
        matches!(self, Self::Diverged { .. } | Self::Unphysical { .. } | Self::Refused(_))
    }
}

impl From<StrikeError> for SimError {
    fn from(e: StrikeError) -> Self {
        Self::Refused(Box::new(e))
    }
}

/// First contact of two bodies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactEvent {
    /// Time, seconds.
    pub time_s: f64,
    /// The faster body; in a contact of a ball and a static body, the ball.
    pub body: BodyId,
    /// The other body.
    pub other: BodyId,
}

/// A rigid-body world.
pub trait World: Send {
    /// Name of the engine ("rapier3d f32").
    fn engine(&self) -> &'static str;
    /// Advances by `dt` seconds (any positive value up to the nominal step); applied wrenches act for this step only.
    fn step(&mut self, dt: f64);
    /// State of a body.
    fn state(&self, body: BodyId) -> BodyState;
    /// Sets the state of a body and wakes it.
    fn set_state(&mut self, body: BodyId, state: &BodyState);
    /// Adds a force (N) and a torque about the centre of mass (N·m), in the world, for the next step. `wake` wakes a
    /// sleeping body.
    fn apply_wrench(&mut self, body: BodyId, force_w: DVec3, torque_w: DVec3, wake: bool);
    /// Whether the body is asleep.
    fn is_asleep(&self, body: BodyId) -> bool;
    /// Adds a kinematic body: a box about its origin with these half extents, metres.
    fn add_kinematic(&mut self, half: DVec3, x_wk: DPose3, friction: f64, restitution: f64) -> BodyId;
    /// Pose that a kinematic body reaches at the end of the next step.
    fn set_kinematic_target(&mut self, body: BodyId, x_wk: DPose3);
    /// Adds a tool: a dynamic box as in [`World::add_kinematic`], without weight. Its pose, velocity and mass are set
    /// before each step ([`World::set_tool`]), and contacts do not rotate it. Its change of velocity in a step, times
    /// the mass, is the received impulse.
    fn add_tool(&mut self, half: DVec3, x_wt: DPose3, friction: f64, restitution: f64) -> BodyId;
    /// State of a tool at the beginning of the next step, and its mass in it, kg.
    fn set_tool(&mut self, body: BodyId, state: &BodyState, mass: f64);
    /// Adds an arm with joints simulated by the engine, at rest at the start of its strike. Returns the body of the
    /// tool, with the state of the tool's frame. Only the striking part of the tool has a shape. Returns `None` if the
    /// engine does not support arms or this robot. A world with an arm cannot be saved.
    fn add_arm(&mut self, strike: &ArmStrike, friction: f64, restitution: f64) -> Option<BodyId> {
        let _ = (strike, friction, restitution);
        None
    }
    /// Reads the positions and speeds of the joints of an arm of [`World::add_arm`].
    fn arm_joints(&self, body: BodyId, q: &mut [f64], qd: &mut [f64]) {
        let _ = (body, q, qd);
    }
    /// Sets the torques of the motors from now on. The engine subtracts friction and damping of the joints.
    fn set_arm_torques(&mut self, body: BodyId, tau: &[f64]) {
        let _ = (body, tau);
    }
    /// Enables or disables the collisions of a kinematic body, a tool or an arm.
    fn set_kinematic_enabled(&mut self, body: BodyId, enabled: bool);
    /// Saves the state; `false` if the engine does not support it.
    fn save(&mut self) -> bool;
    /// Restores the saved state and removes kinematic bodies added since; `false` if none was saved.
    fn restore(&mut self) -> bool;
    /// A body that the engine removed in the last step because its state was not finite, if the engine does so.
    fn first_failed(&self) -> Option<BodyId> {
        None
    }
    /// Appends the pairs of bodies that began to touch since the last call to `pairs`, in a fixed order. A pair occurs
    /// again when it separates and touches again, and once for each pair of parts. Engines that do not report touches
    /// append nothing; then only impacts of balls are known.
    fn take_touches(&mut self, pairs: &mut Vec<(BodyId, BodyId)>) {
        let _ = pairs;
    }
}

/// Builds worlds; shared by threads.
pub trait WorldFactory: Sync {
    /// Name of the engine.
    fn engine(&self) -> &'static str;
    /// Builds a world of the scene.
    ///
    /// # Errors
    /// [`SimError::Body`] when a body's shape or mass cannot be simulated.
    fn build(&self, scene: &Scene, options: &WorldOptions) -> Result<Box<dyn World>, SimError>;

    /// Whether [`WorldOptions::contact_timing`] has an effect: `false` to study an engine with whole steps.
    fn splits_steps(&self) -> bool {
        true
    }
}
