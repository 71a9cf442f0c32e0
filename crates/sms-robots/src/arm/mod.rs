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
pub use control::{FRICTION_SPEED, Osc, OscConfig, OscOutput, joint_friction};
pub use dynamics::{
    ArmSim, IkConfig, IkSolution, IkTarget, Jacobian, JointVector, LENGTH_M, MAX_JOINTS, MassMatrix,
    Unreachable, Workspace,
};
pub use model::{Frame, FrameId, GRAVITY_W, Joint, JointKind, JointLimits, LinkCollision, RobotModel};
pub use obstacles::obstacles;
pub use shape::{Clearance, LinkShape, Obstacle, ObstacleShape, floor};
pub use strike::{
    ArmStrike, CheckItem, CheckKind, ContactTracking, DIRECTION_TOLERANCE_RAD, Hold, Infeasible, JointMotion,
    JointProgram, JointSample, LimitKind, LinePath, PROGRAM_VERSION, Phase, ProgramPoint, SEGMENT_M,
    SPEED_TOLERANCE, StrikeCheck, StrikeConfig, StrikeError, StrikePlan, Sweep, SweepDrive, SweepPath,
    SweepPlan, SweepProfile, ToolPath, ToolReference, Tracking, Use, Uses, check_strike, hold_reference,
    joint_move, minimum_jerk, motor_torques, plan_startable_sweep, plan_strike, plan_sweep, roll_out,
    simulate_sweep,
};
pub use urdf::{FR3_HOME, FR3_URDF, OffChain, UrdfOptions};

/// Half extents, metres, of the closed fingertips of a Franka Hand as one box, in the frame of the tool.
pub const FIST_HALF: DVec3 = DVec3::new(0.008_75, 0.015_18, 0.009_25);
