//! Prediction of the impacts of balls, at which steps are split.

use super::{By, Kind, Simulation};
use crate::BodyId;
use crate::geometry::Path;
use crate::support::BallSupport;
use crate::timing::{Impact, MIN_CLOSING_SPEED, TOUCH_GAP, time_of_impact};
use glamx::DVec3;

/// Distance of the tool from a ball, minus their travel in a step, below which its acceleration is computed, metres.
const LOOK_AHEAD_M: f64 = 1e-3;

impl Simulation {
    /// Computes the accelerations of arm tools near a ball.
    pub(super) fn look_ahead(&mut self, horizon: f64) {
        for strike in self.strikes.iter_mut().filter(|s| !s.over) {
            let By::Arm(arm) = &mut strike.by else { continue };
            let (tool, reach) =
                (&self.states[strike.body], self.bodies[strike.body].geometry.bounding_radius);
            let near = self.bodies.iter().zip(&self.states).any(|(body, state)| {
                let Kind::Ball { radius, .. } = body.kind else { return false };
                let travel = (state.v_w - tool.v_w).length() * horizon;
                let far = radius + reach + travel + LOOK_AHEAD_M;
                state.x_wb.translation.distance_squared(tool.x_wb.translation) < far * far
            });
            if near {
                arm.look_ahead();
            }
        }
    }

    /// The next impact of a ball on another body within `horizon` seconds.
    pub(super) fn next_impact(
        &self,
        horizon: f64,
        supports: &[BallSupport],
    ) -> Option<(Impact, BodyId, BodyId)> {
        let mut first: Option<(Impact, BodyId, BodyId)> = None;
        for (ball, body) in self.bodies.iter().enumerate() {
            let Kind::Ball { radius, .. } = body.kind else { continue };
            let path = self.path(ball, supports);
            let center_w = self.states[ball].x_wb.translation;
            for other in 0..self.bodies.len() {
                let until = first.map_or(horizon, |(i, ..)| i.time_s);
                let Some(travel) = self.travel(ball, other, until) else { continue };
                let geometry = &self.bodies[other].geometry;
                let x_wb = &self.states[other].x_wb;
                let reach = radius + travel;
                let far = geometry.bounding_radius + reach;
                if center_w.distance_squared(x_wb.translation) > far * far {
                    continue;
                }
                let other_path = self.path(other, supports);
                for part in geometry.parts_near(x_wb.inverse_transform_point(center_w), reach) {
                    let until = first.map_or(horizon, |(i, ..)| i.time_s);
                    let impact = time_of_impact(&path, radius, part, &other_path, until);
                    first = impact.map(|i| (i, ball, other)).or(first);
                }
            }
        }
        first
    }

    fn path(&self, body: BodyId, supports: &[BallSupport]) -> Path<'_> {
        if let Some(strike) = self.strikes.iter().find(|s| s.body == body) {
            let acceleration_w = match &strike.by {
                By::Finger(motion) => {
                    return Path::Sweep { motion, start_s: self.world_s - strike.start_s };
                }
                By::EngineArm(_) => DVec3::ZERO,
                By::Arm(arm) => arm.acceleration_w,
            };
            return Path::Free { state: &self.states[body], acceleration_w };
        }
        let is_flying = matches!(self.bodies[body].kind, Kind::Ball { .. })
            && !supports[body].touching
            && !self.world.is_asleep(body);
        let acceleration_w = if is_flying { self.gravity_w } else { DVec3::ZERO };
        Path::Free { state: &self.states[body], acceleration_w }
    }

    /// Upper bound of the approach of a ball to a point of another body within `horizon` s, metres; `None`: skip the pair.
    fn travel(&self, ball: BodyId, other: BodyId, horizon: f64) -> Option<f64> {
        let (a, b) = (&self.states[ball], &self.states[other]);
        let mut speed = (a.v_w - b.v_w).length();
        match self.bodies[other].kind {
            _ if ball == other => return None,
            // A pair of balls is tested once, from the faster one.
            Kind::Ball { .. } => {
                let (own, its) = (a.v_w.length_squared(), b.v_w.length_squared());
                if own < its || (own == its && ball > other) {
                    return None;
                }
            }
            Kind::Striker => {
                if self.strikes.iter().any(|s| s.body == other && s.over) {
                    return None;
                }
            }
            Kind::Dynamic => speed += b.w_w.length() * self.bodies[other].geometry.bounding_radius,
            Kind::Static => {}
        }
        if speed == 0.0 && self.world.is_asleep(ball) {
            return None;
        }
        // Covers free fall and the acceleration of the finger.
        speed += self.gravity_w.length() * horizon;
        if speed < MIN_CLOSING_SPEED { None } else { Some(speed * horizon + TOUCH_GAP) }
    }
}
