//! The planner's knowledge of the true materials of a generated scene.

use glamx::DVec3;
use serde::{Deserialize, Serialize};
use sms_core::{Interval, MassProperties, Material, Mesh, Property, PropertySource, Seed, standard_normal};
use sms_materials::{MaterialTable, ObjectQuery, without_override};
use sms_mesh::convex_hull;
use sms_scene::{Body, BodyShape, Scene};
use sms_synth::{TruthObject, TruthScene};

/// Standard deviation of the natural logarithm of a vision-language model's estimate of a mass (here: of the density, the
/// volume being measured): a factor of two, as published tests of such models find.
pub const DENSITY_LOG_SD: f64 = std::f64::consts::LN_2;
/// The same for the rolling lever arm. No error is published; it is assumed to be as uncertain as a mass.
pub const ROLLING_LOG_SD: f64 = std::f64::consts::LN_2;
/// Half width of the interval that holds 90 % of the errors of friction.
pub const FRICTION_ERROR: f64 = 0.2;
/// The same for restitution. No error is published; it is scaled from friction by its smaller spread.
pub const RESTITUTION_ERROR: f64 = 0.15;
/// Standard deviations in that half width, for normal errors.
const Z90: f64 = 1.645;
/// Vertices of the hulls that bodies' volumes are compared with.
const HULL_VERTICES: usize = 256;
/// Tolerance when shares of hulls are compared. The convex parts of a statue exceed it by 6 % of its hull, and hulls with
/// few corners have similar gaps; closed hollows and gaps between legs are far larger.
const HULL_TOLERANCE: f64 = 0.15;

/// The planner's knowledge of materials (every table names it).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MaterialPrior {
    /// The true class with the handbook's values, as from a good vision-language model.
    Class,
    /// The true values with the errors that such models make: density log-normal by [`DENSITY_LOG_SD`], rolling
    /// resistance by [`ROLLING_LOG_SD`], friction and restitution with normal errors of which 90 % are within
    /// [`FRICTION_ERROR`] and [`RESTITUTION_ERROR`]. The intervals are those of these errors (90 %).
    Noisy,
    /// Nothing: the handbook's prior.
    Prior,
    /// The truth, for ablations.
    Truth,
    /// Estimates of a vision-language model from the views of a scan. Without a scan, as here, the handbook's prior.
    Vlm,
}

impl MaterialPrior {
    /// All of them.
    pub const ALL: [Self; 5] = [Self::Class, Self::Noisy, Self::Prior, Self::Truth, Self::Vlm];

    /// The word in tables and options.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Class => "class",
            Self::Noisy => "noisy",
            Self::Prior => "prior",
            Self::Truth => "truth",
            Self::Vlm => "vlm",
        }
    }

    /// Returns the material of `body`, the reconstruction of `object`. The errors of `noisy` depend on the seed and the object's
    /// name only.
    ///
    /// The fill factor of a hollow object is relative to its convex hull. The body of a bin encloses all of the hull if its inside
    /// was not observed, and only its walls if it was.
    pub fn of_object(self, object: &TruthObject, body: &Body, seed: Seed) -> Material {
        let form = Form::of(body);
        let query = ObjectQuery {
            name: object.name.clone(),
            // Balls are called after their game.
            description: if object.sphere_radius.is_some() {
                object.material.class.clone()
            } else {
                object.class.clone()
            },
            is_sphere: object.sphere_radius.is_some(),
            hull_fill: form.map_or(1.0, |f| f.hull_fill()),
            volume_m3: form.map_or(0.0, |f| f.volume_m3),
            hull_area_m2: form.map_or(0.0, |f| f.hull_area_m2),
            ..ObjectQuery::default()
        };
        let mut material = self.tell(&object.material, query, seed);
        if matches!(self, Self::Noisy | Self::Truth)
            && object.sphere_radius.is_none()
            && let (Some(true_hull), Some(seen)) = (hull_of(&object.mesh.vertices), form)
        {
            // The true density refers to the volume of the true mesh.
            let factor = object.mesh.volume() / true_hull.volume() / seen.hull_fill();
            if (factor - 1.0).abs() > HULL_TOLERANCE {
                let v = material.density.value;
                material.density.value = Interval::new(v.best * factor, v.low * factor, v.high * factor);
            }
        }
        material
    }

    /// Returns the material of the floor.
    pub fn of_floor(self, material: &Material, seed: Seed) -> Material {
        let query = ObjectQuery {
            name: "(floor)".into(),
            description: material.class.clone(),
            ..ObjectQuery::default()
        };
        self.tell(material, query, seed)
    }

    fn tell(self, truth: &Material, query: ObjectQuery, seed: Seed) -> Material {
        match self {
            Self::Truth => truth.clone(),
            Self::Noisy => noisy(truth, seed.derive("materials told").derive(&query.name)),
            Self::Class => without_override(&query, &MaterialTable::builtin()),
            Self::Prior | Self::Vlm => MaterialTable::builtin().prior(query.is_sphere),
        }
    }
}

/// Sets the materials of the planner's `scene`, whose bodies have the names and volumes of the truth's, and masses by the
/// effective densities.
pub fn apply_material_prior(
    scene: &mut Scene,
    truth: &TruthScene,
    material_prior: MaterialPrior,
    seed: Seed,
) {
    for body in &mut scene.bodies {
        let material = match truth.object(&body.name) {
            Some(object) => material_prior.of_object(object, body, seed),
            None if matches!(body.shape, BodyShape::HalfSpace) => {
                material_prior.of_floor(&truth.floor.material, seed)
            }
            None => continue,
        };
        set_material(body, material);
    }
}

/// Volume of a body, and volume and area of its convex hull.
#[derive(Debug, Clone, Copy)]
struct Form {
    /// Volume that the mass is computed from, m³.
    volume_m3: f64,
    hull_m3: f64,
    hull_area_m2: f64,
}

impl Form {
    /// `None` for bodies without mass or extent.
    fn of(body: &Body) -> Option<Self> {
        let volume_m3 = body.mass?.mass() / body.material.effective_density();
        let corners: Vec<DVec3> = body.shape.meshes().into_iter().flat_map(|m| m.vertices).collect();
        let hull = hull_of(&corners)?;
        // A scanned mesh may stick out of the hulls that collide for it.
        let hull_m3 = hull.volume().max(volume_m3);
        (volume_m3.is_finite() && volume_m3 > 0.0).then_some(Self {
            volume_m3,
            hull_m3,
            hull_area_m2: hull.area(),
        })
    }

    fn hull_fill(&self) -> f64 {
        self.volume_m3 / self.hull_m3
    }
}

fn hull_of(corners: &[DVec3]) -> Option<Mesh> {
    convex_hull(corners, HULL_VERTICES, 0.0).filter(|h| h.volume() > 0.0)
}

/// Gives a body another material; its mass goes with the effective density.
pub(crate) fn set_material(body: &mut Body, material: Material) {
    let ratio = material.effective_density() / body.material.effective_density();
    if let Some(was) = body.mass.filter(|_| ratio.is_finite() && ratio > 0.0) {
        body.mass =
            MassProperties::new(was.mass() * ratio, was.com(), was.inertia() * ratio).ok().or(Some(was));
    }
    body.material = material;
}

/// The values with the errors of a vision-language model, and the intervals of these errors.
fn noisy(truth: &Material, seed: Seed) -> Material {
    let mut material_prior = truth.clone();
    let rng = |what: &str| seed.derive(what).rng();
    let factor = |p: &mut Property, log_sd: f64, mut rng: sms_core::StageRng| {
        let best = p.value.best * (log_sd * standard_normal(&mut rng)).exp();
        let width = (Z90 * log_sd).exp();
        *p = Property::new(Interval::new(best, best / width, best * width), PropertySource::Vlm);
    };
    factor(&mut material_prior.density, DENSITY_LOG_SD, rng("density"));
    factor(&mut material_prior.rolling_m, ROLLING_LOG_SD, rng("rolling"));
    let shift = |p: &mut Property, error: f64, high: f64, mut rng: sms_core::StageRng| {
        let best = (p.value.best + error / Z90 * standard_normal(&mut rng)).clamp(0.0, high);
        let interval = Interval::new(best, (best - error).max(0.0), (best + error).min(high));
        *p = Property::new(interval, PropertySource::Vlm);
    };
    shift(&mut material_prior.friction, FRICTION_ERROR, 2.0, rng("friction"));
    shift(&mut material_prior.restitution, RESTITUTION_ERROR, 1.0, rng("restitution"));
    material_prior
}

#[cfg(test)]
mod tests {
    use super::*;
    use sms_synth::{BilliardsSettings, Hollow, LandingStructure, generate_billiards, generate_landing};
    use sms_target::scene_from_truth;

    fn truth() -> TruthScene {
        generate_billiards(Seed(1003), &BilliardsSettings { objects: 9, ..BilliardsSettings::default() })
    }

    #[test]
    fn noise_has_the_stated_spread_and_its_intervals_hold_nine_truths_of_ten() {
        let truth = truth();
        let material = &truth.objects.iter().find(|o| o.sphere_radius.is_none()).unwrap().material;
        let mut logs = Vec::new();
        let mut held = [0usize; 3];
        let n = 4000;
        for i in 0..n {
            let material_prior = noisy(material, Seed(i));
            logs.push((material_prior.density.value.best / material.density.value.best).ln());
            let pairs = [
                (material_prior.density, material.density),
                (material_prior.friction, material.friction),
                (material_prior.restitution, material.restitution),
            ];
            for (k, (material_prior, truth)) in pairs.into_iter().enumerate() {
                let v = material_prior.value;
                held[k] += usize::from(v.low <= truth.value.best && truth.value.best <= v.high);
                assert!(v.low <= v.best && v.best <= v.high && v.low >= 0.0);
            }
        }
        let mean = logs.iter().sum::<f64>() / n as f64;
        let sd = (logs.iter().map(|l| (l - mean).powi(2)).sum::<f64>() / n as f64).sqrt();
        // Five standard errors of the mean and of the standard deviation.
        assert!(mean.abs() < 5.0 * DENSITY_LOG_SD / (n as f64).sqrt(), "{mean}");
        assert!((sd / DENSITY_LOG_SD - 1.0).abs() < 5.0 / (2.0 * n as f64).sqrt(), "{sd}");
        for held in held {
            let share = held as f64 / n as f64;
            assert!((share - 0.9).abs() < 0.025, "{share}");
        }
    }

    #[test]
    fn each_object_has_its_own_error_which_the_seed_repeats() {
        let truth = truth();
        let scene = scene_from_truth(&truth).unwrap();
        let tell = |material_prior, seed| {
            let mut scene = scene.clone();
            apply_material_prior(&mut scene, &truth, material_prior, seed);
            scene
        };
        assert_eq!(tell(MaterialPrior::Truth, Seed(1)), scene);
        let noisy = tell(MaterialPrior::Noisy, Seed(1));
        assert_eq!(noisy, tell(MaterialPrior::Noisy, Seed(1)));
        let ratios: Vec<f64> = scene
            .bodies
            .iter()
            .zip(&noisy.bodies)
            .filter_map(|(a, b)| Some(b.mass?.mass() / a.mass?.mass()))
            .collect();
        assert_eq!(ratios.len(), truth.objects.len());
        for (i, a) in ratios.iter().enumerate() {
            assert!(ratios[..i].iter().all(|b| a != b));
        }
        for (a, b) in scene.bodies.iter().zip(&noisy.bodies) {
            if let (Some(a_mass), Some(b_mass)) = (a.mass, b.mass) {
                let density = b.material.effective_density() / a.material.effective_density();
                assert!((b_mass.mass() / a_mass.mass() / density - 1.0).abs() < 1e-12);
            }
        }
    }

    /// The ladder's profiles are hollow, and a body on the bin may hide its inside.
    #[test]
    fn masses_of_hollow_things_hold_the_truth_however_much_of_the_hollow_was_seen() {
        for structure in LandingStructure::ALL {
            let truth = generate_landing(structure, Seed(1000));
            let scene = scene_from_truth(&truth).unwrap();
            for object in &truth.objects {
                let true_kg = object.mass.mass();
                let body = scene.bodies.iter().find(|b| b.name == object.name).unwrap();
                let masses = |material_prior: MaterialPrior, volumes: f64| {
                    let mut seen = body.clone();
                    let was = seen.mass.unwrap();
                    seen.mass =
                        MassProperties::new(was.mass() * volumes, was.com(), was.inertia() * volumes).ok();
                    let material = material_prior.of_object(object, &seen, Seed(3));
                    set_material(&mut seen, material);
                    let m = &seen.material;
                    let (best, kg) = (m.effective_density(), seen.mass.unwrap().mass());
                    let (d, f) = (m.density.value, m.fill_factor.value);
                    [kg, kg * d.low * f.low / best, kg * d.high * f.high / best]
                };
                let closed = hull_of(&object.mesh.vertices).unwrap().volume() / object.mesh.volume();
                for volumes in [1.0, closed] {
                    let [best, low, high] = masses(MaterialPrior::Class, volumes);
                    // For solid objects only the handbook's density interval matters.
                    let is_in =
                        (low..high).contains(&true_kg) || object.hollow == Hollow::Solid && closed < 1.1;
                    assert!(
                        is_in && (0.5..2.0).contains(&(best / true_kg)),
                        "{}, {volumes:.1} of its volume: {best:.2} ({low:.2} to {high:.2}) kg, in truth {true_kg:.2}",
                        object.name
                    );
                    let [exact, ..] = masses(MaterialPrior::Truth, volumes);
                    assert!((exact / true_kg - 1.0).abs() < 0.05, "{}: {exact} {true_kg}", object.name);
                }
            }
        }
    }

    #[test]
    fn the_class_gives_the_handbook_s_values_near_the_truth() {
        let truth = truth();
        let scene = scene_from_truth(&truth).unwrap();
        let mut material_prior = scene.clone();
        apply_material_prior(&mut material_prior, &truth, MaterialPrior::Class, Seed(1));
        let mut solids = 0;
        for (a, b) in scene.bodies.iter().zip(&material_prior.bodies) {
            assert_ne!(b.material.density.source, PropertySource::Prior, "{}", a.name);
            let off = b.material.friction.value.best - a.material.friction.value.best;
            assert!(off.abs() < 0.3, "{}: friction off by {off}", a.name);
            // The handbook estimates the fill factor of hollow objects and figures, but not of solid balls and blocks.
            let is_solid = truth.object(&a.name).is_some_and(|o| o.hollow == Hollow::Solid);
            let is_plain =
                is_solid && (matches!(a.shape, BodyShape::Sphere { .. }) || a.description.contains("block"));
            if let (Some(a_mass), Some(b_mass)) = (a.mass.filter(|_| is_plain), b.mass) {
                let ratio = b_mass.mass() / a_mass.mass();
                assert!((0.7..1.4).contains(&ratio), "{}: {ratio}", a.name);
                solids += 1;
            }
        }
        assert!(solids >= 2);
    }
}
