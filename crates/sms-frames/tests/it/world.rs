//! World alignment, far-away worlds, repeatability.

use crate::common::{WIDTH, Written, save, write};
use glamx::{DPose3, DQuat, DVec3, EulerRot};
use proptest::prelude::*;
use serde_json::json;
use sms_core::{Cancel, NoProgress, StageContext, Warnings, read_png_gray16, write_png_gray16};
use sms_frames::{Align, LoadSettings, ReadOptions, Recording, Sequence, check, load};
use std::path::Path;

fn settings() -> LoadSettings {
    LoadSettings { long_side: 0, ..LoadSettings::default() }
}

fn scan(dir: &Path, settings: &LoadSettings) -> (Sequence, Warnings) {
    let recording = Recording::open(dir, &ReadOptions::default()).unwrap();
    let warnings = Warnings::new();
    let sequence = load(&recording, settings, StageContext::quiet(&Cancel::new(), &warnings)).unwrap();
    (sequence, warnings)
}

fn turned(roll: f64, pitch: f64, yaw: f64, t: DVec3) -> DPose3 {
    DPose3::from_parts(t, DQuat::from_euler(EulerRot::XYZ, roll, pitch, yaw))
}

/// The loaded world against the true one: z is up, the table at z = 0.
fn assert_upright(sequence: &Sequence, x_recording_world: DPose3, degrees: f64, metres: f64) {
    let x = sequence.x_world_recording * x_recording_world;
    let tilt = (x.rotation * DVec3::Z).angle_between(DVec3::Z).to_degrees();
    assert!(tilt < degrees, "tilt {tilt}");
    for corner in [DVec3::ZERO, DVec3::new(0.3, 0.3, 0.0), DVec3::new(-0.3, 0.3, 0.0)] {
        let z = x.transform_point(corner).z;
        assert!(z.abs() < metres, "table at {z}");
    }
    let origin = x.inverse_transform_point(DVec3::ZERO);
    assert!(origin.length() < 0.4, "the origin is on the table: {origin}");
    for (i, frame) in sequence.frames.iter().enumerate() {
        let truth = x * crate::common::camera(i, sequence.len(), 1.2).x_wc;
        assert!((frame.camera.x_wc.translation - truth.translation).length() < 1e-6);
        assert!(frame.camera.x_wc.rotation.angle_between(truth.rotation) < 1e-6);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(6))]
    #[test]
    fn any_recording_world_is_stood_upright(
        roll in -3.0f64..3.0, pitch in -1.5f64..1.5, yaw in -3.0f64..3.0,
        tx in -3.0f64..3.0, ty in -3.0f64..3.0, tz in -3.0f64..3.0,
    ) {
        let dir = tempfile::tempdir().unwrap();
        let x_recording_world = turned(roll, pitch, yaw, DVec3::new(tx, ty, tz));
        write(dir.path(), &Written { x_recording_world, ..Written::default() });
        let (sequence, warnings) = scan(dir.path(), &settings());
        assert_upright(&sequence, x_recording_world, 0.2, 1e-3);
        prop_assert!(warnings.snapshot().is_empty());
    }
}

#[test]
fn a_far_away_world_loses_no_precision() {
    let dir = tempfile::tempdir().unwrap();
    let x_recording_world = turned(0.4, 0.2, 1.0, DVec3::new(4.5e5, -5.2e6, 130.0));
    write(dir.path(), &Written { x_recording_world, ..Written::default() });
    let (sequence, _) = scan(dir.path(), &settings());
    assert_upright(&sequence, x_recording_world, 0.2, 1e-3);
}

#[test]
fn an_aligned_recording_is_left_as_it_is_and_a_stated_up_is_kept() {
    let dir = tempfile::tempdir().unwrap();
    let mut json = write(dir.path(), &Written::default());
    json["world_is_aligned"] = json!(true);
    json["world_up"] = json!([0, 0, 1]);
    save(dir.path(), &json);
    let (sequence, warnings) = scan(dir.path(), &settings());
    assert_eq!(sequence.x_world_recording, DPose3::identity());
    assert!(warnings.snapshot().is_empty());

    let dir = tempfile::tempdir().unwrap();
    let x_recording_world = turned(0.5, 0.1, 0.0, DVec3::new(0.0, 1.0, 0.0));
    let mut json = write(dir.path(), &Written { x_recording_world, ..Written::default() });
    let up_r = x_recording_world.rotation * DVec3::Z;
    json["world_up"] = json!(up_r.to_array());
    save(dir.path(), &json);
    assert_upright(&scan(dir.path(), &settings()).0, x_recording_world, 1e-4, 2e-3);
    // A setting takes precedence over the file.
    let tilted = turned(0.55, 0.1, 0.0, DVec3::ZERO).rotation * DVec3::Z;
    let given = LoadSettings { align: Align::Up(tilted.to_array()), ..settings() };
    let up_w = scan(dir.path(), &given).0.x_world_recording.rotation * tilted;
    assert!(up_w.angle_between(DVec3::Z) < 1e-9);
    let none = LoadSettings { align: Align::None, ..settings() };
    assert_eq!(scan(dir.path(), &none).0.x_world_recording, DPose3::identity());
}

#[test]
fn an_aligned_world_far_away_is_moved_by_whole_metres() {
    let dir = tempfile::tempdir().unwrap();
    let x_recording_world = DPose3::from_parts(DVec3::new(1234.25, 20.0, -5000.5), DQuat::IDENTITY);
    let mut json = write(dir.path(), &Written { x_recording_world, ..Written::default() });
    json["world_is_aligned"] = json!(true);
    save(dir.path(), &json);
    let (sequence, warnings) = scan(dir.path(), &settings());
    let moved = sequence.x_world_recording.translation;
    assert_eq!(moved.round(), moved);
    assert_eq!(moved.y, 0.0, "a coordinate that is not far stays");
    assert!((moved.x + 1234.0).abs() <= 1.0 && (moved.z - 5000.0).abs() <= 1.0);
    assert_eq!(warnings.snapshot()[0].code, "world_recentred");
}

#[test]
fn loading_does_not_depend_on_threads_and_the_cache_returns_the_same_bits() {
    let dir = tempfile::tempdir().unwrap();
    let x_recording_world = turned(0.3, -0.2, 1.0, DVec3::new(0.1, 0.2, 0.3));
    write(dir.path(), &Written { x_recording_world, ..Written::default() });
    let settings = LoadSettings { long_side: 100, ..LoadSettings::default() };
    let run = |threads: usize, out: &str| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let sequence = pool.install(|| scan(dir.path(), &settings).0);
        sequence.save_with_settings(&dir.path().join(out), &settings).unwrap();
        sequence
    };
    let (one, _two) = (run(1, "one"), run(2, "two"));
    for name in ["sequence.json", "geometry.bin", "color/000003.png"] {
        let read = |out: &str| std::fs::read(dir.path().join(out).join(name)).unwrap();
        assert!(read("one") == read("two"), "{name} differs between 1 and 2 threads");
    }
    let cached = Sequence::load(&dir.path().join("one")).unwrap();
    assert_eq!(cached.x_world_recording, one.x_world_recording);
    for (a, b) in cached.frames.iter().zip(&one.frames) {
        assert!(a.camera == b.camera && a.color == b.color && a.depth == b.depth && a.normal_c == b.normal_c);
    }
}

#[test]
fn frames_can_be_thinned_and_paths_of_labels_follow() {
    let dir = tempfile::tempdir().unwrap();
    let mut json = write(dir.path(), &Written::default());
    json["frames"][4]["mask_path"] = json!("mask.png");
    save(dir.path(), &json);
    let recording = Recording::open(dir.path(), &ReadOptions::default()).unwrap();
    let settings =
        LoadSettings { long_side: 40, first: 2, stride: 2, max_frames: 3, ..LoadSettings::default() };
    let sequence =
        load(&recording, &settings, StageContext::quiet(&Cancel::new(), &Warnings::new())).unwrap();
    let names: Vec<_> =
        sequence.frames.iter().map(|f| f.color_path.file_name().unwrap().to_owned()).collect();
    assert_eq!(names, ["000002.png", "000004.png", "000006.png"]);
    assert_eq!(sequence.frames[0].mask_path, None);
    assert!(sequence.frames[1].mask_path.as_ref().unwrap().ends_with("mask.png"));
    assert_eq!(recording.index_of(&sequence.frames[1]), Some(4));
}

/// Indices of the frames that a recording keeps.
fn kept(how: &Written, keyframe_views: usize) -> Vec<usize> {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), how);
    let recording = Recording::open(dir.path(), &ReadOptions::default()).unwrap();
    let settings = LoadSettings { long_side: 40, keyframe_views, ..LoadSettings::default() };
    let sequence =
        load(&recording, &settings, StageContext::quiet(&Cancel::new(), &Warnings::new())).unwrap();
    sequence.frames.iter().map(|f| recording.index_of(f).unwrap()).collect()
}

#[test]
fn a_camera_that_stands_still_keeps_as_many_frames_as_are_asked_for_spread_evenly() {
    let still = Written { frames: 16, arc: 0.0, ..Written::default() };
    assert_eq!(kept(&still, 4), [0, 4, 8, 12]);
    assert_eq!(kept(&still, 16).len(), 16);
    assert_eq!(kept(&still, 0).len(), 16);
}

#[test]
fn keyframes_follow_the_size_of_the_scene_and_not_the_number_of_frames() {
    let orbit = |frames: usize, arc: f64| Written { frames, arc, ..Written::default() };
    let [few, many] = [96, 384].map(|frames| kept(&orbit(frames, 3.0), 4));
    assert!((20..32).contains(&few.len()) && many.len().abs_diff(few.len()) <= 4, "{few:?} {many:?}");
    // Every part of the path keeps frames.
    let longest = few.windows(2).map(|w| w[1] - w[0]).max().unwrap();
    assert!(longest <= 12, "{few:?}");
    let of_half = kept(&orbit(96, 1.5), 4);
    assert!(of_half.len() < few.len() - 4, "{of_half:?} {few:?}");
}

#[test]
fn what_moves_with_the_camera_is_left_out_and_reported() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &Written::default());
    let (without, _) = scan(dir.path(), &settings());
    // Something 12 cm before the camera covers a sixth of every image.
    const COVERED: usize = WIDTH / 6;
    for i in 0..without.len() {
        let path = dir.path().join(format!("depth/{i:06}.png"));
        let mut depth = read_png_gray16(&path).unwrap();
        for row in depth.data.chunks_exact_mut(WIDTH) {
            row[..COVERED].fill(600);
        }
        write_png_gray16(&path, &depth).unwrap();
    }
    let recording = Recording::open(dir.path(), &ReadOptions::default()).unwrap();
    let report = check(&recording, &NoProgress, &Cancel::new()).unwrap();
    assert!(report.findings.iter().any(|f| f.code == "attached_to_camera"), "{:?}", report.findings);
    let (sequence, warnings) = scan(dir.path(), &settings());
    assert!(warnings.snapshot().iter().any(|w| w.code == "attached_to_camera"));
    for (frame, before) in sequence.frames.iter().zip(&without.frames) {
        for i in 0..frame.depth.data.len() {
            let column = i % WIDTH;
            if column + 3 < COVERED {
                assert!(!frame.shows_scene(i) && frame.depth.data[i] == 0.0);
                assert_eq!(frame.normal_c.data[i], [0.0; 3]);
            } else if column > COVERED + 3 {
                assert!(frame.shows_scene(i));
                assert_eq!(frame.depth.data[i], before.depth.data[i]);
            }
        }
    }
    // The world is that of the table, not of the thing before the camera.
    let moved = without.x_world_recording.inverse() * sequence.x_world_recording;
    assert!(moved.rotation.angle_between(glamx::DQuat::IDENTITY) < 0.01);
}
