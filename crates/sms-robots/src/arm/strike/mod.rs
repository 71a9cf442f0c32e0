//! The paper's strike: a straight sweep of the tool, its approach, and the checks before it is run.

pub(crate) mod approach;
pub(crate) mod check;
pub(crate) mod drive;
mod hold;
pub(crate) mod motion;
mod obstruction;
mod posture;
pub(crate) mod program;
pub(crate) mod sweep;
mod sweep_candidate;
pub(crate) mod sweep_plan;
pub(crate) mod tracking;
