//! Known perturbations are recovered, and good poses are kept.

use crate::common::{billiards, disturbed, poses};
use crate::compare::compare_poses;
use glamx::{DPose3, DQuat, DVec3};
use proptest::prelude::*;
use sms_core::{Cancel, StageContext, Warnings};
use sms_frames::Sequence;
use sms_poses::{PoseRefinement, PoseVerdict, PosesConfig, PosesMode, align_rigidly, refine_poses};

fn refine(sequence: &Sequence, mode: PosesMode) -> PoseRefinement {
    let config = PosesConfig { mode, ..PosesConfig::default() };
    refine_poses(sequence, &config, StageContext::quiet(&Cancel::new(), &Warnings::new())).unwrap()
}

/// Distance of the scene from the cameras.
const AT_M: f64 = 0.8;

#[test]
fn disturbed_poses_are_recovered_and_surfaces_agree_as_with_the_true_ones() {
    for seed in [1, 2] {
        let truth = billiards(seed, 20);
        let given = disturbed(&truth, 0.010, 0.5);
        let result = refine(&given, PosesMode::Auto);
        assert_eq!(result.report.verdict, PoseVerdict::Refined);
        let before = compare_poses(&poses(&given), &poses(&truth), AT_M);
        let after = compare_poses(&poses(&result.sequence), &poses(&truth), AT_M);
        assert!(before.point_rms_m > 0.015, "{before:?}");
        eprintln!(
            "seed {seed}: {:.3} mm at {AT_M} m, {:.3} mm, {:.4}°",
            1e3 * after.point_rms_m,
            1e3 * after.position_rms_m,
            after.rotation_rms_rad.to_degrees()
        );
        assert!(after.point_rms_m < 0.0015, "{after:?}");
        assert!(after.position_rms_m < 0.0025 && after.rotation_rms_rad < 0.2f64.to_radians(), "{after:?}");
        // With the true poses as input, `before` is the effect of noise alone on held-out pairs.
        let floor = refine(&truth, PosesMode::Refine).report.judgement.before.depth_median_m.unwrap();
        let reached = result.report.judgement.after.depth_median_m.unwrap();
        assert!(reached < 1.15 * floor, "{reached} against {floor}");
    }
}

#[test]
fn exact_poses_with_noise_are_hardly_moved_and_auto_keeps_them() {
    for seed in [1, 3] {
        let truth = billiards(seed, 20);
        let on = refine(&truth, PosesMode::Refine);
        let errors = compare_poses(&poses(&on.sequence), &poses(&truth), AT_M);
        eprintln!("seed {seed}: {:.3} mm at {AT_M} m", 1e3 * errors.point_rms_m);
        assert!(errors.point_rms_m < 0.0015, "{errors:?}");
        let auto = refine(&truth, PosesMode::Auto);
        assert_eq!(auto.report.verdict, PoseVerdict::GivenAreAsGood, "{}", auto.report.summary());
        assert_eq!(poses(&auto.sequence), poses(&truth));
        assert!(auto.report.prospect.unwrap() < 0.01, "{:?}", auto.report.prospect);
        // The depth camera has 0.4 mm + 1.2 mm/m² z², and steps that add 1 % to it.
        let (z_m, noise) = (0.8, auto.report.depth_noise.unwrap());
        let found = noise.sigma_m(z_m) / (0.0004 + 0.0012 * z_m * z_m);
        eprintln!("seed {seed}: {noise:?}, {found:.3} of the true noise at {z_m} m");
        assert!((found - 1.0).abs() < 0.15, "{noise:?}");
    }
}

#[test]
fn the_scene_stays_where_it_was_given() {
    let given = disturbed(&billiards(1, 20), 0.010, 0.5);
    let result = refine(&given, PosesMode::Refine);
    // No common rigid motion moves the measured points closer to their positions under the given poses.
    let points = |s: &Sequence| -> Vec<DVec3> {
        let all = s.frames.iter().flat_map(|f| {
            (0..f.depth.data.len()).step_by(37).filter(|&i| f.depth.data[i] > 0.0).map(|i| {
                let (x, y) = (i % f.depth.width, i / f.depth.width);
                f.camera.unproject_pixel(x, y, f64::from(f.depth.data[i]))
            })
        });
        all.collect()
    };
    let moved = align_rigidly(&points(&result.sequence), &points(&given));
    assert!(
        moved.transform_point(DVec3::new(0.5, 0.0, 0.0)).distance(DVec3::new(0.5, 0.0, 0.0)) < 5e-4,
        "{moved:?}"
    );
    assert!(moved.rotation.to_scaled_axis().length() < 1e-3, "{moved:?}");
    // Only poses are changed.
    for (a, b) in result.sequence.frames.iter().zip(&given.frames) {
        assert!(a.depth == b.depth && a.color == b.color && a.camera.intrinsics == b.camera.intrinsics);
    }
}

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let given = disturbed(&billiards(2, 10), 0.010, 0.5);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| refine(&given, PosesMode::Auto))
    };
    let (one, three) = (with(1), with(3));
    assert_eq!(poses(&one.sequence), poses(&three.sequence));
    assert_eq!(one.report, three.report);
}

proptest! {
    #[test]
    fn a_common_motion_is_no_error(
        turn in prop::array::uniform3(-0.5..0.5f64), shift in prop::array::uniform3(-1.0..1.0f64)
    ) {
        let truth: Vec<DPose3> = (0..7)
            .map(|i| {
                let angle = i as f64 * 0.6;
                DPose3::from_parts(
                    DVec3::new(angle.cos(), angle.sin(), 0.3 + 0.05 * angle),
                    DQuat::from_rotation_z(angle) * DQuat::from_rotation_x(2.0),
                )
            })
            .collect();
        let x = DPose3::from_parts(DVec3::from_array(shift), DQuat::from_scaled_axis(DVec3::from_array(turn)));
        let given: Vec<DPose3> = truth.iter().map(|t| x * *t).collect();
        let errors = compare_poses(&given, &truth, AT_M);
        prop_assert!(errors.point_rms_m < 1e-9 && errors.rotation_rms_rad < 1e-7, "{errors:?}");
    }
}

#[test]
fn depth_in_another_unit_is_refused_and_told() {
    let truth = billiards(1, 20);
    let mut given = disturbed(&truth, 0.001, 0.05);
    // All distances seem 3 % larger than the poses say.
    given.frames.iter_mut().for_each(|f| f.depth.data.iter_mut().for_each(|z| *z *= 1.03));
    // Without a hand-eye correction, which could bring the cameras of a circle nearer to its middle.
    let config = PosesConfig {
        mode: PosesMode::Auto,
        prior_hand_eye_m: 0.0,
        prior_hand_eye_rad: 0.0,
        ..PosesConfig::default()
    };
    let warnings = Warnings::new();
    let result = refine_poses(&given, &config, StageContext::quiet(&Cancel::new(), &warnings)).unwrap();
    assert_eq!(result.report.verdict, PoseVerdict::CommonChange);
    assert_eq!(poses(&result.sequence), poses(&given));
    assert!(result.report.relative_size_sigma().unwrap() > 0.01);
}

#[test]
fn poses_of_another_time_are_told_from_noise_and_from_the_mount() {
    let mut truth = billiards(1, 30);
    // The camera moves at a changing speed: at a constant one, a delay is a shift along the path that all frames share.
    let time_s = |i: usize| 0.1 * i as f64 + 0.06 * (0.7 * i as f64).sin();
    truth.frames.iter_mut().enumerate().for_each(|(i, f)| f.time_s = Some(time_s(i)));
    for late_s in [0.0, 0.03] {
        // The pose that an image has is given so much later.
        let mut given = disturbed(&truth, 0.001, 0.05);
        let n = given.len();
        for i in 1..n - 1 {
            let (before, after) = (truth.frames[i - 1].camera.x_wc, truth.frames[i + 1].camera.x_wc);
            let share = late_s / (time_s(i + 1) - time_s(i - 1));
            let turn = (after.rotation * before.rotation.inverse()).to_scaled_axis();
            let x = &mut given.frames[i].camera.x_wc;
            x.translation -= share * (after.translation - before.translation);
            x.rotation = DQuat::from_scaled_axis(-share * turn) * x.rotation;
        }
        given.frames = given.frames[1..n - 1].to_vec();
        let report = refine(&given, PosesMode::Refine).report;
        let found = report.time_offset.unwrap();
        eprintln!("{late_s} s: {found:?}");
        assert!((found.value_s - late_s).abs() < (3.0 * found.sigma_s).max(0.0015), "{found:?}");
        assert!(found.sigma_s < 0.008, "{found:?}");
        assert_eq!(found.is_significant(), late_s > 0.0, "{found:?}");
    }
    let untimed = refine(&billiards(1, 12), PosesMode::Refine).report;
    assert_eq!(untimed.time_offset, None);
}

#[test]
fn a_wrong_focal_length_is_found_and_a_right_one_is_kept() {
    let truth = billiards(2, 30);
    for wrong in [1.0, 1.02] {
        let mut given = disturbed(&truth, 0.001, 0.05);
        for frame in &mut given.frames {
            frame.camera.intrinsics.fx *= wrong;
            frame.camera.intrinsics.fy *= wrong;
        }
        let refined = refine(&given, PosesMode::Refine);
        let focal = refined.report.focal.unwrap();
        eprintln!("{wrong}: {focal:?}");
        let intrinsics = |s: &Sequence| s.frames[0].camera.intrinsics.fx;
        if wrong == 1.0 {
            assert_eq!(focal.share, 0.0, "{focal:?}");
            assert_eq!(intrinsics(&refined.sequence), intrinsics(&truth));
        } else {
            let left = intrinsics(&refined.sequence) / intrinsics(&truth) - 1.0;
            assert!(left.abs() < 0.003, "{left} {focal:?}");
        }
    }
}
