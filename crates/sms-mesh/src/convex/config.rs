//! Settings of the decomposition.

use serde::{Deserialize, Serialize};

/// Convex decomposition.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ConvexConfig {
    /// Largest number of parts of one object. Where there are more, unions that add the least volume are made.
    pub max_parts: usize,
    /// Largest number of vertices of a part.
    pub max_vertices: usize,
    /// A part is convex enough when its concavity, in halves of the object's longest side, is at most this (the
    /// threshold of CoACD, which it sets to 0.05) …
    pub threshold: f64,
    /// … or, in metres, at most this: finer than a scan there is nothing to follow.
    pub floor: f64,
}

impl Default for ConvexConfig {
    fn default() -> Self {
        Self { max_parts: 16, max_vertices: 64, threshold: 0.05, floor: 0.0015 }
    }
}
