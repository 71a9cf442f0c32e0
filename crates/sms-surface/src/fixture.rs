//! Frames of a plane in closed form.

use crate::SurfaceConfig;
use glamx::DVec3;
use sms_core::{Camera, Image, Intrinsics};
use sms_frames::Frame;

/// The settings of the scan.
pub(crate) fn config() -> SurfaceConfig {
    SurfaceConfig::default()
}

/// A camera at `eye_z_m` on the z axis that looks at the origin and measures a plane at height `surface_z_m`.
pub(crate) fn facing_plane(eye_z_m: f64, surface_z_m: f64) -> Frame {
    let k = Intrinsics::from_fov(64, 40, 0.5);
    let camera = Camera::look_at(k, DVec3::Z * eye_z_m, DVec3::ZERO, DVec3::Y);
    Frame::new(
        camera,
        Image::filled(64, 40, [0; 3]),
        Image::filled(64, 40, (eye_z_m - surface_z_m).abs() as f32),
        Image::filled(64, 40, [0.0, 0.0, -1.0]),
    )
}
