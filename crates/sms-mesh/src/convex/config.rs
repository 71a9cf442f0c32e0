//! Settings of the decomposition.

use serde::{Deserialize, Serialize};

/// Convex decomposition.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ConvexConfig {
    /// Largest number of parts of one object. If there are more, the unions that add the least volume are made.
    pub max_parts: usize,
    /// Largest number of vertices of a part.
    pub max_vertices: usize,
    /// Concavity, in halves of the object's longest side, up to which a part is convex enough (the threshold of CoACD,
    /// 0.05 there).
    pub threshold: f64,
    /// Concavity, in metres, up to which a part is always convex enough: details below the resolution of a scan are
    /// noise.
    pub floor: f64,
}

impl Default for ConvexConfig {
    fn default() -> Self {
        Self { max_parts: 16, max_vertices: 64, threshold: 0.05, floor: 0.0015 }
    }
}
