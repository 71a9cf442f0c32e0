//! Perturbations: samples of the uncertainty in the scene and in the strike.

use glamx::DQuat;
use rand::{Rng, RngExt};
use serde::{Deserialize, Serialize};
use sms_core::{Aabb, MassProperties, Material, Property, QuantileRule, Seed};
use sms_scene::{Body, BodyKind, BodyShape, Scene};
use sms_sim::StrikerMotion;

/// Largest scan errors as multiples of the standard errors of the fit, rounded up (experiments/studies/plan.md):
/// position of a ball, radius of a ball, position of another object.
const BALL_RATIO: f64 = 2.0;
const RADIUS_RATIO: f64 = 5.0;
const OBJECT_RATIO: f64 = 15.0;

/// Perturbation of worlds and strikes. All errors are uniform within ± the given half width.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Perturbation {
    /// Number of perturbed worlds; all candidates are tried in the same ones. With 0, the plan uses only the nominal
    /// world.
    pub worlds: usize,
    /// Whether materials are sampled within their intervals.
    pub materials: bool,
    /// Whether sizes and distances are scaled by a common factor, as uncertain as the scene states (its `size_sigma`).
    pub scale: bool,
    /// Horizontal position error of balls that is common to all bodies (pose of the recording, pose of the
    /// robot), metres. Twice the standard error of the fit is added. With 0, there is neither
    /// error. Balls in contact with other bodies stay in place.
    pub position_m: f64,
    /// Radius error of balls, metres. Five times the standard error of the radius is added; with 0, there is neither
    /// error. A resting ball keeps its contact with the support.
    pub radius_m: f64,
    /// Horizontal position error of other objects, metres. Fifteen times the standard error of the fit is added,
    /// because the fit does not include the unseen side; with 0, there is neither error. Objects in contact with each
    /// other stay in place, since they would overlap otherwise.
    pub object_m: f64,
    /// Yaw error of such objects, radians.
    pub object_rad: f64,
    /// Error of the contact position, metres, along x and y.
    pub contact_m: f64,
    /// Error of the sweep's direction, radians.
    pub angle_rad: f64,
    /// Relative error of the sweep's speed.
    pub speed_share: f64,
}

impl Default for Perturbation {
    fn default() -> Self {
        // A scan is accurate to about a millimetre for the position of a ball, a few tenths of a millimetre for its
        // radius, and two millimetres for the position of other objects (one side is not seen). The residuals of one
        // entity do not show these errors, because they are common to all. A torque-controlled arm repeats a path
        // within a few tenths of a millimetre, or 2 mrad over the sweep of 0.1 m.
        Self {
            worlds: 16,
            materials: true,
            scale: true,
            position_m: 0.001,
            radius_m: 0.0003,
            object_m: 0.002,
            object_rad: 0.01,
            contact_m: 0.0003,
            angle_rad: 0.002,
            speed_share: 0.02,
        }
    }
}

/// An uncertain quantity of the scene or the strike.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Unknown {
    /// Mass, friction, restitution and rolling resistance of a body.
    Material {
        /// Its name.
        body: String,
    },
    /// Position and yaw of a body.
    Pose {
        /// Its name.
        body: String,
    },
    /// Radius of a ball.
    Radius {
        /// Its name.
        body: String,
    },
    /// Scale of the scene.
    Scale,
    /// Execution of the strike by the robot.
    Execution,
}

impl std::fmt::Display for Unknown {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Material { body } => write!(f, "the material of `{body}`"),
            Self::Pose { body } => write!(f, "the pose of `{body}`"),
            Self::Radius { body } => write!(f, "the radius of `{body}`"),
            Self::Scale => f.write_str("the scale of the scene"),
            Self::Execution => f.write_str("the execution of the strike"),
        }
    }
}

impl Perturbation {
    /// The uncertain quantities of a scene.
    pub fn unknowns(&self, scene: &Scene) -> Vec<Unknown> {
        let mut all = Vec::new();
        for (body, is_free) in scene.bodies.iter().zip(self.free(scene)) {
            let name = || body.name.clone();
            if self.materials && has_intervals(&body.material) {
                all.push(Unknown::Material { body: name() });
            }
            if is_free && (self.shift(body) > 0.0 || (!is_ball(body) && self.object_rad > 0.0)) {
                all.push(Unknown::Pose { body: name() });
            }
            if is_free && self.swell(body) > 0.0 {
                all.push(Unknown::Radius { body: name() });
            }
        }
        if self.scale && scene.size_sigma > 0.0 {
            all.push(Unknown::Scale);
        }
        if self.contact_m > 0.0 || self.angle_rad > 0.0 || self.speed_share > 0.0 {
            all.push(Unknown::Execution);
        }
        all
    }

    /// The `index`-th perturbed scene: masses, materials, sizes and poses differ from `scene`. It may lack visual meshes.
    pub fn scene(&self, scene: &Scene, seed: Seed, index: usize) -> Scene {
        self.scene_of(scene, seed, index, &|_| true)
    }

    /// The `index`-th perturbed scene with only the unknowns selected by `which`. Each has the same value as in the
    /// fully perturbed scene.
    pub fn scene_of(
        &self,
        scene: &Scene,
        seed: Seed,
        index: usize,
        which: &dyn Fn(&Unknown) -> bool,
    ) -> Scene {
        let seed = seed.derive_index("world", index as u64);
        let mut perturbed = if self.scale && scene.size_sigma > 0.0 && which(&Unknown::Scale) {
            // The half width of a uniform distribution of this standard deviation.
            let half = 3f64.sqrt() * scene.size_sigma;
            scene.scaled(1.0 + half * symmetric(&mut seed.derive("scale").rng()))
        } else {
            scene.clone()
        };
        for (body, is_free) in perturbed.bodies.iter_mut().zip(self.free(scene)) {
            let name = body.name.clone();
            let rng = |what: &str| seed.derive(what).derive(&name).rng();
            if self.materials && which(&Unknown::Material { body: name.clone() }) {
                let density = body.material.effective_density();
                sample_material(&mut body.material, &mut rng("material"));
                scale_mass(body, body.material.effective_density() / density, 1.0);
            }
            let (shift, swell) = (self.shift(body), self.swell(body));
            if is_free && swell > 0.0 && which(&Unknown::Radius { body: name.clone() }) {
                perturb_radius(body, swell * symmetric(&mut rng("radius")));
            }
            if is_free && which(&Unknown::Pose { body: name.clone() }) {
                let mut rng = rng("pose");
                body.x_wb.translation.x += shift * symmetric(&mut rng);
                body.x_wb.translation.y += shift * symmetric(&mut rng);
                if !is_ball(body) {
                    let turn = DQuat::from_rotation_z(self.object_rad * symmetric(&mut rng));
                    body.x_wb.rotation = (turn * body.x_wb.rotation).normalize();
                }
            }
        }
        perturbed
    }

    /// Half width of the position error of a body, metres.
    fn shift(&self, body: &Body) -> f64 {
        if is_ball(body) {
            with_residual(self.position_m, BALL_RATIO * body.fit_se_m)
        } else {
            with_residual(self.object_m, OBJECT_RATIO * body.fit_se_m)
        }
    }

    /// Half width of the radius error of a ball, metres; 0 for other bodies.
    fn swell(&self, body: &Body) -> f64 {
        // All points of the surface determine the radius, but only a third determine one coordinate of the centre.
        if !is_ball(body) {
            return 0.0;
        }
        with_residual(self.radius_m, RADIUS_RATIO * body.fit_se_m / 3f64.sqrt())
    }

    /// Returns whether each body of the scene may move: dynamic ones farther from all others than the sum of both errors.
    fn free(&self, scene: &Scene) -> Vec<bool> {
        let boxes: Vec<Option<Aabb>> = scene.bodies.iter().map(Body::aabb_w).collect();
        let reach: Vec<f64> = scene.bodies.iter().map(|b| self.shift(b) + self.swell(b)).collect();
        (0..boxes.len())
            .map(|i| {
                let Some(own) = boxes[i].as_ref().filter(|_| scene.bodies[i].kind == BodyKind::Dynamic)
                else {
                    return false;
                };
                boxes.iter().enumerate().all(|(k, other)| {
                    let Some(other) = other.as_ref().filter(|_| k != i) else { return true };
                    // A support does not keep a body in place.
                    let is_static = scene.bodies[k].kind == BodyKind::Static;
                    let carries = is_static && other.max.z < own.min.z + 0.005;
                    carries || gap(&scene.bodies[i], own, &scene.bodies[k], other) > reach[i] + reach[k]
                })
            })
            .collect()
    }

    /// The strike as carried out in the `index`-th perturbed world.
    pub fn strike(&self, motion: &StrikerMotion, seed: Seed, index: usize) -> StrikerMotion {
        let mut rng = seed.derive_index("strike", index as u64).rng();
        let mut perturbed = *motion;
        perturbed.contact_w.x += self.contact_m * symmetric(&mut rng);
        perturbed.contact_w.y += self.contact_m * symmetric(&mut rng);
        perturbed.angle += self.angle_rad * symmetric(&mut rng);
        perturbed.speed *= 1.0 + self.speed_share * symmetric(&mut rng);
        perturbed
    }
}

fn is_ball(body: &Body) -> bool {
    body.kind == BodyKind::Dynamic && matches!(body.shape, BodyShape::Sphere { .. })
}

/// Returns the sum of the common error and the error from a body's own residuals; 0 if `common` is 0.
fn with_residual(common: f64, shown: f64) -> f64 {
    if common > 0.0 { common + shown } else { 0.0 }
}

/// Returns a lower bound of the distance between two bodies, metres: exact between balls, otherwise along the axis of
/// largest separation of their boxes. Negative if the boxes overlap.
fn gap(a: &Body, of_a: &Aabb, b: &Body, of_b: &Aabb) -> f64 {
    match (&a.shape, &b.shape) {
        (BodyShape::Sphere { radius: r }, BodyShape::Sphere { radius: s }) => {
            a.x_wb.translation.distance(b.x_wb.translation) - r - s
        }
        _ => (of_a.min - of_b.max).max(of_b.min - of_a.max).max_element(),
    }
}

fn has_intervals(material: &Material) -> bool {
    [&material.density, &material.friction, &material.restitution, &material.fill_factor, &material.rolling_m]
        .iter()
        .any(|p| p.value.low < p.value.high)
}

/// Scales the mass; the inertia is additionally scaled with the square of `length`.
fn scale_mass(body: &mut Body, mass: f64, length: f64) {
    if let Some(was) = body.mass.filter(|_| mass.is_finite() && mass > 0.0) {
        // A positive multiple of a valid inertia is valid.
        body.mass =
            MassProperties::new(was.mass() * mass, was.com(), was.inertia() * (mass * length * length))
                .ok()
                .or(Some(was));
    }
}

fn perturb_radius(body: &mut Body, change_m: f64) {
    let BodyShape::Sphere { radius } = &mut body.shape else { return };
    let was = *radius;
    *radius = (was + change_m).max(0.5 * was);
    let ratio = *radius / was;
    // The ball keeps its contact with the support.
    body.x_wb.translation.z += *radius - was;
    scale_mass(body, ratio.powi(3), ratio);
}

fn sample_material(material: &mut Material, rng: &mut impl Rng) {
    let mut sample = |p: &mut Property, by_factors: bool| {
        let (t, v) = (symmetric(rng), p.value);
        // In log space, half and twice the value are equally likely for a quantity known within a factor.
        let end = if t < 0.0 { v.low } else { v.high };
        let is_positive = v.best > 0.0 && end > 0.0;
        p.value.best =
            if by_factors && is_positive { v.best * (end / v.best).powf(t.abs()) } else { v.at(t) };
    };
    sample(&mut material.density, true);
    sample(&mut material.friction, false);
    sample(&mut material.restitution, false);
    sample(&mut material.fill_factor, true);
    sample(&mut material.rolling_m, true);
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

/// The quantile `q` in [0, 1], linear between order statistics (type 7 of Hyndman and Fan 1996). NaN without values.
pub fn quantile(values: &[f64], q: f64) -> f64 {
    sms_core::quantile(&mut values.to_vec(), q, QuantileRule::Linear).unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glamx::{DPose3, DVec3};
    use sms_core::{Mesh, sphere_mass_properties};
    use sms_scene::{SCENE_VERSION, example_material, floor_body};

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
            fit_se_m: 0.0,
        };
        Scene {
            version: SCENE_VERSION,
            name: "test".into(),
            gravity_w: DVec3::new(0.0, 0.0, -9.81),
            size_sigma: 0.0,
            x_world_recording: DPose3::identity(),
            bodies: vec![floor_body(0.0, material), ball],
        }
    }

    #[test]
    fn perturbed_worlds_repeat_and_stay_within_what_is_known() {
        let (scene, perturbation) = (scene(), Perturbation { radius_m: 0.0, ..Perturbation::default() });
        let mut masses = Vec::new();
        for i in 0..50 {
            let other = perturbation.scene(&scene, Seed(5), i);
            assert_eq!(other, perturbation.scene(&scene, Seed(5), i));
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
    fn a_ball_of_another_radius_rests_and_has_the_mass_of_its_size() {
        let (scene, perturbation) = (scene(), Perturbation { materials: false, ..Perturbation::default() });
        for i in 0..20 {
            let ball = &perturbation.scene(&scene, Seed(5), i).bodies[1];
            let BodyShape::Sphere { radius } = ball.shape else { panic!("still a ball") };
            assert!((radius - 0.03).abs() <= 0.0003 && radius != 0.03);
            assert!((ball.x_wb.translation.z - radius).abs() < 1e-15);
            let density = ball.material.effective_density();
            let of_size = sphere_mass_properties(DVec3::ZERO, radius, density).unwrap();
            assert!((ball.mass.unwrap().mass() / of_size.mass() - 1.0).abs() < 1e-12);
            let (i, expected) = (ball.mass.unwrap().inertia().x_axis.x, of_size.inertia().x_axis.x);
            assert!((i / expected - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_scene_of_uncertain_scale_keeps_its_contacts_and_densities() {
        let exact =
            Perturbation { radius_m: 0.0, position_m: 0.0, materials: false, ..Perturbation::default() };
        let mut scene = scene();
        let other = Body {
            name: "other".into(),
            x_wb: DPose3::from_translation(DVec3::new(0.36, 0.1, 0.03)),
            ..scene.bodies[1].clone()
        };
        scene.bodies.push(other);
        assert_eq!(exact.scene(&scene, Seed(5), 0), scene);
        scene.size_sigma = 0.01;
        assert!(exact.unknowns(&scene).contains(&Unknown::Scale));
        let (count, mut squares) = (400, 0.0);
        for i in 0..count {
            let scaled = exact.scene(&scene, Seed(5), i);
            let [floor, a, b] = &scaled.bodies[..] else { panic!("three bodies") };
            let BodyShape::Sphere { radius } = a.shape else { panic!("still a ball") };
            let factor = radius / 0.03;
            squares += (factor - 1.0).powi(2);
            let density = a.mass.unwrap().mass() / radius.powi(3);
            let was = scene.bodies[1].mass.unwrap();
            assert!((density / (was.mass() / 0.03f64.powi(3)) - 1.0).abs() < 1e-12);
            let inertia = a.mass.unwrap().inertia().x_axis.x / was.inertia().x_axis.x;
            assert!((inertia / factor.powi(5) - 1.0).abs() < 1e-12);
            let (of_floor, of_ball) = (floor.x_wb.translation, a.x_wb.translation);
            assert!((of_ball.z - of_floor.z - radius).abs() < 1e-15, "the ball touches the floor");
            assert!((of_ball.distance(b.x_wb.translation) - 2.0 * radius).abs() < 1e-15, "and the other");
            let mean = 0.5 * (of_ball + b.x_wb.translation);
            assert!((mean - DVec3::new(0.33, 0.1, 0.03)).length() < 1e-15);
        }
        let sigma = (squares / count as f64).sqrt();
        assert!((sigma / 0.01 - 1.0).abs() < 0.1, "{sigma}");
        let fixed = Perturbation { scale: false, ..exact };
        assert_eq!(fixed.scene(&scene, Seed(5), 0).bodies, scene.bodies);
    }

    #[test]
    fn one_unknown_at_a_time_is_drawn_as_in_the_world_of_all() {
        let (scene, perturbation) = (scene(), Perturbation::default());
        let unknowns = perturbation.unknowns(&scene);
        let kinds: Vec<String> = unknowns.iter().map(ToString::to_string).collect();
        assert_eq!(
            kinds,
            [
                "the material of `floor`",
                "the material of `ball`",
                "the pose of `ball`",
                "the radius of `ball`",
                "the execution of the strike"
            ]
        );
        let all = perturbation.scene(&scene, Seed(5), 3);
        let pose = Unknown::Pose { body: "ball".into() };
        let one = perturbation.scene_of(&scene, Seed(5), 3, &|u| *u == pose);
        assert_eq!(one.bodies[1].x_wb.translation.x, all.bodies[1].x_wb.translation.x);
        assert_ne!(one.bodies[1].x_wb, scene.bodies[1].x_wb);
        assert_eq!(one.bodies[1].material, scene.bodies[1].material);
        assert_eq!(one.bodies[0], scene.bodies[0]);
    }

    #[test]
    fn only_objects_that_stand_apart_are_moved() {
        let mut scene = scene();
        let cube = |name: &str, x: f64| Body {
            name: name.into(),
            shape: BodyShape::Box { half_extents: DVec3::splat(0.02) },
            x_wb: DPose3::from_translation(DVec3::new(x, 0.0, 0.02)),
            ..scene.bodies[1].clone()
        };
        let cubes = [cube("a", 0.5), cube("b", 0.541), cube("c", 0.7)];
        scene.bodies.extend(cubes);
        let moved = Perturbation::default().scene(&scene, Seed(1), 0);
        let stays = |name: &str| scene.body(name).unwrap().x_wb == moved.body(name).unwrap().x_wb;
        assert!(stays("a") && stays("b") && !stays("c"));
        let c = moved.body("c").unwrap().x_wb;
        assert_eq!(c.translation.z, 0.02);
        assert!(c.rotation.angle_between(DQuat::IDENTITY) > 1e-4);
    }

    #[test]
    fn balls_that_touch_something_stay_and_no_perturbed_balls_overlap() {
        let mut scene = scene();
        let ball = |name: &str, x: f64| Body {
            name: name.into(),
            x_wb: DPose3::from_translation(DVec3::new(x, 0.1, 0.03)),
            ..scene.bodies[1].clone()
        };
        // Gaps of 0.1 mm and 10 mm.
        let others = [ball("touching", 0.3601), ball("apart", 0.4301)];
        scene.bodies.extend(others);
        let perturbation = Perturbation::default();
        let radius =
            |b: &Body| if let BodyShape::Sphere { radius } = b.shape { radius } else { panic!("a ball") };
        for i in 0..50 {
            let moved = perturbation.scene(&scene, Seed(1), i);
            for name in ["ball", "touching"] {
                let (was, is) = (scene.body(name).unwrap(), moved.body(name).unwrap());
                assert_eq!((was.x_wb, radius(was)), (is.x_wb, radius(is)));
            }
            assert_ne!(scene.body("apart").unwrap().x_wb, moved.body("apart").unwrap().x_wb);
            for (k, a) in moved.bodies.iter().enumerate().skip(1) {
                for b in &moved.bodies[k + 1..] {
                    assert!(a.x_wb.translation.distance(b.x_wb.translation) >= radius(a) + radius(b));
                }
            }
        }
        let unknowns = perturbation.unknowns(&scene);
        assert!(!unknowns.contains(&Unknown::Radius { body: "touching".into() }));
        assert!(unknowns.contains(&Unknown::Pose { body: "apart".into() }));
    }

    #[test]
    fn bodies_that_the_scan_fitted_badly_are_farther_off() {
        let mut scene = scene();
        scene.bodies[1].fit_se_m = 0.003;
        let d = Perturbation { materials: false, ..Perturbation::default() };
        let mut most = (0.0f64, 0.0f64);
        for i in 0..100 {
            let ball = &d.scene(&scene, Seed(2), i).bodies[1];
            let BodyShape::Sphere { radius } = ball.shape else { panic!("still a ball") };
            let off = ball.x_wb.translation - scene.bodies[1].x_wb.translation;
            most = (most.0.max(off.x.abs()), most.1.max((radius - 0.03).abs()));
            // A millimetre plus twice 3 mm; 0.3 mm plus five times 3/√3 mm.
            assert!(off.x.abs() <= 0.007 && (radius - 0.03).abs() <= 0.0003 + 0.015 / 3f64.sqrt());
        }
        assert!(most.0 > 0.0065 && most.1 > 0.008, "{most:?}");
        let off = Perturbation { position_m: 0.0, radius_m: 0.0, ..d };
        assert_eq!(off.scene(&scene, Seed(2), 0).bodies[1].x_wb, scene.bodies[1].x_wb);
    }

    #[test]
    fn strikes_are_perturbed_a_little_and_repeat() {
        let motion = StrikerMotion {
            contact_w: DVec3::new(0.1, 0.2, 0.03),
            angle: 0.5,
            speed: 0.6,
            ball_radius: 0.03,
        };
        let perturbation = Perturbation::default();
        let first = perturbation.strike(&motion, Seed(1), 0);
        assert_eq!(first, perturbation.strike(&motion, Seed(1), 0));
        assert_ne!(first, perturbation.strike(&motion, Seed(1), 1));
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
