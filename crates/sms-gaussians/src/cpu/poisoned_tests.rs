//! Ten thousand damaged inputs through real steps: parameters, losses and images stay finite.

use super::*;
use crate::harmonics::{BASIS, CONSTANT};
use crate::parameters::LOGIT_LIMIT;
use crate::{AFFINITY_DIM, DepthTerm, LearningRates, LossWeights};
use glamx::{DPose3, DQuat, DVec3, Quat};
use rand::RngExt;
use sms_core::{Intrinsics, StageRng};

const CASES: u64 = 10_000;
const CLASSES: usize = 3;
/// One pixel, odd and even sizes, thin and empty ones.
const SIZES: [(usize, usize); 10] =
    [(1, 1), (8, 8), (9, 17), (3, 5), (1, 23), (19, 1), (16, 9), (0, 0), (0, 5), (7, 0)];

/// Invalid measurements.
const POISON: [f32; 16] = [
    f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::MAX,
    f32::MIN,
    1e30,
    -1e30,
    1e18,
    1e10,
    1e5,
    -1.0,
    0.0,
    -0.0,
    1e-10,
    f32::MIN_POSITIVE,
    1e-45,
];

/// Draws valid numbers, and poison with a given probability.
struct Draw {
    rng: StageRng,
    poison: f64,
}

impl Draw {
    fn number(&mut self, low: f32, high: f32) -> f32 {
        let sound = self.rng.random_range(low..high);
        if self.rng.random::<f64>() < self.poison { *self.one_of(&POISON) } else { sound }
    }

    fn one_of<'a, T>(&mut self, values: &'a [T]) -> &'a T {
        &values[self.rng.random_range(0..values.len())]
    }

    fn vector(&mut self, low: f32, high: f32) -> Vec3 {
        Vec3::new(self.number(low, high), self.number(low, high), self.number(low, high))
    }

    fn chance(&mut self, probability: f64) -> bool {
        self.rng.random::<f64>() < probability
    }

    fn camera(&mut self) -> Camera {
        let (width, height) = *self.one_of(&SIZES);
        let mut k = Intrinsics::from_fov(width.max(1), height.max(1), 0.8);
        (k.width, k.height) = (width, height);
        if self.chance(0.1) {
            k.fx = *self.one_of(&[1e-3, 1e6, 1e30]);
            k.cy = *self.one_of(&[-1e4, 1e9, 0.0]);
        }
        let mut pose = DPose3::from_parts(DVec3::ZERO, DQuat::from_rotation_y(0.1));
        if self.chance(0.05) {
            pose.translation.x = f64::from(*self.one_of(&POISON));
        }
        Camera::new(k, pose)
    }

    /// One Gaussian, mostly in view, often of a degenerate shape.
    fn seedling(&mut self) -> Seedling {
        let z = self.number(0.1, 2.0);
        let mut seedling = Seedling {
            position_w: Vec3::new(0.2 * self.number(-1.0, 1.0), 0.2 * self.number(-1.0, 1.0), z),
            rotation_wg: Quat::from_xyzw(
                self.number(-1.0, 1.0),
                self.number(-1.0, 1.0),
                self.number(-1.0, 1.0),
                self.number(-1.0, 1.0),
            ),
            scale: self.vector(0.001, 0.2),
            opacity: self.number(0.05, 0.99),
            color: self.vector(0.0, 1.0).to_array(),
            harmonics: CONSTANT,
            affinity: [0.0; AFFINITY_DIM],
        };
        if self.chance(0.5) {
            seedling.harmonics = [(); 3 * BASIS].map(|()| self.number(-1.0, 1.0));
        }
        for k in 0..AFFINITY_DIM {
            seedling.affinity[k] = self.number(-1.0, 1.0);
        }
        if self.chance(0.3) {
            let scale = [Vec3::ZERO, Vec3::splat(1e-9), Vec3::splat(10.0), Vec3::new(10.0, 1e-6, 1e-6)];
            seedling.scale = *self.one_of(&scale);
        }
        if self.chance(0.2) {
            seedling.opacity = *self.one_of(&[1.0, 1.0 - 1e-7, 0.0, 1.0 / 255.0]);
        }
        if self.chance(0.2) {
            // Behind, in, and just before the camera.
            seedling.position_w.z = *self.one_of(&[-1.0, 0.0, 0.02, 0.0201, 1e-3]);
        }
        seedling
    }

    fn seedlings(&mut self) -> Vec<Seedling> {
        let count = self.rng.random_range(0..6);
        let mut seedlings: Vec<Seedling> = (0..count).map(|_| self.seedling()).collect();
        if self.chance(0.3) && !seedlings.is_empty() {
            // Coincident ones, up to an opaque pile.
            let copies = *self.one_of(&[1, 3, 40]);
            seedlings.extend(vec![seedlings[0]; copies]);
        }
        seedlings
    }

    fn frame(&mut self, camera: Camera) -> TrainFrame {
        let pixels = camera.intrinsics.width * camera.intrinsics.height;
        let whole = *self.one_of(&[None, None, None, None, Some(f32::NAN), Some(f32::INFINITY), Some(0.0)]);
        let mut frame = TrainFrame { camera, color: vec![], depth: vec![], normal_w: vec![], label: vec![] };
        for _ in 0..pixels {
            frame.color.push(whole.map_or_else(|| self.vector(0.0, 1.0).to_array(), |v| [v; 3]));
            frame.depth.push(whole.unwrap_or_else(|| self.number(0.1, 2.0)));
            frame.normal_w.push(whole.map_or_else(|| self.vector(-0.6, 0.6).to_array(), |v| [v; 3]));
            frame.label.push(*self.one_of(&[0, 1, 2, 3, 17, u16::MAX]));
        }
        frame
    }

    fn config(&mut self) -> TrainConfig {
        let depth_term = *self.one_of(&[DepthTerm::Normalized, DepthTerm::Accumulated, DepthTerm::Detached]);
        let depth = *self.one_of(&[1.0, 10.0, 0.0]);
        let rate = *self.one_of(&[1.0, 1.0, 100.0]);
        let rates = LearningRates::default();
        TrainConfig {
            weights: LossWeights { depth, ..LossWeights::default() },
            rates: LearningRates {
                position: rate * rates.position,
                log_scale: rate * rates.log_scale,
                harmonics: *self.one_of(&[0.0, 2e-3]),
                ..rates
            },
            depth_term,
            segmentation_share: *self.one_of(&[1.0, 0.25, 0.01]),
        }
    }
}

/// Returns the first result of a step or a rendering that is not finite, if any.
fn unsound(trainer: &mut CpuTrainer, stats: &StepStats, camera: &Camera) -> Option<&'static str> {
    let p = &trainer.parameters;
    let finite = |rows: &[crate::parameters::Row]| rows.iter().all(|r| r.0.iter().all(|v| v.is_finite()));
    let c = &p.classifier;
    if !(finite(&p.rows) && finite(&p.first) && finite(&p.second)) {
        return Some("a parameter or its moments");
    }
    if ![&c.values, &c.first, &c.second].into_iter().flatten().all(|v| v.is_finite()) {
        return Some("the classifier");
    }
    if p.rows.iter().any(|r| r.0[LOGIT_OPACITY].abs() > LOGIT_LIMIT) {
        return Some("an opacity out of range");
    }
    let l = &stats.loss;
    let terms = [l.color_l1, l.dssim, l.isotropic, l.depth, l.normal, l.flat, l.segmentation, l.total];
    if !terms.iter().all(|v| v.is_finite()) {
        return Some("a loss");
    }
    let maps = trainer.render(camera);
    if !maps.color.iter().flatten().all(|v| v.is_finite()) {
        return Some("a rendered colour");
    }
    if !maps.depth.iter().all(|v| v.is_finite()) {
        return Some("a rendered depth");
    }
    if !maps.normal_w.iter().flatten().chain(&maps.alpha).all(|v| v.is_finite()) {
        return Some("a rendered normal or opacity");
    }
    maps.label.iter().any(|l| usize::from(*l) >= CLASSES).then_some("a rendered label")
}

#[test]
fn ten_thousand_poisoned_inputs_leave_nothing_that_is_not_finite() {
    let forms: Vec<Simd> = SimdForm::available().iter().filter_map(|form| Simd::of(*form)).collect();
    let (mut failures, mut moved) = (Vec::new(), 0);
    for case in 0..CASES {
        let rng = Seed(90).derive_index("poison", case).rng();
        let mut draw = Draw { rng, poison: [0.0, 0.002, 0.02, 0.2][case as usize % 4] };
        let simd = forms[case as usize / 4 % forms.len()];
        let config = draw.config();
        let mut trainer = CpuTrainer::with_simd(&config, CLASSES, Seed(case), simd);
        trainer.set_background(draw.vector(0.0, 1.0).to_array());
        trainer.insert(&draw.seedlings());
        let camera = draw.camera();
        for camera in [camera, draw.camera()] {
            let frame = draw.frame(camera);
            trainer.add_frame(frame);
        }
        let before = trainer.parameters.rows.clone();
        let stats = trainer.steps(&[0, 1, 0]);
        moved += u32::from(before != trainer.parameters.rows);
        if let Some(what) = unsound(&mut trainer, &stats, &camera) {
            failures.push((case, what));
        }
    }
    println!("{CASES} cases, {moved} of which moved a Gaussian; {} failed", failures.len());
    assert!(
        failures.is_empty(),
        "{} cases failed, first {:?}",
        failures.len(),
        &failures[..failures.len().min(20)]
    );
    assert!(moved > CASES as u32 / 4, "only {moved} cases trained anything");
}
