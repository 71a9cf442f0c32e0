//! Optimisers and planning: Nelder-Mead, screening, multi-start, trial log.

mod halton;
mod nelder_mead;
mod optimiser;
mod plan;

pub use halton::Halton;
pub use nelder_mead::{Bounds, NelderMead};
pub use optimiser::{Minimum, Optimiser};
pub use plan::{Plan, StartSummary};
