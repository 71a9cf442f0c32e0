//! Reasons for a choice, as the plan reports them.

use crate::BodyProperty;
use serde::{Deserialize, Serialize};

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
