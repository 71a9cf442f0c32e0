//! Recordings without camera poses.

use sms_core::{Cancel, NoProgress, Seed, StageContext, Warnings};
use sms_frames::{LoadSettings, ReadOptions, Recording};
use sms_pipeline::Error;
use sms_pipeline::settings;
use sms_pipeline::stages::{FramesRequest, frames};
use sms_poses::{PosesConfig, PosesMode};
use sms_synth::{BilliardsSettings, RecordingSettings, generate_billiards, write_recording};

#[test]
fn poses_are_estimated_where_there_are_none() {
    let dir = tempfile::tempdir().unwrap();
    let truth = generate_billiards(Seed(1), &BilliardsSettings::default());
    let dense = RecordingSettings { frames: 36, ..RecordingSettings::small() };
    write_recording(&truth, &dense, dir.path(), &NoProgress, &Cancel::new()).unwrap();
    let (cancel, warnings) = (Cancel::new(), Warnings::new());
    let context = StageContext::quiet(&cancel, &warnings);
    let given = Recording::open(dir.path(), &ReadOptions::default()).unwrap();
    let ignored = ReadOptions { ignore_poses: true, ..ReadOptions::default() };
    let without = Recording::open(dir.path(), &ignored).unwrap();
    let load = LoadSettings { long_side: 160, ..LoadSettings::default() };
    let request = |mode| FramesRequest {
        poses: PosesConfig { mode, ..settings::poses_defaults(&load) },
        load: load.clone(),
        accept_faults: false,
    };

    for mode in [PosesMode::Given, PosesMode::Refine] {
        assert!(matches!(frames(&without, &request(mode), context), Err(Error::Input(_))));
    }
    let estimated = frames(&without, &request(PosesMode::Auto), context).unwrap();
    assert_eq!(estimated.metrics.number("poses.lost_frames"), Some(0.0));
    // Distances between cameras do not depend on the world.
    let truth = frames(&given, &request(PosesMode::Given), context).unwrap().sequence;
    let centers =
        |s: &sms_frames::Sequence| -> Vec<_> { s.frames.iter().map(|f| f.camera.x_wc.translation).collect() };
    let (found, expected) = (centers(&estimated.sequence), centers(&truth));
    assert_eq!(found.len(), expected.len());
    for k in 1..found.len() {
        let off_m = found[k].distance(found[0]) - expected[k].distance(expected[0]);
        assert!(off_m.abs() < 0.01, "frame {k}: {off_m}");
    }
}
