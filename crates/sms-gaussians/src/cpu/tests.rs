//! Tests of images and gradients against the oracle, and helpers for those of steps.

use super::limits::LOW_PASS;
use super::*;
use crate::harmonics::CONSTANT;
use crate::oracle::{CHANNELS, Oracle};
use crate::parameters::{AFFINITY, COLOR, HARMONICS, LOG_SCALE, PARAMETERS, ROTATION};
use crate::test_scene::{CLASSES, camera, frame, seedlings};
use crate::{AFFINITY_DIM, DepthTerm, LossWeights};
use glamx::{DPose3, DQuat, DVec3, Quat};
use sms_core::Intrinsics;

pub(super) const SIZE: (usize, usize) = (61, 37);
pub(super) const COUNT: usize = 150;

pub(super) fn trainer(config: &TrainConfig, simd: Simd) -> CpuTrainer {
    let camera = camera(SIZE.0, SIZE.1);
    let mut trainer = CpuTrainer::with_simd(config, CLASSES, Seed(2), simd);
    trainer.insert(&seedlings(&camera, COUNT, Seed(3)));
    trainer.add_frame(frame(camera, Seed(4)));
    trainer.add_frame(frame(camera, Seed(5)));
    trainer
}

pub(super) fn forms() -> impl Iterator<Item = Simd> {
    SimdForm::available().iter().filter_map(|form| Simd::of(*form))
}

/// 99.9th percentile and maximum.
pub(super) fn spread(mut errors: Vec<f64>) -> (f64, f64) {
    assert!(errors.iter().all(|e| e.is_finite()));
    errors.sort_by(f64::total_cmp);
    (errors[(errors.len() - 1) * 999 / 1000], errors[errors.len() - 1])
}

/// A background that differs in every channel.
const BACKGROUND: [f32; 3] = [0.9, 0.3, 0.6];

#[test]
fn one_gaussian_is_seen_where_it_is() {
    let camera = camera(64, 40);
    let p_w = camera.unproject(30.5, 20.5, 1.2);
    let mut trainer = CpuTrainer::new(&TrainConfig::default(), 3, Seed(1));
    trainer.insert(&[Seedling {
        position_w: p_w.as_vec3(),
        rotation_wg: Quat::IDENTITY,
        scale: Vec3::new(0.02, 0.02, 0.002),
        opacity: 0.8,
        color: [0.5, 0.25, 1.0],
        harmonics: CONSTANT,
        affinity: [0.1; AFFINITY_DIM],
    }]);
    let maps = trainer.render(&camera);
    let i = 20 * 64 + 30;
    // The low-pass filter widens the splat and reduces its opacity accordingly, so the sum is unchanged.
    let [x, y] = [camera.intrinsics.fx, camera.intrinsics.fy].map(|f| (f * 0.02 / 1.2).powi(2));
    let alpha = (0.8 * (x * y / ((x + LOW_PASS) * (y + LOW_PASS))).sqrt()) as f32;
    assert!((maps.alpha[i] - alpha).abs() < 3e-3, "{} {alpha}", maps.alpha[i]);
    let sum: f32 = maps.alpha.iter().sum();
    // Without the filter, the sum over pixels is the integral 2πo√(det Σ); alphas below 1/255 are dropped.
    let integral = std::f32::consts::TAU * 0.8 * (x * y).sqrt() as f32 * (1.0 - 1.0 / 255.0 / alpha);
    assert!((sum / integral - 1.0).abs() < 0.02, "{sum} {integral}");
    let alpha = maps.alpha[i];
    assert!((maps.color[i][2] - alpha).abs() < 1e-3);
    assert!((maps.depth[i] - 1.2).abs() < 1e-4);
    assert!((maps.normal_w[i][2] + alpha).abs() < 5e-3, "faces the camera: {:?}", maps.normal_w[i]);
    assert_eq!((maps.alpha[0], maps.color[0]), (0.0, [0.0; 3]));
    trainer.set_background(BACKGROUND);
    let before = trainer.render(&camera);
    assert_eq!((before.alpha[0], before.color[0]), (0.0, BACKGROUND));
    for c in 0..3 {
        let expected = alpha * [0.5, 0.25, 1.0][c] + (1.0 - alpha) * BACKGROUND[c];
        assert!((before.color[i][c] - expected).abs() < 1e-3, "{:?}", before.color[i]);
    }
    assert_eq!((&before.depth, &before.alpha), (&maps.depth, &maps.alpha));
    assert_eq!(trainer.model().background, BACKGROUND);
    trainer.set_background([f32::NAN, f32::INFINITY, 7.0]);
    assert_eq!(trainer.model().background, [0.0, 0.0, 1.0]);
    assert_eq!(maps.label[i], trainer.model().classifier.classify(&[0.1 * maps.alpha[i]; AFFINITY_DIM]).0);
}

#[test]
fn a_slanted_disc_shows_the_depth_of_its_plane() {
    let camera = Camera::new(Intrinsics::from_fov(64, 40, 1.0), DPose3::identity());
    let (center, tilt) =
        (Vec3::new(0.05, -0.02, 1.0), Quat::from_rotation_y(0.9) * Quat::from_rotation_x(0.3));
    let mut trainer = CpuTrainer::new(&TrainConfig::default(), CLASSES, Seed(1));
    trainer.insert(&[Seedling {
        position_w: center,
        rotation_wg: tilt,
        scale: Vec3::new(0.05, 0.06, 0.0001),
        opacity: 0.9,
        color: [0.5; 3],
        harmonics: CONSTANT,
        affinity: [0.0; AFFINITY_DIM],
    }]);
    let maps = trainer.render(&camera);
    let (normal, mut farthest, mut checked) = (tilt * Vec3::Z, 0.0f32, 0);
    for i in (0..64 * 40).filter(|&i| maps.alpha[i] > 0.3) {
        let ray = camera.unproject_pixel(i % 64, i / 64, 1.0).as_vec3();
        let depth = normal.dot(center) / normal.dot(ray);
        // The rendered plane is linear in depth; the true plane is linear in inverse depth.
        let offset = depth - center.z;
        assert!((maps.depth[i] - depth).abs() < 0.0005 + 1.2 * offset * offset, "{} {depth}", maps.depth[i]);
        farthest = farthest.max(offset.abs());
        checked += 1;
    }
    assert!(checked > 10 && farthest > 0.05, "{checked} pixels, {farthest} m");
}

/// Returns every channel of the last blended image, in the oracle's order.
fn pixels(trainer: &CpuTrainer) -> Vec<[f64; CHANNELS]> {
    let grid = trainer.engine.grid;
    let mut out = vec![[0.0; CHANNELS]; grid.width * grid.height];
    for (tile, image) in trainer.engine.tiles.iter().enumerate() {
        let corner = grid.corner(tile);
        for y in 0..TILE.min(grid.height - corner.1) {
            for x in 0..TILE.min(grid.width - corner.0) {
                let pixel = &mut out[(corner.1 + y) * grid.width + corner.0 + x];
                let patch = &image[y / PATCH_ROWS].channels;
                *pixel = std::array::from_fn(|c| f64::from(patch[c][y % PATCH_ROWS * TILE + x]));
            }
        }
    }
    out
}

#[test]
fn image_equals_the_oracle() {
    for (simd, background) in forms().flat_map(|s| [(s, [0.0; 3]), (s, BACKGROUND)]) {
        let mut trainer = trainer(&TrainConfig::default(), simd);
        trainer.set_background(background);
        let camera = camera(SIZE.0, SIZE.1);
        trainer.render(&camera);
        let oracle = oracle(&trainer).render(&camera);
        let differences = pixels(&trainer).into_iter().zip(&oracle.pixels);
        let errors =
            differences.flat_map(|(a, b)| std::array::from_fn::<f64, CHANNELS, _>(|c| (a[c] - b[c]).abs()));
        let (p999, max) = spread(errors.collect());
        println!("{simd:?}: image p99.9 {p999:.1e}, largest {max:.1e}");
        // An alpha that rounding moves across the cut-off changes a pixel by up to 1/255 times a feature.
        assert!(p999 < 5e-6 && max < 5e-3, "p99.9 {p999:e}, max {max:e}");
    }
}

/// Builds the oracle for a trainer's parameters, settings and background.
fn oracle(trainer: &CpuTrainer) -> Oracle {
    let background = trainer.engine.background.map(f64::from);
    Oracle { background, ..Oracle::new(&trainer.parameters, &trainer.config, true) }
}

/// Tolerance of derivatives relative to the largest derivative of their group.
const GRADIENT_TOLERANCE: f64 = 1e-4;

/// Compares gradients with the oracle's by group. Returns the largest error, relative to the largest derivative of its
/// group.
fn compare_gradients(config: &TrainConfig, background: [f32; 3], simd: Simd) -> f64 {
    let mut worst = 0.0f64;
    let rates = LearningRates { harmonics: 1e-3, ..config.rates };
    let mut trainer = trainer(&TrainConfig { rates, ..*config }, simd);
    trainer.set_background(background);
    let terms = trainer.differentiate(0);
    let expected = oracle(&trainer).gradient(&frame(camera(SIZE.0, SIZE.1), Seed(4)));
    assert_eq!(trainer.engine.seen, expected.seen);
    let pairs = [
        (terms.color_l1, expected.terms.color_l1),
        // The oracle skips this term if its weight is zero.
        if config.weights.color * config.weights.ssim > 0.0 {
            (terms.dssim, expected.terms.dssim)
        } else {
            (0.0, 0.0)
        },
        (terms.isotropic, expected.terms.isotropic),
        (terms.depth, expected.terms.depth),
        (terms.normal, expected.terms.normal),
        (terms.flat, expected.terms.flat),
        (terms.total, expected.terms.total(&config.weights)),
    ];
    for (k, (a, b)) in pairs.into_iter().enumerate() {
        assert!((f64::from(a) - b).abs() < 2e-5 * (1.0 + b.abs()), "term {k}: {a} and {b}");
    }
    let groups = [
        ("position", 0, ROTATION),
        ("rotation", ROTATION, LOG_SCALE),
        ("scale", LOG_SCALE, LOGIT_OPACITY),
        ("opacity", LOGIT_OPACITY, COLOR),
        ("color", COLOR, AFFINITY),
        ("affinity", AFFINITY, HARMONICS),
        ("harmonics", HARMONICS, PARAMETERS),
    ];
    for (name, first, end) in groups {
        let largest = expected.rows.iter().flat_map(|r| &r[first..end]).fold(0.0f64, |m, v| m.max(v.abs()));
        let rows = trainer.engine.gradients.iter().zip(&expected.rows);
        let errors = rows
            .flat_map(|(a, b)| (first..end).map(|k| (f64::from(a.0[k]) - b[k]).abs() / largest.max(1e-12)));
        let (p999, max) = spread(errors.collect());
        println!("{name}: p99.9 {p999:.1e}, largest {max:.1e} of {largest:.1e}");
        assert!(max < GRADIENT_TOLERANCE, "{name}: p99.9 {p999:e}, max {max:e}");
        worst = worst.max(max);
    }
    let largest = expected.classifier.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let both = trainer.engine.classifier_gradient.iter().zip(&expected.classifier);
    let (p999, max) = spread(both.map(|(a, b)| (f64::from(*a) - b).abs() / largest.max(1e-12)).collect());
    println!("classifier: p99.9 {p999:.1e}, largest {max:.1e} of {largest:.1e}");
    assert!(max < GRADIENT_TOLERANCE, "classifier: p99.9 {p999:e}, max {max:e}");
    worst.max(max)
}

#[test]
fn gradients_equal_the_oracle() {
    let none = LossWeights {
        color: 0.0,
        ssim: 0.0,
        isotropic: 0.0,
        depth: 0.0,
        normal: 0.0,
        flat: 0.0,
        segmentation: 0.0,
    };
    let only = |weights: LossWeights| TrainConfig { weights, ..TrainConfig::default() };
    let depth_in = |depth_term| TrainConfig { depth_term, ..only(LossWeights { depth: 1.0, ..none }) };
    let configs = [
        TrainConfig::default(),
        TrainConfig { depth_term: DepthTerm::Accumulated, ..TrainConfig::default() },
        TrainConfig { depth_term: DepthTerm::Detached, ..TrainConfig::default() },
        only(LossWeights { flat: 0.0, isotropic: 10.0, ..LossWeights::default() }),
        only(LossWeights { color: 1.0, ..none }),
        only(LossWeights { color: 1.0, ssim: 1.0, ..none }),
        depth_in(DepthTerm::Normalized),
        depth_in(DepthTerm::Accumulated),
        depth_in(DepthTerm::Detached),
        only(LossWeights { normal: 1.0, ..none }),
        only(LossWeights { isotropic: 1.0, ..none }),
        only(LossWeights { flat: 1.0, ..none }),
        only(LossWeights { segmentation: 1.0, ..none }),
    ];
    for simd in forms() {
        let mut worst = 0.0f64;
        for (i, config) in configs.iter().enumerate() {
            worst = worst.max(compare_gradients(config, [0.0; 3], simd));
            if i < 6 {
                worst = worst.max(compare_gradients(config, BACKGROUND, simd));
            }
        }
        println!("{simd:?}: largest relative error of any gradient {worst:.1e}");
    }
}

#[test]
fn equal_depths_leave_opacities_to_the_other_terms() {
    let camera = Camera::new(Intrinsics::from_fov(61, 37, 1.0), DPose3::identity());
    let opacity_gradient = |depth_term| {
        let weights = LossWeights {
            color: 0.0,
            isotropic: 0.0,
            normal: 0.0,
            flat: 0.0,
            segmentation: 0.0,
            ..LossWeights::default()
        };
        let config = TrainConfig { weights, depth_term, ..TrainConfig::default() };
        let mut trainer = CpuTrainer::new(&config, CLASSES, Seed(2));
        let disc = |k: i32| Seedling {
            position_w: Vec3::new(0.03 * k as f32, 0.0, 1.0),
            rotation_wg: Quat::IDENTITY,
            scale: Vec3::new(0.03, 0.03, 0.001),
            opacity: 0.6,
            color: [0.5; 3],
            harmonics: CONSTANT,
            affinity: [0.0; AFFINITY_DIM],
        };
        trainer.insert(&[disc(-1), disc(0), disc(1)]);
        let mut observed = frame(camera, Seed(4));
        // Only pixels with enough opacity: there the divisor equals the opacity.
        for (i, depth) in observed.depth.iter_mut().enumerate() {
            let (x, y) = (i as i32 % 61, i as i32 / 61);
            *depth = if (x - 30).abs() < 3 && (y - 18).abs() < 3 { 0.9 } else { 0.0 };
        }
        trainer.add_frame(observed);
        trainer.differentiate(0);
        trainer.engine.gradients.iter().fold(0.0f32, |m, g| m.max(g.0[LOGIT_OPACITY].abs()))
    };
    assert!(opacity_gradient(DepthTerm::Detached) > 1e-3, "the form that drains opacity");
    let largest = opacity_gradient(DepthTerm::Normalized);
    assert!(largest < 1e-3 * opacity_gradient(DepthTerm::Detached), "{largest:e}");
}

#[test]
fn a_disc_shows_each_camera_its_own_colour() {
    let disc = Seedling {
        position_w: Vec3::ZERO,
        rotation_wg: Quat::IDENTITY,
        scale: Vec3::new(0.5, 0.5, 0.01),
        opacity: 0.99,
        color: [0.5; 3],
        harmonics: CONSTANT,
        affinity: [0.0; AFFINITY_DIM],
    };
    let rates = LearningRates { color: 5e-3, harmonics: 5e-3, ..LearningRates::default().scaled(0.0) };
    let weights = LossWeights { ssim: 0.0, segmentation: 0.0, ..LossWeights::default() };
    let config = TrainConfig { rates, weights, ..TrainConfig::default() };
    let intrinsics = Intrinsics::from_fov(16, 16, 0.2);
    // From the left it is red, from the right blue, one metre away at 45°.
    let views = [(1.0, [0.8, 0.2, 0.2]), (-1.0, [0.2, 0.2, 0.8])].map(|(side, color)| {
        let rotation = DQuat::from_rotation_y(side * std::f64::consts::FRAC_PI_4);
        let pose = DPose3::from_parts(rotation * DVec3::new(0.0, 0.0, -1.0), rotation);
        (Camera::new(intrinsics, pose), color)
    });
    let difference = |config: &TrainConfig| {
        let mut trainer = CpuTrainer::new(config, 1, Seed(1));
        trainer.insert(&[disc]);
        let pixels = intrinsics.width * intrinsics.height;
        for (camera, color) in views {
            let (depth, normal_w, label) =
                (vec![0.0; pixels], vec![[0.0; 3]; pixels], vec![u16::MAX; pixels]);
            trainer.add_frame(TrainFrame { camera, color: vec![color; pixels], depth, normal_w, label });
        }
        for _ in 0..400 {
            trainer.steps(&[0, 1]);
        }
        let of_view = |(camera, color): &(Camera, [f32; 3])| {
            let shown = trainer.render(camera).color[pixels / 2 + intrinsics.width / 2];
            (0..3).map(|c| (shown[c] - color[c]).abs()).fold(0.0, f32::max)
        };
        views.iter().map(of_view).fold(0.0, f32::max)
    };
    let own = difference(&config);
    assert!(own < 0.03, "{own}");
    let constant = LearningRates { harmonics: 0.0, ..rates };
    let mean = difference(&TrainConfig { rates: constant, ..config });
    assert!((0.25..0.35).contains(&mean), "{mean}");
}
