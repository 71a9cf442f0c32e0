//! Recordings without camera poses.

use crate::common::{Written, save, write};
use glamx::{DPose3, DVec3};
use sms_core::{Cancel, Image, NoProgress, write_png_color, write_png_gray16};
use sms_frames::{ReadOptions, Recording, check};

#[test]
fn poses_may_be_missing_from_all_frames_but_not_from_some() {
    let dir = tempfile::tempdir().unwrap();
    let mut json = write(dir.path(), &Written { frames: 3, arc: 0.3, ..Written::default() });
    let given = Recording::open(dir.path(), &ReadOptions::default()).unwrap();
    assert!(given.has_poses);
    json["frames"][1].as_object_mut().unwrap().remove("transform_matrix");
    save(dir.path(), &json);
    assert!(Recording::open(dir.path(), &ReadOptions::default()).is_err());
    let ignored = ReadOptions { ignore_poses: true, ..ReadOptions::default() };
    assert!(!Recording::open(dir.path(), &ignored).unwrap().has_poses);
    for frame in json["frames"].as_array_mut().unwrap() {
        frame.as_object_mut().unwrap().remove("transform_matrix");
    }
    save(dir.path(), &json);
    let recording = Recording::open(dir.path(), &ReadOptions::default()).unwrap();
    assert!(!recording.has_poses && recording.frames.iter().all(|f| f.x_rc == DPose3::identity()));
    let report = check(&recording, &NoProgress, &Cancel::new()).unwrap();
    assert!(report.approved() && report.overlap_1.is_none() && report.readings.is_empty());
    assert_eq!(report.findings.iter().filter(|f| f.code == "no_poses").count(), 1);
}

#[test]
fn frames_whose_pose_was_not_found_are_left_out() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &Written { frames: 3, arc: 0.3, ..Written::default() });
    let options = ReadOptions { ignore_poses: true, ..ReadOptions::default() };
    let recording = Recording::open(dir.path(), &options).unwrap();
    let (first, last) = (recording.frames[0].clone(), recording.frames[2].clone());
    let moved = DPose3::from_translation(DVec3::X);
    let posed = recording.with_poses(&[Some(DPose3::identity()), None, Some(moved)]);
    assert!(posed.has_poses && posed.frames.len() == 2);
    assert_eq!(
        (&posed.frames[0].color_path, &posed.frames[1].color_path),
        (&first.color_path, &last.color_path)
    );
    assert_eq!(posed.frames[1].x_rc, moved);
}

#[test]
fn tum_recordings_without_a_trajectory_keep_all_pairs() {
    let dir = tempfile::tempdir().unwrap();
    write_png_color(&dir.path().join("c.png"), &Image::filled(640, 480, [1, 2, 3])).unwrap();
    write_png_gray16(&dir.path().join("d.png"), &Image::filled(640, 480, 5000)).unwrap();
    std::fs::write(dir.path().join("rgb.txt"), "10.0 c.png\n11.0 c.png\n").unwrap();
    std::fs::write(dir.path().join("depth.txt"), "10.0 d.png\n11.0 d.png\n").unwrap();
    let recording = Recording::open(dir.path(), &ReadOptions::default()).unwrap();
    assert!(!recording.has_poses && recording.frames.len() == 2);
    // A trajectory that covers one of both pairs drops the other, unless it is ignored.
    std::fs::write(dir.path().join("groundtruth.txt"), "10.0 1 2 3 0 0 0 1\n").unwrap();
    let posed = Recording::open(dir.path(), &ReadOptions::default()).unwrap();
    assert!(posed.has_poses && posed.frames.len() == 1);
    let ignored = ReadOptions { ignore_poses: true, ..ReadOptions::default() };
    assert_eq!(Recording::open(dir.path(), &ignored).unwrap().frames.len(), 2);
}
