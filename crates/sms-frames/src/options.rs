//! Settings of reading and loading.

use serde::{Deserialize, Serialize};
use sms_core::{InputError, Ranges};

/// Axes of the camera frame that the poses of a recording refer to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Axes {
    /// x right, y down, z forward: used internally.
    Opencv,
    /// x right, y up, z backward: nerfstudio, Blender, ARKit.
    Opengl,
}

/// Direction of the pose matrices of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PoseDirection {
    /// The matrix carries camera points to the recording's world.
    CameraToWorld,
    /// The matrix carries world points to the camera.
    WorldToCamera,
}

/// Settings of reading. `None` takes the recording's own value, else its format's default.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ReadOptions {
    /// Centre of pixel (0, 0) in the recording's intrinsics: 0.5 (nerfstudio, COLMAP) or 0 (OpenCV
    /// calibration, TUM). By default the key `pixel_center` of `transforms.json`, else 0.5; 0 for TUM.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub pixel_center: Option<f64>,
    /// Metres of one unit of the depth images. By default the key `depth_unit_scale_factor`, else 0.001 (as
    /// nerfstudio has it); 1/5000 for TUM.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub depth_unit_m: Option<f64>,
    /// Camera axes of the poses. By default the key `camera_convention`, else OpenGL; OpenCV for TUM.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub axes: Option<Axes>,
    /// Direction of the pose matrices. By default the key `pose_convention`, else camera-to-world.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub poses: Option<PoseDirection>,
    /// Whether poses that the recording holds are ignored, because they are estimated.
    pub ignore_poses: bool,
    /// Colour intrinsics fx, fy, cx, cy in pixels of the colour images, in place of the recording's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub intrinsics: Option<[f64; 4]>,
    /// Distortion k1, k2, p1, p2, k3 (OpenCV's order) in place of the recording's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub distortion: Option<[f64; 5]>,
    /// States that colour and depth images of different size show the same field of view, so that the depth
    /// intrinsics are the colour intrinsics scaled.
    pub depth_same_field_of_view: bool,
    /// Depth nearer than this is dropped, metres.
    pub min_depth_m: f64,
    /// Depth beyond this is dropped, metres: for desk-size scenes, and for sensors that mark missing depth by a large value.
    pub max_depth_m: f64,
    /// Skip frames whose depth image is empty (with a warning) instead of refusing the recording.
    pub skip_empty_depth: bool,
    /// TUM: largest time between a colour image and its depth image, seconds (the benchmark's own tools: 0.02).
    pub max_pair_gap_s: f64,
    /// TUM: largest time between two poses that are interpolated, seconds.
    pub max_pose_gap_s: f64,
}

impl Default for ReadOptions {
    fn default() -> Self {
        Self {
            pixel_center: None,
            depth_unit_m: None,
            axes: None,
            poses: None,
            ignore_poses: false,
            intrinsics: None,
            distortion: None,
            depth_same_field_of_view: false,
            min_depth_m: 0.05,
            max_depth_m: 10.0,
            skip_empty_depth: false,
            max_pair_gap_s: 0.02,
            max_pose_gap_s: 0.1,
        }
    }
}

impl ReadOptions {
    /// Checks that all values are in range.
    ///
    /// # Errors
    /// [`InputError`] that names the first key out of range and the allowed range.
    pub fn validate(&self) -> Result<(), InputError> {
        let r = Ranges::of("read");
        r.within("pixel_center", self.pixel_center.unwrap_or(0.5), 0.0, 1.0)?;
        r.within("depth_unit_m", self.depth_unit_m.unwrap_or(0.001), 1e-7, 1e3)?;
        if let Some([fx, fy, cx, cy]) = self.intrinsics {
            for (key, value) in [("intrinsics[0]", fx), ("intrinsics[1]", fy)] {
                r.within(key, value, 1.0, 1e6)?;
            }
            for (key, value) in [("intrinsics[2]", cx), ("intrinsics[3]", cy)] {
                r.within(key, value, -1e6, 1e6)?;
            }
        }
        for (i, value) in self.distortion.unwrap_or_default().into_iter().enumerate() {
            r.within(&format!("distortion[{i}]"), value, -1e3, 1e3)?;
        }
        r.within("min_depth_m", self.min_depth_m, 0.0, 1e3)?;
        r.within("max_depth_m", self.max_depth_m, 1e-3, 1e4)?;
        r.ordered(("min_depth_m", self.min_depth_m), ("max_depth_m", self.max_depth_m))?;
        r.within("max_pair_gap_s", self.max_pair_gap_s, 0.0, 3600.0)?;
        r.within("max_pose_gap_s", self.max_pose_gap_s, 0.0, 3600.0)
    }
}

/// Alignment of the recording's world with the z-up world.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Align {
    /// By the recording's keys (`world_is_aligned`, `world_up`) if present, else by the dominant support plane.
    #[default]
    Auto,
    /// The recording's world is taken as it is; it must be metric with z up.
    None,
    /// This direction of the recording's world is up; the support plane gives the height only.
    Up([f64; 3]),
}

/// Depth noise of a sensor: σ(z) = a + b z².
///
/// The quadratic growth is that of triangulating sensors (Nguyen, Izadi and Lovell, 3DIMPVT 2012). The default
/// (1.5 mm at 0.6 m) is the difference between neighbouring frames of a RealSense F200.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DepthNoise {
    /// Constant part `a`, metres.
    pub a_m: f64,
    /// Quadratic part `b`, per metre.
    pub b_per_m: f64,
}

impl Default for DepthNoise {
    fn default() -> Self {
        Self { a_m: 0.001, b_per_m: 0.0015 }
    }
}

impl DepthNoise {
    /// Checks that all values are in range, as keys of `section` that begin with `prefix` (as in `noise.`).
    ///
    /// # Errors
    /// [`InputError`] that names the first key out of range and the allowed range.
    pub fn validate(&self, section: &str, prefix: &str) -> Result<(), InputError> {
        let r = Ranges::of(section);
        r.within(&format!("{prefix}a_m"), self.a_m, 0.0, 0.1)?;
        r.within(&format!("{prefix}b_per_m"), self.b_per_m, 0.0, 0.1)?;
        // Without any noise, every difference would count as another surface.
        r.within(&format!("{prefix}a_m"), self.a_m + self.b_per_m, 1e-6, 0.2)
    }

    /// Standard deviation in metres at depth `z_m` metres.
    pub fn sigma_m(&self, z_m: f64) -> f64 {
        self.a_m + self.b_per_m * z_m * z_m
    }

    /// Returns the greatest difference between depths of one surface at depth `z_m`, metres: three standard deviations, or `share` of
    /// the depth, as poses have errors, too.
    pub(crate) fn tolerance_m(&self, z_m: f64, share: f64) -> f64 {
        (3.0 * self.sigma_m(z_m)).max(share * z_m)
    }
}

/// Settings of loading.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LoadSettings {
    /// Longer image side of the loaded frames in pixels; 0, or more than the recording has, keeps its size.
    pub long_side: usize,
    /// The first frame that is used.
    pub first: usize,
    /// Every `stride`-th frame is used, at least 1.
    pub stride: usize,
    /// Maximum number of frames, 0 for all.
    pub max_frames: usize,
    /// Frames that show a surface from about the same side and distance, beyond which more are not used: a frame is left out if most of the
    /// surface that it shows has that many keyframes, so that memory and time follow the size of the scene rather than the number
    /// of frames. A recording of at most this many frames keeps all of them; 0 keeps all of any recording.
    pub keyframe_views: usize,
    /// How the world is aligned.
    pub align: Align,
    /// Depth noise of the sensor.
    pub noise: DepthNoise,
    /// Whether the depth noise that the differences between frames show takes its place, once the poses were examined.
    pub estimate_noise: bool,
    /// Half width of the window that a normal is fitted to, in pixels: 2 is 5 × 5.
    pub normal_radius: usize,
}

impl Default for LoadSettings {
    fn default() -> Self {
        Self {
            long_side: 320,
            first: 0,
            stride: 1,
            max_frames: 0,
            keyframe_views: 100,
            align: Align::Auto,
            noise: DepthNoise::default(),
            estimate_noise: true,
            normal_radius: 2,
        }
    }
}

impl LoadSettings {
    /// Checks that all values are in range.
    ///
    /// # Errors
    /// [`InputError`] that names the first key out of range and the allowed range.
    pub fn validate(&self) -> Result<(), InputError> {
        let r = Ranges::of("frames");
        // 0 keeps the recording's size. Fewer than 16 pixels show no object, more than 16384 exceed the memory.
        if self.long_side != 0 {
            r.count("long_side", self.long_side, 16, 16_384)?;
        }
        r.count("first", self.first, 0, 10_000_000)?;
        r.count("stride", self.stride, 1, 1_000_000)?;
        r.count("max_frames", self.max_frames, 0, 10_000_000)?;
        r.count("keyframe_views", self.keyframe_views, 0, 10_000)?;
        if let Align::Up(up) = self.align {
            for (axis, value) in up.into_iter().enumerate() {
                r.within(&format!("align.up[{axis}]"), value, -1e6, 1e6)?;
            }
            r.within("align.up", up.iter().map(|v| v * v).sum::<f64>().sqrt(), 1e-6, 1e7)?;
        }
        r.count("normal_radius", self.normal_radius, 1, 32)?;
        self.noise.validate("frames", "noise.")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_out_of_range_are_named() {
        LoadSettings::default().validate().unwrap();
        ReadOptions::default().validate().unwrap();
        let key = |checked: Result<(), InputError>| checked.unwrap_err().key().unwrap().to_owned();
        let side = LoadSettings { long_side: 3, ..LoadSettings::default() };
        assert_eq!(&*key(side.validate()), "frames.long_side");
        let up = LoadSettings { align: Align::Up([0.0; 3]), ..LoadSettings::default() };
        assert_eq!(&*key(up.validate()), "frames.align.up");
        let noise = DepthNoise { a_m: -0.001, ..DepthNoise::default() };
        let settings = LoadSettings { noise, ..LoadSettings::default() };
        assert_eq!(&*key(settings.validate()), "frames.noise.a_m");
        let near = ReadOptions { min_depth_m: 3.0, max_depth_m: 1.0, ..ReadOptions::default() };
        assert!(key(near.validate()).ends_with("min_depth_m"));
        let lens = ReadOptions { intrinsics: Some([500.0, f64::NAN, 1.0, 1.0]), ..ReadOptions::default() };
        assert!(key(lens.validate()).ends_with("intrinsics[1]"));
    }

    #[test]
    fn settings_survive_a_file_and_unknown_keys_are_refused() {
        let options =
            ReadOptions { axes: Some(Axes::Opencv), pixel_center: Some(0.0), ..ReadOptions::default() };
        let text = serde_json::to_string(&options).unwrap();
        let json: serde_json::Value = serde_json::from_str(&text).unwrap();
        assert_eq!(json["axes"], "opencv");
        assert!(json.as_object().unwrap().values().all(|v| !v.is_null()), "{text}");
        assert_eq!(serde_json::from_str::<ReadOptions>(&text).unwrap(), options);
        for align in [Align::Auto, Align::None, Align::Up([0.0, -1.0, 0.1])] {
            let settings = LoadSettings { align, stride: 3, ..LoadSettings::default() };
            let text = serde_json::to_string(&settings).unwrap();
            assert_eq!(serde_json::from_str::<LoadSettings>(&text).unwrap(), settings);
        }
        assert!(serde_json::from_str::<LoadSettings>("{\"long_sied\": 320}").unwrap_err().is_data());
    }

    #[test]
    fn noise_grows_with_the_square_of_depth() {
        let noise = DepthNoise { a_m: 0.001, b_per_m: 0.002 };
        assert!((noise.sigma_m(2.0) - 0.009).abs() < 1e-15);
    }
}
