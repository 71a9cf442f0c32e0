//! Errors of recorded camera poses.

use glamx::{DPose3, DQuat, DVec3};
use rand::RngExt;
use serde::{Deserialize, Serialize};
use sms_core::{Seed, StageRng};

/// Errors of the recorded poses, in the order in which they are applied: drift, hand-eye error, independent errors. All are 0 by
/// default.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PoseErrors {
    /// Error of the position at the end of the path relative to the path's length, root mean square: a random walk of steps from
    /// frame to frame, of which each moves all later poses.
    pub drift_share: f64,
    /// Turn at the end of the path by the same walk, root mean square, radians.
    pub drift_turn_rad: f64,
    /// Distance of the camera from the place that the poses are for, metres: one error for the recording, in a random direction.
    pub hand_eye_m: f64,
    /// Turn of the camera against the poses, radians: one for the recording, about a random axis.
    pub hand_eye_rad: f64,
    /// Standard deviation of the position per axis, metres; independent from frame to frame.
    pub jitter_m: f64,
    /// Standard deviation of the rotation per axis, radians; independent from frame to frame.
    pub jitter_rad: f64,
}

impl PoseErrors {
    /// Returns the poses `X_WC` as a tracker with these errors records them.
    pub fn applied(&self, poses: &[DPose3], seed: Seed) -> Vec<DPose3> {
        let mut recorded = self.drifted(poses, seed);
        if self.hand_eye_m != 0.0 || self.hand_eye_rad != 0.0 {
            let mut rng = seed.derive("hand eye").rng();
            let shift = self.hand_eye_m * direction(&mut rng);
            let turn = DQuat::from_scaled_axis(self.hand_eye_rad * direction(&mut rng));
            recorded.iter_mut().for_each(|x| *x *= DPose3::from_parts(shift, turn));
        }
        for (index, x_wc) in recorded.iter_mut().enumerate() {
            let mut rng = seed.derive_index("pose", index as u64).rng();
            let (shift, turn) = (normals(&mut rng) * self.jitter_m, normals(&mut rng) * self.jitter_rad);
            *x_wc =
                DPose3::from_parts(x_wc.translation + shift, x_wc.rotation * DQuat::from_scaled_axis(turn));
        }
        recorded
    }

    fn drifted(&self, poses: &[DPose3], seed: Seed) -> Vec<DPose3> {
        if self.drift_share == 0.0 && self.drift_turn_rad == 0.0 {
            return poses.to_vec();
        }
        let mut rng = seed.derive("drift").rng();
        let steps = poses.len().saturating_sub(1).max(1) as f64;
        let path: f64 = poses.windows(2).map(|w| (w[1].translation - w[0].translation).length()).sum();
        let per_axis = 1.0 / (3.0 * steps).sqrt();
        let (step_m, step_rad) = (self.drift_share * path * per_axis, self.drift_turn_rad * per_axis);
        let mut drifted: Vec<DPose3> = poses.iter().take(1).copied().collect();
        for pair in poses.windows(2) {
            let error = DPose3::from_parts(
                step_m * normals(&mut rng),
                DQuat::from_scaled_axis(step_rad * normals(&mut rng)),
            );
            let x = drifted[drifted.len() - 1] * (pair[0].inverse() * pair[1]) * error;
            drifted.push(DPose3::from_parts(x.translation, x.rotation.normalize()));
        }
        drifted
    }
}

/// Three near standard normal numbers: sums of twelve uniform ones.
fn normals(rng: &mut StageRng) -> DVec3 {
    let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
    DVec3::new(normal(), normal(), normal())
}

fn direction(rng: &mut StageRng) -> DVec3 {
    normals(rng).normalize_or(DVec3::X)
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let errors = PoseErrors { drift_share: 0.01, ..PoseErrors::default() };
        let path: f64 = poses.windows(2).map(|w| (w[1].translation - w[0].translation).length()).sum();
        let n = 400;
        let share = |at: usize| {
            let off = |seed: u64| {
                (errors.applied(&poses, Seed(seed))[at].translation - poses[at].translation).length_squared()
            };
            ((0..n).map(off).sum::<f64>() / n as f64).sqrt() / path
        };
        assert_eq!(share(0), 0.0);
        assert!((share(59) / 0.01 - 1.0).abs() < 0.08, "{}", share(59));
        // A random walk: half of the error after a quarter of the path.
        assert!((share(15) / (0.01 * (15.0f64 / 59.0).sqrt()) - 1.0).abs() < 0.1, "{}", share(15));
    }

    #[test]
    fn a_drift_turns_by_its_angle() {
        let poses = circle();
        let errors = PoseErrors { drift_turn_rad: 0.02, ..PoseErrors::default() };
        let n = 400;
        let square = |seed: u64| {
            let drifted = errors.applied(&poses, Seed(seed));
            // The turn in the world: all turns of the path are about one axis, so that they can be divided out.
            let turn: DQuat = drifted[59].rotation * poses[59].rotation.inverse();
            turn.to_scaled_axis().length_squared()
        };
        let rms = ((0..n).map(square).sum::<f64>() / n as f64).sqrt();
        assert!((rms / 0.02 - 1.0).abs() < 0.1, "{rms}");
    }

    #[test]
    fn a_hand_eye_error_is_one_and_of_its_size() {
        let poses = circle();
        let errors = PoseErrors { hand_eye_m: 0.01, hand_eye_rad: 0.02, ..PoseErrors::default() };
        let recorded = errors.applied(&poses, Seed(3));
        let relative: Vec<DPose3> = poses.iter().zip(&recorded).map(|(a, b)| a.inverse() * b).collect();
        for x in &relative {
            assert!((x.translation - relative[0].translation).length() < 1e-12);
            assert!((x.translation.length() - 0.01).abs() < 1e-12);
            assert!((x.rotation.to_scaled_axis().length() - 0.02).abs() < 1e-9);
        }
        assert_ne!(recorded, errors.applied(&poses, Seed(4)));
    }

    #[test]
    fn independent_errors_have_their_size_per_axis() {
        let poses = vec![DPose3::identity(); 3000];
        let errors = PoseErrors { jitter_m: 0.002, jitter_rad: 0.004, ..PoseErrors::default() };
        let recorded = errors.applied(&poses, Seed(1));
        let rms = |of: &dyn Fn(&DPose3) -> f64| {
            (recorded.iter().map(|x| of(x).powi(2)).sum::<f64>() / recorded.len() as f64).sqrt()
        };
        assert!((rms(&|x| x.translation.y) / 0.002 - 1.0).abs() < 0.04);
        assert!((rms(&|x| x.rotation.to_scaled_axis().z) / 0.004 - 1.0).abs() < 0.04);
        assert_eq!(PoseErrors::default().applied(&poses, Seed(1)), poses);
    }
}
