//! Time of impact of balls. At the paper's step of 2.5 ms, a ball of 0.8 m/s travels 2 mm, and a contact normal
//! computed at the boundary of a step deflects its path by degrees. Therefore steps are split at impacts.

use crate::geometry::{CollisionPart, Path};
use glamx::DVec3;

/// Gap that counts as a touch, metres: too small to deflect a path, above the resolution of single precision a metre
/// from the origin (1.2e-7 m).
pub(crate) const TOUCH_GAP: f64 = 2e-6;

/// Closing speed below which an impact is left to the engine, m/s: the ball travels 50 µm in a step of 2.5 ms.
pub(crate) const MIN_CLOSING_SPEED: f64 = 0.02;

/// Iterations after which a grazing approach is left to the engine.
const MAX_ITERATIONS: usize = 32;

/// An imminent impact of a ball.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Impact {
    /// Time from now, seconds.
    pub(crate) time_s: f64,
    /// Closing speed of the gap at that time, m/s, positive.
    pub(crate) closing_speed: f64,
    /// Point on the other body at that time, in the world.
    pub(crate) point_w: DVec3,
    /// Unit vector from that point to the ball's centre.
    pub(crate) normal_w: DVec3,
}

/// Returns the time at which a ball of `radius` comes within [`TOUCH_GAP`] of a part of another body, if it is before
/// `horizon` seconds. The time is zero if the ball is already closer and approaching.
///
/// Conservative advancement (Mirtich 1996): a convex part lies behind the plane through its nearest point, so the time
/// until the ball reaches that plane is never later than the impact. For a mesh, the plane is not a bound, so the whole
/// relative speed counts as closing speed.
pub(crate) fn time_of_impact(
    ball: &Path,
    radius: f64,
    part: &CollisionPart,
    other: &Path,
    horizon: f64,
) -> Option<Impact> {
    let mut t = 0.0;
    for _ in 0..MAX_ITERATIONS {
        let x_wb = other.pose_at(t);
        let center_w = ball.position_at(t);
        let p = x_wb.inverse_transform_point(center_w);
        let (nearest, inside) = part.nearest(p);
        if inside {
            return None;
        }
        let distance = p.distance(nearest);
        let gap = distance - radius;
        let normal_w = x_wb.rotation * ((p - nearest) / distance);
        let spin = other.spin_w().cross(center_w - x_wb.translation);
        let relative = ball.velocity_at(t) - other.velocity_at(t) - spin;
        let closing = -relative.dot(normal_w);
        if gap <= TOUCH_GAP {
            let point_w = x_wb.transform_point(nearest);
            let impact = Impact { time_s: t, closing_speed: closing, point_w, normal_w };
            return (closing > MIN_CLOSING_SPEED).then_some(impact);
        }
        let along = if part.is_convex() { closing } else { relative.length() };
        // The plane rotates with the other body.
        let turn = other.spin_w().length();
        let turning = turn * (turn * center_w.distance(x_wb.translation) + 2.0 * relative.length());
        let gained = ball.acceleration_bound() + other.acceleration_bound() + turning;
        if along + gained * (horizon - t) < MIN_CLOSING_SPEED {
            return None;
        }
        t += time_to_cover(gap - 0.5 * TOUCH_GAP, along, gained);
        if t >= horizon {
            return None;
        }
    }
    None
}

/// Time in which `distance` > 0 is covered at the speed `v` (of either sign) and the acceleration `a` ≥ 0.
fn time_to_cover(distance: f64, v: f64, a: f64) -> f64 {
    let root = (v * v + 2.0 * a * distance).sqrt();
    // Root of the quadratic in a form without cancellation.
    if v >= 0.0 { 2.0 * distance / (v + root) } else { (root - v) / a }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::BodyState;
    use glamx::{DPose3, DQuat};
    use parry3d_f64::shape::Cuboid;
    use proptest::prelude::*;

    fn moving(p: DVec3, v: DVec3) -> BodyState {
        BodyState { x_wb: DPose3::from_translation(p), v_w: v, w_w: DVec3::ZERO }
    }

    fn free(state: &BodyState) -> Path<'_> {
        Path::Free { state, acceleration_w: DVec3::ZERO }
    }

    proptest! {
        /// Two spheres meet at the time given by the quadratic.
        #[test]
        fn two_spheres_meet_when_the_quadratic_says(
            offset in -0.055..0.055f64, gap in 0.0001..0.002f64, speed in 0.3..2.0f64,
        ) {
            let (r, horizon) = (0.03, 0.01);
            let ahead = (4.0 * r * r - offset * offset).sqrt();
            let a = moving(DVec3::new(-ahead - gap, offset, 0.0), DVec3::new(speed, 0.0, 0.0));
            let b = moving(DVec3::ZERO, DVec3::ZERO);
            let t = time_of_impact(&free(&a), r, &CollisionPart::Sphere(r), &free(&b), horizon);
            let t = t.expect("they meet within the horizon").time_s;
            // The impact is found up to the gap, which a grazing ball closes more slowly.
            let slack = TOUCH_GAP / (speed * ahead / (2.0 * r)) + 1e-9;
            prop_assert!(t <= gap / speed + 1e-9 && t > gap / speed - slack, "{t} {}", gap / speed);
        }

        /// A ball moving along a wall never hits it. A ball falling on a plane hits it at the time given by the
        /// parabola.
        #[test]
        fn a_falling_ball_lands_when_the_parabola_says(height in 1e-4..1e-3f64, drop in 0.0..0.5f64) {
            let g = DVec3::new(0.0, 0.0, -9.81);
            let state = moving(DVec3::new(0.0, 0.0, 0.03 + height), DVec3::new(0.8, 0.0, -drop));
            let ball = Path::Free { state: &state, acceleration_w: g };
            let still = moving(DVec3::ZERO, DVec3::ZERO);
            let t = time_of_impact(&ball, 0.03, &CollisionPart::HalfSpace, &free(&still), 0.1).unwrap().time_s;
            let exact = (-drop + (drop * drop + 2.0 * 9.81 * height).sqrt()) / 9.81;
            prop_assert!((t - exact).abs() < 2.0 * TOUCH_GAP / (drop * drop + 2.0 * 9.81 * height).sqrt());
        }
    }

    #[test]
    fn a_ball_that_passes_or_leaves_hits_nothing() {
        let wall = CollisionPart::Cuboid(Cuboid::new(DVec3::splat(0.1)));
        let still = moving(DVec3::ZERO, DVec3::ZERO);
        for (p, v) in [
            (DVec3::new(0.131, 0.0, 0.0), DVec3::new(0.0, 1.0, 0.0)),
            (DVec3::new(0.1301, 0.0, 0.0), DVec3::new(1.0, 0.0, 0.0)),
            // Touching and sliding along.
            (DVec3::new(0.13, 0.0, 0.0), DVec3::new(0.0, 1.0, 0.0)),
        ] {
            assert_eq!(time_of_impact(&free(&moving(p, v)), 0.03, &wall, &free(&still), 0.05), None);
        }
    }

    #[test]
    fn a_turning_plank_hits_a_ball_at_rest() {
        // A plank of half length 0.5 rotates at 1 rad/s; the ball is 10 mm off its face at 0.4 m.
        let plank = CollisionPart::Cuboid(Cuboid::new(DVec3::new(0.5, 0.01, 0.05)));
        let turning = BodyState { x_wb: DPose3::IDENTITY, v_w: DVec3::ZERO, w_w: DVec3::Z };
        let ball = moving(DVec3::new(0.4, 0.05, 0.0), DVec3::ZERO);
        let t = time_of_impact(&free(&ball), 0.03, &plank, &free(&turning), 0.1).unwrap().time_s;
        let x = DPose3::from_parts(DVec3::ZERO, DQuat::from_rotation_z(t));
        let p = x.inverse_transform_point(ball.x_wb.translation);
        let gap = p.y - 0.01 - 0.03;
        assert!(gap > 0.0 && gap < 1.1 * TOUCH_GAP, "{gap}");
    }
}
