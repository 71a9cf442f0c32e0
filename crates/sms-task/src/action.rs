//! Actions are points in a box of named parameters.

use serde::{Deserialize, Serialize};

/// One parameter of an action.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Parameter {
    /// Name ("speed").
    pub name: String,
    /// Unit ("m/s").
    pub unit: String,
    /// Smallest allowed value.
    pub low: f64,
    /// Largest allowed value.
    pub high: f64,
}

/// Values of the task's parameters, in the task's order.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Action(pub Vec<f64>);
