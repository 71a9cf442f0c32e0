//! Buffers for intermediate results, so that control steps do not allocate.

use glamx::{DMat3, DVec3};

/// Largest number of moving joints.
pub const MAX_JOINTS: usize = 16;

/// One value for each joint, the first `dof` of them in use.
pub type JointVector = [f64; MAX_JOINTS];

/// The values of the first joints; the others are zero.
pub(crate) fn joint_vector(values: &[f64]) -> JointVector {
    let mut all = [0.0; MAX_JOINTS];
    all[..values.len()].copy_from_slice(values);
    all
}

/// The mass matrix of joint space, kg·m²; the leading `dof` × `dof` block is in use.
pub(crate) type MassMatrix = [[f64; MAX_JOINTS]; MAX_JOINTS];

/// The Jacobian of a frame: column i is the velocity of the frame's origin and the angular velocity, both in world
/// axes, at unit speed of joint i (Pinocchio's `LOCAL_WORLD_ALIGNED`).
#[derive(Debug, Clone, Copy)]
pub struct Jacobian {
    /// Number of columns.
    pub dof: usize,
    /// Velocity of the origin per unit of joint speed.
    pub linear_w: [DVec3; MAX_JOINTS],
    /// Angular velocity per unit of joint speed.
    pub angular_w: [DVec3; MAX_JOINTS],
}

impl Default for Jacobian {
    fn default() -> Self {
        Self { dof: 0, linear_w: [DVec3::ZERO; MAX_JOINTS], angular_w: [DVec3::ZERO; MAX_JOINTS] }
    }
}

impl Jacobian {
    /// Row `r` (0 to 2 linear, 3 to 5 angular) of column `i`.
    pub fn get(&self, r: usize, i: usize) -> f64 {
        if r < 3 { self.linear_w[i][r] } else { self.angular_w[i][r - 3] }
    }

    /// J q̇: velocity of the origin and angular velocity.
    pub fn times(&self, qd: &[f64]) -> (DVec3, DVec3) {
        let mut v = (DVec3::ZERO, DVec3::ZERO);
        for i in 0..self.dof {
            v.0 += self.linear_w[i] * qd[i];
            v.1 += self.angular_w[i] * qd[i];
        }
        v
    }
}

/// Pose of each joint's frame in the world.
#[derive(Debug, Clone, Copy)]
pub(crate) struct JointPlacement {
    pub(crate) r_wj: DMat3,
    pub(crate) p_w: DVec3,
    pub(crate) axis_w: DVec3,
}

/// Velocity and acceleration of each joint's frame, in world axes.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Moving {
    pub(crate) v: DVec3,
    pub(crate) w: DVec3,
    pub(crate) a: DVec3,
    pub(crate) alpha: DVec3,
}

/// The links beyond a joint as one rigid body, in world axes about its centre of mass.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Composite {
    pub(crate) mass: f64,
    pub(crate) com: DVec3,
    pub(crate) inertia: DMat3,
}

/// Buffers of one robot's kinematics and dynamics. Create one per thread and reuse it.
#[derive(Debug, Clone)]
pub struct Workspace {
    pub(crate) placed: [JointPlacement; MAX_JOINTS],
    pub(crate) moving: [Moving; MAX_JOINTS],
    pub(crate) force: [DVec3; MAX_JOINTS],
    pub(crate) moment: [DVec3; MAX_JOINTS],
    pub(crate) composite: [Composite; MAX_JOINTS],
    pub(crate) mass_matrix: MassMatrix,
}

impl Default for Workspace {
    fn default() -> Self {
        let placed = JointPlacement { r_wj: DMat3::IDENTITY, p_w: DVec3::ZERO, axis_w: DVec3::Z };
        Self {
            placed: [placed; MAX_JOINTS],
            moving: [Moving::default(); MAX_JOINTS],
            force: [DVec3::ZERO; MAX_JOINTS],
            moment: [DVec3::ZERO; MAX_JOINTS],
            composite: [Composite::default(); MAX_JOINTS],
            mass_matrix: [[0.0; MAX_JOINTS]; MAX_JOINTS],
        }
    }
}
