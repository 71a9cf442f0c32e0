//! Planning of actions: optimisers, robust choice and the trial log (paper section "Simulate").
//!
//! [`plan`] searches the actions of a task in the nominal world. It then chooses the action with the best outcomes in
//! perturbed worlds, which differ within the uncertainty of the scan and of the materials. Local searches are
//! [`LocalSearch`]es by the paper's method, [`NelderMead`].
//!
//! ```
//! use sms_plan::{LocalSearch, NelderMead};
//! let valley = |x: &[f64]| (x[0] - 0.3).powi(2) + 10.0 * (x[1] - x[0]).powi(2);
//! let mut search = LocalSearch::new(&NelderMead::default(), &[vec![0.9, 0.1]], &[0.1, 0.1], None);
//! while let Some(x) = search.next_point() {
//!     let value = valley(x);
//!     search.tell(value);
//! }
//! let found = search.minimum();
//! assert!((found.x[0] - 0.3).abs() < 0.01 && (found.x[1] - 0.3).abs() < 0.01);
//! ```

mod batch;
mod body_property;
mod candidate;
mod config;
mod counter;
mod descents;
mod error;
mod explain;
mod halton;
mod nelder_mead;
mod outcome;
mod perturbation;
mod plan;
mod planner;
mod prediction;
mod racing;
mod robust;
mod robust_search;
pub mod screening;
mod search;
mod sensitivity_analysis;
mod session;
mod simplex;
mod space;
mod strategy;
mod trials;
mod worlds;

pub use batch::{BatchOptimiser, Proposal, StartRecord, drive};
pub use body_property::BodyProperty;
pub use config::{Method, PlanConfig, SOLVED};
pub use error::PlanError;
pub use halton::Halton;
pub use nelder_mead::{BoxBounds, NelderMead};
pub use outcome::{PlanOutcome, load_plan, save_plan};
pub use perturbation::{Perturbation, Unknown, quantile};
pub use plan::{Counterfactual, InvalidRollout, Plan, Reason, Refusal, Sensitivity, StartSummary};
pub use planner::{MakeOptimiser, plan, search_nominal};
pub use prediction::{Prediction, RobustObjective};
pub use search::{SearchLog, optimiser};
pub use simplex::{LocalSearch, Minimum, SimplexSearch};
pub use space::Space;
pub use strategy::Strategy;
pub use trials::{Trial, TrialPhase, write_trials};
