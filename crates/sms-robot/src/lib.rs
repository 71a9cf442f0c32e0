//! The robot.

mod arm_sim;
mod check;
mod clearance;
mod dynamics;
mod ik;
mod kinematics;
mod linalg;
mod model;
mod motion;
mod osc;
mod posture;
mod program;
mod shape;
mod strike;
mod sweep;
mod urdf;
mod workspace;

use glamx::DVec3;

pub use arm_sim::ArmSim;
pub use check::{CheckItem, CheckKind, DIRECTION_TOLERANCE_RAD, SPEED_TOLERANCE, StrikeCheck, check_strike};
pub use ik::{IkConfig, IkSolution, IkTarget, LENGTH_M, Unreachable};
pub use linalg::MAX_JOINTS;
pub use model::{Frame, FrameId, GRAVITY_W, Joint, JointKind, JointLimits, LinkCollision, RobotModel};
pub use motion::{
    Infeasible, JointMotion, JointSample, LimitKind, Use, Uses, hold_reference, joint_move, motor_torques,
    roll_out,
};
pub use osc::{FRICTION_SPEED, Osc, OscConfig, OscOutput, joint_friction};
pub use program::{JointProgram, PROGRAM_VERSION, ProgramPoint};
pub use shape::{Clearance, LinkShape, Obstacle, ObstacleShape, floor};
pub use strike::{
    Phase, StrikeConfig, StrikeError, StrikePlan, SweepPlan, Tracking, plan_strike, plan_sweep,
    simulate_sweep,
};
pub use sweep::{LinePath, SEGMENT_M, Sweep, SweepPath, SweepProfile, ToolPath, ToolReference, minimum_jerk};
pub use urdf::{FR3_HOME, FR3_URDF, OffChain, UrdfOptions};
pub use workspace::{Jacobian, JointVector, MassMatrix, Workspace};

/// Half extents, metres, of the closed fingertips of a Franka Hand as one box, in the frame of the tool.
pub const FIST_HALF: DVec3 = DVec3::new(0.008_75, 0.015_18, 0.009_25);
