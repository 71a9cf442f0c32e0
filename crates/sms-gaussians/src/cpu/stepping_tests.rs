//! Tests of training steps: determinism, compiled forms, restored state, damaged input, and falling losses.

use super::tests::{COUNT, SIZE, forms, spread, trainer};
use super::*;
use crate::AFFINITY_DIM;
use crate::harmonics::BASIS;
use crate::parameters::{AFFINITY, HARMONICS, PARAMETERS, ROTATION};
use crate::test_scene::{CLASSES, camera, frame, seedlings};
use glamx::Quat;

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
