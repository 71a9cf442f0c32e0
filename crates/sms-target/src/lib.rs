//! Target worlds that execute plans; the planner never reads them.
//!
//! [`execute`] takes a [`Target`], a task, the planned action, the planner's scene and the ground truth of a generated
//! scene, and returns the realised outcome. [`TargetEngine`] lists the targets: Rapier ([`SameEngineTarget`]), PhysX
//! with the feature `physx`, MuJoCo with the feature `mujoco`.
//!
//! [`execute_landing`] executes landings (`sms-landing`).
//!
//! ```
//! use sms_core::Seed;
//! use sms_synth::{BilliardsSettings, generate_billiards};
//! use sms_target::{SameEngineTarget, TargetOptions, execute, scene_from_truth};
//! use sms_task::{Billiards, Selector, Task};
//!
//! let truth = generate_billiards(Seed(1), &BilliardsSettings { objects: 1, ..Default::default() });
//! // A perfect scan; `sms materialize` returns a scene that differs from the ground truth.
//! let planned = scene_from_truth(&truth)?;
//! let (cue, target) = (Selector::by_name(&truth.cue), Selector::by_name(&truth.target));
//! let task = Task::Billiards(Billiards::new(cue, target, truth.goal_w));
//! let action = task.resolve(&planned)?.suggestions()[0].clone();
//! let options = TargetOptions::default();
//! let execution = execute(&SameEngineTarget, &task, &action, &planned, &truth, &options)?;
//! println!("{}: {:.3} m from the goal", execution.engine, execution.objective);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod engines;
mod execute;
mod landing;
mod matching;
#[cfg(feature = "mujoco")]
mod mujoco;
#[cfg(feature = "physx")]
mod physx;
mod scene;
mod target;

pub use engines::TargetEngine;
pub use execute::{TargetError, TargetOptions, disturbed, execute};
pub use landing::{LANDING_EXECUTION_FILE, LandingExecution, LandingTargetOptions, execute_landing};
pub use matching::match_bodies;
#[cfg(feature = "mujoco")]
pub use mujoco::{MUJOCO_VARIABLE, MujocoFactory};
#[cfg(feature = "physx")]
pub use physx::{PhysxFactory, physx_live_objects};
pub use scene::{robot_of, scene_from_truth};
pub use target::{SAME_ENGINE, SameEngineTarget, Target};
