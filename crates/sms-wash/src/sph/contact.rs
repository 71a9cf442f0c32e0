//! Contact of particles with bodies: particles stop at surfaces, keep their tangential velocity, and transfer the rest
//! of their momentum.

use crate::{BodyState, BodySurface};
use glamx::{DPose3, DVec3};
use sms_core::Aabb;

/// Largest number of contacts of a particle in a step.
pub(super) const MAX_HITS: usize = 3;

/// An impulse on a body.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct ParticleImpulse {
    pub(super) body: u32,
    /// Impulse on the body, N·s.
    pub(super) impulse_w: DVec3,
    pub(super) p_w: DVec3,
}

/// A particle after a step, and its impulses on bodies.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Moved {
    pub(super) x: [f32; 3],
    pub(super) v: [f32; 3],
    pub(super) hits: [ParticleImpulse; MAX_HITS],
    pub(super) hit_count: u32,
}

/// Bounds of a body for a coarse test.
#[derive(Debug, Clone, Copy)]
pub(super) struct Near {
    /// World-space bounding box of the surface; infinite for a half space that is not level.
    pub(super) around: Aabb,
    /// Upper bound of the speed in the box, m/s.
    speed: f64,
}

impl Near {
    pub(super) fn of(surface: &BodySurface, motion: &BodyState) -> Self {
        let x_wb = &motion.x_wb;
        let Some(extent) = surface.extent() else {
            let is_level = (x_wb.rotation * DVec3::Z).abs_diff_eq(DVec3::Z, 1e-12);
            let top = if is_level && surface.is_half_space() { x_wb.translation.z } else { f64::INFINITY };
            let max = DVec3::new(f64::INFINITY, f64::INFINITY, top);
            return Self {
                around: Aabb { min: DVec3::NEG_INFINITY, max },
                speed: if motion.v_w == DVec3::ZERO && motion.w_w == DVec3::ZERO {
                    0.0
                } else {
                    f64::INFINITY
                },
            };
        };
        let farthest = extent.min.abs().max(extent.max.abs()).length();
        Self {
            around: surface.extent_w(x_wb).unwrap_or(extent),
            speed: motion.v_w.length() + motion.w_w.length() * farthest,
        }
    }
}

/// The bodies at the current time.
pub(super) struct Obstacles<'a> {
    pub(super) surfaces: &'a [BodySurface],
    pub(super) motions: &'a [BodyState],
    pub(super) poses_bw: &'a [DPose3],
    pub(super) near: &'a [Near],
    /// Distance of particles from surfaces due to their size, metres.
    pub(super) offset: f64,
    /// Mass of a particle, kg.
    pub(super) mass: f64,
}

impl Obstacles<'_> {
    /// Moves a particle for `dt` seconds. Particles do not bounce: air that meets a wall flows along it.
    pub(super) fn advance(&self, x: [f32; 3], v: [f32; 3], dt: f64) -> Moved {
        let (mut x_w, mut v_w) = (single(x), single(v));
        let mut moved = Moved::default();
        let mut left = dt;
        while (moved.hit_count as usize) < MAX_HITS {
            let Some((body, time, normal_w, depth)) = self.first(x_w, v_w, left) else {
                x_w += left * v_w;
                break;
            };
            x_w += time * v_w + depth * normal_w;
            left -= time;
            let motion = &self.motions[body];
            let into = (v_w - motion.velocity_at(x_w)).dot(normal_w);
            v_w -= into * normal_w;
            moved.hits[moved.hit_count as usize] =
                ParticleImpulse { body: body as u32, impulse_w: self.mass * into * normal_w, p_w: x_w };
            moved.hit_count += 1;
        }
        // A particle in a corner rests there until the next step.
        moved.x = x_w.to_array().map(|a| a as f32);
        moved.v = v_w.to_array().map(|a| a as f32);
        moved
    }

    /// The first contact of the particle: body, time, outward normal, and penetration depth.
    fn first(&self, x_w: DVec3, v_w: DVec3, dt: f64) -> Option<(usize, f64, DVec3, f64)> {
        let mut best: Option<(usize, f64, DVec3, f64)> = None;
        let speed = v_w.length();
        for (body, surface) in self.surfaces.iter().enumerate() {
            let (motion, x_bw) = (&self.motions[body], &self.poses_bw[body]);
            let Near { around, speed: body_speed } = &self.near[body];
            let limit = best.map_or(dt, |b| b.1);
            // As in `BodySurface::sweep`, with a margin for corners.
            let reach = limit * (speed + body_speed) + 4.0 * self.offset;
            if x_w.cmplt(around.min - reach).any() || x_w.cmpgt(around.max + reach).any() {
                continue;
            }
            let relative_w = v_w - motion.velocity_at(x_w);
            let way = limit * relative_w.length();
            let x_b = x_bw.transform_point(x_w);
            if surface.distance_at_least(x_b) > way + self.offset || way <= 0.0 {
                continue;
            }
            let v_b = x_bw.rotation * relative_w;
            if let Some(hit) = surface.sweep(x_b, v_b, limit, self.offset)
                && best.is_none_or(|b| hit.time < b.1)
            {
                best = Some((body, hit.time, motion.x_wb.rotation * hit.normal, hit.depth));
            }
        }
        best
    }
}

fn single(a: [f32; 3]) -> DVec3 {
    DVec3::from_array(a.map(f64::from))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn advance(surfaces: &[BodySurface], motions: &[BodyState], x: [f32; 3], v: [f32; 3]) -> Moved {
        let poses_bw: Vec<_> = motions.iter().map(|m| m.x_wb.inverse()).collect();
        let near: Vec<_> = surfaces.iter().zip(motions).map(|(s, m)| Near::of(s, m)).collect();
        let (poses_bw, near) = (&poses_bw[..], &near[..]);
        Obstacles { surfaces, motions, poses_bw, near, offset: 0.005, mass: 2.0 }.advance(x, v, 0.01)
    }

    #[test]
    fn a_fast_particle_does_not_pass_a_thin_plate() {
        let plate = [BodySurface::cuboid(DVec3::new(0.3, 0.3, 0.001)).unwrap()];
        let still = [BodyState::at_rest(DPose3::IDENTITY)];
        let moved = advance(&plate, &still, [0.1, 0.0, 0.08], [2.0, 0.0, -18.0]);
        assert_eq!(moved.hit_count, 1);
        assert!((moved.x[2] - 0.006).abs() < 1e-4, "{:?}", moved.x);
        // The remaining motion is along the plate.
        assert!(
            (moved.x[0] - 0.12).abs() < 1e-4 && moved.v[2].abs() < 1e-6 && moved.v[0] == 2.0,
            "{moved:?}"
        );
        assert!((moved.hits[0].impulse_w.z + 36.0).abs() < 1e-9, "mass × speed");
        // Beside the plate nothing happens.
        assert_eq!(advance(&plate, &still, [0.31, 0.0, 0.08], [0.0, 0.0, -18.0]).hit_count, 0);
    }

    #[test]
    fn a_corner_stops_a_particle_and_a_moving_plate_takes_it_along() {
        let walls = [
            BodySurface::cuboid(DVec3::new(0.3, 0.3, 0.01)).unwrap(),
            BodySurface::cuboid(DVec3::new(0.01, 0.3, 0.3)).unwrap(),
        ];
        let motions = [
            BodyState::at_rest(DPose3::IDENTITY),
            BodyState::at_rest(DPose3::from_translation(DVec3::new(0.1, 0.0, 0.2))),
        ];
        let moved = advance(&walls, &motions, [0.05, 0.0, 0.05], [10.0, 1.0, -10.0]);
        assert_eq!(moved.hit_count, 2);
        assert!(moved.v[0].abs() < 1e-6 && moved.v[2].abs() < 1e-6 && moved.v[1] == 1.0);
        let given: DVec3 = moved.hits[..2].iter().map(|h| h.impulse_w).sum();
        assert!(given.distance(DVec3::new(20.0, 0.0, -20.0)) < 1e-5);

        let rising = [BodyState { v_w: DVec3::Z * 3.0, ..motions[0] }];
        let pushed = advance(&walls[..1], &rising, [0.0, 0.0, 0.012], [0.0, 0.0, 0.0]);
        assert!(pushed.v[2] == 3.0 && (pushed.hits[0].impulse_w.z + 6.0).abs() < 1e-9);
    }
}
