//! Tasks as data: actions, objectives, trajectories and the one rollout that planner and target share.

mod action;
mod billiards;
mod closest;
mod execution;
pub mod json;
mod selector;
pub mod table;
mod trajectory;

pub use action::{Action, Parameter};
pub use billiards::{ActionBounds, ActionForm, Billiards, BilliardsKind, Range, StrikerMaterial, Task};
pub use closest::ClosestApproach;
pub use execution::Execution;
pub use selector::{COLOR_WORDS, ColorName, Selector};
pub use trajectory::{BodyTrack, Trajectory};
