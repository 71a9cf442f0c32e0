//! The paper's strike: a straight sweep of the tool, its approach, and the checks before it is run.

mod approach;
mod check;
mod drive;
mod followed;
mod hold;
mod motion;
mod posture;
mod program;
pub(crate) mod sweep;
mod sweep_plan;
mod tracking;

pub use approach::{Phase, StrikePlan, plan_startable_sweep, plan_strike};
pub use check::{CheckItem, CheckKind, DIRECTION_TOLERANCE_RAD, SPEED_TOLERANCE, StrikeCheck, check_strike};
pub use drive::{ArmStrike, SweepDrive};
pub use hold::Hold;
pub use motion::{
    Infeasible, JointMotion, JointSample, LimitKind, Use, Uses, hold_reference, joint_move, motor_torques,
    roll_out,
};
pub use program::{JointProgram, PROGRAM_VERSION, ProgramPoint};
pub use sweep::{LinePath, SEGMENT_M, Sweep, SweepPath, SweepProfile, ToolPath, ToolReference, minimum_jerk};
pub use sweep_plan::{StrikeConfig, StrikeError, SweepPlan, plan_sweep};
pub use tracking::{ContactTracking, Tracking, simulate_sweep};
