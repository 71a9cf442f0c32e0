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

pub use arm::{
    ArmSim, ArmStrike, CheckKind, FIST_HALF, FR3_URDF, FrameId, IkConfig, IkSolution, IkTarget, Infeasible,
    Jacobian, Joint, JointKind, JointMotion, JointProgram, JointVector, LimitKind, LinkFrame, LinkShape,
    MAX_JOINTS, Obstacle, ObstacleShape, OffChain, Osc, OscConfig, Phase, RobotConfig, RobotModel, SEGMENT_M,
    StrikeCheck, StrikeConfig, StrikeError, StrikePlan, Sweep, SweepDrive, SweepPlan, SweepProfile, ToolPath,
    ToolReference, Tracking, Unreachable, UrdfOptions, Use, Uses, Workspace, check_strike, floor,
    joint_friction, obstacles, plan_startable_sweep, plan_strike, plan_sweep, simulate_sweep,
};
pub use vehicle::{BezierPath, Flight, FlightSettings, Quadrotor, Rotor, VehicleError};
