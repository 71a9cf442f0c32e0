//! The robot: a fixed-base arm from a URDF (or the built-in Franka Research 3), its kinematics and dynamics,
//! operational-space torque control, the paper's strike, and the checks before one is called executable.
//!
//! A pure library: no physics engine is in it. What comes out is joint motions and torques ([`StrikePlan`],
//! [`JointProgram`]), a controller ([`Osc`]) that any engine can be driven by, and collision shapes
//! ([`RobotModel::collisions`]) that it can be given.
//!
//! ```
//! use glamx::DVec3;
//! use sms_robots::{FIST_HALF, JointProgram, RobotModel, StrikeConfig, Sweep, Workspace, check_strike, floor, plan_strike};
//!
//! let robot = RobotModel::fr3();
//! let mut ws = Workspace::default();
//! // A ball of 3 cm radius, half a metre ahead, is struck along x at 0.5 m/s.
//! let sweep = Sweep::of_ball(DVec3::new(0.5, 0.0, 0.03), 0.03, 0.0, 0.5, FIST_HALF.x);
//! let (config, around) = (StrikeConfig::default(), [floor(0.0)]);
//! let plan = plan_strike(&robot, &sweep, &around, &config, &mut ws)?;
//! let check = check_strike(&robot, &plan, &around, &config, &mut ws);
//! assert!(check.executable(), "{:?}", check.items);
//! let program = JointProgram::of_strike(&robot, &plan, 0.001, &mut ws);
//! assert_eq!(program.points[0].q, robot.home());
//! # Ok::<(), sms_robots::StrikeError>(())
//! ```
//!
//! # Conventions
//! - Poses are in the world: `x_wr` is the pose of the robot's base, `x_wt` that of its tool. Velocities are of a frame's
//!   origin, in world axes (Pinocchio's `LOCAL_WORLD_ALIGNED`).
//! - Vectors over joints follow [`RobotModel::joints`]; SI units; a sliding joint has metres and newtons.
//! - Nothing is allocated in kinematics, dynamics and control steps: [`Workspace`] holds what they need, for up to
//!   [`MAX_JOINTS`] joints.
//! - RNEA, CRBA, Jacobian and J̇ q̇ agree with Pinocchio to 1e-13 over 1500 states (`tests/oracle.rs`).

mod approach;
mod arm_sim;
mod check;
mod clearance;
mod config;
mod drive;
mod dynamics;
mod followed;
mod hold;
mod ik;
mod kinematics;
mod linalg;
mod model;
mod motion;
mod osc;
mod posture;
mod program;
mod scene;
mod shape;
mod strike;
mod sweep;
mod tracking;
mod urdf;
mod workspace;

use glamx::DVec3;

pub use approach::{Phase, StrikePlan, plan_startable_sweep, plan_strike};
pub use arm_sim::ArmSim;
pub use check::{CheckItem, CheckKind, DIRECTION_TOLERANCE_RAD, SPEED_TOLERANCE, StrikeCheck, check_strike};
pub use config::RobotConfig;
pub use drive::{ArmStrike, SweepDrive};
pub use hold::Hold;
pub use ik::{IkConfig, IkSolution, IkTarget, LENGTH_M, Unreachable};
pub use linalg::MAX_JOINTS;
pub use model::{Frame, FrameId, GRAVITY_W, Joint, JointKind, JointLimits, LinkCollision, RobotModel};
pub use motion::{
    Infeasible, JointMotion, JointSample, LimitKind, Use, Uses, hold_reference, joint_move, motor_torques,
    roll_out,
};
pub use osc::{FRICTION_SPEED, Osc, OscConfig, OscOutput, joint_friction};
pub use program::{JointProgram, PROGRAM_VERSION, ProgramPoint};
pub use scene::obstacles;
pub use shape::{Clearance, LinkShape, Obstacle, ObstacleShape, floor};
pub use strike::{StrikeConfig, StrikeError, SweepPlan, plan_sweep};
pub use sweep::{LinePath, SEGMENT_M, Sweep, SweepPath, SweepProfile, ToolPath, ToolReference, minimum_jerk};
pub use tracking::{ContactTracking, Tracking, simulate_sweep};
pub use urdf::{FR3_HOME, FR3_URDF, OffChain, UrdfOptions};
pub use workspace::{Jacobian, JointVector, MassMatrix, Workspace};

/// Half extents, metres, of the closed fingertips of a Franka Hand as one box, in the frame of the tool.
pub const FIST_HALF: DVec3 = DVec3::new(0.008_75, 0.015_18, 0.009_25);
