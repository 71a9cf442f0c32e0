//! Rendered sequences with known poses.

use glamx::{DPose3, DQuat, DVec3};
use rand::RngExt;
use sms_core::{Camera, ColorImage, DepthImage, Image, Seed};
use sms_frames::{DepthNoise, Frame, Sequence, normals_from_depth};
use sms_synth::{
    BilliardsSettings, CameraModel, CameraPath, RecordingSettings, Renderer, generate_billiards,
};

/// Returns a frame of the given images.
pub(crate) fn frame(index: usize, camera: Camera, color: ColorImage, depth: DepthImage) -> Frame {
    let normal_c = normals_from_depth(&depth, &camera.intrinsics, &DepthNoise::default(), 2);
    Frame { index, ..Frame::new(camera, color, depth, normal_c) }
}

pub(crate) fn sequence(frames: Vec<Frame>) -> Sequence {
    Sequence { frames, x_world_recording: DPose3::identity(), source: "rendered".into() }
}

/// A billiards scene at 160 × 100, recorded on a full circle by a noisy depth camera (1 to 2 mm at these distances).
pub(crate) fn billiards(seed: u64, frames: usize) -> Sequence {
    let scene = generate_billiards(Seed(seed), &BilliardsSettings::default());
    let k = RecordingSettings::default().intrinsics().scaled_to(160, 100);
    let path = CameraPath { rounds: 1, height_range_m: [0.4, 0.5], ..CameraPath::default() };
    let renderer = Renderer::new(&scene);
    let render = |(index, x_wc): (usize, DPose3)| {
        let model =
            CameraModel { seed: Seed(seed).derive_index("frame", index as u64), ..CameraModel::default() };
        let camera = Camera::new(k, x_wc);
        let seen = renderer.render(&camera, &model);
        frame(index, camera, seen.color, seen.depth_noisy)
    };
    sequence(path.poses(&scene, frames).into_iter().enumerate().map(render).collect())
}

/// A floor without texture, recorded from all around.
pub(crate) fn bare_floor(frames: usize) -> Sequence {
    let k = RecordingSettings::default().intrinsics().scaled_to(160, 100);
    let mut rng = Seed(5).rng();
    let views = (0..frames).map(|index| {
        let angle = 0.2 * index as f64;
        let eye = DVec3::new(0.7 * angle.cos(), 0.7 * angle.sin(), 0.6);
        let camera = Camera::look_at(k, eye, DVec3::ZERO, DVec3::Z);
        let mut depth = Image::filled(k.width, k.height, 0.0f32);
        for y in 0..k.height {
            for x in 0..k.width {
                // Scaled to depth 1.
                let ray = camera.unproject_pixel(x, y, 1.0) - eye;
                if ray.z < -0.2 {
                    depth[(x, y)] = (-eye.z / ray.z + 0.001 * (2.0 * rng.random::<f64>() - 1.0)) as f32;
                }
            }
        }
        let color = Image::filled(k.width, k.height, 0).map(|_: &i32| {
            let noise = (3.0 * rng.random::<f64>()) as u8;
            [120 + noise; 3]
        });
        frame(index, camera, color, depth)
    });
    sequence(views.collect())
}

/// Disturbs every pose independently; standard deviations per axis.
pub(crate) fn disturbed(sequence: &Sequence, position_m: f64, rotation_deg: f64) -> Sequence {
    let mut disturbed = sequence.clone();
    for frame in &mut disturbed.frames {
        let mut rng = Seed(11).derive_index("disturb", frame.index as u64).rng();
        let mut normal = || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let shift = DVec3::new(normal(), normal(), normal()) * position_m;
        let turn = DVec3::new(normal(), normal(), normal()) * rotation_deg.to_radians();
        let x = frame.camera.x_wc;
        frame.camera.x_wc =
            DPose3::from_parts(x.translation + shift, x.rotation * DQuat::from_scaled_axis(turn));
    }
    disturbed
}

pub(crate) fn poses(sequence: &Sequence) -> Vec<DPose3> {
    sequence.frames.iter().map(|f| f.camera.x_wc).collect()
}
