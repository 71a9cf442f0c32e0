//! Tasks as data: actions, objectives, trajectories and the one rollout that planner and target share.

mod action;
mod trajectory;

pub use action::{Action, Parameter};
pub use trajectory::{BodyTrack, Execution, Trajectory};
