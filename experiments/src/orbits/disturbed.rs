//! Faults of given poses, as of trackers, arms and cameras that are not registered.

use super::poses_of;
use crate::disturb::{disturbed_pose, shifted};
use glamx::DPose3;
use serde::{Deserialize, Serialize};
use sms_core::Seed;
use sms_frames::Sequence;
use sms_synth::PoseErrors;

/// A fault of a recording's poses or of its colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PoseFault {
    /// No fault.
    Exact,
    /// Every pose is off by 5 mm and 0.5° (root mean square), independently.
    Independent,
    /// The camera sits 10 mm and 1° from the place that the poses are for (hand-eye error).
    HandEye,
    /// The poses drift by 1 % of the path, and by 1° at its end.
    Drift,
    /// The colour lies 3 pixels beside the depth.
    ColorShift,
    /// The recorded focal length is 1.5 % too long.
    Focal,
    /// All of them but the wrong focal length.
    All,
}

impl PoseFault {
    /// All kinds, in the order of the table.
    pub const ALL: [Self; 7] = [
        Self::Exact,
        Self::Independent,
        Self::HandEye,
        Self::Drift,
        Self::ColorShift,
        Self::Focal,
        Self::All,
    ];

    /// The word in tables and keys.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Independent => "independent",
            Self::HandEye => "hand_eye",
            Self::Drift => "drift",
            Self::ColorShift => "color_shift",
            Self::Focal => "focal",
            Self::All => "all",
        }
    }

    fn has(self, part: Self) -> bool {
        self == part || (self == Self::All && part != Self::Focal)
    }

    /// The errors that are not drawn anew for each frame.
    fn lasting(self) -> PoseErrors {
        let mut errors = PoseErrors::default();
        if self.has(Self::Drift) {
            (errors.drift_share, errors.drift_turn_rad) = (0.01, 1f64.to_radians());
        }
        if self.has(Self::HandEye) {
            (errors.hand_eye_m, errors.hand_eye_rad) = (0.010, 1f64.to_radians());
        }
        errors
    }

    /// Returns a sequence with this fault.
    pub fn applied(self, sequence: &Sequence, seed: Seed) -> Sequence {
        let mut sequence = sequence.clone();
        if self.has(Self::ColorShift) {
            sequence.frames.iter_mut().for_each(|f| f.color = shifted(&f.color, COLOR_SHIFT_PX));
        }
        if self.has(Self::Focal) {
            for frame in &mut sequence.frames {
                frame.camera.intrinsics.fx *= FOCAL_FACTOR;
                frame.camera.intrinsics.fy *= FOCAL_FACTOR;
            }
        }
        let mut poses: Vec<DPose3> = self.lasting().applied(&poses_of(&sequence), seed);
        if self.has(Self::Independent) {
            let mut rng = seed.derive("independent").rng();
            for x in &mut poses {
                *x = disturbed_pose(x, 0.005, 0.5f64.to_radians(), &mut rng);
            }
        }
        sequence.frames.iter_mut().zip(poses).for_each(|(frame, x_wc)| frame.camera.x_wc = x_wc);
        sequence
    }
}

/// Factor of a wrong focal length.
const FOCAL_FACTOR: f64 = 1.015;

/// Shift of the colour to the right, pixels.
const COLOR_SHIFT_PX: i64 = 3;

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::Image;

    #[test]
    fn a_shift_moves_colour_to_the_right() {
        let color = Image::from_vec(4, 1, vec![[1; 3], [2; 3], [3; 3], [4; 3]]);
        assert_eq!(shifted(&color, 2).data, [[1; 3], [1; 3], [1; 3], [2; 3]]);
    }
}
