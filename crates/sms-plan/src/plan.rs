//! The stage's result.

use serde::{Deserialize, Serialize};
use sms_task::{Action, Parameter, Trajectory};

/// One optimisation from one start.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StartSummary {
    /// Index of the start.
    pub start: usize,
    /// Where it began.
    pub initial: Action,
    /// Objective there.
    pub initial_objective: f64,
    /// Where it ended.
    pub action: Action,
    /// Objective there.
    pub objective: f64,
    /// Rollouts used.
    pub evaluations: usize,
    /// Nelder-Mead iterations used.
    pub iterations: usize,
    /// 90 % quantile of the objective over disturbed worlds, where it was computed.
    pub objective_q90: Option<f64>,
}

/// The chosen action with what it is predicted to do.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Kind of task ("billiards").
    pub task: String,
    /// Engine that predicted.
    pub engine: String,
    /// The action's parameters.
    pub parameters: Vec<Parameter>,
    /// The chosen action.
    pub action: Action,
    /// Predicted objective in the nominal world.
    pub objective: f64,
    /// Unit of the objective.
    pub objective_unit: String,
    /// 90 % quantile over disturbed worlds.
    pub objective_q90: f64,
    /// Rollouts in all.
    pub evaluations: usize,
    /// Every start.
    pub starts: Vec<StartSummary>,
    /// Predicted motion of the chosen action.
    pub trajectory: Trajectory,
}
