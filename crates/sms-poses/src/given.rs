//! The given poses as measurements: frame i is near `given_i(τ) · E`, where all frames share a correction E of the hand-eye pose and
//! a time offset τ: the pose of an image is that given τ later. Its deviation ξ_i, in the axes of the world, is noise whose size is estimated.
//!
//! The precision of ξ over the frames is `a I + s L`, per axis, where L is the Laplacian of the recorded order: `1/√a`
//! is the deviation from the given poses that is plausible, and `1/√s` that of one frame against the next. Independent
//! errors (motion capture) have no s; a drift (odometry) has a small a. Both follow from the recording by expectation
//! maximisation (Dempster, Laird and Rubin 1977), for rotations and positions apart.

use crate::PosesConfig;
use crate::align::lever;
use crate::linear::{COMMON, Common, HAND_EYE, Inverse, Row, Six, System, TIME};
use glamx::{DMat3, DPose3, DQuat, DVec3};
use rayon::prelude::*;
use sms_core::Seed;

/// Smallest standard deviations of a pose: radians, metres. They keep weights finite for exact poses.
const LEAST: [f64; 2] = [1e-4, 1e-4];
/// Number of random vectors from which the traces of the covariance are estimated (Hutchinson 1990).
const PROBES: u64 = 8;

/// Precisions of the noise per axis, of rotations (1/rad²) and of positions (1/m²).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct GivenNoise {
    /// Of a frame.
    pub(crate) frame: [f64; 2],
    /// Of the change between consecutive frames.
    pub(crate) step: [f64; 2],
}

impl GivenNoise {
    /// The configured noise, without a relation between frames.
    pub(crate) fn configured(config: &PosesConfig) -> Self {
        let sigmas = [config.prior_rotation_rad, config.prior_position_m];
        Self { frame: sigmas.map(|s| s.powi(-2)), step: [0.0; 2] }
    }

    /// Returns the standard deviation of a frame, of rotations and of positions, in the mean over `frames` frames.
    pub(crate) fn sigma(&self, frames: usize) -> [f64; 2] {
        [0, 1].map(|kind| self.mean_variance(kind, frames, |_| 1.0).sqrt())
    }

    /// Returns that of the change between consecutive frames, where it is more certain than independent frames.
    pub(crate) fn step_sigma(&self, frames: usize) -> [Option<f64>; 2] {
        let sigma = |kind| self.mean_variance(kind, frames, |l| l).sqrt();
        [0, 1].map(|kind| (self.step[kind] > self.frame[kind]).then(|| sigma(kind)))
    }

    /// Returns the standard deviation of a weighted sum of the position errors of all frames.
    pub(crate) fn position_sigma(&self, weights: &[DVec3]) -> f64 {
        const POSITION: usize = 1;
        let variance = |axis: usize| {
            let w: Vec<f64> = weights.iter().map(|w| w[axis]).collect();
            let solved = chain_solve(self.frame[POSITION], self.step[POSITION], &w);
            w.iter().zip(&solved).map(|(w, x)| w * x).sum::<f64>()
        };
        (0..3).map(variance).sum::<f64>().max(0.0).sqrt()
    }

    fn mean_variance(&self, kind: usize, frames: usize, of: impl Fn(f64) -> f64) -> f64 {
        let variances =
            laplacian_eigenvalues(frames).map(|l| of(l) / (self.frame[kind] + self.step[kind] * l));
        variances.sum::<f64>() / frames.max(1) as f64
    }
}

/// The given poses.
#[derive(Debug, Clone, Copy)]
pub(crate) struct GivenPoses<'a> {
    pub(crate) poses: &'a [DPose3],
    /// Motion of the camera at each frame in the axes of the world: turn rate (rad/s), velocity (m/s); zero where the times of
    /// frames are not known.
    pub(crate) rates: &'a [Six],
    /// Centre of rotation of the corrections.
    pub(crate) center_w: DVec3,
}

/// The values that the given poses of all frames share.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Shared {
    /// Correction of the hand-eye pose.
    pub(crate) hand_eye: DPose3,
    /// Time offset, seconds.
    pub(crate) time_s: f64,
}

impl Shared {
    /// Returns the values after a step.
    pub(crate) fn after(&self, step: &Common) -> Self {
        let part =
            |at: usize| DVec3::new(step[HAND_EYE + at], step[HAND_EYE + at + 1], step[HAND_EYE + at + 2]);
        let moved = self.hand_eye * DPose3::from_parts(part(3), DQuat::from_scaled_axis(part(0)));
        let hand_eye = DPose3::from_parts(moved.translation, moved.rotation.normalize());
        Self { hand_eye, time_s: self.time_s + step[TIME] }
    }
}

/// Returns the motion of the camera at each frame between its neighbours, as [`GivenPoses::rates`]; `times_s` has the time of each.
pub(crate) fn rates(poses: &[DPose3], times_s: &[Option<f64>]) -> Vec<Six> {
    let rate = |i: usize| -> Option<Six> {
        let (before, after) = (i.saturating_sub(1), (i + 1).min(poses.len() - 1));
        let (from, to) = (&poses[before], &poses[after]);
        let seconds = times_s[after]? - times_s[before]?;
        let turn = (to.rotation * from.rotation.inverse()).to_scaled_axis() / seconds;
        let shift = (to.translation - from.translation) / seconds;
        (seconds > 0.0 && turn.is_finite() && shift.is_finite())
            .then_some([turn.x, turn.y, turn.z, shift.x, shift.y, shift.z])
    };
    (0..poses.len()).map(|i| rate(i).unwrap_or([0.0; 6])).collect()
}

/// A component of a frame's deviation: rotation about the world's axes (0 to 2), position (3 to 5).
struct Deviation {
    value: f64,
    row: Row,
}

impl GivenPoses<'_> {
    /// Returns a frame's pose as given with the values that all share.
    fn base(&self, frame: usize, shared: &Shared) -> DPose3 {
        let [a, b, c, x, y, z] = self.rates[frame].map(|rate| shared.time_s * rate);
        let given = &self.poses[frame];
        let turn = DQuat::from_scaled_axis(DVec3::new(a, b, c));
        let moved = DPose3::from_parts(given.translation + DVec3::new(x, y, z), turn * given.rotation);
        moved * shared.hand_eye
    }

    /// Returns the deviations of a frame's pose from the given one.
    fn deviations(&self, frame: usize, pose: &DPose3, shared: &Shared) -> [Deviation; 6] {
        let base = self.base(frame, shared);
        let turned = (pose.rotation * base.rotation.inverse()).to_scaled_axis();
        let shifted = pose.translation - base.translation;
        let arm = pose.translation - self.center_w;
        // Rows of the rotation of the base: a change of E acts in its axes.
        let r_bw = DMat3::from_quat(base.rotation).transpose();
        let [a, b, c, x, y, z] = self.rates[frame];
        let (turn_rate, velocity) = (DVec3::new(a, b, c), DVec3::new(x, y, z));
        // The shift of the hand-eye correction turns with the camera.
        let shift_w = base.rotation * (shared.hand_eye.rotation.inverse() * shared.hand_eye.translation);
        let by_time = [turn_rate, velocity + turn_rate.cross(shift_w)];
        std::array::from_fn(|r| {
            let axis = r % 3;
            let is_turn = r < 3;
            let mut own = [0.0; 6];
            if is_turn {
                own[axis] = 1.0;
            } else {
                own = lever(arm, DVec3::AXES[axis]);
            }
            let mut common = [0.0; COMMON];
            for k in 0..3 {
                common[HAND_EYE + if is_turn { k } else { 3 + k }] = -r_bw.col(axis)[k];
            }
            common[TIME] = -by_time[usize::from(!is_turn)][axis];
            let value = if is_turn { turned[axis] } else { shifted[axis] };
            Deviation { value, row: Row { frames: vec![(frame, own)], common } }
        })
    }

    /// Returns the camera centres under the given poses with the values that all share, and the deviations of the poses from them.
    pub(crate) fn shifts(&self, poses: &[DPose3], shared: &Shared) -> (Vec<DVec3>, Vec<DVec3>) {
        let of = |(i, x): (usize, &DPose3)| {
            let base = self.base(i, shared).translation;
            (base, x.translation - base)
        };
        poses.iter().enumerate().map(of).unzip()
    }

    /// Returns the size of each frame's deviation: metres, radians.
    pub(crate) fn lengths(&self, poses: &[DPose3], shared: &Shared) -> Vec<[f64; 2]> {
        let of = |(i, x): (usize, &DPose3)| {
            let d = self.deviations(i, x, shared).map(|d| d.value);
            [DVec3::new(d[3], d[4], d[5]).length(), DVec3::new(d[0], d[1], d[2]).length()]
        };
        poses.iter().enumerate().map(of).collect()
    }

    /// Returns the deviations of all frames, and their changes between consecutive frames.
    fn all(&self, poses: &[DPose3], shared: &Shared) -> [Vec<[Deviation; 6]>; 2] {
        let frames: Vec<[Deviation; 6]> =
            poses.iter().enumerate().map(|(i, x)| self.deviations(i, x, shared)).collect();
        let change = |pair: &[[Deviation; 6]]| {
            std::array::from_fn(|r| {
                let (before, after) = (&pair[0][r], &pair[1][r]);
                let [(i, own)] = after.row.frames[..] else { unreachable!("one frame") };
                let (j, other) = before.row.frames[0];
                Deviation {
                    value: after.value - before.value,
                    row: Row {
                        frames: vec![(j, other.map(|v| -v)), (i, own)],
                        common: std::array::from_fn(|c| after.row.common[c] - before.row.common[c]),
                    },
                }
            })
        };
        let steps = frames.windows(2).map(change).collect();
        [frames, steps]
    }

    /// Adds the given poses to the system.
    pub(crate) fn add_to(&self, system: &mut System, poses: &[DPose3], shared: &Shared, noise: &GivenNoise) {
        let [frames, steps] = self.all(poses, shared);
        for (deviations, precision) in [(frames, noise.frame), (steps, noise.step)] {
            for (r, d) in deviations.iter().flat_map(|d| d.iter().enumerate()) {
                let weight = precision[r / 3];
                if weight > 0.0 {
                    system.add_row(&d.row, d.value, weight);
                }
            }
        }
    }

    /// Returns the noise under which the estimate and its covariance are most likely: one step of expectation
    /// maximisation. The configured noise counts as one frame.
    pub(crate) fn noise_after(
        &self,
        inverse: &Inverse<'_>,
        poses: &[DPose3],
        shared: &Shared,
        config: &PosesConfig,
    ) -> GivenNoise {
        let n = poses.len();
        let [frames, steps] = self.all(poses, shared).map(|d| squares(&d, inverse, n));
        let configured = GivenNoise::configured(config);
        let mut noise = GivenNoise { frame: [0.0; 2], step: [0.0; 2] };
        for kind in 0..2 {
            let first = 3.0 / configured.frame[kind];
            let most = LEAST[kind].powi(-2);
            (noise.frame[kind], noise.step[kind]) =
                most_likely(frames[kind] + first, steps[kind], n, 3.0, most);
        }
        noise
    }
}

/// Returns the expected sums of squares of deviations, of rotations and of positions.
fn squares(deviations: &[[Deviation; 6]], inverse: &Inverse<'_>, frames: usize) -> [f64; 2] {
    let mut sums = [0.0; 2];
    for (r, d) in deviations.iter().flat_map(|d| d.iter().enumerate()) {
        sums[r / 3] += d.value * d.value;
    }
    let traces = |probe: u64| {
        let signs: Vec<f64> = (0..6 * deviations.len() as u64)
            .map(|k| if Seed(probe).derive_index("probe", k).0 & 1 == 0 { 1.0 } else { -1.0 })
            .collect();
        let all = || deviations.iter().flat_map(|d| d.iter().enumerate()).zip(&signs);
        let (mut right, mut common): (Vec<Six>, Common) = (vec![[0.0; 6]; frames], [0.0; COMMON]);
        all().for_each(|((_, d), sign)| d.row.add_to(&mut right, &mut common, *sign));
        let (x, c) = inverse.times(&right, &common);
        let mut traces = [0.0; 2];
        all().for_each(|((r, d), sign)| traces[r / 3] += sign * d.row.of(&x, &c) / PROBES as f64);
        traces
    };
    let traces: Vec<[f64; 2]> = (0..PROBES).into_par_iter().map(traces).collect();
    traces.iter().for_each(|t| (0..2).for_each(|kind| sums[kind] += t[kind]));
    sums
}

/// Solves (a I + s L) x = b, where L is the Laplacian of a chain: elimination of a tridiagonal matrix.
fn chain_solve(a: f64, s: f64, b: &[f64]) -> Vec<f64> {
    let n = b.len();
    let neighbours = |i: usize| usize::from(i > 0) + usize::from(i + 1 < n);
    let (mut diagonal, mut x) = (vec![0.0; n], b.to_vec());
    for i in 0..n {
        diagonal[i] = a + s * neighbours(i) as f64;
        if i > 0 {
            let factor = s / diagonal[i - 1];
            diagonal[i] -= factor * s;
            x[i] += factor * x[i - 1];
        }
    }
    for i in (0..n).rev() {
        let next = if i + 1 < n { s * x[i + 1] } else { 0.0 };
        x[i] = (x[i] + next) / diagonal[i];
    }
    x
}

/// Returns the eigenvalues of the Laplacian of a chain of n frames.
fn laplacian_eigenvalues(n: usize) -> impl Iterator<Item = f64> {
    (0..n).map(move |k| 2.0 - 2.0 * (std::f64::consts::PI * k as f64 / n as f64).cos())
}

/// Maximises the likelihood of precisions a and s, with `extra` further values of precision a: minimises
/// a S + s T − 3 Σₖ log(a + s λₖ) − extra log a, which is convex, where λₖ are the eigenvalues of the Laplacian of a chain.
fn most_likely(frames: f64, steps: f64, n: usize, extra: f64, most: f64) -> (f64, f64) {
    let lambda: Vec<f64> = laplacian_eigenvalues(n).collect();
    let (mut a, mut s) = ((3.0 * n as f64 + extra) / frames.max(1e-300), 0.0);
    for _ in 0..40 {
        a = zero_of(1e-6, most, |a| {
            frames - extra / a - 3.0 * lambda.iter().map(|l| 1.0 / (a + s * l)).sum::<f64>()
        });
        s = zero_of(0.0, most, |s| steps - 3.0 * lambda.iter().map(|l| l / (a + s * l)).sum::<f64>());
    }
    (a, s)
}

/// Returns the zero of a growing function between two limits, or the limit on its side.
fn zero_of(low: f64, high: f64, f: impl Fn(f64) -> f64) -> f64 {
    if f(low) >= 0.0 {
        return low;
    }
    if f(high) <= 0.0 {
        return high;
    }
    // Bisection of the logarithm: the values span many powers of ten.
    let (mut low, mut high) = (low.max(1e-9), high);
    for _ in 0..80 {
        let middle = (low * high).sqrt();
        if f(middle) < 0.0 { low = middle } else { high = middle }
    }
    (low * high).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::moved_about;
    use rand::RngExt;

    fn pose(v: [f64; 6]) -> DPose3 {
        moved_about(DVec3::ZERO, &v)
    }

    #[test]
    fn rows_are_the_derivatives_of_deviations() {
        let center_w = DVec3::new(0.2, -0.1, 0.3);
        let given = [pose([0.3, -0.5, 1.1, 0.4, 0.2, -0.6])];
        let problem = GivenPoses { poses: &given, rates: &[[0.3, -0.2, 0.5, 0.1, 0.4, -0.3]], center_w };
        let shared = Shared { hand_eye: pose([0.01, -0.02, 0.015, 0.01, 0.02, -0.01]), time_s: 0.02 };
        // At the base itself the derivatives of the rotation are exact.
        let x = problem.base(0, &shared);
        let at = |x: &DPose3, shared: &Shared| problem.deviations(0, x, shared).map(|d| d.value);
        let step = 1e-6;
        for (r, d) in problem.deviations(0, &x, &shared).iter().enumerate() {
            for a in 0..6 {
                let mut unit = [0.0; 6];
                unit[a] = step;
                let moved = at(&(moved_about(center_w, &unit) * x), &shared)[r];
                unit[a] = -step;
                let back = at(&(moved_about(center_w, &unit) * x), &shared)[r];
                let expected = (moved - back) / (2.0 * step);
                assert!((d.row.frames[0].1[a] - expected).abs() < 1e-6, "{r} {a}");
            }
            for k in HAND_EYE..COMMON {
                let mut unit = [0.0; COMMON];
                unit[k] = step;
                let expected = (at(&x, &shared.after(&unit))[r] - d.value) / step;
                assert!((d.row.common[k] - expected).abs() < 1e-5, "{r} {k}");
            }
        }
    }

    #[test]
    fn rates_are_those_of_a_steady_motion() {
        let twist = DVec3::new(0.1, -0.2, 0.3);
        let at = |t: f64| {
            DPose3::from_parts(
                DVec3::new(0.5, 1.0, -0.2) * t,
                DQuat::from_scaled_axis(twist * t) * DQuat::from_rotation_x(1.0),
            )
        };
        // Times need not be even.
        let times = [0.0, 0.1, 0.25, 0.3];
        let found = rates(&times.map(at), &times.map(Some));
        for rate in &found {
            let expected = [0.1, -0.2, 0.3, 0.5, 1.0, -0.2];
            assert!(rate.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-12), "{rate:?}");
        }
        assert_eq!(rates(&times.map(at), &[None; 4]), [[0.0; 6]; 4]);
    }

    #[test]
    fn chains_are_solved() {
        let (a, s, b) = (0.3, 2.0, [1.0, -2.0, 0.5, 3.0]);
        let x = chain_solve(a, s, &b);
        let n = b.len();
        for i in 0..n {
            let mut sum = a * x[i];
            for j in [i.wrapping_sub(1), i + 1].into_iter().filter(|j| *j < n) {
                sum += s * (x[i] - x[j]);
            }
            assert!((sum - b[i]).abs() < 1e-12, "{i}");
        }
    }

    #[test]
    fn precisions_of_drawn_noise_are_found() {
        let n = 200;
        let mut rng = Seed(4).rng();
        let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let sums = |values: &[[f64; 3]]| {
            let frames: f64 = values.as_flattened().iter().map(|v| v * v).sum();
            let steps: f64 =
                values.windows(2).map(|w| (0..3).map(|k| (w[1][k] - w[0][k]).powi(2)).sum::<f64>()).sum();
            (frames, steps)
        };
        let independent: Vec<[f64; 3]> = (0..n).map(|_| [(); 3].map(|()| 0.005 * normal())).collect();
        let (frames, steps) = sums(&independent);
        let (a, s) = most_likely(frames, steps, n, 3.0, 1e8);
        assert!((a.powf(-0.5) / 0.005 - 1.0).abs() < 0.1, "{}", a.powf(-0.5));
        assert!(s < 0.2 * a, "{s} {a}");

        let mut at = [0.0; 3];
        let walk: Vec<[f64; 3]> = (0..n)
            .map(|_| {
                at = at.map(|v| v + 0.001 * normal());
                at
            })
            .collect();
        let (frames, steps) = sums(&walk);
        let (a, s) = most_likely(frames, steps, n, 3.0, 1e8);
        assert!((s.powf(-0.5) / 0.001 - 1.0).abs() < 0.1, "{}", s.powf(-0.5));
        assert!(a.powf(-0.5) > 0.004, "{}", a.powf(-0.5));
    }
}
