//! Settings of the fits.

use serde::{Deserialize, Serialize};

/// Sphere recognition, by shape only.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SphereConfig {
    /// Random minimal samples (released code: 1000).
    pub samples: usize,
    /// Distance from the sphere below which a point is an inlier, metres.
    pub inlier_distance: f64,
    /// Distance for inliers as a share of the radius; the larger distance is used.
    pub inlier_radius_share: f64,
    /// Smallest share of the surface points that must be inliers.
    pub min_inlier_share: f64,
    /// Smallest share of the sphere's directions that must have been seen.
    pub min_coverage: f64,
    /// Smallest radius, metres.
    pub min_radius: f64,
    /// Largest radius, metres.
    pub max_radius: f64,
}

impl Default for SphereConfig {
    fn default() -> Self {
        Self {
            samples: 1000,
            inlier_distance: 0.0015,
            inlier_radius_share: 0.05,
            min_inlier_share: 0.85,
            min_coverage: 0.25,
            min_radius: 0.004,
            max_radius: 0.25,
        }
    }
}

/// Recognition of boxes and cylinders: exact solids collide better and faster than hulls.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PrimitiveConfig {
    /// Whether boxes and cylinders are recognised.
    pub enabled: bool,
    /// Distance from the solid's surface below which a point with a matching normal is an inlier, metres.
    pub inlier_distance: f64,
    /// Smallest share of the surface points that must be inliers.
    pub min_inlier_share: f64,
    /// Largest relative difference of the solid's volume from that of the mesh of the same points: hollow objects are
    /// not solids.
    pub max_volume_error: f64,
}

impl Default for PrimitiveConfig {
    fn default() -> Self {
        Self { enabled: true, inlier_distance: 0.0015, min_inlier_share: 0.92, max_volume_error: 0.06 }
    }
}
