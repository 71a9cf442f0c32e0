//! Emitters in place of propellers: layers of particles that move at the stream's speed.

use super::particles::Particles;
use crate::SphSettings;
use crate::wash::Stream;
use serde::{Deserialize, Serialize};
use sms_core::GOLDEN_ANGLE_RAD;
use std::f64::consts::PI;

/// Arrangement of the particles of a layer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EmissionPattern {
    /// A sunflower: every particle has the same area (Vogel 1979); layers are rotated against each other.
    #[default]
    Sunflower,
    /// A square lattice; every other layer is shifted by half the spacing.
    Square,
}

/// One emitter.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(super) struct Emitter {
    /// Mass that is due for emission, kg.
    due: f64,
    layer: u32,
}

/// Offsets across the flow, in radii, of the particles of a layer.
fn layer_offsets(pattern: EmissionPattern, radius_in_spacings: f64, layer: u32, out: &mut Vec<(f64, f64)>) {
    out.clear();
    match pattern {
        EmissionPattern::Sunflower => {
            let count = (PI * radius_in_spacings * radius_in_spacings).round().max(1.0);
            for k in 0..count as usize {
                let r = ((k as f64 + 0.5) / count).sqrt();
                let angle = GOLDEN_ANGLE_RAD * k as f64 + 2.4 * f64::from(layer);
                out.push((r * angle.cos(), r * angle.sin()));
            }
        }
        EmissionPattern::Square => {
            let shift = 0.5 * f64::from(layer % 2);
            let n = radius_in_spacings.ceil() as i32 + 1;
            for i in -n..=n {
                for j in -n..=n {
                    let (x, y) = (
                        (f64::from(i) + shift) / radius_in_spacings,
                        (f64::from(j) + shift) / radius_in_spacings,
                    );
                    if x * x + y * y <= 1.0 {
                        out.push((x, y));
                    }
                }
            }
            if out.is_empty() {
                out.push((0.0, 0.0));
            }
        }
    }
}

impl Emitter {
    /// Clears the due mass, for a stopped propeller or one without structure below.
    pub(super) fn rest(&mut self) {
        self.due = 0.0;
    }

    /// Emits the layers that leave within `dt`, each at its position at the end of `dt`. Returns the number of emitted
    /// particles and the number dropped for lack of capacity.
    pub(super) fn emit(
        &mut self,
        stream: &Stream,
        settings: &SphSettings,
        dt: f64,
        offsets: &mut Vec<(f64, f64)>,
        particles: &mut Particles,
    ) -> (usize, usize) {
        let mass = settings.particle_mass();
        self.due += stream.emitted.mass_flow * dt;
        let (across, along) = stream.axis_w.any_orthonormal_pair();
        let v = (stream.emitted.speed * stream.axis_w).to_array().map(|a| a as f32);
        let (mut emitted, mut dropped) = (0, 0);
        loop {
            layer_offsets(settings.pattern, stream.emitted.radius / settings.spacing, self.layer, offsets);
            let layer_mass = mass * offsets.len() as f64;
            if self.due < layer_mass {
                return (emitted, dropped);
            }
            self.due -= layer_mass;
            self.layer = self.layer.wrapping_add(1);
            if particles.len() + offsets.len() > settings.max_particles {
                dropped += offsets.len();
                continue;
            }
            let age = self.due / stream.emitted.mass_flow;
            let center_w = stream.p_w + stream.emitted.speed * age * stream.axis_w;
            for &(x, y) in offsets.iter() {
                let p_w = center_w + stream.emitted.radius * (x * across + y * along);
                particles.push(p_w.to_array().map(|a| a as f32), v, age as f32);
            }
            emitted += offsets.len();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Emitted;
    use glamx::DVec3;

    #[test]
    fn what_leaves_is_the_mass_flow_whatever_the_step_and_the_pattern() {
        let emitted = Emitted { mass_flow: 0.1618, speed: 17.9, radius: 0.0484 };
        let stream = Stream { rotor: 0, p_w: DVec3::Z, axis_w: DVec3::NEG_Z, emitted };
        let mass = 1.225 * 0.02f64.powi(3);
        for pattern in [EmissionPattern::Sunflower, EmissionPattern::Square] {
            let settings =
                SphSettings { pattern, spacing: 0.02, max_particles: 40_000, ..SphSettings::default() };
            for dt in [3e-4, 2.5e-3] {
                let mut emitter = Emitter::default();
                let (mut particles, mut offsets) = (Particles::with_capacity(40_000), Vec::new());
                let steps = (0.2 / dt) as usize;
                for _ in 0..steps {
                    emitter.emit(&stream, &settings, dt, &mut offsets, &mut particles);
                }
                let flow = particles.len() as f64 * mass / (steps as f64 * dt);
                assert!((flow / emitted.mass_flow - 1.0).abs() < 0.01, "{pattern:?} {dt}: {flow}");
                // All particles left through the disk.
                for i in 0..particles.len() {
                    let [x, y, _] = particles.position(i);
                    assert!(x.hypot(y) <= 0.0485);
                }
            }
        }
    }

    #[test]
    fn a_full_house_drops_whole_layers() {
        let emitted = Emitted { mass_flow: 0.1618, speed: 17.9, radius: 0.0484 };
        let stream = Stream { rotor: 0, p_w: DVec3::Z, axis_w: DVec3::NEG_Z, emitted };
        let (mut emitter, mut particles) = (Emitter::default(), Particles::with_capacity(100));
        let settings = SphSettings { spacing: 0.02, max_particles: 100, ..SphSettings::default() };
        let (e, d) = emitter.emit(&stream, &settings, 0.05, &mut Vec::new(), &mut particles);
        assert!(particles.len() == e && e <= 100 && d > 500);
    }
}
