//! Candidates of the choice over perturbed worlds.

use crate::PlanConfig;
use sms_task::Action;

/// Number of strategies with a candidate in all worlds.
pub(crate) const STRATEGIES: usize = 4;

/// An action in the choice over perturbed worlds.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct RobustCandidate {
    pub(crate) x: Vec<f64>,
    pub(crate) action: Action,
    /// Objective in the nominal world.
    pub(crate) objective: f64,
    /// Name of the strategy.
    pub(crate) strategy: String,
    /// Objectives in the worlds tried so far.
    pub(crate) outcomes: Vec<f64>,
}

impl RobustCandidate {
    /// The rank over the worlds tried so far, the scanned world if known and weighted, and `more` worlds of objective 0.
    pub(crate) fn rank(&self, config: &PlanConfig, more: usize) -> (usize, f64) {
        let nominal = if self.objective.is_finite() { config.nominal_worlds } else { 0 };
        let mut values = self.outcomes.clone();
        values.extend(std::iter::repeat_n(self.objective, nominal));
        values.extend(std::iter::repeat_n(0.0, more));
        config.objective.rank(&values)
    }
}

/// The key of a unit point in maps: its bits.
pub(crate) fn key(x: &[f64]) -> Vec<u64> {
    x.iter().map(|v| v.to_bits()).collect()
}
