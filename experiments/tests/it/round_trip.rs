//! The truth itself, exported and scored, is a perfect reconstruction; and one that is moved is off by the motion.

use glamx::{DPose3, DVec3};
use sms_core::{Camera, Image, Intrinsics, LabelInfo, Labels, MaskSource, Seed};
use sms_eval::LabelledPoint;
use sms_experiments::{
    BenchOptions, BenchScene, Prepared, ShownView, Yardstick, export_scene, score_files, write_points,
    write_view,
};
use sms_frames::{Frame, Sequence};
use sms_gaussians::Preset;
use sms_synth::{BilliardsSettings, CameraModel, CameraPath, DepthCamera, Renderer, generate_billiards};

const HOLDOUT: usize = 4;

/// Twelve noise-free frames of two balls; the masks call the first object 2 and the second 1.
fn prepared() -> Prepared {
    let truth = generate_billiards(Seed(3), &BilliardsSettings { objects: 0, ..Default::default() });
    let renderer = Renderer::new(&truth);
    let model = CameraModel { depth: DepthCamera::perfect(), ..CameraModel::default() };
    let k = Intrinsics::from_fov(160, 100, 1.25);
    let (mut frames, mut maps) = (Vec::new(), Vec::new());
    for (index, x_wc) in CameraPath::default().poses(&truth, 12).into_iter().enumerate() {
        let camera = Camera::new(k, x_wc);
        let view = renderer.render(&camera, &model);
        maps.push(view.label.map(|l| [0, 2, 1][usize::from(*l)]));
        frames.push(Frame {
            index,
            ..Frame::new(camera, view.color, view.depth, Image::filled(160, 100, [0.0, 0.0, -1.0]))
        });
    }
    let object = |id| LabelInfo { id, name: format!("object_{id}"), description: String::new() };
    Prepared {
        true_cameras: frames.iter().map(|f| f.camera).collect(),
        sequence: Sequence { frames, x_world_recording: DPose3::identity(), source: "test".into() },
        labels: Labels { maps, objects: vec![object(1), object(2)], source: MaskSource::Geometry },
        truth: Some(truth),
        real: None,
        load_seconds: (0.0, 0.0),
        poses_seconds: (0.0, 0.0),
        masks_seconds: (0.0, 0.0),
    }
}

#[test]
fn the_truth_scores_perfectly_and_a_moved_one_by_its_motion() {
    let prepared = prepared();
    let dir = tempfile::tempdir().unwrap();
    let mut options = BenchOptions::new(Preset::Draft, dir.path());
    options.scan.holdout = HOLDOUT;
    let exported = dir.path().join("scene");
    export_scene(&BenchScene::Billiards(3), &prepared, &options, &exported).unwrap();

    let yardstick = Yardstick::new(&prepared, HOLDOUT).unwrap();
    assert_eq!(yardstick.truth_of, [0, 2, 1]);
    let views = dir.path().join("views");
    for &i in &prepared.held_out(HOLDOUT) {
        let frame = &prepared.sequence.frames[i];
        let shown = ShownView {
            color: frame.color.map(|c| c.map(|v| f32::from(v) / 255.0)),
            depth: frame.depth.clone(),
            label: Some(prepared.labels.maps[i].clone()),
        };
        write_view(&views, i, &shown).unwrap();
    }
    let surface = dir.path().join("surface.ply");
    let score = |shift: DVec3| {
        let mut points = Vec::new();
        for (object, samples) in yardstick.observed.iter().enumerate() {
            let label = [2, 1][object];
            points.extend(samples.iter().map(|s| LabelledPoint { point: s.point + shift, label }));
        }
        write_points(&surface, &points).unwrap();
        score_files(&exported, Some(&surface), Some(&views)).unwrap()
    };
    let m = score(DVec3::ZERO);
    let n = |key: &str| m.number(&format!("bench.score.{key}")).unwrap();
    assert!(n("surface_median_m") < 1e-6 && n("f1_2p5mm") == 1.0 && n("cropped_f1_2p5mm") > 0.999, "{m:?}");
    // Files hold depth in tenths of millimetres.
    assert!(n("holdout_depth_mae_m") <= 5.1e-5 && n("holdout_coverage") == 1.0, "{m:?}");
    assert!(n("holdout_psnr_db") > 90.0 && n("holdout_miou") == 1.0, "{m:?}");
    // Far from the balls every point of the wrong place is wrong.
    let m = score(DVec3::Z * 0.05);
    assert!(m.number("bench.score.f1_2p5mm").unwrap() < 0.2, "{m:?}");
}

#[test]
fn disturbed_poses_are_aligned_before_points_are_scored() {
    let mut prepared = prepared();
    // All poses are off by one motion: a reconstruction made with them is moved as a whole.
    let moved = DPose3::from_parts(DVec3::new(0.01, -0.02, 0.005), glamx::DQuat::from_rotation_z(0.02));
    for frame in &mut prepared.sequence.frames {
        frame.camera.x_wc = moved * frame.camera.x_wc;
    }
    let dir = tempfile::tempdir().unwrap();
    let mut options = BenchOptions::new(Preset::Draft, dir.path());
    options.scan.holdout = HOLDOUT;
    options.disturbance.pose_shift_m = 0.01;
    export_scene(&BenchScene::Billiards(3), &prepared, &options, dir.path()).unwrap();
    let yardstick = Yardstick::new(&prepared, HOLDOUT).unwrap();
    let mut points = Vec::new();
    for (object, samples) in yardstick.observed.iter().enumerate() {
        let label = [2, 1][object];
        points.extend(samples.iter().map(|s| LabelledPoint { point: moved.transform_point(s.point), label }));
    }
    let surface = dir.path().join("surface.ply");
    write_points(&surface, &points).unwrap();
    let m = score_files(dir.path(), Some(&surface), None).unwrap();
    assert!(m.number("bench.score.surface_median_m").unwrap() < 1e-5, "{m:?}");
    assert!(
        score_files(dir.path(), None, Some(dir.path())).is_err(),
        "views of disturbed poses mean nothing"
    );
}
