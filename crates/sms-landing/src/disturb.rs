//! Perturbed scenes and flights: samples of the uncertain masses, frictions, positions and flight errors.

use crate::{CarriedOut, LandingDisturbances, LandingError, ResolvedLanding};
use glamx::DVec2;
use rand::{Rng, RngExt};
use sms_core::{Aabb, Seed};
use sms_plan::Perturbation;
use sms_scene::{Body, Scene};
use sms_sim::WorldFactory;

/// Largest number of draws until the structure stands.
const DRAWS: u64 = 64;

/// Largest overlap or gap between a body and its support, metres.
const ON_TOP_M: f64 = 0.01;

impl LandingDisturbances {
    /// Returns the `index`-th perturbed scene. Masses and frictions are drawn from their intervals, and bodies that
    /// stand on others are shifted horizontally.
    pub fn scene(&self, landing: &ResolvedLanding, scene: &Scene, seed: Seed, index: usize) -> Scene {
        let materials = Perturbation {
            materials: self.materials,
            scale: false,
            position_m: 0.0,
            radius_m: 0.0,
            object_m: 0.0,
            object_rad: 0.0,
            ..Perturbation::default()
        };
        let mut disturbed = materials.scene(scene, seed, index);
        if self.object_m > 0.0 {
            let boxes: Vec<Option<Aabb>> = scene.bodies.iter().map(Body::aabb_w).collect();
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

    /// Returns the `index`-th perturbed scene in which the structure stands by itself. The structure stood during the
    /// scan, so masses with which it falls are rejected. If it falls in all of 64 draws, the unperturbed scene is
    /// returned.
    ///
    /// # Errors
    /// [`LandingError`] if a scene cannot be simulated.
    pub fn standing_scene(
        &self,
        landing: &ResolvedLanding,
        factory: &dyn WorldFactory,
        scene: &Scene,
        seed: Seed,
        index: usize,
    ) -> Result<Scene, LandingError> {
        for draw in 0..DRAWS {
            let seed = if draw == 0 { seed } else { seed.derive_index("draw", draw) };
            let drawn = self.scene(landing, scene, seed, index);
            match landing.check_rest(factory, &drawn) {
                Ok(_) => return Ok(drawn),
                Err(LandingError::AlreadyFalling(_)) => {}
                Err(e) => return Err(e),
            }
        }
        Ok(scene.clone())
    }

    /// Finds masses with which the structure stands. Returns `None` if it stands in `scene`. If it falls and materials
    /// are sampled, returns the scene with the masses, among 64 draws from their intervals, that keep the structure
    /// standing and change the least (by the squared logarithms of the mass ratios).
    ///
    /// # Errors
    /// [`LandingError::AlreadyFalling`] if the structure falls with all draws; other variants if a scene cannot be
    /// simulated.
    pub(crate) fn that_stands(
        &self,
        landing: &ResolvedLanding,
        factory: &dyn WorldFactory,
        scene: &Scene,
        seed: Seed,
    ) -> Result<Option<Scene>, LandingError> {
        let falls = match landing.check_rest(factory, scene) {
            Ok(_) => return Ok(None),
            Err(e @ LandingError::AlreadyFalling(_)) if self.materials => e,
            Err(e) => return Err(e),
        };
        let masses_alone = Self { object_m: 0.0, ..*self };
        let mut draws: Vec<(f64, Scene)> = (0..DRAWS as usize)
            .map(|i| masses_alone.scene(landing, scene, seed, i))
            .map(|drawn| (change_of_masses(scene, &drawn), drawn))
            .filter(|(change, _)| *change > 0.0)
            .collect();
        draws.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (_, drawn) in draws {
            match landing.check_rest(factory, &drawn) {
                Ok(_) => return Ok(Some(drawn)),
                Err(LandingError::AlreadyFalling(_)) => {}
                Err(e) => return Err(e),
            }
        }
        Err(falls)
    }

    /// Returns the execution errors of the `index`-th flight.
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

/// Sum of the squared logarithms of the mass ratios.
fn change_of_masses(from: &Scene, to: &Scene) -> f64 {
    let log_ratio = |(a, b): (&Body, &Body)| Some((b.mass?.mass() / a.mass?.mass()).ln());
    from.bodies.iter().zip(&to.bodies).filter_map(log_ratio).map(|l| l * l).sum()
}

/// Whether a body stands on another one and touches others only from above or below. Such a body can be shifted
/// horizontally without a collision.
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

/// Uniform in [−1, 1).
fn symmetric(rng: &mut impl Rng) -> f64 {
    rng.random_range(-1.0..1.0)
}
