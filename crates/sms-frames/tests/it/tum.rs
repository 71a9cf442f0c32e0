//! The TUM RGB-D reader.

use glamx::{DPose3, DQuat, DVec3};
use sms_core::{Cancel, Image, NoProgress, StageContext, Warnings, write_png_color, write_png_gray16};
use sms_frames::{FramesError, LoadSettings, ReadOptions, Recording, RecordingFormat, check, load};
use std::fmt::Write;
use std::path::Path;

const FRAMES: usize = 9;

/// Writes the ray-cast scene: colour at 10 Hz, depth 4 ms later, poses at 50 Hz with their own clock offset.
fn write(dir: &Path) {
    let (mut rgb, mut depth) = (String::from("# colour\n"), String::from("# depth\n"));
    for i in 0..FRAMES {
        let camera = crate::common::camera(i, FRAMES, 1.0);
        let (color, z) = crate::common::render(&camera);
        let raw = z.map(|z| (z * 5000.0).round() as u16);
        write_png_color(&dir.join(format!("rgb/{i}.png")), &color).unwrap();
        write_png_gray16(&dir.join(format!("depth/{i}.png")), &raw).unwrap();
        let t = 1.3e9 + 0.1 * i as f64;
        writeln!(rgb, "{:.6} rgb/{i}.png", t - 0.004).unwrap();
        writeln!(depth, "{t:.6} depth/{i}.png").unwrap();
    }
    // A colour image without depth near it, and one after the trajectory's end.
    writeln!(rgb, "{:.6} rgb/0.png", 1.3e9 + 0.05).unwrap();
    let mut poses = String::from("# time tx ty tz qx qy qz qw\n");
    for j in -2..=(5 * FRAMES as i32) {
        // Between the frames the camera moves along the straight line and the great arc between their poses.
        let s = 0.2 * (f64::from(j) + 0.5);
        let i = (s.floor() as usize).min(FRAMES - 2);
        let (a, b) =
            (crate::common::camera(i, FRAMES, 1.0).x_wc, crate::common::camera(i + 1, FRAMES, 1.0).x_wc);
        let f = s - i as f64;
        let (t, q) = (a.translation.lerp(b.translation, f), a.rotation.slerp(b.rotation, f));
        writeln!(
            poses,
            "{:.6} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9}",
            1.3e9 + 0.02 * (f64::from(j) + 0.5),
            t.x,
            t.y,
            t.z,
            q.x,
            q.y,
            q.z,
            q.w
        )
        .unwrap();
    }
    std::fs::write(dir.join("rgb.txt"), rgb).unwrap();
    std::fs::write(dir.join("depth.txt"), depth).unwrap();
    std::fs::write(dir.join("groundtruth.txt"), poses).unwrap();
    let k = crate::common::intrinsics();
    // TUM's principal points refer to pixel centres at 0.
    let text = format!("# fx fy cx cy\n{} {} {} {}\n", k.fx, k.fy, k.cx - 0.5, k.cy - 0.5);
    std::fs::write(dir.join("intrinsics.txt"), text).unwrap();
}

#[test]
fn frames_are_associated_posed_and_measured() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path());
    let recording = Recording::open(dir.path(), &ReadOptions::default()).unwrap();
    assert_eq!(recording.format, RecordingFormat::TumRgbd);
    assert_eq!(recording.frames.len(), FRAMES);
    for (i, frame) in recording.frames.iter().enumerate() {
        let truth = crate::common::camera(i, FRAMES, 1.0).x_wc;
        assert!((frame.color_lens.intrinsics.cx - crate::common::intrinsics().cx).abs() < 1e-9);
        assert!(frame.color_path.ends_with(format!("rgb/{i}.png")));
        assert!((frame.time_s.unwrap() - 0.1 * i as f64).abs() < 1e-6);
        // The test's path has a corner of 0.13 rad at each frame, which interpolation cuts.
        assert!((frame.x_rc.translation - truth.translation).length() < 5e-4, "{i}");
        assert!(frame.x_rc.rotation.angle_between(truth.rotation) < 1e-3, "{i}");
    }
    assert_eq!(recording.notices.len(), 1, "the colour image without depth is mentioned");
    let report = check(&recording, &NoProgress, &Cancel::new()).unwrap();
    assert!(report.approved(), "{report}");
    let sequence =
        load(&recording, &LoadSettings::default(), StageContext::quiet(&Cancel::new(), &Warnings::new()))
            .unwrap();
    let up = sequence.x_world_recording.rotation * DVec3::Z;
    assert!(up.angle_between(DVec3::Z).to_degrees() < 1.0);
}

#[test]
fn a_wrong_depth_unit_is_found() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path());
    let options = ReadOptions { depth_unit_m: Some(0.001), ..ReadOptions::default() };
    let report = check(&Recording::open(dir.path(), &options).unwrap(), &NoProgress, &Cancel::new()).unwrap();
    assert!(report.findings.iter().any(|f| f.code == "wrong_depth_unit"), "{report}");
}

/// The file that opening the recording refuses.
fn faulty(corrupt: impl FnOnce(&Path)) -> String {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path());
    corrupt(dir.path());
    match Recording::open(dir.path(), &ReadOptions::default()) {
        Err(FramesError::Input(e)) => e.path.rsplit('/').next().unwrap_or_default().to_owned(),
        other => panic!("{other:?}"),
    }
}

#[test]
fn faults_are_named() {
    assert_eq!(faulty(|d| std::fs::remove_file(d.join("depth.txt")).unwrap()), "depth.txt");
    assert_eq!(faulty(|d| std::fs::remove_file(d.join("depth/3.png")).unwrap()), "3.png");
    for poses in ["1 0 0 0 0 0 0 1\n2 0 0 nan 0 0 0 1\n", "1 0 0 0 0 0 0 2\n", "1 0 0 0\n"] {
        assert_eq!(
            faulty(|d| std::fs::write(d.join("groundtruth.txt"), poses).unwrap()),
            "groundtruth.txt",
            "{poses}"
        );
    }
    // A single pose at another time leaves no frame.
    faulty(|d| std::fs::write(d.join("groundtruth.txt"), "1 0 0 0 0 0 0 1\n").unwrap());
    // An image of this size has no published calibration.
    faulty(|d| std::fs::remove_file(d.join("intrinsics.txt")).unwrap());
    assert_eq!(faulty(|d| std::fs::write(d.join("intrinsics.txt"), "525 525\n").unwrap()), "intrinsics.txt");
}

#[test]
fn published_calibrations_and_matrices_are_used() {
    let outer = tempfile::tempdir().unwrap();
    let write_one = |name: &str| {
        let dir = outer.path().join(name);
        write_png_color(&dir.join("c.png"), &Image::filled(640, 480, [1, 2, 3])).unwrap();
        write_png_gray16(&dir.join("d.png"), &Image::filled(640, 480, 5000)).unwrap();
        std::fs::write(dir.join("rgb.txt"), "10.0 c.png\n").unwrap();
        std::fs::write(dir.join("depth.txt"), "10.0 d.png\n").unwrap();
        std::fs::write(dir.join("groundtruth.txt"), "10.0 1 2 3 0 0 0 1\n").unwrap();
        dir
    };
    let dir = write_one("rgbd_dataset_freiburg1_desk");
    let recording = Recording::open(&dir, &ReadOptions::default()).unwrap();
    let lens = recording.frames[0].color_lens;
    assert_eq!((lens.intrinsics.fx, lens.intrinsics.cx), (517.3, 319.1));
    assert!(!lens.distortion.is_none());
    assert_eq!(recording.notices[0].code, "assumed_intrinsics");
    assert_eq!(recording.frames[0].x_rc, DPose3::from_parts(DVec3::new(1.0, 2.0, 3.0), DQuat::IDENTITY));
    assert!((recording.read_depth_m(0).unwrap().data[0] - 1.0).abs() < 1e-6);
    let dir = write_one("desk");
    let lens = Recording::open(&dir, &ReadOptions::default()).unwrap().frames[0].color_lens;
    assert_eq!((lens.intrinsics.fx, lens.intrinsics.cx, lens.intrinsics.cy), (525.0, 320.0, 240.0));
    std::fs::write(dir.join("calibration.txt"), "500 0 300\n0 501 200\n0 0 1\n").unwrap();
    let recording = Recording::open(&dir, &ReadOptions::default()).unwrap();
    let k = recording.frames[0].color_lens.intrinsics;
    assert_eq!((k.fx, k.fy, k.cx, k.cy), (500.0, 501.0, 300.5, 200.5));
    assert!(recording.notices.is_empty());
}
