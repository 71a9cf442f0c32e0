//! Input that does not determine the poses.

use crate::common::{bare_floor, billiards, disturbed, poses, sequence};
use crate::compare::compare_poses;
use glamx::{DQuat, DVec3};
use sms_core::{Cancel, CoreError, Image, StageContext, Warnings};
use sms_frames::Sequence;
use sms_poses::{PoseRefinement, PoseVerdict, PosesConfig, PosesMode, refine_poses};

fn refine(sequence: &Sequence) -> (PoseRefinement, Vec<String>) {
    let config = PosesConfig { mode: PosesMode::Refine, ..PosesConfig::default() };
    let warnings = Warnings::new();
    let result = refine_poses(sequence, &config, StageContext::quiet(&Cancel::new(), &warnings)).unwrap();
    (result, warnings.snapshot().into_iter().map(|w| w.code).collect())
}

fn is_kept_with_a_warning(given: &Sequence) {
    let (result, warnings) = refine(given);
    assert_eq!(result.report.verdict, PoseVerdict::NotPossible);
    assert_eq!(poses(&result.sequence), poses(given));
    assert_eq!(warnings, ["poses_not_refined"]);
}

#[test]
fn one_frame_and_no_frame() {
    is_kept_with_a_warning(&billiards(1, 1));
    is_kept_with_a_warning(&sequence(Vec::new()));
}

#[test]
fn no_depth() {
    let mut given = billiards(1, 4);
    for frame in &mut given.frames {
        frame.depth = Image::filled(frame.depth.width, frame.depth.height, 0.0);
        frame.normal_c = Image::filled(frame.depth.width, frame.depth.height, [0.0; 3]);
    }
    is_kept_with_a_warning(&given);
}

#[test]
fn no_overlap() {
    let mut given = billiards(1, 4);
    for (i, frame) in given.frames.iter_mut().enumerate() {
        frame.camera.x_wc.translation += DVec3::X * (10.0 * i as f64);
    }
    is_kept_with_a_warning(&given);
}

#[test]
fn a_frame_that_sees_nothing_in_common_keeps_its_pose_relative_to_the_others() {
    let truth = billiards(1, 12);
    let mut given = disturbed(&truth, 0.01, 0.5);
    let mut alone = given.frames[3].clone();
    alone.index = 12;
    alone.camera.x_wc.translation += DVec3::Y * 20.0;
    alone.camera.x_wc.rotation = DQuat::from_rotation_z(0.3) * alone.camera.x_wc.rotation;
    given.frames.push(alone);
    let (result, warnings) = refine(&given);
    assert!(warnings.contains(&"poses_of_some_frames_kept".to_owned()), "{warnings:?}");
    let (after, before) = (poses(&result.sequence), poses(&given));
    // The other frames are still refined; this frame moves at most with the world.
    let errors = compare_poses(&after[..12], &poses(&truth), 0.8);
    assert!(errors.point_rms_m < 0.003, "{errors:?}");
    assert!((after[12].translation - before[12].translation).length() < 0.1);
    assert!(after[12].rotation.angle_between(before[12].rotation) < 0.01);
}

#[test]
fn a_floor_without_texture_corrects_only_what_it_determines() {
    let truth = bare_floor(12);
    let given = disturbed(&truth, 0.01, 0.5);
    let (result, _) = refine(&given);
    // Height and tilt above the floor are determined: only noise remains (1 mm uniform, so 0.5 mm median).
    let judged = result.report.judgement;
    assert!(judged.before.depth_median_m.unwrap() > 0.003, "{judged:?}");
    assert!(judged.after.depth_median_m.unwrap() < 0.0007, "{judged:?}");
    // Position and heading are not determined; they must stay close to the given ones.
    for (refined, given) in poses(&result.sequence).iter().zip(poses(&given)) {
        assert!((refined.translation - given.translation).length() < 0.05);
        assert!(refined.rotation.angle_between(given.rotation) < 3f64.to_radians());
    }
    let before = compare_poses(&poses(&given), &poses(&truth), 0.8);
    let after = compare_poses(&poses(&result.sequence), &poses(&truth), 0.8);
    assert!(after.point_rms_m < before.point_rms_m, "{before:?} {after:?}");
}

#[test]
fn absurd_input_stays_finite() {
    let mut given = billiards(1, 5);
    for (i, frame) in given.frames.iter_mut().enumerate() {
        for (at, z) in frame.depth.data.iter_mut().enumerate() {
            match (at + i) % 7 {
                0 => *z = f32::NAN,
                1 => *z = f32::INFINITY,
                2 => *z = -1.0,
                _ => {}
            }
        }
        frame.normal_c.data.iter_mut().step_by(5).for_each(|n| *n = [f32::NAN; 3]);
    }
    let (result, _) = refine(&given);
    assert_eq!(result.report.verdict, PoseVerdict::Refined);
    for x in poses(&result.sequence) {
        assert!(x.translation.is_finite() && x.rotation.is_finite());
    }
}

#[test]
fn interruption_and_settings_out_of_range_are_errors() {
    let given = billiards(1, 4);
    let on = PosesConfig { mode: PosesMode::Refine, ..PosesConfig::default() };
    let cancel = Cancel::new();
    cancel.cancel();
    let interrupted = refine_poses(&given, &on, StageContext::quiet(&cancel, &Warnings::new()));
    assert!(matches!(interrupted, Err(CoreError::Interrupted)));
    let wrong = PosesConfig { prior_position_m: 0.0, ..on };
    let refused = refine_poses(&given, &wrong, StageContext::quiet(&Cancel::new(), &Warnings::new()));
    let Err(CoreError::Input(refused)) = refused else { panic!("{refused:?}") };
    assert_eq!(refused.key(), Some("poses.prior_position_m"));
}
