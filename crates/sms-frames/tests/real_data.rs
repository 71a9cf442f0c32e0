//! On the recordings of `SMS_TEST_DATA`; skipped with a printed reason where they are absent.

use glamx::DVec3;
use sms_core::{Cancel, NoProgress, StageContext, Warnings};
use sms_frames::{LoadSettings, ReadOptions, Recording, load};
use std::path::PathBuf;

fn data(name: &str) -> Option<PathBuf> {
    let root = std::env::var_os("SMS_TEST_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"),
        PathBuf::from,
    );
    let dir = root.join(name);
    if dir.is_dir() {
        return Some(dir);
    }
    println!("skipped: {} is not there (set SMS_TEST_DATA)", dir.display());
    None
}

/// The recordings' README: pixel (0, 0) is centred at the origin.
fn options() -> ReadOptions {
    ReadOptions { pixel_center: Some(0.0), ..ReadOptions::default() }
}

fn fill(depths: impl Iterator<Item = sms_core::DepthImage>) -> f64 {
    let (valid, all) = depths.fold((0usize, 0usize), |(v, n), d| {
        (v + d.data.iter().filter(|&&z| z > 0.0).count(), n + d.data.len())
    });
    valid as f64 / all as f64
}

#[test]
fn the_bin_recording_fills_up_and_stands_upright() {
    let Some(dir) = data("seq_tabletop_bin") else { return };
    let recording = Recording::open(&dir, &options()).unwrap();
    assert_eq!(recording.frames.len(), 50);
    let native = fill((0..50).map(|i| recording.read_depth_m(i).unwrap()));
    let started = std::time::Instant::now();
    let warnings = Warnings::new();
    let sequence =
        load(&recording, &LoadSettings::default(), StageContext::quiet(&Cancel::new(), &warnings)).unwrap();
    let seconds = started.elapsed().as_secs_f64();
    let loaded = fill(sequence.frames.iter().map(|f| f.depth.clone()));
    let with_normal = sequence
        .frames
        .iter()
        .map(|f| {
            f.normal_c.data.iter().filter(|n| **n != [0.0; 3]).count() as f64 / f.depth.data.len() as f64
        })
        .sum::<f64>()
        / 50.0;
    let up_r = DVec3::new(-0.0343, -0.9466, -0.3206).normalize();
    let tilt = (sequence.x_world_recording.rotation * up_r).angle_between(DVec3::Z).to_degrees();
    println!(
        "fill {native:.3} -> {loaded:.3}, normals {with_normal:.3}, gravity off by {tilt:.2} deg, {seconds:.1} s"
    );
    assert!((native - 0.36).abs() < 0.02);
    assert!(loaded > 0.62);
    assert!(tilt < 2.0);
    assert!(warnings.snapshot().is_empty());
    // The desk is at z = 0: little lies under it and the cameras are over it.
    assert!(sequence.frames.iter().all(|f| f.camera.center_w().z > 0.1));
}

#[test]
fn the_shelf_recording_stands_upright() {
    let Some(dir) = data("seq_shelf_tissue") else { return };
    let recording = Recording::open(&dir, &options()).unwrap();
    let sequence =
        load(&recording, &LoadSettings::default(), StageContext::quiet(&Cancel::new(), &Warnings::new()))
            .unwrap();
    let tilt = (sequence.x_world_recording.rotation * DVec3::Z).angle_between(DVec3::Z).to_degrees();
    println!("gravity off by {tilt:.2} deg");
    assert!(tilt < 3.0);
}

fn check_of(name: &str, options: &ReadOptions) -> Option<sms_frames::CheckReport> {
    let recording = Recording::open(data(name)?, options).unwrap();
    let report = sms_frames::check(&recording, &NoProgress, &Cancel::new()).unwrap();
    println!("{report}");
    Some(report)
}

#[test]
fn check_approves_the_recordings_with_the_published_overlap_errors() {
    let Some(bin) = check_of("seq_tabletop_bin", &options()) else { return };
    assert!(bin.approved() && bin.findings.is_empty());
    let metrics = bin.metrics();
    assert!((metrics.number("check.overlap_1_m").unwrap() - 0.0015).abs() < 0.0002);
    assert!((metrics.number("check.overlap_4_m").unwrap() - 0.0018).abs() < 0.0002);
    assert!((metrics.number("check.valid_depth_share").unwrap() - 0.36).abs() < 0.01);
    assert_eq!(metrics.number("check.frames"), Some(50.0));
    let Some(shelf) = check_of("seq_shelf_tissue", &options()) else { return };
    assert!(shelf.approved());
    assert!((shelf.overlap_1.unwrap().median_m - 0.0031).abs() < 0.0005);
}

#[test]
fn check_names_what_is_declared_wrongly() {
    use sms_frames::{Axes, PoseDirection};
    let cases = [
        (
            ReadOptions { depth_unit_m: Some(0.01), ..options() },
            "wrong_depth_unit",
            "ten times too large",
            "to 0.001",
        ),
        (
            ReadOptions { depth_unit_m: Some(0.0001), ..options() },
            "wrong_depth_unit",
            "ten times too small",
            "to 0.001",
        ),
        (ReadOptions { axes: Some(Axes::Opencv), ..options() }, "wrong_axes", "fits OpenGL", "\"opengl\""),
        (
            ReadOptions { poses: Some(PoseDirection::WorldToCamera), ..options() },
            "wrong_pose_direction",
            "fits camera-to-world",
            "invert the poses",
        ),
    ];
    for (options, code, what, cure) in cases {
        let Some(report) = check_of("seq_tabletop_bin", &options) else { return };
        let faults: Vec<_> =
            report.findings.iter().filter(|f| f.severity == sms_frames::Severity::Fault).collect();
        assert_eq!(faults.len(), 1, "{report}");
        assert_eq!(faults[0].code, code);
        assert!(faults[0].what.contains(what) && faults[0].cure.contains(cure), "{report}");
    }
}
