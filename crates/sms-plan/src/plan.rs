//! The plan: result of the planning stage.

use crate::{BodyProperty, Prediction, RobustObjective, Strategy, Unknown};
use serde::{Deserialize, Deserializer, Serialize};
use sms_robots::RobotConfig;
use sms_task::{Action, AgainstPrediction, Parameter, Trajectory};

/// One local search from one start.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StartSummary {
    /// Index of the start.
    pub start: usize,
    /// The initial action.
    pub initial: Action,
    /// Objective of the initial action; infinite (`null` in JSON) if the rollout was invalid.
    #[serde(deserialize_with = "infinite_if_null")]
    pub initial_objective: f64,
    /// The best action.
    pub action: Action,
    /// Objective of the best action.
    #[serde(deserialize_with = "infinite_if_null")]
    pub objective: f64,
    /// Rollouts used.
    pub evaluations: usize,
    /// Nelder-Mead iterations used.
    pub iterations: usize,
    /// Number of infeasible strikes that the search proposed. They cost nothing, and other strikes were tried instead.
    #[serde(default)]
    pub refused: usize,
    /// 90 % quantile of the objective over perturbed worlds, if it was computed.
    pub objective_q90: Option<f64>,
}

impl StartSummary {
    /// Returns whether no feasible strike was found as a start of this search.
    pub fn is_out_of_reach(&self) -> bool {
        self.refused > 0 && self.evaluations == 0 && !self.objective.is_finite()
    }
}

fn infinite_if_null<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::INFINITY))
}

/// A reason for refused strikes.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refusal {
    /// The reason as text.
    pub reason: String,
    /// Number of strikes.
    pub count: usize,
}

impl Refusal {
    /// Returns the number of strikes of all reasons.
    pub(crate) fn total(refusals: &[Self]) -> usize {
        refusals.iter().map(|r| r.count).sum()
    }
}

/// A reason for invalid rollouts.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct InvalidRollout {
    /// The reason as text: the body and its failure.
    pub reason: String,
    /// Number of rollouts.
    pub count: usize,
    /// An example: engine, time and measured value.
    pub example: String,
}

/// A comparison of one shot in the scanned world and in a world where one property of one body differs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Counterfactual {
    /// The strategy.
    pub strategy: String,
    /// The body that the strategy relies on.
    pub body: String,
    /// The property that differs.
    pub property: BodyProperty,
    /// The value in the scanned world and the value in the other one.
    pub values: [f64; 2],
    /// Objective in the scanned world and in the other one.
    pub objectives: [f64; 2],
    /// Displacement of the body in both worlds, metres.
    pub moved_m: [f64; 2],
    /// Number of shots of the strategy that were tried in the other world: 1 for the chosen shot, which is repeated
    /// unchanged.
    pub shots: usize,
}

/// One reason for the choice.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Reason {
    /// The reason as a sentence.
    pub text: String,
    /// The rollouts behind it; `None` for a comparison of two strategies' predictions.
    pub counterfactual: Option<Counterfactual>,
}

/// Effect of one unknown on the chosen action.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sensitivity {
    /// The unknown.
    pub unknown: Unknown,
    /// Root mean square change of the objective when only this unknown is perturbed, in the task's unit.
    pub change: f64,
    /// Share of this unknown in the sum of the mean squares over all unknowns.
    pub share: f64,
    /// For an important material, the property with the largest effect when perturbed alone.
    #[serde(default)]
    pub property: Option<BodyProperty>,
}

impl std::fmt::Display for Sensitivity {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.unknown)?;
        self.property.map_or(Ok(()), |p| write!(f, ", mostly its {}", p.as_str()))
    }
}

/// The chosen action with its prediction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Kind of task ("billiards").
    pub task: String,
    /// The engine of the prediction.
    pub engine: String,
    /// The action's parameters.
    pub parameters: Vec<Parameter>,
    /// The chosen action.
    pub action: Action,
    /// Predicted objective in the nominal world.
    pub objective: f64,
    /// Unit of the objective.
    pub objective_unit: String,
    /// 90 % quantile over perturbed worlds; the nominal objective without them.
    pub objective_q90: f64,
    /// Simulated shots in all worlds: the trials of the log and one for the recorded motion, without infeasible points.
    pub evaluations: usize,
    /// Number of invalid rollouts. They never count as best.
    #[serde(default)]
    pub invalid: usize,
    /// Reasons of the invalid rollouts, the most frequent first.
    #[serde(default, rename = "unbelievable")]
    pub invalid_rollouts: Vec<InvalidRollout>,
    /// Actions considered in the nominal search and in the scan of the perturbed worlds, including points that the
    /// robot cannot carry out.
    #[serde(default)]
    pub searched: usize,
    /// Infeasible actions among `searched` by reason, the most frequent first. They were not simulated.
    #[serde(default)]
    pub refused: Vec<Refusal>,
    /// Name of the striker.
    #[serde(default)]
    pub striker: String,
    /// The robot, with its pose in the world of the run; `None` for the kinematic finger.
    #[serde(default)]
    pub robot: Option<RobotConfig>,
    /// All local searches.
    pub starts: Vec<StartSummary>,
    /// Statistic that was minimised over perturbed worlds; `None` for a plan of the nominal world alone.
    #[serde(default)]
    pub chosen_by: Option<RobustObjective>,
    /// Forecast of the action in perturbed worlds that were not used for the choice.
    #[serde(default)]
    pub predicted: Option<Prediction>,
    /// Strategies, best first. The action of the first one is the plan's.
    #[serde(default)]
    pub strategies: Vec<Strategy>,
    /// Reasons for the choice, most important first.
    #[serde(default)]
    pub reasons: Vec<Reason>,
    /// Sensitivities of the chosen action, most important first. Each unknown is perturbed alone, without interactions.
    #[serde(default)]
    pub sensitivities: Vec<Sensitivity>,
    /// Predicted motion of the chosen action.
    pub trajectory: Trajectory,
}

impl Plan {
    /// Returns whether the striker cannot make more than half of the actions considered, which is also a warning.
    pub fn is_mostly_refused(&self) -> bool {
        2 * Refusal::total(&self.refused) > self.searched
    }

    /// "the striker cannot make 312 of 1500 actions: …"; `None` if it can make all.
    pub fn refused_text(&self) -> Option<String> {
        let count = Refusal::total(&self.refused);
        let list: Vec<String> =
            self.refused.iter().take(4).map(|r| format!("{} ({})", r.reason, r.count)).collect();
        let more = if self.refused.len() > 4 { ", …" } else { "" };
        (count > 0).then(|| {
            format!("the striker cannot make {count} of {} actions: {}{more}", self.searched, list.join(", "))
        })
    }

    /// The reasons for invalid rollouts with an example, "`ball` was inside of `box` (3), …"; `None` if all rollouts
    /// were valid, or for plans of earlier versions.
    pub fn failure_text(&self) -> Option<String> {
        let first = self.invalid_rollouts.first()?;
        let list: Vec<String> =
            self.invalid_rollouts.iter().take(4).map(|u| format!("{} ({})", u.reason, u.count)).collect();
        let more = if self.invalid_rollouts.len() > 4 { ", …" } else { "" };
        Some(format!("{}{more}; for example, {}", list.join(", "), first.example))
    }

    /// The rank of a realised objective in the forecast; `None` without a forecast.
    pub fn against(&self, realised: f64) -> Option<AgainstPrediction> {
        let p = self.predicted?;
        let outcomes: Vec<f64> = self.strategies.first()?.outcomes.iter().copied().flatten().collect();
        if outcomes.is_empty() {
            return None;
        }
        let better = outcomes.iter().filter(|v| **v < realised).count() as f64;
        let equal = outcomes.iter().filter(|v| **v == realised).count() as f64;
        Some(AgainstPrediction {
            nominal: self.objective,
            mean: p.mean,
            q90: p.q90,
            rank: (better + 0.5 * equal) / outcomes.len() as f64,
            worlds: outcomes.len(),
        })
    }

    /// Returns whether the plan was made only in the nominal world.
    pub fn is_nominal_only(&self) -> bool {
        // Plans of earlier versions lack both fields, but have a quantile over perturbed worlds.
        self.predicted.is_none() && self.strategies.first().is_some_and(|s| s.outcomes.is_empty())
    }
}
