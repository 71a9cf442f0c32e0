//! The trial log.

use serde::{Deserialize, Serialize};
use sms_core::CoreError;
use sms_core::table::{Column, write_table};
use sms_task::{Action, Parameter};
use std::path::Path;

/// Purpose of a rollout.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TrialPhase {
    /// A point of the screening.
    Screen,
    /// A point of a local search.
    Search,
    /// A candidate, or a point of the scan, in a perturbed world.
    #[serde(rename = "disturbed")]
    Perturbed,
    /// The action of a strategy in a forecast world.
    Forecast,
    /// The chosen action with one unknown perturbed.
    Sensitivity,
    /// A shot in a world with a different property of one body, to explain the choice.
    Reason,
}

impl TrialPhase {
    /// The value in the trial log.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Screen => "screen",
            Self::Search => "search",
            Self::Perturbed => "disturbed",
            Self::Forecast => "forecast",
            Self::Sensitivity => "sensitivity",
            Self::Reason => "reason",
        }
    }
}

/// One rollout.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// Purpose of the rollout.
    pub phase: TrialPhase,
    /// Index of the start (search), candidate (perturbed), strategy (forecast), unknown (sensitivity) or
    /// counterfactual world (reason); −1 in the screening and in the scan of the perturbed worlds.
    pub start: i32,
    /// Number of the evaluation within its phase and start. For perturbed worlds it is the index of the world, with −1
    /// for the nominal world.
    pub iteration: i32,
    /// The action.
    pub action: Action,
    /// The objective in the task's unit; infinite for an invalid trial.
    pub objective: f64,
    /// Whether the rollout is valid: it did not diverge, bodies gained no energy and did not pass through each other.
    pub valid: bool,
}

impl Trial {
    /// Creates a trial; it is valid when the objective is finite.
    pub fn new(phase: TrialPhase, start: i32, iteration: i32, action: Action, objective: f64) -> Self {
        let valid = objective.is_finite();
        let objective = if valid { objective } else { f64::INFINITY };
        Self { phase, start, iteration, action, objective, valid }
    }

    /// Returns the trials of an action in consecutive worlds from the index `first` on.
    pub(crate) fn row<'a>(
        phase: TrialPhase,
        start: usize,
        first: usize,
        action: &'a Action,
        objectives: &'a [f64],
    ) -> impl Iterator<Item = Self> + 'a {
        let trial = move |(w, &objective): (usize, &f64)| {
            Self::new(phase, start as i32, w as i32, action.clone(), objective)
        };
        (first..).zip(objectives).map(trial)
    }
}

/// Writes `trials.parquet`: `phase`, `start`, `iteration`, one column per parameter (under its name), `objective` and
/// `valid` (1, or 0 for invalid rollouts, which have an infinite objective). The file contains no times, so that equal
/// plans give equal bytes.
///
/// # Errors
/// [`CoreError::Write`].
pub fn write_trials(path: &Path, parameters: &[Parameter], trials: &[Trial]) -> Result<(), CoreError> {
    let mut columns = vec![
        ("phase", Column::Text(trials.iter().map(|t| t.phase.as_str().to_owned()).collect())),
        ("start", Column::I32(trials.iter().map(|t| t.start).collect())),
        ("iteration", Column::I32(trials.iter().map(|t| t.iteration).collect())),
    ];
    for (i, p) in parameters.iter().enumerate() {
        columns.push((&p.name, Column::F64(trials.iter().map(|t| t.action.0[i]).collect())));
    }
    columns.push(("objective", Column::F64(trials.iter().map(|t| t.objective).collect())));
    columns.push(("valid", Column::I32(trials.iter().map(|t| i32::from(t.valid)).collect())));
    write_table(path, &columns)
}
