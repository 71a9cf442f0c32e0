//! The stage's result.

use crate::{Prediction, Reason, RobustObjective, Sensitivity, Strategy};
use serde::{Deserialize, Deserializer, Serialize};
use sms_robots::RobotConfig;
use sms_task::{Action, AgainstPrediction, Parameter, Trajectory};

/// One optimisation from one start.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StartSummary {
    /// Index of the start.
    pub start: usize,
    /// Where it began.
    pub initial: Action,
    /// Objective there; infinite (`null` in JSON) where the rollout was not valid.
    #[serde(deserialize_with = "infinite_if_null")]
    pub initial_objective: f64,
    /// Where it ended.
    pub action: Action,
    /// Objective there.
    #[serde(deserialize_with = "infinite_if_null")]
    pub objective: f64,
    /// Rollouts used.
    pub evaluations: usize,
    /// Nelder-Mead iterations used.
    pub iterations: usize,
    /// Strikes that it asked for and that the robot cannot make: they cost nothing, and others were tried in their place.
    #[serde(default)]
    pub refused: usize,
    /// 90 % quantile of the objective over disturbed worlds, where it was computed.
    pub objective_q90: Option<f64>,
}

impl StartSummary {
    /// Whether no strike that the robot can make was found where this search was to begin.
    pub fn is_out_of_reach(&self) -> bool {
        self.refused > 0 && self.evaluations == 0 && !self.objective.is_finite()
    }
}

fn infinite_if_null<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::INFINITY))
}

/// Why the robot cannot make some of the strikes that were looked at.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refusal {
    /// The reason, in words.
    pub reason: String,
    /// How many strikes.
    pub count: usize,
}

/// Why some of the rollouts cannot be believed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Unbelievable {
    /// The reason, in words: which body did what.
    pub reason: String,
    /// How many rollouts.
    pub count: usize,
    /// One of them: engine, time and figure.
    pub example: String,
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
    /// 90 % quantile over disturbed worlds; the nominal objective where there are none.
    pub objective_q90: f64,
    /// Shots that were tried in some world, as many as trials in the log and one for the recorded motion. What a scan or a
    /// search asks for and the robot cannot make is none of them: others are tried in its place.
    pub evaluations: usize,
    /// Rollouts among them that could not be believed; they were never the best.
    #[serde(default)]
    pub invalid: usize,
    /// Why they could not be, the most frequent reason first.
    #[serde(default)]
    pub unbelievable: Vec<Unbelievable>,
    /// Actions that were looked at in the search of the scanned world and in the scan of disturbed worlds, points that were
    /// drawn for a scan and that the robot cannot make included.
    #[serde(default)]
    pub searched: usize,
    /// Those among them that the robot cannot make, by reason, the most frequent first; nothing was simulated for them,
    /// and they were never the best.
    #[serde(default)]
    pub refused: Vec<Refusal>,
    /// What carries the strike out, in words.
    #[serde(default)]
    pub striker: String,
    /// The robot that carries it out, with its place in the run's world; `None` for the finger that gives no way.
    #[serde(default)]
    pub robot: Option<RobotConfig>,
    /// Every start.
    pub starts: Vec<StartSummary>,
    /// What was minimised over the disturbed worlds; `None` where the nominal world alone was looked at.
    #[serde(default)]
    pub chosen_by: Option<RobustObjective>,
    /// What the action does in disturbed worlds that played no part in choosing it.
    #[serde(default)]
    pub predicted: Option<Prediction>,
    /// Ways of reaching the goal, best first; the first one's action is the plan's.
    #[serde(default)]
    pub strategies: Vec<Strategy>,
    /// Why it was chosen, most telling first.
    #[serde(default)]
    pub reasons: Vec<Reason>,
    /// Which unknowns matter for the chosen action, most important first. Each is disturbed alone: interactions are left
    /// out.
    #[serde(default)]
    pub sensitivities: Vec<Sensitivity>,
    /// Predicted motion of the chosen action.
    pub trajectory: Trajectory,
}

impl Plan {
    /// "312 of 1500 actions are out of the robot's reach: …"; `None` where none is.
    pub fn refused_text(&self) -> Option<String> {
        let count: usize = self.refused.iter().map(|r| r.count).sum();
        let list: Vec<String> =
            self.refused.iter().take(4).map(|r| format!("{} ({})", r.reason, r.count)).collect();
        let more = if self.refused.len() > 4 { ", …" } else { "" };
        (count > 0).then(|| {
            format!(
                "{count} of {} actions are out of the robot's reach: {}{more}",
                self.searched,
                list.join(", ")
            )
        })
    }

    /// "`ball` was inside of `box` (3), …": why rollouts could not be believed, with an example; `None` where all could, or
    /// the plan is of an earlier version.
    pub fn unbelievable_text(&self) -> Option<String> {
        let first = self.unbelievable.first()?;
        let list: Vec<String> =
            self.unbelievable.iter().take(4).map(|u| format!("{} ({})", u.reason, u.count)).collect();
        let more = if self.unbelievable.len() > 4 { ", …" } else { "" };
        Some(format!("{}{more}; for example, {}", list.join(", "), first.example))
    }

    /// Where a realised objective lies in the predicted distribution; `None` where there is none.
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

    /// Whether no disturbed world was looked at, so that nothing is known of how the action fares in them.
    pub fn is_nominal_only(&self) -> bool {
        // Plans of earlier versions have neither, and a quantile over disturbed worlds.
        self.predicted.is_none() && self.strategies.first().is_some_and(|s| s.outcomes.is_empty())
    }
}
