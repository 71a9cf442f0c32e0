//! A small random scene with observed views, for the self-check and the tests.

use glamx::{DPose3, DQuat, DVec3, EulerRot, Quat, Vec3};
use rand::RngExt;
use sms_core::{Camera, Intrinsics, Seed};
use sms_gaussians::{AFFINITY_DIM, LearningRates, Seedling, TrainFrame, Trainer};

/// Classes of the scene.
pub(crate) const CLASSES: usize = 5;
/// Colour behind the Gaussians, another in every channel.
pub(crate) const BACKGROUND: [f32; 3] = [0.9, 0.3, 0.6];

/// A camera that looks roughly along +z of the world, principal point off the centre.
pub(crate) fn camera((width, height): (usize, usize)) -> Camera {
    let rotation = DQuat::from_euler(EulerRot::XYZ, -0.06, 0.08, 0.04);
    let (w, h) = (width as f64, height as f64);
    let intrinsics = Intrinsics { width, height, fx: 0.95 * w, fy: 0.9 * w, cx: 0.53 * w, cy: 0.46 * h };
    Camera::new(intrinsics, DPose3::from_parts(DVec3::new(-0.08, 0.04, -1.0), rotation))
}

/// Rates at which every group of parameters is trained, but too low for a step to change a number: for comparing gradients.
pub(crate) fn still() -> LearningRates {
    LearningRates { harmonics: 1e-2, ..LearningRates::default() }.scaled(1e-30)
}

/// Discs of a few pixels across the camera's view and a little beyond, one of them behind the camera, and one that
/// covers much of the image.
pub(crate) fn seedlings(camera: &Camera, count: usize, seed: Seed) -> Vec<Seedling> {
    let mut rng = seed.derive("seedlings").rng();
    let k = &camera.intrinsics;
    let spacing = ((k.width * k.height) as f64 / count as f64).sqrt();
    let seedling = |i: usize| {
        let depth = if i == 5 { -0.5 } else { rng.random_range(0.6..1.6) };
        let (right, down) = (rng.random_range(-0.05..1.05), rng.random_range(-0.05..1.05));
        let p_w = camera.unproject(right * k.width as f64, down * k.height as f64, depth);
        let size = if i == 9 { 8.0 } else { 1.2 };
        let sigma = (size * spacing * depth.abs() / k.fx) as f32;
        let mut between = |low: f32, high: f32| rng.random_range(low..high);
        let rotation = [(); 4].map(|()| between(-1.0, 1.0));
        Seedling {
            position_w: p_w.as_vec3(),
            rotation_wg: Quat::from_array(rotation),
            scale: sigma * Vec3::new(between(0.6, 1.4), between(0.6, 1.4), between(0.1, 0.4)),
            opacity: between(0.2, 0.95),
            color: [(); 3].map(|()| between(0.0, 1.0)),
            harmonics: std::array::from_fn(|_| between(-0.3, 0.3)),
            affinity: [(); AFFINITY_DIM].map(|()| between(-1.0, 1.0)),
        }
    };
    (0..count).map(seedling).collect()
}

/// Random observations with holes in every buffer, values that are not finite among them.
pub(crate) fn frame(camera: &Camera, seed: Seed) -> TrainFrame {
    let mut rng = seed.derive("frame").rng();
    let pixels = camera.intrinsics.width * camera.intrinsics.height;
    let mut frame =
        TrainFrame { camera: *camera, color: vec![], depth: vec![], normal_w: vec![], label: vec![] };
    for i in 0..pixels {
        frame.color.push([rng.random(), rng.random(), rng.random()]);
        let depth = rng.random_range(0.5..2.0);
        frame.depth.push(if i % 4 == 1 { 0.0 } else { depth });
        let normal = Vec3::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0), -1.0).normalize();
        frame.normal_w.push(if i % 7 == 0 { [0.0; 3] } else { normal.to_array() });
        let label = rng.random_range(0..=CLASSES as u16);
        frame.label.push(if usize::from(label) < CLASSES { label } else { u16::MAX });
    }
    frame.color[pixels / 3] = [0.5, f32::NAN, 0.5];
    frame.color[pixels / 2] = [f32::INFINITY; 3];
    frame.depth[pixels / 5] = f32::NAN;
    frame.normal_w[pixels / 6] = [f32::NAN, 0.0, 1.0];
    frame
}

/// Fills a trainer without Gaussians with `count` of them and two views.
pub(crate) fn fill(trainer: &mut dyn Trainer, size: (usize, usize), count: usize) {
    let camera = camera(size);
    trainer.set_background(BACKGROUND);
    trainer.insert(&seedlings(&camera, count, Seed(3)));
    trainer.add_frame(frame(&camera, Seed(4)));
    trainer.add_frame(frame(&camera, Seed(5)));
}
