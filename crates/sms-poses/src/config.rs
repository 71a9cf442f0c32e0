//! Settings.

use crate::PoseOrigin;
use serde::{Deserialize, Serialize};
use sms_core::{InputError, Ranges};

/// Condition for the use of refined poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PosesMode {
    /// Refined poses are used only if held-out pairs of frames agree significantly better with them than with the given
    /// ones.
    #[default]
    Auto,
    /// The given poses are used as they are.
    Given,
    /// Refined poses are used whenever they could be computed.
    Refine,
    /// Given poses are ignored: all are estimated from the images ([`crate::track_cameras`]), and then refined as with
    /// [`Self::Auto`].
    Estimate,
}

/// Settings of the refinement. Lengths in metres, angles in radians, colours in 8-bit levels, pixels at loaded size
/// unless stated otherwise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PosesConfig {
    /// Whether poses are refined, and when the result is used.
    pub mode: PosesMode,
    /// Standard deviation of the given camera positions per axis, with which the estimate of their noise begins.
    pub prior_position_m: f64,
    /// That of the given camera rotations per axis.
    pub prior_rotation_rad: f64,
    /// Standard deviation of the hand-eye correction that all frames share, per axis, metres. With 0, there is none.
    pub prior_hand_eye_m: f64,
    /// Standard deviation of its rotation per axis, radians.
    pub prior_hand_eye_rad: f64,
    /// Standard deviation of the time offset between given poses and images, seconds. With 0, or without times of the frames, there
    /// is none.
    pub prior_time_offset_s: f64,
    /// Number of partners of each frame: those with the most overlap from a similar side.
    pub neighbours: usize,
    /// Number of partners of each frame with a more different direction, so that small errors do not add up along the
    /// path.
    pub far_neighbours: usize,
    /// Standard deviation of colour where the image is flat, levels.
    pub color_sigma: f64,
    /// Error of colour per gradient: the assumed misalignment between the images of one point, pixels of the level.
    pub color_slip_px: f64,
    /// Minimum gradient of a point for comparison by colour, levels per pixel.
    pub min_gradient: f64,
    /// Standard deviation of the shift of colour against depth, which is estimated along with the poses, pixels at
    /// loaded size. With 0, both are exactly registered.
    pub prior_color_shift_px: f64,
    /// Standard deviation of the error of the recorded focal length, which is estimated along with the poses, as a share. With 0,
    /// it is exact.
    pub prior_focal_share: f64,
    /// Share of the measurements that counts as independent; scales both data terms.
    pub independent_share: f64,
    /// Radius of the window of the normals of single frames, pixels at loaded size. They tell the side of a surface, and its
    /// direction where it is not flat.
    pub normal_radius_px: usize,
    /// Whether depth is compared.
    pub use_depth: bool,
    /// Whether colour is compared.
    pub use_color: bool,
    /// Longest side of the finest images, pixels; each coarser level has half the size.
    pub finest_long_side: usize,
    /// Maximum iterations of each level, starting with the finest; the length is the number of levels.
    pub iterations: Vec<usize>,
    /// Distance between compared points, pixels of the level.
    pub point_stride: f64,
}

impl PosesMode {
    /// Returns whether refined poses are used only if they are better.
    pub(crate) fn is_judged(self) -> bool {
        matches!(self, Self::Auto | Self::Estimate)
    }
}

impl Default for PosesConfig {
    fn default() -> Self {
        Self {
            mode: PosesMode::default(),
            prior_position_m: 0.015,
            prior_rotation_rad: 1f64.to_radians(),
            prior_hand_eye_m: 0.015,
            prior_hand_eye_rad: 1.5f64.to_radians(),
            prior_time_offset_s: 0.02,
            neighbours: 4,
            far_neighbours: 2,
            color_sigma: 3.0,
            color_slip_px: 0.25,
            min_gradient: 2.0,
            prior_color_shift_px: 2.0,
            prior_focal_share: 0.01,
            independent_share: 0.1,
            normal_radius_px: 3,
            use_depth: true,
            use_color: true,
            finest_long_side: 320,
            iterations: vec![6, 8, 10, 10],
            point_stride: 2.0,
        }
    }
}

impl PosesConfig {
    /// Returns the settings for poses of an origin. Poses that were estimated from the images have no mount whose pose could be wrong,
    /// and no clock of their own.
    #[must_use]
    pub fn for_origin(&self, origin: PoseOrigin) -> Self {
        match origin {
            PoseOrigin::Recorded => self.clone(),
            PoseOrigin::Estimated | PoseOrigin::EstimatedAlone => Self {
                prior_hand_eye_m: 0.0,
                prior_hand_eye_rad: 0.0,
                prior_time_offset_s: 0.0,
                ..self.clone()
            },
        }
    }

    /// Checks that all values are in range.
    ///
    /// # Errors
    /// [`InputError`] that names the first key out of range and the allowed range.
    pub fn validate(&self) -> Result<(), InputError> {
        let r = Ranges::of("poses");
        r.within("prior_position_m", self.prior_position_m, 1e-6, 10.0)?;
        r.within("prior_rotation_rad", self.prior_rotation_rad, 1e-6, 3.0)?;
        r.within("prior_hand_eye_m", self.prior_hand_eye_m, 0.0, 1.0)?;
        r.within("prior_hand_eye_rad", self.prior_hand_eye_rad, 0.0, 3.0)?;
        r.within("prior_time_offset_s", self.prior_time_offset_s, 0.0, 10.0)?;
        r.count("neighbours", self.neighbours, 1, 1000)?;
        r.count("far_neighbours", self.far_neighbours, 0, 1000)?;
        r.within("color_sigma", self.color_sigma, 0.1, 255.0)?;
        r.within("color_slip_px", self.color_slip_px, 0.0, 10.0)?;
        r.within("min_gradient", self.min_gradient, 0.0, 255.0)?;
        r.within("prior_color_shift_px", self.prior_color_shift_px, 0.0, 100.0)?;
        r.within("prior_focal_share", self.prior_focal_share, 0.0, 0.2)?;
        r.within("independent_share", self.independent_share, 1e-6, 1.0)?;
        r.count("normal_radius_px", self.normal_radius_px, 1, 64)?;
        r.count("finest_long_side", self.finest_long_side, 16, 16_384)?;
        r.count("iterations.len()", self.iterations.len(), 1, 8)?;
        for (level, &count) in self.iterations.iter().enumerate() {
            r.count(&format!("iterations[{level}]"), count, 0, 1000)?;
        }
        r.within("point_stride", self.point_stride, 0.25, 64.0)
    }
}
