//! `check` on recordings with known truth: it approves correct ones and names the faults of others.

use crate::common::{Written, save, write};
use serde_json::json;
use sms_core::{Cancel, NoProgress};
use sms_frames::{Axes, CheckReport, PoseDirection, ReadOptions, Recording, Severity, check};

fn check_with(how: &Written, options: &ReadOptions) -> CheckReport {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), how);
    check(&Recording::open(dir.path(), options).unwrap(), &NoProgress, &Cancel::new()).unwrap()
}

/// The code of the only fault.
fn fault(report: &CheckReport) -> &'static str {
    let faults: Vec<_> = report.findings.iter().filter(|f| f.severity == Severity::Fault).collect();
    assert_eq!(faults.len(), 1, "{report}");
    assert!(!report.approved());
    faults[0].code
}

#[test]
fn a_sound_recording_is_approved_however_it_is_written() {
    for (how, options) in [
        (Written::default(), ReadOptions::default()),
        (
            Written { opencv_axes: true, ..Written::default() },
            ReadOptions { axes: Some(Axes::Opencv), ..ReadOptions::default() },
        ),
        (
            Written { inverted: true, ..Written::default() },
            ReadOptions { poses: Some(PoseDirection::WorldToCamera), ..ReadOptions::default() },
        ),
    ] {
        let report = check_with(&how, &options);
        assert!(report.approved(), "{report}");
        // Exact depths differ by the sub-pixel position (4 mm per pixel) times the slope.
        assert!(report.overlap_1.unwrap().median_m < 2e-3, "{report}");
        assert!((report.best_unit_factor.unwrap() - 1.0).abs() < 0.03, "{report}");
        assert_eq!(report.frames, 9);
    }
}

#[test]
fn axes_declared_wrongly() {
    let report = check_with(&Written { opencv_axes: true, ..Written::default() }, &ReadOptions::default());
    assert_eq!(fault(&report), "wrong_axes");
    // The suggested key removes the fault.
    let dir = tempfile::tempdir().unwrap();
    let mut json = write(dir.path(), &Written { opencv_axes: true, ..Written::default() });
    json["camera_convention"] = json!("opencv");
    save(dir.path(), &json);
    let recording = Recording::open(dir.path(), &ReadOptions::default()).unwrap();
    assert!(check(&recording, &NoProgress, &Cancel::new()).unwrap().approved());
}

#[test]
fn poses_written_inverted() {
    let report = check_with(&Written { inverted: true, ..Written::default() }, &ReadOptions::default());
    assert_eq!(fault(&report), "wrong_pose_direction");
    let dir = tempfile::tempdir().unwrap();
    let mut json = write(dir.path(), &Written { inverted: true, ..Written::default() });
    json["pose_convention"] = json!("world_to_camera");
    save(dir.path(), &json);
    let recording = Recording::open(dir.path(), &ReadOptions::default()).unwrap();
    assert!(check(&recording, &NoProgress, &Cancel::new()).unwrap().approved());
}

#[test]
fn depth_unit_declared_wrongly() {
    for declared in [0.002, 0.00002, 0.001, 0.2] {
        let options = ReadOptions { depth_unit_m: Some(declared), ..ReadOptions::default() };
        let report = check_with(&Written::default(), &options);
        assert_eq!(fault(&report), "wrong_depth_unit");
        let unit = declared * report.best_unit_factor.unwrap();
        assert!((unit / 0.0002 - 1.0).abs() < 0.03, "{unit}");
    }
}

#[test]
fn two_faults_at_once_are_both_named() {
    let options = ReadOptions { depth_unit_m: Some(0.002), ..ReadOptions::default() };
    let report = check_with(&Written { opencv_axes: true, ..Written::default() }, &options);
    let codes: Vec<&str> = report.findings.iter().map(|f| f.code).collect();
    assert!(codes.contains(&"wrong_axes") && codes.contains(&"wrong_depth_unit"), "{report}");
}

#[test]
fn a_camera_that_stands_still_cannot_tell() {
    let options = ReadOptions { depth_unit_m: Some(0.002), ..ReadOptions::default() };
    let report = check_with(&Written { arc: 0.0, ..Written::default() }, &options);
    let codes: Vec<&str> = report.findings.iter().map(|f| f.code).collect();
    assert!(report.approved(), "{report}");
    assert!(codes.contains(&"convention_not_told") && codes.contains(&"unit_not_told"), "{report}");
    assert_eq!(report.best_unit_factor, None);
}

#[test]
fn one_frame_and_a_bad_pose() {
    let report = check_with(&Written { frames: 1, ..Written::default() }, &ReadOptions::default());
    assert!(report.approved() && report.overlap_1.is_none(), "{report}");

    let dir = tempfile::tempdir().unwrap();
    let mut json = write(dir.path(), &Written { frames: 16, ..Written::default() });
    json["frames"][7]["transform_matrix"] = json["frames"][12]["transform_matrix"].clone();
    save(dir.path(), &json);
    let recording = Recording::open(dir.path(), &ReadOptions::default()).unwrap();
    let report = check(&recording, &NoProgress, &Cancel::new()).unwrap();
    assert!(report.findings.iter().any(|f| f.code == "pose_jumps"), "{report}");
}

#[test]
fn a_wrong_pixel_centre_is_found_if_the_camera_rolls() {
    let how = Written { frames: 16, pixel_center: 0.0, ..Written::default() };
    let right = check_with(&how, &ReadOptions { pixel_center: Some(0.0), ..ReadOptions::default() });
    assert!(right.findings.iter().all(|f| f.code != "pixel_center"), "{right}");
    let wrong = check_with(&how, &ReadOptions::default());
    let fit = wrong.pixel_center_fit.unwrap();
    println!("{fit:?} {:?}", right.pixel_center_fit);
    assert_eq!(fit.better, 0.0);
    assert!(wrong.findings.iter().any(|f| f.code == "pixel_center"), "{wrong}");
}
