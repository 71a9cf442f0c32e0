//! The paper's strike: a straight sweep of the tool, its approach, and the checks before it is run.

mod approach;
mod check;
mod drive;
mod hold;
mod motion;
mod obstruction;
mod posture;
mod program;
pub(crate) mod sweep;
mod sweep_candidate;
mod sweep_plan;
mod tracking;

pub use approach::{Phase, StrikePlan, plan_startable_sweep, plan_strike};
pub use check::{CheckKind, StrikeCheck, check_strike};
pub use drive::{ArmStrike, SweepDrive};
pub use motion::{Infeasible, JointMotion, LimitKind, Use, Uses};
pub use program::JointProgram;
pub use sweep::{SEGMENT_M, Sweep, SweepProfile, ToolPath, ToolReference};
pub use sweep_plan::{StrikeConfig, StrikeError, SweepPlan, plan_sweep};
pub use tracking::{Tracking, simulate_sweep};
