//! Strikers: the torque-controlled arm, or a kinematic finger of infinite mass. Both execute the paper's strike: two
//! linear segments of 0.1 m (appendix "Manipulator Control and Action Modeling").

use glamx::{DPose3, DQuat, DVec3};
use serde::{Deserialize, Serialize};
use sms_robots::{ArmStrike, FIST_HALF, SEGMENT_M, Sweep};
use std::sync::Arc;

/// Height by which a striker is lifted after its sweep, metres.
pub(crate) const RETRACTION_M: f64 = 0.3;

/// Executor of a strike.
#[derive(Debug, Clone)]
pub enum Striker {
    /// A kinematic finger, for an unknown robot. Contacts do not change its motion.
    Finger(StrikerMotion),
    /// An arm under torque control.
    Arm(Arc<ArmStrike>),
}

impl From<&StrikerMotion> for Striker {
    fn from(motion: &StrikerMotion) -> Self {
        Self::Finger(*motion)
    }
}

impl From<StrikerMotion> for Striker {
    fn from(motion: StrikerMotion) -> Self {
        Self::Finger(motion)
    }
}

impl From<&Self> for Striker {
    fn from(striker: &Self) -> Self {
        striker.clone()
    }
}

/// Half extents, metres, of the closed fingertips of a Franka Hand as one box: x along the sweep, y along the fingers'
/// stroke, z up. The rubber tip of one finger is 17.5 × 15.2 × 18.5 mm and begins at the contact plane of the closed
/// fingers (`franka_description`, `end_effectors/franka_hand`).
pub const FINGER_HALF: DVec3 = FIST_HALF;

/// A sweep of the closed fingers, in world coordinates.
///
/// The finger is a box with its front face perpendicular to the sweep. It starts at rest, 0.1 m before the front face
/// touches a ball of `ball_radius` at `contact_w`. It reaches `speed` at the contact with the profile of [`Sweep`],
/// decelerates to rest over another 0.1 m, and is then lifted out of the scene. So `speed` is the finger's speed at the
/// first touch if the ball is at its estimated position.
///
/// The front face is flat, so the position of the contact on the face (up to 15 mm to either side) makes no difference.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct StrikerMotion {
    /// Contact position: the estimated centre of the ball, metres.
    pub contact_w: DVec3,
    /// Direction of the sweep in the floor plane, radians from world x: (cos, sin, 0).
    pub angle: f64,
    /// Speed at the contact position, m/s.
    pub speed: f64,
    /// Estimated radius of the ball, metres.
    pub ball_radius: f64,
}

impl StrikerMotion {
    /// Direction of the sweep, a unit vector.
    pub fn direction_w(&self) -> DVec3 {
        DVec3::new(self.angle.cos(), self.angle.sin(), 0.0)
    }

    /// Time at which the front face reaches the contact position, seconds from the start.
    pub fn contact_s(&self) -> f64 {
        2.0 * SEGMENT_M / self.speed
    }

    /// Duration of the sweep, seconds.
    pub fn duration_s(&self) -> f64 {
        2.0 * self.contact_s()
    }

    /// The sweep of a tool whose front is `front_m` ahead of its origin.
    pub fn sweep(&self, front_m: f64) -> Sweep {
        Sweep::of_ball(self.contact_w, self.ball_radius, self.angle, self.speed, front_m)
    }

    /// Largest acceleration of the sweep, m/s².
    pub(crate) fn largest_acceleration(&self) -> f64 {
        // The larger of both profiles.
        5.0 / 3.0 * self.speed / self.contact_s()
    }

    /// Pose `X_WK` of the finger's box at `t` seconds from the start: its centre, x along the sweep, z up. The finger
    /// waits before the start and is lifted after the end.
    pub fn pose_at(&self, t: f64) -> DPose3 {
        let sweep = self.sweep(FINGER_HALF.x);
        let along = sweep.travel_at(t).0 - SEGMENT_M;
        let lift = if t > self.duration_s() { RETRACTION_M } else { 0.0 };
        DPose3::from_parts(
            sweep.contact_w + along * sweep.direction_w + DVec3::new(0.0, 0.0, lift),
            DQuat::from_rotation_z(self.angle),
        )
    }

    /// Velocity of the finger at `t` seconds from the start, m/s.
    pub fn velocity_at(&self, t: f64) -> DVec3 {
        self.sweep(FINGER_HALF.x).travel_at(t).1 * self.direction_w()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const MOTION: StrikerMotion =
        StrikerMotion { contact_w: DVec3::new(0.4, -0.1, 0.03), angle: 0.7, speed: 0.6, ball_radius: 0.03 };

    /// The middle of the front face.
    fn front_w(motion: &StrikerMotion, t: f64) -> DVec3 {
        motion.pose_at(t).transform_point(DVec3::new(FINGER_HALF.x, 0.0, 0.0))
    }

    #[test]
    fn the_front_face_touches_the_ball_at_the_asked_speed() {
        let t = MOTION.contact_s();
        let ball_back = MOTION.contact_w - 0.03 * MOTION.direction_w();
        assert!((front_w(&MOTION, t) - ball_back).length() < 1e-12);
        assert!((MOTION.velocity_at(t) - 0.6 * MOTION.direction_w()).length() < 1e-12);
    }

    #[test]
    fn both_segments_are_a_tenth_of_a_metre() {
        let (start, contact, end) = (
            front_w(&MOTION, 0.0),
            front_w(&MOTION, MOTION.contact_s()),
            front_w(&MOTION, MOTION.duration_s()),
        );
        assert!(((contact - start).length() - 0.1).abs() < 1e-12);
        assert!(((end - contact).length() - 0.1).abs() < 1e-12);
        assert_eq!(MOTION.velocity_at(0.0), DVec3::ZERO);
        assert!(MOTION.velocity_at(MOTION.duration_s()).length() < 1e-12);
        assert!(front_w(&MOTION, MOTION.duration_s() + 1e-6).z > 0.2, "lifted");
    }

    proptest! {
        #[test]
        fn velocity_is_the_derivative_of_the_pose(speed in 0.2..0.85f64, share in 0.001..0.999f64) {
            let motion = StrikerMotion { speed, ..MOTION };
            let t = share * motion.duration_s();
            let h = 1e-6;
            let slope = (motion.pose_at(t + h).translation - motion.pose_at(t - h).translation) / (2.0 * h);
            prop_assert!((slope - motion.velocity_at(t)).length() < 1e-5);
        }
    }
}
