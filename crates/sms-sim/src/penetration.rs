//! Penetration depths between bodies, on the engine-independent shapes.

use crate::geometry::{BodyGeometry, CollisionPart};
use crate::simulation::{Kind, Simulation};
use crate::{BodyId, BodyState};
use glamx::{DPose3, DVec3};

impl Simulation {
    /// The body, other than the robot, with the deepest penetration by `body`, and the depth, metres. `None` without
    /// penetration and for bodies that do not move. The depth of a ball is exact, except against meshes: they have no
    /// inside, so the depth is the radius minus the distance of the centre. For other bodies the depth is a lower
    /// bound, from the corners of both bodies, and against meshes from a ball inside each convex part.
    pub fn deepest(&self, body: BodyId) -> Option<(BodyId, f64)> {
        self.deepest_at(body, &self.states)
    }

    /// The largest depth ([`Self::deepest`]) with the bodies in other states, for example earlier ones; 0 without
    /// penetration. Bodies without a state are left out.
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
    let depth_in = |part: &CollisionPart| radius + part.depth(p);
    geometry.parts_near(p, radius).map(depth_in).fold(0.0, f64::max)
}

/// Penetration of `a` into `b`; `x_ba` maps the frame of `a` to that of `b`.
fn depth(a: &BodyGeometry, b: &BodyGeometry, x_ba: &DPose3) -> f64 {
    let mut deepest = 0.0f64;
    for corner in &a.corners {
        let p = x_ba.transform_point(*corner);
        if p.cmplt(b.low).any() || p.cmpgt(b.high).any() {
            continue;
        }
        let depths = b.parts_near(p, 0.0).filter(|part| part.is_convex()).map(|part| part.depth(p));
        deepest = depths.fold(deepest, f64::max);
    }
    for (center, radius) in &a.inner_balls {
        let p = x_ba.transform_point(*center);
        for part in b.parts_near(p, *radius).filter(|part| !part.is_convex()) {
            deepest = deepest.max(radius - p.distance(part.nearest(p).0));
        }
    }
    deepest
}
