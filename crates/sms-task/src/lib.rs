//! Tasks as data: actions, objectives, trajectories and the rollout that planner and target share.
//!
//! A [`Task`] is a TOML file. [`Task::resolve`] finds its bodies in the planner's scene. The [`ResolvedTask`] converts
//! an [`Action`] to a motion of the robot in the world ([`ResolvedTask::strike`]) and carries out this motion in any
//! world ([`ResolvedTask::rollout`]), either the planner's or a target's. The striker is the arm of
//! [`ResolvedTask::with_robot`], or a kinematic finger.
//!
//! ```
//! use sms_task::{Billiards, Selector, Task};
//! let file = r#"
//!     kind = "billiards"
//!     cue = { color = "white", sphere = true }
//!     target = { color = "blue", sphere = true }
//!     goal_w = [0.8, 0.1]
//! "#;
//! let dir = std::env::temp_dir().join("sms-task-example");
//! std::fs::create_dir_all(&dir)?;
//! std::fs::write(dir.join("shot.toml"), file)?;
//! let Task::Billiards(task) = Task::read(&dir.join("shot.toml"))? else { panic!("the kind says it") };
//! assert_eq!(task.cue, Selector::sphere_of_color("white"));
//! assert_eq!(task.horizon_s, 4.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod arm;
mod billiards;
mod body;
mod closest;
mod error;
mod execution;
pub mod json;
mod place;
mod resolved;
mod rollout;
mod selector;
mod strike;
mod task;
mod terms;
mod trajectory;

pub use arm::RobotArm;
pub use billiards::{ActionBounds, ActionForm, Billiards, BilliardsKind, ParameterRange, StrikerMaterial};
pub use body::TaskBody;
pub use closest::ClosestApproach;
pub use error::TaskError;
pub use execution::{AgainstPrediction, Execution};
pub use resolved::ResolvedTask;
pub use rollout::{MotionRecording, Rollout, STRIKER, WorldBodies};
pub use selector::{COLOR_WORDS, ColorName, Selector};
pub use strike::{Strike, StrikeKind};
pub use task::{Action, Parameter, TASK_KINDS, Task};
pub use terms::{METRES_PER_RADIAN, Others, Region, Term, TermBodies, When};
pub use trajectory::{BodyTrack, Trajectory};
