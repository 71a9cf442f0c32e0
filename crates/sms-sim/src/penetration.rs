//! How deep bodies are inside of each other, on our own shapes, the same for every engine.

use crate::geometry::{BodyGeometry, Part};
use crate::simulation::{Kind, Simulation};
use crate::{BodyId, BodyState};
use glamx::{DPose3, DVec3};

impl Simulation {
    /// How deep a body is inside of others that are no robot, metres; 0 where it is in none, and for what does not move. Of a
    /// ball it is exact, but for meshes, which have no inside: there it is how much nearer than its radius the centre is.
    /// Of other bodies it is a lower bound, from the corners of both bodies, and from a ball inside each convex part
    /// against meshes.
    pub fn penetration(&self, body: BodyId) -> f64 {
        self.deepest_at(body, &self.states).map_or(0.0, |deepest| deepest.1)
    }

    /// In which other body a body is deepest, and how deep, metres; `None` where it is in none. As [`Self::penetration`].
    pub fn deepest(&self, body: BodyId) -> Option<(BodyId, f64)> {
        self.deepest_at(body, &self.states)
    }

    /// The same, were the bodies in other states: those of before, say. Bodies beyond their number are left out.
    pub fn penetration_at(&self, body: BodyId, states: &[BodyState]) -> f64 {
        self.deepest_at(body, states).map_or(0.0, |deepest| deepest.1)
    }

    fn deepest_at(&self, body: BodyId, states: &[BodyState]) -> Option<(BodyId, f64)> {
        let own = &self.bodies[body];
        let pose = states[body].x_wb;
        let reach = match own.kind {
            Kind::Ball { radius, .. } => radius,
            Kind::Dynamic => own.geometry.bounding_radius,
            Kind::Static | Kind::Striker => return None,
        };
        let mut deepest: Option<(BodyId, f64)> = None;
        for (other, (theirs, state)) in self.bodies.iter().zip(states).enumerate() {
            let their_pose = state.x_wb;
            let most = reach + theirs.geometry.bounding_radius;
            let is_far = pose.translation.distance_squared(their_pose.translation) > most * most;
            if other == body || is_far || theirs.kind == Kind::Striker {
                continue;
            }
            let depth_m = match own.kind {
                Kind::Ball { radius, .. } => {
                    ball_depth(their_pose.inverse_transform_point(pose.translation), radius, &theirs.geometry)
                }
                _ => {
                    let x_to = their_pose.inv_mul(&pose);
                    depth(&own.geometry, &theirs.geometry, &x_to).max(depth(
                        &theirs.geometry,
                        &own.geometry,
                        &x_to.inverse(),
                    ))
                }
            };
            if depth_m > deepest.map_or(0.0, |d| d.1) {
                deepest = Some((other, depth_m));
            }
        }
        deepest
    }
}

/// Depth of a ball with its centre at `p` in a body's frame.
fn ball_depth(p: DVec3, radius: f64, geometry: &BodyGeometry) -> f64 {
    let depth_in = |part: &Part| radius + part.depth(p);
    geometry.parts_near(p, radius).map(depth_in).fold(0.0, f64::max)
}

/// How deep `a` reaches into `b`; `x_ba` takes from the frame of `a` to that of `b`.
fn depth(a: &BodyGeometry, b: &BodyGeometry, x_ba: &DPose3) -> f64 {
    let mut deepest = 0.0f64;
    let (low, high) = (b.low(), b.high());
    for corner in a.corners() {
        let p = x_ba.transform_point(*corner);
        if p.cmplt(low).any() || p.cmpgt(high).any() {
            continue;
        }
        let depths = b.parts_near(p, 0.0).filter(|part| part.is_convex()).map(|part| part.depth(p));
        deepest = depths.fold(deepest, f64::max);
    }
    for (center, radius) in a.inner_balls() {
        let p = x_ba.transform_point(*center);
        for part in b.parts_near(p, *radius).filter(|part| !part.is_convex()) {
            deepest = deepest.max(radius - p.distance(part.nearest(p).0));
        }
    }
    deepest
}
