//! Tasks as data: actions, objectives, trajectories and the one rollout that planner and target share.
//!
//! A [`Task`] is a TOML file. [`Task::resolve`] finds its bodies in the planner's scene and gives a
//! [`ResolvedTask`], which says what an [`Action`] means as a motion of the robot in the world
//! ([`ResolvedTask::strike`]), and carries that motion out in any world ([`ResolvedTask::rollout`]): the planner's
//! or a target's. What moves so is the arm of [`ResolvedTask::with_robot`], or a finger that gives no way.
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

mod action;
mod arm;
mod billiards;
mod closest;
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

pub use action::{Action, Parameter};
pub use arm::RobotArm;
pub use billiards::{ActionBounds, ActionForm, Billiards, BilliardsKind, Range, StrikerMaterial};
pub use closest::ClosestApproach;
pub use execution::{AgainstPrediction, Execution};
pub use resolved::{Ball, ResolvedTask, TaskError};
pub use rollout::{Recording, Rollout, STRIKER, WorldBodies};
pub use selector::{COLOR_WORDS, ColorName, Selector};
pub use strike::{Strike, StrikeKind};
pub use task::Task;
pub use terms::{Bodies, METRES_PER_RADIAN, Others, Region, Term, When};
pub use trajectory::{BodyTrack, Trajectory};
