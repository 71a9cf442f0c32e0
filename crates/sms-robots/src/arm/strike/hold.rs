//! Holds of the tool in a sweep: rotated about the sweep's direction or about the tool's own axis, so that the hand
//! clears obstacles beside the ball.

use crate::arm::shape::{Clearance, obstacle_distance};
use crate::{LinkShape, Obstacle, RobotModel, Sweep, ToolPath};
use glamx::{DPose3, DQuat, DVec3};
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_PI_2;

/// A hold of the tool. The striking face is always perpendicular to the sweep.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub(super) struct Hold {
    /// Quarter turns about the tool's z axis, which select the side in front.
    pub quarter_turns: u8,
    /// Rotation about the sweep's direction, radians: the hand leans to a side.
    pub roll_rad: f64,
}

impl Hold {
    /// Attitude in the sweep's frame (x along the sweep, z up).
    fn in_sweep(self) -> DQuat {
        DQuat::from_rotation_x(self.roll_rad)
            * DQuat::from_rotation_z(FRAC_PI_2 * f64::from(self.quarter_turns))
    }

    /// Attitude of the tool in the world.
    pub(super) fn rotation_w(self, sweep: &Sweep) -> DQuat {
        sweep.rotation_w() * self.in_sweep()
    }

    /// Distance from the tool's origin to the front side of a box with these half extents, metres.
    pub(super) fn front_m(self, half: DVec3) -> f64 {
        if self.quarter_turns.is_multiple_of(2) { half.x } else { half.y }
    }

    /// Returns the sweep for this hold, given the sweep of the upright tool. The front touches at the same place.
    pub(super) fn sweep(self, sweep: &Sweep, half: DVec3) -> Sweep {
        let back = self.front_m(half) - half.x;
        Sweep { contact_w: sweep.contact_w - back * sweep.direction_w, ..*sweep }
    }
}

/// The holds to try, in groups by preference. The holds of the first group are equivalent.
pub(crate) fn groups(symmetric: bool, turned: bool) -> Vec<Vec<Hold>> {
    let both_ways = |turns: [u8; 2], degrees: f64| -> Vec<Hold> {
        let turns = if symmetric { &turns[..] } else { &turns[..1] };
        let rolls = if degrees == 0.0 { vec![0.0] } else { vec![degrees, -degrees] };
        let hold =
            |q: u8| rolls.iter().map(move |r: &f64| Hold { quarter_turns: q, roll_rad: r.to_radians() });
        turns.iter().flat_map(|&q| hold(q).collect::<Vec<_>>()).collect()
    };
    let mut groups = vec![both_ways([0, 2], 0.0)];
    if turned && symmetric {
        groups.push(both_ways([1, 3], 0.0));
        groups.push(both_ways([1, 3], 30.0));
    }
    if turned {
        groups.push(both_ways([0, 2], 20.0));
    }
    if turned && symmetric {
        groups.push(both_ways([1, 3], 60.0));
    }
    let upright = groups.remove(0);
    std::iter::once(upright).chain(groups.into_iter().flatten().map(|hold| vec![hold])).collect()
}

/// Number of intervals of a sweep. The tool alone is checked at their ends.
const PLACES: usize = 8;

/// Returns where the tool comes too close to an obstacle during a sweep, independently of the arm's posture. Checks the
/// shapes of the links that are rigidly attached to the tool, and `striking`, a box about the tool's origin.
pub(crate) fn tool_blocked(
    model: &RobotModel,
    path: &impl ToolPath,
    striking: Option<DVec3>,
    obstacles: &[Obstacle],
    clearance_m: f64,
) -> Option<(Clearance, f64)> {
    let tool = &model.frames[model.tool.0];
    let x_tj = tool.x_jf.inverse();
    let box_ =
        striking.map(|half| (tool.name.as_str(), DPose3::IDENTITY, LinkShape::Box { half }, half.length()));
    let carried = model.collisions.iter().filter(|c| c.joint.is_some() && c.joint == tool.joint);
    let shapes: Vec<(&str, DPose3, LinkShape, f64)> =
        carried.map(|c| (c.link.as_str(), x_tj * c.x_js, c.shape.clone(), c.radius)).chain(box_).collect();
    (0..=PLACES).find_map(|k| {
        let at_s = path.duration_s() * k as f64 / PLACES as f64;
        let x_wt = path.at(at_s).x_wt;
        shapes.iter().find_map(|(link, x_ts, shape, radius)| {
            let x_ws = x_wt * *x_ts;
            obstacles.iter().filter(|o| !o.is_struck).find_map(|o| {
                let distance_m = obstacle_distance((shape, *radius), &x_ws, o, clearance_m);
                (distance_m < clearance_m).then(|| {
                    (Clearance { link: (*link).to_owned(), other: o.name.clone(), distance_m }, at_s)
                })
            })
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::FIST_HALF;

    const UPRIGHT: Hold = Hold { quarter_turns: 0, roll_rad: 0.0 };

    #[test]
    fn every_hold_strikes_the_same_place_with_a_face_square_to_the_sweep() {
        let upright = Sweep::of_ball(DVec3::new(0.5, 0.1, 0.03), 0.03, 0.7, 0.5, FIST_HALF.x);
        let touched = upright.contact_w + FIST_HALF.x * upright.direction_w;
        let holds: Vec<Hold> = groups(true, true).concat();
        assert_eq!((holds.len(), holds[0]), (16, UPRIGHT));
        for hold in holds {
            let sweep = hold.sweep(&upright, FIST_HALF);
            let front = sweep.contact_w + hold.front_m(FIST_HALF) * sweep.direction_w;
            assert!((front - touched).length() < 1e-12);
            // In the tool's frame, the sweep is parallel to one axis of the box, and a face of the box makes the
            // contact.
            let along = hold.rotation_w(&sweep).inverse() * sweep.direction_w;
            assert!((along.abs().max_element() - 1.0).abs() < 1e-12, "{along}");
            assert!((along.abs().dot(FIST_HALF) - hold.front_m(FIST_HALF)).abs() < 1e-12);
            let up = (hold.rotation_w(&sweep) * DVec3::Z).z;
            assert!((up - hold.roll_rad.cos()).abs() < 1e-12);
        }
    }

    #[test]
    fn a_tool_whose_sides_differ_keeps_its_front() {
        let holds: Vec<Hold> = groups(false, true).concat();
        assert!(holds.len() == 3 && holds.iter().all(|h| h.quarter_turns == 0));
        assert_eq!(groups(false, false).concat(), [UPRIGHT]);
    }
}
