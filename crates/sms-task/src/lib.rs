//! Tasks as data: actions, objectives, trajectories and the one rollout that planner and target share.

mod action;
mod selector;
pub mod table;
mod trajectory;

pub use action::{Action, Parameter};
pub use selector::{COLOR_WORDS, ColorName, Selector};
pub use trajectory::{BodyTrack, Execution, Trajectory};
