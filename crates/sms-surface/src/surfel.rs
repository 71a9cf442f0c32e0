//! Surface elements.

use glamx::DVec3;

/// The pixel that added an element.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct SeedPixel {
    /// Position of the frame among those that were fused.
    pub slot: usize,
    /// Index of the pixel, row by row.
    pub pixel: usize,
}

/// An element of the surface.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Surfel {
    /// Position in the world, metres.
    pub p_w: DVec3,
    /// Unit normal towards the cameras.
    pub n_w: DVec3,
    /// Upper bound on the standard deviation of the position along the normal, from the noise of the measurements of
    /// [`crate::settle`], metres: the four pixels of a frame count as one. 0 until there are any.
    pub sigma_m: f64,
    /// Distance to its neighbours that the finest frame asked for, metres.
    pub spacing_m: f64,
    /// Direction to the camera of the frame that resolves it best, unit.
    pub to_camera_w: DVec3,
    /// Size of a pixel of that frame on the surface, along the direction in which the surface recedes, metres.
    pub pitch_m: f64,
    /// The pixel that added it.
    pub seed: SeedPixel,
}
