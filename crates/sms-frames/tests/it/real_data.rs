//! Loading and checking of the recordings of `SMS_TEST_DATA`.

use glamx::DVec3;
use sms_core::{Cancel, NoProgress, StageContext, Warnings};
use sms_frames::{LoadSettings, ReadOptions, Recording, load};
use std::path::PathBuf;

fn data(name: &str) -> PathBuf {
    let root = std::env::var_os("SMS_TEST_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"),
        PathBuf::from,
    );
    root.join(name)
}

/// Pixel (0, 0) is centred at the origin (README of the recordings).
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
#[ignore = "needs the recordings of SMS_TEST_DATA"]
fn the_bin_recording_fills_up_and_stands_upright() {
    let dir = data("seq_tabletop_bin");
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
    // The desk is at z = 0 and the cameras are above it.
    assert!(sequence.frames.iter().all(|f| f.camera.center_w().z > 0.1));
}

#[test]
#[ignore = "needs the recordings of SMS_TEST_DATA"]
fn the_shelf_recording_stands_upright() {
    let dir = data("seq_shelf_tissue");
    let recording = Recording::open(&dir, &options()).unwrap();
    let sequence =
        load(&recording, &LoadSettings::default(), StageContext::quiet(&Cancel::new(), &Warnings::new()))
            .unwrap();
    let tilt = (sequence.x_world_recording.rotation * DVec3::Z).angle_between(DVec3::Z).to_degrees();
    println!("gravity off by {tilt:.2} deg");
    assert!(tilt < 3.0);
}

fn check_of(name: &str, options: &ReadOptions) -> sms_frames::CheckReport {
    let recording = Recording::open(data(name), options).unwrap();
    let report = sms_frames::check(&recording, &NoProgress, &Cancel::new()).unwrap();
    println!("{report}");
    report
}

#[test]
#[ignore = "needs the recordings of SMS_TEST_DATA"]
fn check_approves_the_recordings_with_the_published_overlap_errors() {
    let bin = check_of("seq_tabletop_bin", &options());
    assert!(bin.approved() && bin.findings.is_empty());
    let metrics = bin.metrics();
    assert!((metrics.number("check.overlap_1_m").unwrap() - 0.0015).abs() < 0.0002);
    assert!((metrics.number("check.overlap_4_m").unwrap() - 0.0018).abs() < 0.0002);
    assert!((metrics.number("check.valid_depth_share").unwrap() - 0.36).abs() < 0.01);
    assert_eq!(metrics.number("check.frames"), Some(50.0));
    let shelf = check_of("seq_shelf_tissue", &options());
    assert!(shelf.approved());
    assert!((shelf.overlap_1.unwrap().median_m - 0.0031).abs() < 0.0005);
}

#[test]
#[ignore = "needs the recordings of SMS_TEST_DATA"]
fn check_names_what_is_declared_wrongly() {
    use sms_frames::{Axes, PoseDirection};
    let cases = [
        (ReadOptions { depth_unit_m: Some(0.01), ..options() }, "wrong_depth_unit"),
        (ReadOptions { depth_unit_m: Some(0.0001), ..options() }, "wrong_depth_unit"),
        (ReadOptions { axes: Some(Axes::Opencv), ..options() }, "wrong_axes"),
        (ReadOptions { poses: Some(PoseDirection::WorldToCamera), ..options() }, "wrong_pose_direction"),
    ];
    for (options, code) in cases {
        let report = check_of("seq_tabletop_bin", &options);
        let faults: Vec<_> =
            report.findings.iter().filter(|f| f.severity == sms_frames::Severity::Fault).collect();
        assert_eq!(faults.len(), 1, "{report}");
        assert_eq!(faults[0].code, code);
    }
}
