//! The seam to physics engines. A world speaks `f64` whatever it computes in.

use glamx::{DPose3, DVec3};
use serde::{Deserialize, Serialize};
use sms_robots::{ArmStrike, StrikeError};
use sms_scene::Scene;

/// Index of a body: scene bodies first, in the scene's order, then kinematic ones and tools in the order they were added.
pub type BodyId = usize;

/// Motion state of one body.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct BodyState {
    /// Pose in the world; the origin is the centre of mass.
    pub x_wb: DPose3,
    /// Linear velocity of the origin, m/s, in the world.
    pub v_w: DVec3,
    /// Angular velocity, rad/s, in the world.
    pub w_w: DVec3,
}

/// Shape of a kinematic body in its own frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "type", rename_all = "snake_case")]
pub enum KinematicShape {
    /// A box with these half extents, metres.
    Cuboid {
        /// Half extents.
        half: DVec3,
    },
    /// A capsule along z, metres.
    Capsule {
        /// Half of the distance between the cap centres.
        half_length: f64,
        /// Radius.
        radius: f64,
    },
}

/// Whose the joints of an arm are.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ArmKind {
    /// Ours, the same in every engine; the engine sees the tool alone.
    #[default]
    Shared,
    /// The engine's: an articulation under the same controller, where the engine has one ([`World::add_arm`]).
    Articulation,
}

/// How a world is built.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct WorldOptions {
    /// Nominal time step in seconds (paper: 0.0025).
    pub dt: f64,
    /// Whether resting bodies may sleep.
    pub sleep: bool,
    /// Whether steps are split at the time of impact of fast balls.
    pub contact_timing: bool,
    /// Whose the joints of an arm are.
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
        /// Why.
        why: String,
    },
    /// The state stopped being finite.
    #[error("the simulation of {engine} blew up at t = {time_s:.4} s (body `{body}`)")]
    Diverged {
        /// Engine.
        engine: &'static str,
        /// Time.
        time_s: f64,
        /// Body.
        body: String,
    },
    /// The robot cannot make the strike; nothing was simulated.
    #[error("the robot cannot make this strike: {0}")]
    Refused(Box<StrikeError>),
    /// The motion is none that bodies can have.
    #[error("the simulation of {engine} cannot be believed from t = {time_s:.4} s on: {why}")]
    Unphysical {
        /// Engine.
        engine: &'static str,
        /// Time.
        time_s: f64,
        /// What was seen.
        why: Impossible,
    },
}

/// What a simulation shows that bodies cannot do.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Impossible {
    /// One body is inside of another.
    #[error("`{body}` is {:.1} mm inside of `{other}`", 1e3 * .depth_m)]
    Inside {
        /// The body that moves.
        body: String,
        /// What it is in.
        other: String,
        /// How deep, metres.
        depth_m: f64,
    },
    /// Bodies have more energy than the robot gave them.
    #[error("bodies have {has_j:.3} J, of which the robot gave {given_j:.3} J; most of it has `{body}`")]
    MoreThanGiven {
        /// The body with the most energy of motion.
        body: String,
        /// Energy that was not there at rest, joules.
        has_j: f64,
        /// The most that the robot can have given, joules.
        given_j: f64,
    },
    /// Bodies gained energy after the robot had gone.
    #[error("bodies gained {gain_j:.3} J by themselves; most of all has `{body}`")]
    Gained {
        /// The body with the most energy of motion.
        body: String,
        /// How much, joules.
        gain_j: f64,
    },
    /// Something else.
    #[error("{0}")]
    Other(String),
}

impl SimError {
    /// Why a run was spoilt, without figures, for counting; `None` where it was not.
    pub fn failure_reason(&self) -> Option<String> {
        match self {
            Self::Diverged { body, .. } => Some(format!("`{body}` went beyond all numbers")),
            Self::Unphysical { why: Impossible::Inside { body, other, .. }, .. } => {
                Some(format!("`{body}` was inside of `{other}`"))
            }
            Self::Unphysical { why: Impossible::MoreThanGiven { body, .. }, .. } => {
                Some(format!("`{body}` had more energy than the robot gave"))
            }
            Self::Unphysical { why: Impossible::Gained { body, .. }, .. } => {
                Some(format!("`{body}` gained energy by itself"))
            }
            Self::Unphysical { why: Impossible::Other(why), .. } => Some(why.clone()),
            Self::Body { .. } | Self::Refused(_) => None,
        }
    }

    /// Whether a run was spoilt or refused, not the scene: another motion may be simulated well.
    pub fn is_invalid_rollout(&self) -> bool {
        matches!(self, Self::Diverged { .. } | Self::Unphysical { .. } | Self::Refused(_))
    }
}

impl From<StrikeError> for SimError {
    fn from(e: StrikeError) -> Self {
        Self::Refused(Box::new(e))
    }
}

/// Two bodies that touch for the first time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ContactEvent {
    /// When, seconds.
    pub time_s: f64,
    /// The faster one of the two; of a ball and something static the ball.
    pub body: BodyId,
    /// What it hits.
    pub other: BodyId,
}

/// A rigid-body world.
pub trait World: Send {
    /// Name of the engine ("rapier3d f32").
    fn engine(&self) -> &'static str;
    /// Advances by `dt` seconds (any positive value up to the nominal step); applied wrenches act for this step only.
    fn step(&mut self, dt: f64);
    /// Number of bodies.
    fn body_count(&self) -> usize;
    /// State of a body.
    fn state(&self, body: BodyId) -> BodyState;
    /// Sets the state of a body and wakes it.
    fn set_state(&mut self, body: BodyId, state: &BodyState);
    /// Adds a force (N) and a torque about the centre of mass (N·m), in the world, for the next step. `wake` says
    /// whether a sleeping body is woken.
    fn apply_wrench(&mut self, body: BodyId, force_w: DVec3, torque_w: DVec3, wake: bool);
    /// Whether the body is asleep.
    fn is_asleep(&self, body: BodyId) -> bool;
    /// Adds a kinematic body that pushes others and is pushed by none.
    fn add_kinematic(
        &mut self,
        shape: KinematicShape,
        x_wk: DPose3,
        friction: f64,
        restitution: f64,
    ) -> BodyId;
    /// Pose that a kinematic body reaches at the end of the next step.
    fn set_kinematic_target(&mut self, body: BodyId, x_wk: DPose3);
    /// Adds a tool: a dynamic body whose pose, velocity and mass are given before each step ([`World::set_tool`]), which
    /// has no weight and is not turned by contacts. The change of its velocity in a step, times the mass, is the impulse
    /// that it has received.
    fn add_tool(&mut self, shape: KinematicShape, x_wt: DPose3, friction: f64, restitution: f64) -> BodyId;
    /// State of a tool at the beginning of the next step, and its mass in it, kg.
    fn set_tool(&mut self, body: BodyId, state: &BodyState, mass: f64);
    /// Adds an arm of the engine's own joints, at rest at the start of its strike, and gives the body of its tool, whose state
    /// is that of the tool's frame. Of its shapes only the striking part of the tool is there. `None` where the engine
    /// has none such, or not of this robot. A world with one cannot be saved.
    fn add_arm(&mut self, strike: &ArmStrike, friction: f64, restitution: f64) -> Option<BodyId> {
        let _ = (strike, friction, restitution);
        None
    }
    /// Positions and speeds of the joints of such an arm.
    fn arm_joints(&self, body: BodyId, q: &mut [f64], qd: &mut [f64]) {
        let _ = (body, q, qd);
    }
    /// Torques of its motors from now on. The engine takes friction and damping of the joints off.
    fn set_arm_torques(&mut self, body: BodyId, tau: &[f64]) {
        let _ = (body, tau);
    }
    /// Switches the collisions of a kinematic body, a tool or an arm off or on.
    fn set_kinematic_enabled(&mut self, body: BodyId, enabled: bool);
    /// Saves the state as snapshot 0; `false` where the engine cannot.
    fn save(&mut self) -> bool;
    /// Returns to the saved state; `false` where there is none. Kinematic bodies added since are gone.
    fn restore(&mut self) -> bool;
    /// A body that the engine gave up in the last step because its state was not finite any more, for engines that
    /// take such bodies out of the world.
    fn first_failed(&self) -> Option<BodyId> {
        None
    }
    /// Moves the pairs of bodies that began to touch since the last call, in a fixed order, to the end of `pairs`. A pair
    /// may come again when it parts and touches again, and once for each two of its parts. Engines that cannot tell
    /// add none: only impacts of balls are then known.
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

    /// Whether [`WorldOptions::contact_timing`] has any effect: `false` for an engine that is to be shown in whole steps, with
    /// the errors that come of them.
    fn splits_steps(&self) -> bool {
        true
    }
}
