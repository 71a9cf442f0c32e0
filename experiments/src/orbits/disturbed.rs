//! Faults of given poses, as of trackers, arms and cameras that are not registered.

use super::poses_of;
use crate::disturb::{disturbed_pose, normals, shifted};
use glamx::{DPose3, DQuat, DVec3};
use serde::{Deserialize, Serialize};
use sms_core::{Seed, StageRng};
use sms_frames::Sequence;

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
    /// All of them.
    All,
}

impl PoseFault {
    /// All kinds, in the order of the table.
    pub const ALL: [Self; 6] =
        [Self::Exact, Self::Independent, Self::HandEye, Self::Drift, Self::ColorShift, Self::All];

    /// The word in tables and keys.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Exact => "exact",
            Self::Independent => "independent",
            Self::HandEye => "hand_eye",
            Self::Drift => "drift",
            Self::ColorShift => "color_shift",
            Self::All => "all",
        }
    }

    fn has(self, part: Self) -> bool {
        self == part || self == Self::All
    }

    /// Returns a sequence with this fault.
    pub fn applied(self, sequence: &Sequence, seed: Seed) -> Sequence {
        let mut sequence = sequence.clone();
        if self.has(Self::ColorShift) {
            sequence.frames.iter_mut().for_each(|f| f.color = shifted(&f.color, COLOR_SHIFT_PX));
        }
        let mut poses: Vec<DPose3> = poses_of(&sequence);
        if self.has(Self::Drift) {
            poses = drifted(&poses, &mut seed.derive("drift").rng());
        }
        if self.has(Self::HandEye) {
            let mut rng = seed.derive("hand eye").rng();
            let error = DPose3::from_parts(
                0.010 * direction(&mut rng),
                DQuat::from_scaled_axis(1f64.to_radians() * direction(&mut rng)),
            );
            poses.iter_mut().for_each(|x| *x *= error);
        }
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

/// Shift of the colour to the right, pixels.
const COLOR_SHIFT_PX: i64 = 3;
/// Error of the position at the end of a path, relative to its length (root mean square).
const DRIFT_SHARE: f64 = 0.01;

/// Adds a random walk: errors of single steps, of which each moves all later poses.
fn drifted(poses: &[DPose3], rng: &mut StageRng) -> Vec<DPose3> {
    let steps = poses.len().saturating_sub(1).max(1) as f64;
    let path: f64 = poses.windows(2).map(|w| (w[1].translation - w[0].translation).length()).sum();
    let per_axis = 1.0 / (3.0 * steps).sqrt();
    let (step_m, step_rad) = (DRIFT_SHARE * path * per_axis, 1f64.to_radians() * per_axis);
    let mut drifted: Vec<DPose3> = poses.iter().take(1).copied().collect();
    for pair in poses.windows(2) {
        let error =
            DPose3::from_parts(step_m * normals(rng), DQuat::from_scaled_axis(step_rad * normals(rng)));
        let x = drifted[drifted.len() - 1] * (pair[0].inverse() * pair[1]) * error;
        drifted.push(DPose3::from_parts(x.translation, x.rotation.normalize()));
    }
    drifted
}

fn direction(rng: &mut StageRng) -> DVec3 {
    normals(rng).normalize_or(DVec3::X)
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_core::Image;

    fn circle() -> Vec<DPose3> {
        let pose = |i: usize| {
            let angle = 0.1 * i as f64;
            DPose3::from_parts(DVec3::new(angle.cos(), angle.sin(), 0.5), DQuat::from_rotation_z(angle))
        };
        (0..60).map(pose).collect()
    }

    #[test]
    fn a_drift_grows_to_its_share_of_the_path() {
        let poses = circle();
        let path: f64 = poses.windows(2).map(|w| (w[1].translation - w[0].translation).length()).sum();
        let n = 400;
        let mean_square = |at: usize| {
            let off = |seed: u64| {
                let drifted = drifted(&poses, &mut Seed(seed).rng());
                (drifted[at].translation - poses[at].translation).length_squared()
            };
            (0..n).map(off).sum::<f64>() / n as f64
        };
        assert_eq!(mean_square(0), 0.0);
        // The turns add to the shifts at the end of the path: up to 1° at a distance of 2 m.
        let share = mean_square(59).sqrt() / path;
        assert!((0.008..0.014).contains(&share), "{share}");
        assert!(mean_square(15) < 0.5 * mean_square(59));
    }

    #[test]
    fn a_shift_moves_colour_to_the_right() {
        let color = Image::from_vec(4, 1, vec![[1; 3], [2; 3], [3; 3], [4; 3]]);
        assert_eq!(shifted(&color, 2).data, [[1; 3], [1; 3], [1; 3], [2; 3]]);
    }
}
