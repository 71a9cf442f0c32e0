//! Tests of the whole back end: against the oracle, between compiled forms, and with damaged input.

use super::limits::LOW_PASS;
use super::*;
use crate::harmonics::{BASIS, CONSTANT};
use crate::oracle::{CHANNELS, Oracle};
use crate::parameters::{AFFINITY, COLOR, HARMONICS, LOG_SCALE, PARAMETERS, ROTATION};
use crate::test_scene::{CLASSES, camera, frame, seedlings};
use crate::{AFFINITY_DIM, DepthTerm, LossWeights};
use glamx::{DPose3, DQuat, DVec3, Quat};
use sms_core::Intrinsics;

const SIZE: (usize, usize) = (61, 37);
const COUNT: usize = 150;

fn trainer(config: &TrainConfig, simd: Simd) -> CpuTrainer {
    let camera = camera(SIZE.0, SIZE.1);
    let mut trainer = CpuTrainer::with_simd(config, CLASSES, Seed(2), simd);
    trainer.insert(&seedlings(&camera, COUNT, Seed(3)));
    trainer.add_frame(frame(camera, Seed(4)));
    trainer.add_frame(frame(camera, Seed(5)));
    trainer
}

fn forms() -> impl Iterator<Item = Simd> {
    SimdForm::available().iter().filter_map(|form| Simd::of(*form))
}

/// 99.9th percentile and maximum.
fn spread(mut errors: Vec<f64>) -> (f64, f64) {
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

fn after_steps(threads: usize, simd: Simd, steps: usize) -> (StepStats, TrainState) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(|| {
        let mut trainer = trainer(&TrainConfig::default(), simd);
        let frames: Vec<FrameId> = (0..steps).map(|i| i % 2).collect();
        (trainer.steps(&frames), trainer.snapshot())
    })
}

#[test]
fn any_number_of_threads_gives_the_same_bytes() {
    for simd in forms() {
        let one = after_steps(1, simd, 6);
        assert_eq!(one, after_steps(2, simd, 6));
        assert_eq!(one, after_steps(3, simd, 6));
    }
}

#[test]
fn all_forms_agree() {
    let camera = camera(SIZE.0, SIZE.1);
    let results: Vec<_> = forms()
        .map(|simd| {
            let mut trainer = trainer(&TrainConfig::default(), simd);
            let terms = trainer.differentiate(0);
            let maps = trainer.render(&camera);
            (terms, trainer.engine.gradients.clone(), maps)
        })
        .collect();
    for pair in results.windows(2) {
        let (a, b) = (&pair[0], &pair[1]);
        assert!((a.0.total - b.0.total).abs() < 1e-5 * a.0.total, "{} {}", a.0.total, b.0.total);
        let image = a.2.color.iter().flatten().zip(b.2.color.iter().flatten());
        let (p999, max) = spread(image.map(|(a, b)| f64::from((a - b).abs())).collect());
        assert!(p999 < 2e-6 && max < 5e-3, "p99.9 {p999:e}, max {max:e}");
        let largest = a.1.iter().flat_map(|r| r.0).fold(0.0f32, |m, v| m.max(v.abs()));
        let gradients = a.1.iter().zip(&b.1).flat_map(|(a, b)| a.0.into_iter().zip(b.0));
        let (p999, max) = spread(gradients.map(|(a, b)| f64::from((a - b).abs() / largest)).collect());
        println!("gradients of one form and the next: p99.9 {p999:.1e}, largest {max:.1e}");
        assert!(p999 < 1e-4 && max < 5e-3, "p99.9 {p999:e}, max {max:e}");
    }
}

#[test]
fn a_restored_trainer_continues_bit_by_bit() {
    let config = TrainConfig::default();
    let mut whole = trainer(&config, Simd::detect());
    whole.steps(&[0, 1, 0]);
    let state = whole.snapshot();
    let mut resumed = CpuTrainer::new(&config, CLASSES, Seed(99));
    let camera = camera(SIZE.0, SIZE.1);
    resumed.add_frame(frame(camera, Seed(4)));
    resumed.add_frame(frame(camera, Seed(5)));
    resumed.restore(&state).unwrap();
    assert_eq!(resumed.snapshot(), state);
    let mask: Vec<bool> = (0..COUNT).map(|i| i % 7 != 0).collect();
    for trainer in [&mut whole, &mut resumed] {
        trainer.retain(&mask);
        trainer.insert(&seedlings(&camera, 20, Seed(8)));
    }
    assert_eq!(whole.steps(&[1, 0, 1, 0]), resumed.steps(&[1, 0, 1, 0]));
    assert_eq!(whole.snapshot(), resumed.snapshot());
    assert_eq!(whole.model(), resumed.model());
}

#[test]
fn a_damaged_state_is_refused_and_changes_nothing() {
    let mut trainer = trainer(&TrainConfig::default(), Simd::detect());
    let state = trainer.snapshot();
    let mut damaged = vec![TrainState::default(), state.clone(), state.clone(), state.clone()];
    damaged[1].bytes.truncate(state.bytes.len() - 4);
    damaged[2].bytes[0] ^= 7;
    let last = state.bytes.len() - 4;
    damaged[3].bytes[last..].copy_from_slice(&f32::NAN.to_le_bytes());
    for damaged in &damaged {
        assert!(matches!(trainer.restore(damaged), Err(TrainerError::BadState(_))));
    }
    let other = CpuTrainer::new(&TrainConfig::default(), CLASSES + 1, Seed(0)).snapshot();
    assert!(matches!(trainer.restore(&other), Err(TrainerError::BadState(_))));
    assert_eq!(trainer.snapshot(), state);
}

fn finite(trainer: &CpuTrainer) -> bool {
    let p = &trainer.parameters;
    let rows =
        [&p.rows, &p.first, &p.second].into_iter().flatten().all(|r| r.0.iter().all(|v| v.is_finite()));
    let c = &p.classifier;
    rows && [&c.values, &c.first, &c.second].into_iter().flatten().all(|v| v.is_finite())
}

#[test]
fn damaged_numbers_never_reach_a_parameter() {
    let camera = camera(SIZE.0, SIZE.1);
    let good = seedlings(&camera, 1, Seed(6))[0];
    let (nan, inf) = (f32::NAN, f32::INFINITY);
    let poisons: Vec<(&str, bool, Seedling)> = vec![
        ("NaN position", false, Seedling { position_w: Vec3::new(nan, 0.0, 0.0), ..good }),
        ("infinite position", false, Seedling { position_w: Vec3::splat(inf), ..good }),
        ("NaN rotation", false, Seedling { rotation_wg: Quat::from_xyzw(nan, 0.0, 0.0, 1.0), ..good }),
        ("NaN scale", false, Seedling { scale: Vec3::splat(nan), ..good }),
        ("infinite opacity", false, Seedling { opacity: inf, ..good }),
        ("NaN color", false, Seedling { color: [nan; 3], ..good }),
        ("NaN harmonics", false, Seedling { harmonics: [nan; 3 * BASIS], ..good }),
        ("NaN affinity", false, Seedling { affinity: [nan; AFFINITY_DIM], ..good }),
        ("zero rotation", true, Seedling { rotation_wg: Quat::from_xyzw(0.0, 0.0, 0.0, 0.0), ..good }),
        ("zero scale", true, Seedling { scale: Vec3::ZERO, ..good }),
        ("negative scale", true, Seedling { scale: Vec3::splat(-1.0), ..good }),
        ("huge scale", true, Seedling { scale: Vec3::splat(1e30), ..good }),
        ("needle", true, Seedling { scale: Vec3::new(5.0, 1e-9, 1e-9), ..good }),
        ("opacity one", true, Seedling { opacity: 1.0, ..good }),
        ("opacity above one", true, Seedling { opacity: 7.0, ..good }),
        ("opacity zero", true, Seedling { opacity: 0.0, ..good }),
        ("huge color", true, Seedling { color: [3e38; 3], ..good }),
        ("huge harmonics", true, Seedling { harmonics: [3e38; 3 * BASIS], ..good }),
        ("huge affinity", true, Seedling { affinity: [-3e38; AFFINITY_DIM], ..good }),
        ("far away", true, Seedling { position_w: Vec3::splat(1e30), ..good }),
        ("in the camera", true, Seedling { position_w: camera.center_w().as_vec3(), ..good }),
        (
            "on the near plane",
            true,
            Seedling { position_w: camera.unproject(30.0, 20.0, 0.0201).as_vec3(), ..good },
        ),
        ("behind", true, Seedling { position_w: camera.unproject(30.0, 20.0, -1.0).as_vec3(), ..good }),
    ];
    for (name, kept, poison) in poisons {
        let mut trainer = trainer(&TrainConfig::default(), Simd::detect());
        trainer.insert(&[poison]);
        assert_eq!(trainer.len(), COUNT + usize::from(kept), "{name}");
        let before = trainer.parameters.rows[..COUNT].to_vec();
        let stats = trainer.steps(&[0, 1, 0, 1]);
        assert!(finite(&trainer), "{name}");
        assert!(stats.loss.total.is_finite(), "{name}: {:?}", stats.loss);
        assert_ne!(before, trainer.parameters.rows[..COUNT], "{name}: the others still learn");
        let maps = trainer.render(&camera);
        assert!(maps.color.iter().flatten().chain(&maps.depth).all(|v| v.is_finite()), "{name}");
    }
}

#[test]
fn unusable_frames_change_only_regularized_parameters() {
    let camera = camera(SIZE.0, SIZE.1);
    let pixels = SIZE.0 * SIZE.1;
    let mut trainer = trainer(&TrainConfig::default(), Simd::detect());
    let empty = trainer.add_frame(TrainFrame {
        camera,
        color: vec![[f32::NAN; 3]; pixels],
        depth: vec![f32::NAN; pixels],
        normal_w: vec![[f32::NAN; 3]; pixels],
        label: vec![u16::MAX; pixels],
    });
    let before = trainer.parameters.clone();
    let stats = trainer.steps(&[empty]);
    assert!(stats.loss.total.is_finite() && finite(&trainer));
    assert_eq!(before.classifier, trainer.parameters.classifier);
    for (a, b) in before.rows.iter().zip(&trainer.parameters.rows) {
        assert_eq!(a.0[..ROTATION], b.0[..ROTATION]);
        assert_eq!(a.0[LOGIT_OPACITY..], b.0[LOGIT_OPACITY..]);
    }
}

#[test]
fn a_trainer_without_gaussians_steps_and_renders() {
    let camera = camera(SIZE.0, SIZE.1);
    let mut trainer = CpuTrainer::new(&TrainConfig::default(), CLASSES, Seed(2));
    trainer.add_frame(frame(camera, Seed(4)));
    assert!(trainer.steps(&[0]).loss.total.is_finite());
    assert!(trainer.render(&camera).alpha.iter().all(|a| *a == 0.0));
    assert_eq!(trainer.steps(&[]), StepStats::default());
}

#[test]
fn gaussians_out_of_view_are_left_alone() {
    let mut trainer = trainer(&TrainConfig::default(), Simd::detect());
    let hidden = 3;
    let before = trainer.parameters.rows[hidden];
    trainer.steps(&[0, 1]);
    assert_eq!(before, trainer.parameters.rows[hidden], "this one is behind the camera");
    assert_eq!(trainer.parameters.steps[hidden], 0);
    assert_eq!(trainer.parameters.steps.iter().max(), Some(&2));
}

#[test]
fn fifty_steps_lower_every_observed_term() {
    let camera = camera(SIZE.0, SIZE.1);
    // The observed view is a rendering of other Gaussians, so the optimum is reachable.
    let mut truth = CpuTrainer::new(&TrainConfig::default(), CLASSES, Seed(2));
    truth.insert(&seedlings(&camera, 400, Seed(31)));
    let maps = truth.render(&camera);
    let observed = TrainFrame {
        camera,
        color: maps.color,
        depth: maps.depth,
        normal_w: maps.normal_w,
        label: (0..SIZE.0 * SIZE.1).map(|i| u16::from(i % SIZE.0 > SIZE.0 / 2)).collect(),
    };
    let mut trainer = CpuTrainer::new(&TrainConfig::default(), CLASSES, Seed(2));
    trainer.insert(&seedlings(&camera, COUNT, Seed(3)));
    trainer.add_frame(observed);
    let first = trainer.steps(&[0]).loss;
    trainer.steps(&[0; 48]);
    let last = trainer.steps(&[0]).loss;
    println!("{first:?}\n{last:?}");
    assert!(last.total < 0.75 * first.total);
    assert!(last.color_l1 < first.color_l1 && last.dssim < first.dssim && last.depth < first.depth);
    assert!(last.segmentation < 0.5 * first.segmentation);
}

#[test]
fn a_share_of_the_segmentation_estimates_the_whole() {
    let steps = 400;
    for simd in forms() {
        let whole_config = TrainConfig::default();
        let mut whole = trainer(&whole_config, simd);
        let expected = whole.differentiate(0);
        let mut part = trainer(&TrainConfig { segmentation_share: 0.5, ..whole_config }, simd);
        let mut terms = 0.0;
        let mut rows = vec![[0.0f64; PARAMETERS]; COUNT];
        let mut classifier = vec![0.0f64; part.engine.classifier_gradient.len().max(1000)];
        for step in 0..steps {
            // The classifier's step count selects the patches.
            part.parameters.classifier.steps = step;
            let found = part.differentiate(0);
            assert_eq!((found.color_l1, found.depth), (expected.color_l1, expected.depth));
            terms += f64::from(found.segmentation) / f64::from(steps);
            for (sum, row) in rows.iter_mut().zip(&part.engine.gradients) {
                (0..PARAMETERS).for_each(|k| sum[k] += f64::from(row.0[k]) / f64::from(steps));
            }
            for (sum, value) in classifier.iter_mut().zip(&part.engine.classifier_gradient) {
                *sum += f64::from(*value) / f64::from(steps);
            }
        }
        assert!((terms / f64::from(expected.segmentation) - 1.0).abs() < 0.01, "{terms}");
        let close = |found: &[f64], expected: &[f64], name: &str| {
            let largest = expected.iter().fold(0.0f64, |m, v| m.max(v.abs()));
            let squares: f64 = found.iter().zip(expected).map(|(a, b)| (a - b).powi(2)).sum();
            let error = (squares / found.len() as f64).sqrt() / largest;
            println!("{name}: mean over {steps} steps off by {error:.1e} of the largest");
            assert!(error < 0.01, "{name}: {error}");
        };
        let flat = |rows: &[[f64; PARAMETERS]]| {
            rows.iter().flat_map(|r| r[AFFINITY..HARMONICS].to_vec()).collect::<Vec<_>>()
        };
        let exact: Vec<[f64; PARAMETERS]> =
            whole.engine.gradients.iter().map(|r| std::array::from_fn(|k| f64::from(r.0[k]))).collect();
        close(&flat(&rows), &flat(&exact), "affinities");
        let exact: Vec<f64> = whole.engine.classifier_gradient.iter().map(|v| f64::from(*v)).collect();
        close(&classifier[..exact.len()], &exact, "classifier");
    }
}

#[test]
fn a_share_of_the_segmentation_resumes_bit_by_bit_on_any_number_of_threads() {
    let config = TrainConfig { segmentation_share: 0.4, ..TrainConfig::default() };
    let run = |threads: usize, interrupted: bool| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let mut whole = trainer(&config, Simd::detect());
            whole.steps(&[0, 1, 0]);
            if interrupted {
                let state = whole.snapshot();
                whole = trainer(&config, Simd::detect());
                whole.restore(&state).unwrap();
            }
            whole.steps(&[1, 0, 1]);
            whole.snapshot()
        })
    };
    let once = run(1, false);
    assert_eq!(once, run(3, true));
    assert_eq!(once, run(2, false));
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
