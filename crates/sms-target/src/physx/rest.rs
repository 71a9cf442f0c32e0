//! Rest detection by displacement.
//!
//! PhysX puts a body to sleep if it is slow in every step. At short steps, contacts of many parts tremble at 1e-4 m/s
//! forever, and PhysX solves all their contacts: nine tenths of a shot's time.

use super::instance::{Blueprint, Instance};
use super::world::is_dynamic;
use physx_sys::PxTransform;

/// Time for which a body must rest, seconds.
const WINDOW_S: f64 = 0.1;
/// Largest displacement, metres, and rotation, radians, in that time. A body balanced on an edge needs seconds to fall;
/// a ball this slow stops within a micrometre.
const MOVED_M: f32 = 1e-5;
const TURNED_RAD: f32 = 1e-4;

/// Detects resting bodies.
#[derive(Default)]
pub(super) struct Rest {
    elapsed_s: f64,
    /// Pose of each body at the start of the window.
    places: Vec<PxTransform>,
}

impl Rest {
    /// Starts a window.
    pub(super) fn begin(&mut self, instance: &Instance, bodies: usize) {
        self.elapsed_s = 0.0;
        self.places.clear();
        self.places.extend((0..bodies).map(|b| instance.pose(b)));
    }

    /// Puts resting bodies to sleep, after a step of `dt`. PhysX wakes them again when an awake body touches them.
    pub(super) fn after_step(&mut self, dt: f64, instance: &mut Instance, blueprints: &[Blueprint]) {
        self.elapsed_s += dt;
        if self.elapsed_s < WINDOW_S {
            return;
        }
        for (body, (blueprint, place)) in blueprints.iter().zip(&self.places).enumerate() {
            if is_dynamic(&blueprint.role)
                && !instance.is_asleep(body, &blueprint.role)
                && is_near(place, &instance.pose(body))
            {
                instance.put_to_sleep(body);
            }
        }
        self.begin(instance, blueprints.len());
    }
}

/// Returns whether two poses differ by less than the limits of a body at rest.
fn is_near(a: &PxTransform, b: &PxTransform) -> bool {
    let way = [a.p.x - b.p.x, a.p.y - b.p.y, a.p.z - b.p.z];
    // A quaternion and its negative are the same rotation.
    let (qa, qb) = ([a.q.x, a.q.y, a.q.z, a.q.w], [b.q.x, b.q.y, b.q.z, b.q.w]);
    let sign = if qa.iter().zip(&qb).map(|(x, y)| x * y).sum::<f32>() < 0.0 { -1.0 } else { 1.0 };
    let turn = qa.iter().zip(&qb).map(|(x, y)| (x - sign * y).powi(2)).sum::<f32>().sqrt();
    way.iter().map(|d| d * d).sum::<f32>() < MOVED_M * MOVED_M && 2.0 * turn < TURNED_RAD
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::physx::shapes::transform;
    use glamx::{DPose3, DQuat, DVec3};

    #[test]
    fn poses_are_near_by_way_and_turn() {
        let at = DPose3::from_parts(DVec3::new(0.4, -0.3, 0.05), DQuat::from_rotation_z(2.0));
        let other = |way: f64, turn: f64, sign: f64| {
            let q = DQuat::from_rotation_x(turn) * at.rotation;
            let q = DQuat::from_xyzw(sign * q.x, sign * q.y, sign * q.z, sign * q.w);
            transform(&DPose3::from_parts(at.translation + DVec3::Y * way, q))
        };
        let from = transform(&at);
        assert!(is_near(&from, &other(0.8e-5, 0.8e-4, 1.0)) && is_near(&from, &other(0.0, 0.8e-4, -1.0)));
        assert!(!is_near(&from, &other(1.3e-5, 0.0, 1.0)) && !is_near(&from, &other(0.0, 1.3e-4, 1.0)));
    }
}
