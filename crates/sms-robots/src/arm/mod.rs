//! Fixed-base arms.

mod clearance;
mod config;
pub(crate) mod control;
pub(crate) mod dynamics;
pub(crate) mod model;
mod obstacles;
pub(crate) mod shape;
pub(crate) mod strike;
mod urdf;

use glamx::DVec3;

pub use config::RobotConfig;
pub use control::{Osc, OscConfig, joint_friction};
pub use dynamics::{
    ArmSim, IkConfig, IkSolution, IkTarget, Jacobian, JointVector, MAX_JOINTS, Unreachable, Workspace,
};
pub use model::{FrameId, Joint, JointKind, LinkFrame, RobotModel};
pub use obstacles::obstacles;
pub use shape::{LinkShape, Obstacle, ObstacleShape, floor};
pub use strike::{
    ArmStrike, CheckKind, Infeasible, JointMotion, JointProgram, LimitKind, Phase, SEGMENT_M, StrikeCheck,
    StrikeConfig, StrikeError, StrikePlan, Sweep, SweepDrive, SweepPlan, SweepProfile, ToolPath,
    ToolReference, Tracking, Use, Uses, check_strike, plan_startable_sweep, plan_strike, plan_sweep,
    simulate_sweep,
};
pub use urdf::{FR3_URDF, OffChain, UrdfOptions};

/// Half extents, metres, of the closed fingertips of a Franka Hand as one box, in the frame of the tool.
pub const FIST_HALF: DVec3 = DVec3::new(0.008_75, 0.015_18, 0.009_25);
