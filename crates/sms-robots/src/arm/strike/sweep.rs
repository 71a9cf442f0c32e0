//! Motions of the tool: the paper's strike (two straight segments of 0.1 m, appendix "Manipulator Control and Action
//! Modeling") and straight lines between points at rest.

use glamx::{DMat3, DPose3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// Length of each of the two segments of a sweep, metres.
pub const SEGMENT_M: f64 = 0.1;

/// Reference of the tool at one time, in the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ToolReference {
    /// Pose `X_WT`.
    pub x_wt: DPose3,
    /// Velocity of the tool's origin, m/s.
    pub v_w: DVec3,
    /// Angular velocity, rad/s.
    pub w_w: DVec3,
    /// Acceleration of the origin, m/s².
    pub a_w: DVec3,
    /// Angular acceleration, rad/s².
    pub alpha_w: DVec3,
}

impl ToolReference {
    /// The reference of a resting tool.
    pub fn at_rest(x_wt: DPose3) -> Self {
        Self { x_wt, v_w: DVec3::ZERO, w_w: DVec3::ZERO, a_w: DVec3::ZERO, alpha_w: DVec3::ZERO }
    }
}

/// A tool motion without rotation.
pub trait ToolPath {
    /// Duration, seconds.
    fn duration_s(&self) -> f64;
    /// The reference at `t` seconds; the tool is at rest before the start and after the end.
    fn at(&self, t: f64) -> ToolReference;
    /// The reference for a controller that holds its torques from `t` for `period_s` seconds: pose and velocity at `t`,
    /// acceleration at the middle of the period.
    fn held(&self, t: f64, period_s: f64) -> ToolReference {
        let ahead = self.at(t + 0.5 * period_s);
        ToolReference { a_w: ahead.a_w, alpha_w: ahead.alpha_w, ..self.at(t) }
    }
}

/// Speed profile of a sweep. Both take the same time for the same distance and speed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SweepProfile {
    /// In each segment the acceleration rises over the first two fifths, is constant, and falls over the last two. It
    /// is zero at the start, contact and end, so that torques are continuous and timing errors hardly change the
    /// contact speed. Its peak is 5/3 of the uniform acceleration.
    #[default]
    Smooth,
    /// Uniform acceleration, then uniform deceleration; torques jump at the start, contact and end.
    Uniform,
}

/// A strike: from rest 0.1 m before the contact, the tool reaches `speed` at the contact and comes to rest 0.1 m beyond
/// it, on a straight line, without rotation.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Sweep {
    /// Position of the tool's origin at the contact, metres in the world.
    pub contact_w: DVec3,
    /// Direction of the sweep, a unit vector in the world.
    pub direction_w: DVec3,
    /// Up direction: the tool's z axis after orthogonalization against the direction.
    pub up_w: DVec3,
    /// Speed at the contact, m/s.
    pub speed: f64,
    /// Speed profile.
    pub profile: SweepProfile,
}

impl Sweep {
    /// The strike of a ball of `radius` with its estimated centre at `center_w`, along (cos `angle`, sin `angle`, 0).
    /// The front of the tool, `front_m` ahead of its origin (for the FR3's fist [`crate::FIST_HALF`]`.x`), touches the
    /// ball at `speed`.
    pub fn of_ball(center_w: DVec3, radius: f64, angle: f64, speed: f64, front_m: f64) -> Self {
        let direction_w = DVec3::new(angle.cos(), angle.sin(), 0.0);
        Self {
            contact_w: center_w - (radius + front_m) * direction_w,
            direction_w,
            up_w: DVec3::Z,
            speed,
            profile: SweepProfile::default(),
        }
    }

    /// Time of the contact, seconds from the start.
    pub fn contact_s(&self) -> f64 {
        2.0 * SEGMENT_M / self.speed
    }

    /// Attitude of the tool: x along the sweep, z up.
    pub fn rotation_w(&self) -> DQuat {
        let x = self.direction_w.normalize();
        let z = (self.up_w - self.up_w.dot(x) * x).normalize();
        DQuat::from_mat3(&DMat3::from_cols(x, z.cross(x), z))
    }

    /// Distance from the start, speed and acceleration along the sweep at `t` seconds.
    pub fn travel_at(&self, t: f64) -> (f64, f64, f64) {
        let (v, half) = (self.speed, self.contact_s());
        if t <= 0.0 {
            return (0.0, 0.0, 0.0);
        }
        if t >= 2.0 * half {
            return (2.0 * SEGMENT_M, 0.0, 0.0);
        }
        // The deceleration mirrors the acceleration.
        let rising = t < half;
        let s = if rising { t / half } else { 2.0 - t / half };
        let (distance, speed, acceleration) = match self.profile {
            SweepProfile::Smooth => {
                let [p, u, a] = smooth_rise(s);
                (v * half * p, v * u, v / half * a)
            }
            SweepProfile::Uniform => (0.5 * v * half * s * s, v * s, v / half),
        };
        if rising {
            (distance, speed, acceleration)
        } else {
            (2.0 * SEGMENT_M - distance, speed, -acceleration)
        }
    }

    /// Returns the tool's motion with a given attitude, such as [`Self::rotation_w`].
    pub fn path(&self, rotation_w: DQuat) -> SweepPath {
        SweepPath { sweep: *self, rotation_w }
    }
}

/// A [`Sweep`] with the tool's attitude.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SweepPath {
    /// The sweep.
    pub sweep: Sweep,
    /// Attitude of the tool in the world.
    pub rotation_w: DQuat,
}

impl ToolPath for SweepPath {
    fn duration_s(&self) -> f64 {
        2.0 * self.sweep.contact_s()
    }

    fn at(&self, t: f64) -> ToolReference {
        let (distance, speed, acceleration) = self.sweep.travel_at(t);
        let d = self.sweep.direction_w;
        let x_wt = DPose3::from_parts(self.sweep.contact_w + (distance - SEGMENT_M) * d, self.rotation_w);
        ToolReference { v_w: speed * d, a_w: acceleration * d, ..ToolReference::at_rest(x_wt) }
    }
}

/// Distance, speed and acceleration of a speed rise from 0 to 1 in unit time with a trapezoidal acceleration.
fn smooth_rise(s: f64) -> [f64; 3] {
    const RAMP: f64 = 0.4;
    let peak = 1.0 / (1.0 - RAMP);
    let ramp = |s: f64| [peak * s.powi(3) / (6.0 * RAMP), peak * s * s / (2.0 * RAMP), peak * s / RAMP];
    if s < RAMP {
        ramp(s)
    } else if s <= 1.0 - RAMP {
        let [p, v, _] = ramp(RAMP);
        let t = s - RAMP;
        [p + v * t + 0.5 * peak * t * t, v + peak * t, peak]
    } else {
        // The rise is symmetric about its middle.
        let [p, v, a] = ramp(1.0 - s);
        [s - 0.5 + p, 1.0 - v, a]
    }
}

/// A straight line between two resting poses with minimum jerk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LinePath {
    /// Pose at the start.
    pub start: DPose3,
    /// Displacement, metres in the world.
    pub by_w: DVec3,
    /// Duration, seconds.
    pub duration_s: f64,
}

impl ToolPath for LinePath {
    fn duration_s(&self) -> f64 {
        self.duration_s
    }

    fn at(&self, t: f64) -> ToolReference {
        let [p, v, a] = minimum_jerk(t, self.duration_s);
        let x_wt = DPose3::from_parts(self.start.translation + p * self.by_w, self.start.rotation);
        ToolReference { v_w: v * self.by_w, a_w: a * self.by_w, ..ToolReference::at_rest(x_wt) }
    }
}

/// Share of the way, its first and second derivative at `t` of a rest-to-rest motion over `duration_s` seconds:
/// 10 s³ − 15 s⁴ + 6 s⁵ (Flash and Hogan 1985).
pub(crate) fn minimum_jerk(t: f64, duration_s: f64) -> [f64; 3] {
    let s = (t / duration_s).clamp(0.0, 1.0);
    let rest = s <= 0.0 || s >= 1.0;
    [
        s.powi(3) * (10.0 - 15.0 * s + 6.0 * s * s),
        if rest { 0.0 } else { 30.0 * s * s * (1.0 - s).powi(2) / duration_s },
        if rest { 0.0 } else { 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / duration_s.powi(2) },
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sweep(speed: f64, profile: SweepProfile) -> Sweep {
        Sweep { profile, ..Sweep::of_ball(DVec3::new(0.5, 0.1, 0.03), 0.03, 0.7, speed, 0.009) }
    }

    #[test]
    fn the_contact_is_reached_at_the_asked_speed_after_a_tenth_of_a_metre() {
        for profile in [SweepProfile::Smooth, SweepProfile::Uniform] {
            let s = sweep(0.6, profile);
            let path = s.path(s.rotation_w());
            let at = path.at(s.contact_s());
            assert!((at.x_wt.translation - s.contact_w).length() < 1e-12);
            assert!((at.v_w - 0.6 * s.direction_w).length() < 1e-12);
            let start = path.at(0.0).x_wt.translation;
            let end = path.at(path.duration_s()).x_wt.translation;
            assert!(((s.contact_w - start).length() - 0.1).abs() < 1e-12);
            assert!(((end - s.contact_w).length() - 0.1).abs() < 1e-12);
            let x = at.x_wt.rotation * DVec3::X;
            assert!(
                (x - s.direction_w).length() < 1e-12
                    && (at.x_wt.rotation * DVec3::Z - DVec3::Z).length() < 1e-12
            );
        }
    }

    proptest! {
        #[test]
        fn velocity_and_acceleration_are_derivatives(
            speed in 0.2..1.5f64, share in 0.001..0.999f64, smooth: bool,
        ) {
            let s = sweep(speed, if smooth { SweepProfile::Smooth } else { SweepProfile::Uniform });
            // Away from the corner of the uniform profile.
            prop_assume!((share - 0.5).abs() > 1e-3);
            let line = LinePath { start: DPose3::IDENTITY, by_w: DVec3::new(0.1, -0.2, 0.3), duration_s: 0.7 };
            for path in [&s.path(s.rotation_w()) as &dyn ToolPath, &line] {
                let (t, h) = (share * path.duration_s(), 1e-6);
                let (before, at, after) = (path.at(t - h), path.at(t), path.at(t + h));
                let slope = (after.x_wt.translation - before.x_wt.translation) / (2.0 * h);
                prop_assert!((slope - at.v_w).length() < 1e-6);
                prop_assert!(((after.v_w - before.v_w) / (2.0 * h) - at.a_w).length() < 1e-4);
            }
        }
    }
}
