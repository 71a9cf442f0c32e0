//! Settings of the fused surface.

use sms_frames::DepthNoise;

/// The least difference in depth that separates two surfaces.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceTolerance {
    /// Constant part, metres.
    pub min_m: f64,
    /// Number of standard deviations of the depth noise.
    pub sigmas: f64,
}

impl SurfaceTolerance {
    /// Returns the tolerance at depth `z_m` metres, metres.
    pub fn at(&self, noise: &DepthNoise, z_m: f64) -> f64 {
        self.min_m.max(self.sigmas * noise.sigma_m(z_m))
    }
}

/// Settings of the fused surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SurfaceConfig {
    /// Separation of surfaces.
    pub tolerance: SurfaceTolerance,
    /// Distance between neighbouring elements in pixels of the frame that adds them.
    pub spacing_px: f64,
    /// Distance on edges of colour or depth, as a share of `spacing_px`.
    pub edge_spacing: f64,
    /// Change of brightness (0..1, Sobel, per pixel) above which a pixel counts as an edge.
    pub edge_threshold: f32,
    /// Measurements with a smaller cosine between normal and ray are left to other frames.
    pub min_cosine: f64,
    /// Least cosine between the normals of an element and of its measurements in the first pass of [`crate::settle`]; the second
    /// measures at the position and normal found by the first, with [`crate::SAME_SURFACE_COSINE`].
    pub first_alike: f64,
}

impl Default for SurfaceConfig {
    fn default() -> Self {
        Self {
            tolerance: SurfaceTolerance { min_m: 0.005, sigmas: 3.0 },
            spacing_px: 2.5,
            edge_spacing: 0.5,
            edge_threshold: 0.08,
            min_cosine: 0.1,
            // New elements have the normal of one noisy pixel.
            first_alike: 0.3,
        }
    }
}
