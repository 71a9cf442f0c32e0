//! The robot model: a tree of bodies, each carried by one joint.

use crate::LinkShape;
use glamx::{DMat3, DPose3, DVec3};
use serde::{Deserialize, Serialize};
use sms_core::{InertiaError, MassProperties};

/// Standard gravity in the world, m/s².
pub(crate) const GRAVITY_W: DVec3 = DVec3::new(0.0, 0.0, -9.81);

/// Type of a joint.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum JointKind {
    /// Turns between limits.
    Revolute,
    /// Turns without limits.
    Continuous,
    /// Slides between limits.
    Prismatic,
}

impl JointKind {
    /// Whether the joint turns.
    pub fn turns(self) -> bool {
        self != Self::Prismatic
    }
}

/// Limits of one joint: radians, rad/s, N·m; metres, m/s, N where it slides.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct JointLimits {
    /// Smallest position (−∞ for a continuous joint).
    pub lower: f64,
    /// Largest position.
    pub upper: f64,
    /// Largest speed.
    pub velocity: f64,
    /// Largest torque or force.
    pub effort: f64,
}

/// A moving joint and the body that it carries.
#[derive(Debug, Clone)]
pub struct Joint {
    /// Name.
    pub name: String,
    /// Type of the joint.
    pub kind: JointKind,
    /// The preceding joint in the tree, always of a smaller index; `None` if the joint is attached to the base.
    pub parent: Option<usize>,
    /// Pose `X_PJ` of the joint at position zero in the parent joint's frame (or the base).
    pub x_pj: DPose3,
    /// Axis in the joint's frame, a unit vector.
    pub axis: DVec3,
    /// Limits.
    pub limits: JointLimits,
    /// Viscous friction, N·m·s/rad (N·s/m).
    pub damping: f64,
    /// Coulomb friction, N·m (N).
    pub friction: f64,
    /// Inertia of the rotor reflected through the gear, kg·m² (kg).
    pub armature: f64,
    /// Mass properties of all links that this joint carries rigidly, in the joint's frame; `None` if they have no mass
    /// (another joint follows).
    pub mass: Option<MassProperties>,
}

/// A named frame fixed to a joint's body: one per link of the URDF.
#[derive(Debug, Clone)]
pub struct LinkFrame {
    /// Name of the link.
    pub name: String,
    /// The joint that carries it; `None` for the base.
    pub joint: Option<usize>,
    /// Pose `X_JF` in that joint's frame (or the base).
    pub x_jf: DPose3,
}

/// Index of a [`LinkFrame`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FrameId(pub(crate) usize);

/// A collision shape.
#[derive(Debug, Clone)]
pub struct LinkCollision {
    /// Name of its link.
    pub link: String,
    /// The joint that carries it; `None` for the base.
    pub joint: Option<usize>,
    /// Pose `X_JS` of the shape in that joint's frame (or the base).
    pub x_js: DPose3,
    /// The shape.
    pub shape: LinkShape,
    /// [`LinkShape::bounding_radius`].
    pub(crate) radius: f64,
}

/// A fixed-base robot: joints (parents first), frames, collision shapes, and the tool.
#[derive(Debug, Clone)]
pub struct RobotModel {
    pub(crate) name: String,
    pub(crate) joints: Vec<Joint>,
    pub(crate) frames: Vec<LinkFrame>,
    pub(crate) collisions: Vec<LinkCollision>,
    pub(crate) tool: FrameId,
    pub(crate) x_wr: DPose3,
    pub(crate) gravity_w: DVec3,
    pub(crate) home: Vec<f64>,
    /// Pairs of collision shapes that the self-collision check compares, as indices.
    pub(crate) pairs: Vec<(usize, usize)>,
}

impl RobotModel {
    /// Name of the robot.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Number of moving joints.
    pub fn dof(&self) -> usize {
        self.joints.len()
    }

    /// The moving joints; vectors of positions, speeds and torques have one entry per joint, in this order.
    pub fn joints(&self) -> &[Joint] {
        &self.joints
    }

    /// All frames, one per link.
    pub fn frames(&self) -> &[LinkFrame] {
        &self.frames
    }

    /// Collision shapes of all links.
    pub fn collisions(&self) -> &[LinkCollision] {
        &self.collisions
    }

    /// The frame of a link.
    pub fn frame(&self, link: &str) -> Option<FrameId> {
        self.frames.iter().position(|f| f.name == link).map(FrameId)
    }

    /// The tool's frame: x along the stroke of a strike, z away from the floor.
    pub fn tool(&self) -> FrameId {
        self.tool
    }

    /// Pose `X_WR` of the robot's base in the world.
    pub fn x_wr(&self) -> DPose3 {
        self.x_wr
    }

    /// Returns the robot with its base at `x_wr` in the world.
    pub fn with_base(mut self, x_wr: DPose3) -> Self {
        self.x_wr = x_wr;
        self
    }

    /// Returns the robot with another gravity, m/s² in the world.
    pub fn with_gravity(mut self, gravity_w: DVec3) -> Self {
        self.gravity_w = gravity_w;
        self
    }

    /// The resting posture from which approaches start: the middle of each joint's range, unless the model defines
    /// another.
    pub fn home(&self) -> &[f64] {
        &self.home
    }

    /// Returns the robot with another home posture; positions are clamped to the limits.
    ///
    /// # Panics
    /// When `home` does not have one entry for each joint.
    pub fn with_home(mut self, home: &[f64]) -> Self {
        assert_eq!(home.len(), self.dof(), "one position for each joint");
        self.home =
            home.iter().zip(&self.joints).map(|(q, j)| q.clamp(j.limits.lower, j.limits.upper)).collect();
        self
    }

    /// A joint and those that carry it, towards the base.
    pub(crate) fn chain(&self, joint: Option<usize>) -> impl Iterator<Item = usize> {
        std::iter::successors(joint, move |&i| self.joints[i].parent)
    }
}

/// The sum of two rigid bodies, given in one frame.
pub(crate) fn merged(a: Option<MassProperties>, b: MassProperties) -> Result<MassProperties, InertiaError> {
    let Some(a) = a else { return Ok(b) };
    let mass = a.mass() + b.mass();
    let com = (a.mass() * a.com() + b.mass() * b.com()) / mass;
    let shifted = |m: &MassProperties| m.inertia() + m.mass() * point_inertia(m.com() - com);
    MassProperties::new(mass, com, shifted(&a) + shifted(&b))
}

/// Mass properties carried into another frame by `x_ab`.
pub(crate) fn transformed(m: &MassProperties, x_ab: &DPose3) -> Result<MassProperties, InertiaError> {
    let r = DMat3::from_quat(x_ab.rotation);
    MassProperties::new(m.mass(), x_ab.transform_point(m.com()), r * m.inertia() * r.transpose())
}

/// The inertia of a unit point mass at `r`: (r·r) 1 − r rᵀ.
pub(crate) fn point_inertia(r: DVec3) -> DMat3 {
    let d = r.length_squared();
    DMat3::from_cols(
        DVec3::new(d - r.x * r.x, -r.x * r.y, -r.x * r.z),
        DVec3::new(-r.y * r.x, d - r.y * r.y, -r.y * r.z),
        DVec3::new(-r.z * r.x, -r.z * r.y, d - r.z * r.z),
    )
}
