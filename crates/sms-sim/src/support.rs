//! Supports of balls and their rolling resistance.

use crate::BodyId;
use crate::simulation::{Kind, Simulation};
use glamx::DVec3;

/// Largest gap to a body below that carries a ball, metres: in engines, bodies sink in or float by some µm.
const SUPPORT_GAP: f64 = 5e-5;

/// Contacts of a ball.
#[derive(Clone, Copy, Default)]
pub(crate) struct BallSupport {
    /// Whether the ball touches any body.
    pub(crate) touching: bool,
    /// Upward normal, rolling lever (m) and angular velocity of the supporting body.
    pub(crate) carried: Option<(DVec3, f64, DVec3)>,
}

impl Simulation {
    /// The supports of all balls that are awake.
    pub(crate) fn supports(&self) -> Vec<BallSupport> {
        (0..self.bodies.len()).map(|b| self.support_of(b)).collect()
    }

    fn support_of(&self, ball: BodyId) -> BallSupport {
        let mut support = BallSupport::default();
        let Kind::Ball { radius, .. } = self.bodies[ball].kind else { return support };
        if self.world.is_asleep(ball) {
            return support;
        }
        let center_w = self.states[ball].x_wb.translation;
        let up_w = (-self.gravity_w).try_normalize().unwrap_or(DVec3::Z);
        // A steeper surface does not carry.
        let mut best_slope = 0.5;
        for (other, body) in self.bodies.iter().enumerate() {
            let state = &self.states[other];
            let reach = radius + body.geometry.bounding_radius + SUPPORT_GAP;
            if other == ball || center_w.distance_squared(state.x_wb.translation) > reach * reach {
                continue;
            }
            let p = state.x_wb.inverse_transform_point(center_w);
            for part in body.geometry.parts_near(p, radius + SUPPORT_GAP) {
                let (nearest, inside) = part.nearest(p);
                let distance = p.distance(nearest);
                if inside || distance > radius + SUPPORT_GAP || distance == 0.0 {
                    continue;
                }
                support.touching = true;
                let normal_w = state.x_wb.rotation * ((p - nearest) / distance);
                let slope = normal_w.dot(up_w);
                if slope > best_slope {
                    best_slope = slope;
                    let lever = 0.5 * (self.bodies[ball].rolling_m + body.rolling_m);
                    support.carried = Some((normal_w, lever, state.w_w));
                }
            }
        }
        support
    }

    /// Torque of the rolling resistance for a step of `dt`, limited to that which stops the rotation.
    pub(crate) fn rolling_torque(&self, ball: BodyId, support: &BallSupport, dt: f64) -> Option<DVec3> {
        let Kind::Ball { mass, inertia, .. } = self.bodies[ball].kind else { return None };
        let (normal_w, lever, spin_w) = support.carried?;
        let weight = (-mass * self.gravity_w.dot(normal_w)).max(0.0);
        let rotation = self.states[ball].w_w - spin_w;
        let spinning = rotation.dot(normal_w) * normal_w;
        let against = |part: DVec3| {
            let most = inertia * part.length() / dt;
            -part.normalize_or_zero() * (lever * weight).min(most)
        };
        let torque = against(rotation - spinning) + against(spinning);
        (torque.length_squared() > 0.0).then_some(torque)
    }
}
