//! Optimisers and planning: Nelder-Mead, screening, multi-start, trial log.

mod plan;

pub use plan::{Plan, StartSummary};
