//! Disturbed worlds: what the planner does not know for certain, sampled.

use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};
use sms_core::{MassProperties, Material, Property, Seed};
use sms_scene::{BodyKind, BodyShape, Scene};
use sms_sim::StrikerMotion;

/// How worlds and strikes are disturbed. All errors are uniform within ± the given half width.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Disturbances {
    /// Number of disturbed worlds; the same ones for every candidate.
    pub worlds: usize,
    /// Whether materials are sampled within their intervals.
    pub materials: bool,
    /// Horizontal error of where the scan put a ball, metres.
    pub position_m: f64,
    /// Error of the contact position, metres, along x and y.
    pub contact_m: f64,
    /// Error of the sweep's direction, radians.
    pub angle_rad: f64,
    /// Relative error of the sweep's speed.
    pub speed_share: f64,
}

impl Default for Disturbances {
    fn default() -> Self {
        // A scan places a ball within about a millimetre, and a torque-controlled arm repeats a path within a few
        // tenths of one: over the sweep of 0.1 m that is 2 mrad.
        Self {
            worlds: 16,
            materials: true,
            position_m: 0.001,
            contact_m: 0.0003,
            angle_rad: 0.002,
            speed_share: 0.02,
        }
    }
}

impl Disturbances {
    /// The `index`-th disturbed scene: masses, materials and the places of balls differ from `scene`.
    pub fn scene(&self, scene: &Scene, seed: Seed, index: usize) -> Scene {
        let mut rng = seed.derive_index("world", index as u64).rng();
        let mut disturbed = scene.clone();
        for body in &mut disturbed.bodies {
            let density = body.material.effective_density();
            if self.materials {
                sample_material(&mut body.material, &mut rng);
            }
            let ratio = body.material.effective_density() / density;
            if let Some(mass) = body.mass.filter(|_| ratio.is_finite() && ratio > 0.0) {
                // A positive multiple of a possible inertia is possible.
                body.mass = MassProperties::new(mass.mass() * ratio, mass.com(), mass.inertia() * ratio)
                    .ok()
                    .or(Some(mass));
            }
            let (dx, dy) = (symmetric(&mut rng), symmetric(&mut rng));
            if body.kind == BodyKind::Dynamic && matches!(body.shape, BodyShape::Sphere { .. }) {
                body.x_wb.translation.x += self.position_m * dx;
                body.x_wb.translation.y += self.position_m * dy;
            }
        }
        disturbed
    }

    /// The strike as it is carried out in the `index`-th disturbed world.
    pub fn strike(&self, motion: &StrikerMotion, seed: Seed, index: usize) -> StrikerMotion {
        let mut rng = seed.derive_index("strike", index as u64).rng();
        let mut disturbed = *motion;
        disturbed.contact_w.x += self.contact_m * symmetric(&mut rng);
        disturbed.contact_w.y += self.contact_m * symmetric(&mut rng);
        disturbed.angle += self.angle_rad * symmetric(&mut rng);
        disturbed.speed *= 1.0 + self.speed_share * symmetric(&mut rng);
        disturbed
    }
}

fn sample_material(material: &mut Material, rng: &mut impl Rng) {
    let mut sample = |p: &mut Property| p.value.best = p.value.at(symmetric(rng));
    sample(&mut material.density);
    sample(&mut material.friction);
    sample(&mut material.restitution);
    sample(&mut material.fill_factor);
    sample(&mut material.rolling_m);
    material.restitution.value.best = material.restitution.value.best.clamp(0.0, 1.0);
    material.fill_factor.value.best = material.fill_factor.value.best.clamp(1e-3, 1.0);
    for p in [&mut material.friction, &mut material.rolling_m] {
        p.value.best = p.value.best.max(0.0);
    }
}

/// Uniform in [−1, 1).
fn symmetric(rng: &mut impl Rng) -> f64 {
    rng.random_range(-1.0..1.0)
}

/// The quantile `q` in [0, 1] of values, linear between order statistics (type 7 of Hyndman and Fan 1996). NaN
/// when there are none.
pub(crate) fn quantile(values: &[f64], q: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let position = q.clamp(0.0, 1.0) * last as f64;
    let below = position.floor() as usize;
    let (low, high) = (sorted[below], sorted[(below + 1).min(last)]);
    low + (position - below as f64) * (high - low)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::{DPose3, DVec3};
    use sms_core::{Mesh, sphere_mass_properties};
    use sms_scene::{Body, SCENE_VERSION, example_material, floor_body};

    fn scene() -> Scene {
        let material = example_material();
        let density = material.density.value.best;
        let ball = Body {
            name: "ball".into(),
            label: 1,
            description: String::new(),
            kind: BodyKind::Dynamic,
            x_wb: DPose3::from_translation(DVec3::new(0.3, 0.1, 0.03)),
            shape: BodyShape::Sphere { radius: 0.03 },
            visual: Mesh::default(),
            texture: None,
            mass: Some(sphere_mass_properties(DVec3::ZERO, 0.03, density).unwrap()),
            material: material.clone(),
            color: [200, 0, 0],
            observed_share: 0.8,
        };
        Scene {
            version: SCENE_VERSION,
            name: "test".into(),
            gravity_w: DVec3::new(0.0, 0.0, -9.81),
            x_world_recording: DPose3::identity(),
            bodies: vec![floor_body(0.0, material), ball],
        }
    }

    #[test]
    fn disturbed_worlds_repeat_and_stay_within_what_is_known() {
        let (scene, disturbances) = (scene(), Disturbances::default());
        let mut masses = Vec::new();
        for i in 0..50 {
            let other = disturbances.scene(&scene, Seed(5), i);
            assert_eq!(other, disturbances.scene(&scene, Seed(5), i));
            let (ball, nominal) = (&other.bodies[1], &scene.bodies[1]);
            let moved = ball.x_wb.translation - nominal.x_wb.translation;
            assert!(moved.x.abs() <= 0.001 && moved.y.abs() <= 0.001 && moved.z == 0.0);
            assert_eq!(other.bodies[0].x_wb, scene.bodies[0].x_wb);
            let interval = nominal.material.friction.value;
            let friction = ball.material.friction.value.best;
            assert!((interval.low..=interval.high).contains(&friction));
            assert_ne!(friction, other.bodies[0].material.friction.value.best);
            let (mass, was) = (ball.mass.unwrap(), nominal.mass.unwrap());
            let ratio = mass.mass() / was.mass();
            assert!((ratio - ball.material.density.value.best / 700.0).abs() < 1e-12);
            assert!((mass.inertia().x_axis.x / was.inertia().x_axis.x - ratio).abs() < 1e-12);
            masses.push(ratio);
        }
        masses.sort_by(f64::total_cmp);
        assert!(
            masses[0] < 0.86 && masses[49] > 1.14,
            "the interval is used: {} to {}",
            masses[0],
            masses[49]
        );
    }

    #[test]
    fn strikes_are_disturbed_a_little_and_repeat() {
        let motion = StrikerMotion {
            contact_w: DVec3::new(0.1, 0.2, 0.03),
            angle: 0.5,
            speed: 0.6,
            ball_radius: 0.03,
        };
        let disturbances = Disturbances::default();
        let first = disturbances.strike(&motion, Seed(1), 0);
        assert_eq!(first, disturbances.strike(&motion, Seed(1), 0));
        assert_ne!(first, disturbances.strike(&motion, Seed(1), 1));
        assert!((first.angle - 0.5).abs() <= 0.002 && (first.speed / 0.6 - 1.0).abs() <= 0.02);
        assert!((first.contact_w - motion.contact_w).length() <= 0.0003 * 2f64.sqrt());
    }

    #[test]
    fn quantiles_are_those_of_a_uniform_ladder() {
        let ladder: Vec<f64> = (0..=10).rev().map(f64::from).collect();
        assert_eq!(quantile(&ladder, 0.9), 9.0);
        assert_eq!(quantile(&ladder, 0.95), 9.5);
        assert_eq!(quantile(&[3.0], 0.9), 3.0);
        assert_eq!(quantile(&ladder, 1.0), 10.0);
        assert!(quantile(&[], 0.5).is_nan());
    }
}
