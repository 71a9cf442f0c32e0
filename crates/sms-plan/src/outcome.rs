//! Output of the planning stage.

use crate::{Plan, Refusal, Trial, write_trials};
use sms_core::metrics::Metrics;
use sms_core::{CoreError, atomic};
use sms_task::json;
use std::path::Path;

/// A plan with all rollouts behind it.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanOutcome {
    /// The plan.
    pub plan: Plan,
    /// The rollouts: screening, searches in order of their starts, perturbed worlds.
    pub trials: Vec<Trial>,
}

impl PlanOutcome {
    /// `plan.{evaluations, objective, objective_q90, objective_unit, invalid, refused, striker, strategies}` and, with
    /// perturbed worlds, `plan.predicted_{mean, q10, q50, q90, success_share, worlds}`.
    pub fn metrics(&self) -> Metrics {
        let mut metrics = Metrics::new();
        metrics
            .set("plan.evaluations", self.plan.evaluations)
            .set("plan.objective", self.plan.objective)
            .set("plan.objective_q90", self.plan.objective_q90)
            .set("plan.objective_unit", self.plan.objective_unit.clone())
            .set("plan.invalid", self.plan.invalid)
            .set("plan.refused", Refusal::total(&self.plan.refused))
            .set("plan.striker", self.plan.striker.clone())
            .set("plan.strategies", self.plan.strategies.len());
        if let Some(p) = &self.plan.predicted {
            metrics
                .set("plan.predicted_mean", p.mean)
                .set("plan.predicted_q10", p.q10)
                .set("plan.predicted_q50", p.q50)
                .set("plan.predicted_q90", p.q90)
                .set("plan.predicted_success_share", p.success_share)
                .set("plan.predicted_worlds", p.worlds);
        }
        metrics
    }
}

/// Writes `plan.json`, `trials.parquet` and `trajectory.parquet` (the predicted motion) into a folder.
///
/// # Errors
/// [`CoreError::Write`].
pub fn save_plan(dir: &Path, outcome: &PlanOutcome) -> Result<(), CoreError> {
    json::write(&dir.join("plan.json"), &outcome.plan)?;
    write_trials(&dir.join("trials.parquet"), &outcome.plan.parameters, &outcome.trials)?;
    outcome.plan.trajectory.write_parquet(&dir.join("trajectory.parquet"))
}

/// Reads `plan.json` of a folder.
///
/// # Errors
/// [`CoreError::Read`] or [`CoreError::Input`] that names the file.
pub fn load_plan(dir: &Path) -> Result<Plan, CoreError> {
    atomic::read_json(&dir.join("plan.json"))
}
