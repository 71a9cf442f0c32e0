//! Constants of the rendering and the losses that every back end and the oracle share.

pub use super::losses::DEPTH_OPACITY_MIN;
pub use super::project::{LOW_PASS, MARGIN, NEAR, SLOPE_LOW_PASS};
pub use super::raster::{ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN};
pub use super::ssim::{C1 as SSIM_C1, C2 as SSIM_C2, RADIUS as SSIM_RADIUS};
