//! Errors of the colour camera, and the rays of its pixels while it moves.

use glamx::{DPose3, DQuat, DVec3, Mat3, Vec3};
use serde::{Deserialize, Serialize};
use sms_core::{Camera, Intrinsics, Seed, standard_normal};

/// Errors of the colour camera. Lengths in pixels refer to an image 1280 wide and scale with the width.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ColorCamera {
    /// Standard deviation of the noise, in 8-bit levels.
    pub sigma_levels: f32,
    /// Time during which each row is exposed, seconds: motion blurs the image. 0 for none.
    pub exposure_s: f64,
    /// Standard deviation of the change of the logarithm of the gain from frame to frame: automatic exposure as a random walk.
    pub gain_walk: f64,
    /// Time from the first row to the last, seconds (rolling shutter); the pose is that of the middle row. 0 for a global shutter.
    pub readout_s: f64,
    /// Time by which colour is taken after depth, seconds. Recorded poses are those of the depth.
    pub delay_s: f64,
    /// Place of the colour image's content relative to the depth image's, to the right and down, pixels at width 1280: an error of
    /// the registration.
    pub offset_px: [f64; 2],
}

impl Default for ColorCamera {
    fn default() -> Self {
        Self { sigma_levels: 1.2, ..Self::perfect() }
    }
}

impl ColorCamera {
    /// A camera without errors.
    pub fn perfect() -> Self {
        Self {
            sigma_levels: 0.0,
            exposure_s: 0.0,
            gain_walk: 0.0,
            readout_s: 0.0,
            delay_s: 0.0,
            offset_px: [0.0; 2],
        }
    }

    /// Returns the gain of each frame, relative to the first.
    pub fn gains(&self, frames: usize, seed: Seed) -> Vec<f64> {
        let mut rng = seed.derive("gain").rng();
        let mut log = 0.0f64;
        let mut next = |index: usize| {
            if index > 0 {
                log += self.gain_walk * standard_normal(&mut rng);
            }
            log.exp()
        };
        (0..frames).map(&mut next).collect()
    }

    /// Returns whether the rays of colour differ from those of depth.
    pub(crate) fn has_own_rays(&self, state: &FrameState) -> bool {
        let moves = state.velocity_w_m_s != DVec3::ZERO || state.spin_c_rad_s != DVec3::ZERO;
        let takes_time = self.exposure_s > 0.0 || self.readout_s > 0.0 || self.delay_s != 0.0;
        self.offset_px != [0.0; 2] || (moves && takes_time)
    }
}

/// State of the camera while it takes a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameState {
    /// Velocity in the world, m/s.
    pub velocity_w_m_s: DVec3,
    /// Angular velocity about the camera's own axes, rad/s.
    pub spin_c_rad_s: DVec3,
    /// Gain of the colour, 1 for none.
    pub gain: f64,
}

impl Default for FrameState {
    fn default() -> Self {
        Self { velocity_w_m_s: DVec3::ZERO, spin_c_rad_s: DVec3::ZERO, gain: 1.0 }
    }
}

impl FrameState {
    /// Returns the velocities at a pose of a path that is walked at this rate: central differences, one-sided at the ends.
    pub fn on_path(poses: &[DPose3], index: usize, frame_rate_hz: f64) -> Self {
        let (before, after) = (index.saturating_sub(1), (index + 1).min(poses.len().saturating_sub(1)));
        let time_s = (after - before.min(after)) as f64 / frame_rate_hz;
        let (Some(from), Some(to)) = (poses.get(before), poses.get(after)) else { return Self::default() };
        if time_s <= 0.0 {
            return Self::default();
        }
        Self {
            velocity_w_m_s: (to.translation - from.translation) / time_s,
            spin_c_rad_s: (from.rotation.inverse() * to.rotation).to_scaled_axis() / time_s,
            gain: 1.0,
        }
    }

    /// Returns the pose this long after `x_wc`.
    pub fn carried(&self, x_wc: &DPose3, time_s: f64) -> DPose3 {
        DPose3::from_parts(
            x_wc.translation + self.velocity_w_m_s * time_s,
            x_wc.rotation * DQuat::from_scaled_axis(self.spin_c_rad_s * time_s),
        )
    }
}

/// The rays of a camera at one moment.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rays {
    pub(crate) eye: Vec3,
    rotation: Mat3,
    intrinsics: Intrinsics,
}

impl Rays {
    pub(crate) fn new(camera: &Camera) -> Self {
        Self {
            eye: camera.x_wc.translation.as_vec3(),
            rotation: Mat3::from_quat(camera.x_wc.rotation.as_quat()),
            intrinsics: camera.intrinsics,
        }
    }

    /// Returns the direction through a point of the image, with length 1 along the optical axis.
    pub(crate) fn direction(&self, u: f64, v: f64) -> Vec3 {
        let k = &self.intrinsics;
        self.rotation * Vec3::new(((u - k.cx) / k.fx) as f32, ((v - k.cy) / k.fy) as f32, 1.0)
    }
}

/// The colour camera's rays row by row, and over the time of the exposure.
#[derive(Debug)]
pub(crate) struct ColorRays<'a> {
    camera: Camera,
    model: &'a ColorCamera,
    state: &'a FrameState,
    /// Moments of the exposure that are rendered.
    pub(crate) moments: usize,
}

/// Most moments of an exposure that are rendered.
const MOST_MOMENTS: usize = 16;

impl<'a> ColorRays<'a> {
    /// `near_m` is the depth of near surfaces, whose blur decides how many moments are rendered.
    pub(crate) fn new(camera: &Camera, model: &'a ColorCamera, state: &'a FrameState, near_m: f64) -> Self {
        let mut camera = *camera;
        let scale = camera.intrinsics.width as f64 / 1280.0;
        camera.intrinsics.cx += model.offset_px[0] * scale;
        camera.intrinsics.cy += model.offset_px[1] * scale;
        let k = &camera.intrinsics;
        let (w, h) = (k.width as f64, k.height as f64);
        // Length of the blur of a few points, pixels.
        let moved = Camera::new(*k, state.carried(&camera.x_wc, model.exposure_s));
        let blur = |(u, v): (f64, f64)| {
            let p_w = camera.unproject(u, v, near_m.max(0.05));
            moved.project(p_w).map_or(0.0, |(a, b, _)| (a - u).hypot(b - v))
        };
        let points = [(0.5 * w, 0.5 * h), (0.0, 0.0), (w, 0.0), (0.0, h), (w, h)];
        let longest = points.into_iter().map(blur).fold(0.0, f64::max);
        let moments = if longest < 0.25 { 1 } else { (longest.ceil() as usize + 1).min(MOST_MOMENTS) };
        Self { camera, model, state, moments }
    }

    /// Returns the rays of a row at the moment with this number; 0.5 of `moments` is the middle of the exposure.
    pub(crate) fn at(&self, row: usize, moment: f64) -> Rays {
        let down = (row as f64 + 0.5) / self.camera.intrinsics.height as f64 - 0.5;
        let exposed = self.model.exposure_s * (moment / self.moments as f64 - 0.5);
        let time_s = self.model.delay_s + self.model.readout_s * down + exposed;
        Rays::new(&Camera::new(self.camera.intrinsics, self.state.carried(&self.camera.x_wc, time_s)))
    }

    /// Returns the rays of a row in the middle of its exposure.
    pub(crate) fn middle(&self, row: usize) -> Rays {
        self.at(row, 0.5 * self.moments as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn velocities_are_those_of_the_path() {
        let pose = |i: usize| {
            let t = 0.2 * i as f64;
            DPose3::from_parts(DVec3::new(0.3 * t, 0.0, 1.0), DQuat::from_rotation_y(0.5 * t))
        };
        let poses: Vec<DPose3> = (0..6).map(pose).collect();
        for index in [0, 3, 5] {
            let state = FrameState::on_path(&poses, index, 5.0);
            assert!((state.velocity_w_m_s - DVec3::X * 0.3).length() < 1e-12);
            assert!((state.spin_c_rad_s - DVec3::Y * 0.5).length() < 1e-12);
            let next = state.carried(&poses[index], 0.2);
            assert!((next.translation - pose(index + 1).translation).length() < 1e-12);
            assert!(next.rotation.angle_between(pose(index + 1).rotation) < 1e-7);
        }
        assert_eq!(FrameState::on_path(&poses[..1], 0, 5.0), FrameState::default());
        assert_eq!(FrameState::on_path(&[], 0, 5.0), FrameState::default());
    }

    #[test]
    fn gains_walk_with_their_step() {
        let camera = ColorCamera { gain_walk: 0.02, ..ColorCamera::default() };
        let n = 400;
        let variance = |frame: usize| {
            (0..n).map(|s| camera.gains(60, Seed(s))[frame].ln().powi(2)).sum::<f64>() / n as f64
        };
        assert_eq!(variance(0), 0.0);
        assert!((variance(9).sqrt() / (0.02 * 3.0) - 1.0).abs() < 0.1, "{}", variance(9).sqrt());
        assert!((variance(36).sqrt() / (0.02 * 6.0) - 1.0).abs() < 0.1, "{}", variance(36).sqrt());
        assert!(ColorCamera::default().gains(60, Seed(1)).iter().all(|g| *g == 1.0));
    }
}
