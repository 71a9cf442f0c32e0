//! Optimisers and planning: Nelder-Mead, screening, multi-start, robust choice, trial log (paper section
//! "Simulate").
//!
//! [`plan`] searches the actions of a task in the nominal world and chooses, among the good ones, the one that
//! fares best in worlds that differ within what the scan and the materials leave open. The local search sits behind
//! the [`Optimiser`] trait; [`NelderMead`] is the paper's.
//!
//! ```
//! use sms_plan::{NelderMead, Optimiser};
//! let valley = |x: &[f64]| Some((x[0] - 0.3).powi(2) + 10.0 * (x[1] - x[0]).powi(2));
//! let found = NelderMead::default().minimise(&[vec![0.9, 0.1]], &[0.1, 0.1], &mut { valley });
//! assert!((found.x[0] - 0.3).abs() < 0.01 && (found.x[1] - 0.3).abs() < 0.01);
//! ```

mod batch;
mod beaten;
mod config;
mod descents;
mod disturb;
mod grid;
mod halton;
mod nelder_mead;
mod optimiser;
mod outcome;
mod plan;
mod planner;
mod prediction;
mod reason;
mod robust;
mod robust_search;
pub mod screening;
mod search;
mod sensitivity;
mod simplex;
mod space;
mod strategy;
mod trials;
mod worlds;

pub use batch::{BatchOptimiser, Proposal, StartRecord, drive};
pub use config::{Method, PlanConfig, SOLVED};
pub use disturb::{Disturbances, Unknown, quantile};
pub use grid::{GridBaseline, GridPlan};
pub use halton::Halton;
pub use nelder_mead::{Bounds, NelderMead};
pub use optimiser::{Minimum, Optimiser};
pub use outcome::{PlanOutcome, load_plan, save_plan};
pub use plan::{Plan, Refusal, StartSummary, Unbelievable};
pub use planner::{MakeOptimiser, NominalSearch, PlanError, plan, search_nominal, search_nominal_by};
pub use prediction::{Prediction, RobustObjective};
pub use reason::{BodyProperty, Counterfactual, Reason};
pub use sensitivity::Sensitivity;
pub use simplex::{LocalSearch, SimplexSearch};
pub use space::Space;
pub use strategy::Strategy;
pub use trials::{Phase, Trial, read_trials, write_trials};
pub use worlds::rehearse;
