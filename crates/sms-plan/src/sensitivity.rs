//! Sensitivities of the chosen action, as the plan reports them.

use crate::{BodyProperty, Unknown};
use serde::{Deserialize, Serialize};

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
