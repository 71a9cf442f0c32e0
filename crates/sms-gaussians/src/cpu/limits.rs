//! Constants of rendering and losses, shared by every back end and the oracle.

pub use super::losses::DEPTH_OPACITY_MIN;
pub use super::planes::RADIUS as SSIM_RADIUS;
pub use super::project::{AREA_FLOOR, FAR, LOW_PASS, MARGIN, NEAR, SLOPE_LOW_PASS};
pub use super::ssim::{C1 as SSIM_C1, C2 as SSIM_C2, window as ssim_window};
pub use super::tile::{ALPHA_MAX, ALPHA_MIN, TRANSMITTANCE_MIN};
