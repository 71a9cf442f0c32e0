//! Robots: fixed-base arms and flying vehicles.
//!
//! | module | content |
//! |---|---|
//! | `arm` | [`RobotModel`] from a URDF file or the built-in Franka Research 3; kinematics and dynamics; operational-space torque control ([`Osc`]); the paper's strike ([`plan_strike`]) and its checks ([`check_strike`]) |
//! | `vehicle` | [`Quadrotor`] and its approach to a landing ([`Flight`]) |
//! | [`autopilot`] | the approach as files for PX4 and QGroundControl |
//!
//! The crate contains no physics engine. It produces joint motions and torques ([`StrikePlan`], [`JointProgram`]), a
//! controller that works with any engine, and collision shapes ([`RobotModel::collisions`]).
//!
//! ```
//! use glamx::DVec3;
//! use sms_robots::{FIST_HALF, JointProgram, RobotModel, StrikeConfig, Sweep, Workspace, check_strike, floor, plan_strike};
//!
//! let robot = RobotModel::fr3();
//! let mut ws = Workspace::default();
//! // Strike a ball of 3 cm radius, half a metre ahead, along x at 0.5 m/s.
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
//! - SI units. Vectors over joints follow [`RobotModel::joints`]; a prismatic joint has metres and newtons.
//! - Poses are in the world: `x_wr` of the robot's base, `x_wt` of its tool, `x_wv` of a vehicle. Velocities are those
//!   of a frame's origin, in world axes (Pinocchio's `LOCAL_WORLD_ALIGNED`).
//! - Kinematics, dynamics and control steps do not allocate: [`Workspace`] holds their buffers, for up to
//!   [`MAX_JOINTS`] joints.
//! - RNEA, CRBA, Jacobian and J̇ q̇ agree with Pinocchio to 1e-13 over 1500 states (test `oracle`).

mod arm;
pub mod autopilot;
mod vehicle;

pub use arm::FIST_HALF;
pub use arm::config::RobotConfig;
pub use arm::dynamics::ik::{IkConfig, IkSolution, Unreachable};
pub use arm::dynamics::simulation::ArmSim;
pub use arm::dynamics::workspace::{Jacobian, JointVector, MAX_JOINTS, Workspace};
pub use arm::model::{FrameId, Joint, JointKind, LinkFrame, RobotModel};
pub use arm::obstacles::obstacles;
pub use arm::osc::{Osc, OscConfig, joint_friction};
pub use arm::shape::{LinkShape, Obstacle, ObstacleShape, floor};
pub use arm::strike::approach::{Phase, StrikePlan, plan_startable_sweep, plan_strike};
pub use arm::strike::check::{CheckKind, StrikeCheck, check_strike};
pub use arm::strike::drive::{ArmStrike, SweepDrive};
pub use arm::strike::motion::{Infeasible, JointMotion, LimitKind, Use, Uses};
pub use arm::strike::program::JointProgram;
pub use arm::strike::sweep::{SEGMENT_M, Sweep, SweepProfile, ToolPath, ToolReference};
pub use arm::strike::sweep_plan::{StrikeConfig, StrikeError, SweepPlan, plan_sweep};
pub use arm::strike::tracking::{Tracking, simulate_sweep};
pub use arm::urdf::{FR3_URDF, OffChain, UrdfOptions};
pub use vehicle::{BezierPath, Flight, FlightSettings, Quadrotor, Rotor, VehicleError};
