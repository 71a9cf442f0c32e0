//! The errors of RGB-D sensors and of the poses that are recorded with them.

mod color_camera;
mod depth_camera;
mod depth_grid;
mod dots;
mod edges;
mod multipath;
mod noise;
mod pose_errors;
mod presets;

pub use color_camera::{ColorCamera, FrameState};
pub(crate) use color_camera::{ColorRays, Rays};
pub use depth_camera::{DepthCamera, DepthView, Measured};
pub(crate) use noise::irwin_hall;
pub use pose_errors::PoseErrors;
pub use presets::Sensor;

use serde::{Deserialize, Serialize};
use sms_core::{InputError, Ranges};

/// Everything about a sensor but its image size, field of view and path.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SensorModel {
    /// Errors of the depth camera.
    pub depth: DepthCamera,
    /// Errors of the colour camera.
    pub color: ColorCamera,
    /// Errors of the recorded poses.
    pub poses: PoseErrors,
}

impl SensorModel {
    /// Checks that all values are in range; `r` are the checks of the section that has the key `sensor`.
    pub(crate) fn validate(&self, r: &Ranges<'_>) -> Result<(), InputError> {
        let (d, c, p) = (&self.depth, &self.color, &self.poses);
        r.count("sensor.depth.columns", d.columns, 0, 8192)?;
        r.count("sensor.depth.dots", d.dots, 0, 1_000_000)?;
        let share = [0.0, 1.0];
        let settings = [
            ("depth.sigma_m", d.sigma_m, [0.0, 1.0]),
            ("depth.sigma_linear", d.sigma_linear, [0.0, 1.0]),
            ("depth.sigma_per_m", d.sigma_per_m, [0.0, 1.0]),
            ("depth.light_exponent", d.light_exponent, [0.0, 2.0]),
            ("depth.correlation_px", d.correlation_px, [0.0, 1280.0]),
            ("depth.disparity_step_per_m", d.disparity_step_per_m, [0.0, 1.0]),
            ("depth.edge_px", d.edge_px, [0.0, 100.0]),
            ("depth.edge_dropout", d.edge_dropout, share),
            ("depth.flying_share", d.flying_share, share),
            ("depth.mixed_px", d.mixed_px, [0.0, 100.0]),
            ("depth.multipath", d.multipath, [0.0, 10.0]),
            ("depth.grazing_cos", d.grazing_cos, share),
            ("depth.baseline_m", d.baseline_m, [0.0, 1.0]),
            ("depth.dark_echo", d.dark_echo, [0.0, 100.0]),
            ("depth.lost_light", d.lost_light, [0.0, 100.0]),
            ("depth.glare_echo", d.glare_echo, [0.0, 1e6]),
            ("depth.hole_share", d.hole_share, share),
            ("depth.missing_share", d.missing_share, share),
            ("depth.missing_px", d.missing_px, [0.0, 1280.0]),
            ("depth.smoothing_px", d.smoothing_px, [0.0, 100.0]),
            ("depth.fov_rad", d.fov_rad[0], [0.0, 3.1]),
            ("depth.fov_rad", d.fov_rad[1], [0.0, 3.1]),
            ("depth.range_m", d.range_m[0], [0.0, f64::INFINITY]),
            ("depth.range_m", d.range_m[1], [0.0, f64::INFINITY]),
            ("color.sigma_levels", f64::from(c.sigma_levels), [0.0, 255.0]),
            ("color.exposure_s", c.exposure_s, [0.0, 1.0]),
            ("color.gain_walk", c.gain_walk, [0.0, 1.0]),
            ("color.readout_s", c.readout_s, [-1.0, 1.0]),
            ("color.delay_s", c.delay_s, [-1.0, 1.0]),
            ("color.offset_px", c.offset_px[0], [-200.0, 200.0]),
            ("color.offset_px", c.offset_px[1], [-200.0, 200.0]),
            ("poses.drift_share", p.drift_share, share),
            ("poses.drift_turn_rad", p.drift_turn_rad, [0.0, 3.1]),
            ("poses.hand_eye_m", p.hand_eye_m, [0.0, 10.0]),
            ("poses.hand_eye_rad", p.hand_eye_rad, [0.0, 3.1]),
            ("poses.jitter_m", p.jitter_m, [0.0, 10.0]),
            ("poses.jitter_rad", p.jitter_rad, [0.0, 3.1]),
        ];
        for (key, value, [low, high]) in settings {
            r.within(&format!("sensor.{key}"), value, low, high)?;
        }
        Ok(())
    }
}
