//! Disturbed worlds and flights: what is not known for certain, sampled.

use crate::{CarriedOut, LandingDisturbances, ResolvedLanding};
use glamx::DVec2;
use rand::{Rng, RngExt};
use sms_core::{Aabb, Seed};
use sms_plan::Disturbances;
use sms_scene::{Body, Scene};

/// A body that is this much above what it touches stands on it, metres.
const ON_TOP_M: f64 = 0.01;

impl LandingDisturbances {
    /// The `index`-th disturbed scene: masses and frictions within their intervals, and what stands on something else a little aside.
    pub fn scene(&self, landing: &ResolvedLanding, scene: &Scene, seed: Seed, index: usize) -> Scene {
        let materials = Disturbances {
            materials: self.materials,
            position_m: 0.0,
            radius_m: 0.0,
            object_m: 0.0,
            object_rad: 0.0,
            ..Disturbances::default()
        };
        let mut disturbed = materials.scene(scene, seed, index);
        if self.object_m > 0.0 {
            let boxes: Vec<Option<Aabb>> = scene.bodies.iter().map(aabb_w).collect();
            let seed = seed.derive_index("places", index as u64);
            for (i, body) in disturbed.bodies.iter_mut().enumerate() {
                if !landing.structure().contains(&body.name) || !stands_on_something(i, &boxes) {
                    continue;
                }
                let mut rng = seed.derive(&body.name).rng();
                body.x_wb.translation.x += self.object_m * symmetric(&mut rng);
                body.x_wb.translation.y += self.object_m * symmetric(&mut rng);
            }
        }
        disturbed
    }

    /// How exactly the `index`-th flight is carried out.
    pub fn carried_out(&self, seed: Seed, index: usize) -> CarriedOut {
        let mut rng = seed.derive_index("flight", index as u64).rng();
        let mut within = |half: f64| half * symmetric(&mut rng);
        CarriedOut {
            shift_w: DVec2::new(within(self.flight_m), within(self.flight_m)),
            speed: 1.0 + within(self.speed_share),
            wash: 1.0 + within(self.wash_share),
        }
    }
}

/// Whether what a body touches is below or above it, so that it can be moved aside without being pushed into anything.
fn stands_on_something(index: usize, boxes: &[Option<Aabb>]) -> bool {
    let Some(own) = &boxes[index] else { return false };
    let mut stands = false;
    for (k, other) in boxes.iter().enumerate() {
        let Some(other) = other.as_ref().filter(|_| k != index) else { continue };
        let apart = (own.min - other.max).max(other.min - own.max);
        if apart.truncate().max_element() > ON_TOP_M {
            continue;
        }
        let (above, below) = (own.min.z - other.max.z, other.min.z - own.max.z);
        if above < -ON_TOP_M && below < -ON_TOP_M {
            return false;
        }
        stands |= above.abs() <= ON_TOP_M;
    }
    stands
}

fn aabb_w(body: &Body) -> Option<Aabb> {
    let corners = body.shape.meshes().into_iter().flat_map(|m| m.vertices);
    Aabb::of_points(corners.map(|p| body.x_wb.transform_point(p)))
}

/// Uniform in [−1, 1).
fn symmetric(rng: &mut impl Rng) -> f64 {
    rng.random_range(-1.0..1.0)
}
