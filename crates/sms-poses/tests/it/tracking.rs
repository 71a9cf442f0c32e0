//! Poses from images alone.

use crate::common::{billiards, poses};
use crate::compare::compare_poses;
use glamx::DPose3;
use sms_core::{Cancel, StageContext, Warnings};
use sms_frames::Frame;
use sms_poses::{PosesConfig, Trajectory, track_cameras};

fn track(frames: &[Option<Frame>]) -> Trajectory {
    let (cancel, warnings) = (Cancel::new(), Warnings::new());
    let context = StageContext::quiet(&cancel, &warnings);
    track_cameras(frames.len(), &|i| Ok(frames[i].clone()), &PosesConfig::default(), context).unwrap()
}

/// The first frames of an orbit of 40.
fn frames_of(seed: u64, count: usize) -> Vec<Option<Frame>> {
    billiards(seed, 40).frames.into_iter().take(count).map(Some).collect()
}

#[test]
fn an_orbit_is_tracked_and_closed_without_given_poses() {
    for seed in [1, 2] {
        let truth = billiards(seed, 40);
        let mut frames: Vec<Option<Frame>> = truth.frames.iter().cloned().map(Some).collect();
        // Given poses have no influence.
        frames.iter_mut().flatten().for_each(|f| f.camera.x_wc = DPose3::identity());
        let found = track(&frames);
        assert_eq!(found.poses.iter().flatten().count(), 40);
        assert!(found.other_pieces.is_empty() && found.without_depth.is_empty());
        assert!(found.keyframes >= 4 && found.loops >= 1, "{} {}", found.keyframes, found.loops);
        let found: Vec<DPose3> = found.poses.into_iter().flatten().collect();
        let errors = compare_poses(&found, &poses(&truth), 0.8);
        eprintln!("seed {seed}: {errors:?}");
        assert!(errors.position_rms_m < 0.008, "{errors:?}");
    }
}

#[test]
fn frames_without_depth_are_left_out() {
    let mut frames = frames_of(1, 12);
    frames[4] = None;
    frames[7].as_mut().unwrap().depth.data.fill(0.0);
    let found = track(&frames);
    assert_eq!(found.without_depth, [4, 7]);
    assert_eq!(found.poses.iter().filter(|p| p.is_none()).count(), 2);
    assert!(found.other_pieces.is_empty());
}

#[test]
fn a_bad_frame_does_not_end_a_track() {
    let mut frames = frames_of(1, 14);
    // Another scene, without anything in common, in the middle.
    frames[7] = frames_of(2, 20).pop().unwrap();
    let found = track(&frames);
    assert_eq!(found.other_pieces, [[7]]);
    assert_eq!(found.poses.iter().flatten().count(), 13);
    assert!(found.poses[0].unwrap().translation.length() < 1e-9);
}

#[test]
fn another_scene_is_another_piece() {
    let mut frames = frames_of(1, 12);
    frames.extend(frames_of(2, 6));
    let found = track(&frames);
    assert!(found.poses[..12].iter().all(Option::is_some) && found.poses[12..].iter().all(Option::is_none));
    assert_eq!(found.other_pieces.concat(), (12..18).collect::<Vec<_>>());
}

#[test]
fn the_same_frames_give_the_same_poses() {
    let frames = frames_of(3, 10);
    assert_eq!(track(&frames).poses, track(&frames).poses);
}
