//! Settings of the decomposition.

use serde::{Deserialize, Serialize};

/// Convex decomposition.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ConvexConfig {
    /// Largest number of parts of one object.
    pub max_parts: usize,
    /// Largest number of vertices of a part.
    pub max_vertices: usize,
    /// A part is convex enough when its hull leaves it by less than this share of the object's size (the concavity
    /// of CoACD, which the released code sets to 0.075) …
    pub concavity: f64,
    /// … or by less than this length, metres.
    pub concavity_floor: f64,
}

impl Default for ConvexConfig {
    fn default() -> Self {
        Self { max_parts: 16, max_vertices: 64, concavity: 0.035, concavity_floor: 0.0035 }
    }
}
