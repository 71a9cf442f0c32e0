//! The trial log.

use serde::{Deserialize, Serialize};
use sms_core::table::{Column, read_table, write_table};
use sms_core::{CoreError, InputError};
use sms_task::{Action, Parameter};
use std::path::Path;

/// What a rollout was for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Phase {
    /// A point of the screening.
    Screen,
    /// A point of a local search.
    Search,
    /// A candidate, or a point of the scan, in a disturbed world.
    Disturbed,
    /// A strategy's action in a disturbed world that played no part in choosing it.
    Forecast,
    /// The chosen action with one unknown disturbed.
    Sensitivity,
    /// A shot in a world in which one property of one body is another, to find out why the action was chosen.
    Reason,
}

impl Phase {
    /// The word in the trial log.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Screen => "screen",
            Self::Search => "search",
            Self::Disturbed => "disturbed",
            Self::Forecast => "forecast",
            Self::Sensitivity => "sensitivity",
            Self::Reason => "reason",
        }
    }
}

/// One rollout.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// What it was for.
    pub phase: Phase,
    /// Index of the start (search), candidate (disturbed), strategy (forecast), unknown (sensitivity) or world with another
    /// body (reason); −1 in the screening and in the scan of the disturbed worlds.
    pub start: i32,
    /// Number of the evaluation within the phase and start; the world's for disturbed ones, where −1 is the nominal world.
    pub iteration: i32,
    /// The action.
    pub action: Action,
    /// Its objective, in the task's unit; infinite for a trial that is not valid.
    pub objective: f64,
    /// Whether the simulation can be believed: it neither diverged nor gained energy nor let bodies pass through each
    /// other.
    pub valid: bool,
}

impl Trial {
    /// A trial; one without a finite objective is not valid.
    pub fn new(phase: Phase, start: i32, iteration: i32, action: Action, objective: f64) -> Self {
        let valid = objective.is_finite();
        let objective = if valid { objective } else { f64::INFINITY };
        Self { phase, start, iteration, action, objective, valid }
    }
}

/// Writes `trials.parquet`: `phase`, `start`, `iteration`, one column per parameter (by its name), `objective`,
/// `valid` (1, or 0 for rollouts that cannot be believed, whose objective is infinite). No times, so that the same plan gives the same bytes.
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

/// Reads `trials.parquet`.
///
/// # Errors
/// [`CoreError::Read`] or [`CoreError::Input`] that names the file.
pub fn read_trials(path: &Path) -> Result<Vec<Trial>, CoreError> {
    let table = read_table(path)?;
    let rows = table.first().map_or(0, |(_, c)| c.len());
    let mut parameters = Vec::new();
    let (mut phases, mut starts, mut iterations, mut objectives) = (None, None, None, None);
    for (name, column) in table {
        match (name.as_str(), column) {
            ("phase", Column::Text(v)) => phases = Some(v),
            ("start", Column::I32(v)) => starts = Some(v),
            ("iteration", Column::I32(v)) => iterations = Some(v),
            ("objective", Column::F64(v)) => objectives = Some(v),
            (_, Column::F64(v)) => parameters.push(v),
            _ => {}
        }
    }
    let not_trials = || {
        InputError::new("this table is no trial log", path, "restore or regenerate the file with `sms plan`")
    };
    let (Some(phases), Some(starts), Some(iterations), Some(objectives)) =
        (phases, starts, iterations, objectives)
    else {
        return Err(not_trials().into());
    };
    (0..rows)
        .map(|i| {
            let all = [
                Phase::Screen,
                Phase::Search,
                Phase::Disturbed,
                Phase::Forecast,
                Phase::Sensitivity,
                Phase::Reason,
            ];
            let phase = all
                .into_iter()
                .find(|p| p.as_str() == phases[i])
                .ok_or_else(|| not_trials().because(format!("unknown phase `{}`", phases[i])))?;
            let action = Action(parameters.iter().map(|c: &Vec<f64>| c[i]).collect());
            Ok(Trial::new(phase, starts[i], iterations[i], action, objectives[i]))
        })
        .collect()
}
