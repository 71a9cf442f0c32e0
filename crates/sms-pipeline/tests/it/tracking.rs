//! Recordings without camera poses.

use glamx::DVec3;
use sms_core::{Cancel, NoProgress, Seed, StageContext, Warnings};
use sms_frames::{Align, LoadSettings, ReadOptions, Recording, Sequence};
use sms_pipeline::Error;
use sms_pipeline::stages::{FramesRequest, frames, sensor};
use sms_poses::{PoseOrigin, PosesConfig, PosesMode};
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
        poses: PosesConfig { mode, ..PosesConfig::default() },
        load: load.clone(),
        accept_faults: false,
    };

    for mode in [PosesMode::Given, PosesMode::Refine] {
        assert!(matches!(frames(&without, &request(mode), context), Err(Error::Input(_))));
    }
    let estimated = frames(&without, &request(PosesMode::Auto), context).unwrap();
    assert_eq!(estimated.metrics.number("poses.lost_frames"), Some(0.0));
    assert_eq!(estimated.poses.unwrap().origin, PoseOrigin::Estimated);
    // The files hold poses, so the estimated ones are in their world.
    let truth = frames(&given, &request(PosesMode::Given), context).unwrap().sequence;
    let centers = |s: &Sequence| -> Vec<DVec3> {
        let x_rw = s.x_world_recording.inverse();
        s.frames.iter().map(|f| x_rw.transform_point(f.camera.x_wc.translation)).collect()
    };
    let (found, expected) = (centers(&estimated.sequence), centers(&truth));
    assert_eq!(found.len(), expected.len());
    for k in 0..found.len() {
        let off_m = found[k].distance(expected[k]);
        assert!(off_m < 0.01, "frame {k}: {off_m}");
    }

    // The errors of the recording follow from some of its frames.
    let as_recorded = LoadSettings { long_side: 0, ..load.clone() };
    let seen = sensor(&given, &as_recorded, &PosesConfig::default(), context).unwrap();
    let sigma_m = seen.report.depth_noise.unwrap().sigma_m(0.7);
    let true_sigma_m = dense.sensor.depth.sigma_at(0.7);
    assert!((0.8..1.25).contains(&(sigma_m / true_sigma_m)), "{sigma_m} instead of {true_sigma_m}");
    let shift_px = seen.report.color_shift_px;
    assert!(shift_px.iter().all(|v| v.abs() < 1e-6), "{shift_px:?}");
    assert_eq!((seen.report.origin, seen.pixel_scale), (PoseOrigin::Recorded, 1.0));
    let seen = sensor(&without, &load, &PosesConfig::default(), context).unwrap();
    assert_eq!((seen.report.origin, seen.pixel_scale), (PoseOrigin::Estimated, 2.0));

    // Without poses in the files, there is no world that could be taken as it is.
    let path = dir.path().join("transforms.json");
    let mut file: serde_json::Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    for frame in file["frames"].as_array_mut().unwrap() {
        frame.as_object_mut().unwrap().remove("transform_matrix").unwrap();
    }
    std::fs::write(&path, file.to_string()).unwrap();
    let without = Recording::open(dir.path(), &ReadOptions::default()).unwrap();
    let alone = frames(&without, &request(PosesMode::Auto), context).unwrap();
    assert_eq!(alone.poses.unwrap().origin, PoseOrigin::EstimatedAlone);
    let request = request(PosesMode::Auto);
    let as_it_is = LoadSettings { align: Align::None, ..load.clone() };
    let refused = frames(&without, &FramesRequest { load: as_it_is, ..request }, context);
    assert!(matches!(refused, Err(Error::Input(_))));
}
