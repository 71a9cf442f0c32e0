//! A small random scene with an observed view, for tests.

use crate::{AFFINITY_DIM, Seedling, TrainFrame};
use glamx::{DPose3, DQuat, DVec3, EulerRot, Quat, Vec3};
use rand::RngExt;
use sms_core::{Camera, Intrinsics, Seed};

/// Classes of the scene.
pub(crate) const CLASSES: usize = 5;

/// A camera looking roughly along +z of the world, principal point off the centre.
pub(crate) fn camera(width: usize, height: usize) -> Camera {
    let rotation = DQuat::from_euler(EulerRot::XYZ, 0.05, -0.1, 0.03);
    let (w, h) = (width as f64, height as f64);
    let intrinsics = Intrinsics { width, height, fx: 0.9 * w, fy: 0.92 * w, cx: 0.48 * w, cy: 0.53 * h };
    Camera::new(intrinsics, DPose3::from_parts(DVec3::new(0.1, -0.05, -1.0), rotation))
}

/// Gaussians of a few pixels each across the camera's view, some just outside it, one behind the camera.
pub(crate) fn seedlings(camera: &Camera, count: usize, seed: Seed) -> Vec<Seedling> {
    let mut rng = seed.derive("seedlings").rng();
    let k = &camera.intrinsics;
    let spacing = ((k.width * k.height) as f64 / count as f64).sqrt();
    (0..count)
        .map(|i| {
            let z = rng.random_range(0.6..1.6);
            let (u, v) = (rng.random_range(-0.05..1.05), rng.random_range(-0.05..1.05));
            let z = if i == 3 { -0.4 } else { z };
            let p_w = camera.unproject(u * k.width as f64, v * k.height as f64, z);
            let sigma = (1.2 * spacing * z.abs() / k.fx) as f32;
            let mut part = |low: f32, high: f32| rng.random_range(low..high);
            Seedling {
                position_w: p_w.as_vec3(),
                rotation_wg: Quat::from_xyzw(
                    part(-1.0, 1.0),
                    part(-1.0, 1.0),
                    part(-1.0, 1.0),
                    part(-1.0, 1.0),
                ),
                scale: sigma * Vec3::new(part(0.6, 1.4), part(0.6, 1.4), part(0.1, 0.4)),
                opacity: part(0.2, 0.95),
                color: [part(0.0, 1.0), part(0.0, 1.0), part(0.0, 1.0)],
                harmonics: std::array::from_fn(|_| part(-0.3, 0.3)),
                affinity: std::array::from_fn::<f32, AFFINITY_DIM, _>(|_| part(-1.0, 1.0)),
            }
        })
        .collect()
}

/// Random observations with holes in every buffer, NaN among them.
pub(crate) fn frame(camera: Camera, seed: Seed) -> TrainFrame {
    let mut rng = seed.derive("frame").rng();
    let pixels = camera.intrinsics.width * camera.intrinsics.height;
    let mut frame = TrainFrame { camera, color: vec![], depth: vec![], normal_w: vec![], label: vec![] };
    for i in 0..pixels {
        frame.color.push([rng.random(), rng.random(), rng.random()]);
        frame.depth.push(if i % 3 == 0 { 0.0 } else { rng.random_range(0.5..2.0) });
        let n = Vec3::new(rng.random_range(-1.0..1.0), rng.random_range(-1.0..1.0), -1.0).normalize();
        frame.normal_w.push(if i % 5 == 0 { [0.0; 3] } else { n.to_array() });
        let label = rng.random_range(0..CLASSES as u16 + 1);
        frame.label.push(if usize::from(label) < CLASSES { label } else { u16::MAX });
    }
    frame.color[7] = [0.5, f32::NAN, 0.5];
    frame.color[pixels / 2] = [f32::INFINITY; 3];
    frame.depth[10] = f32::NAN;
    frame.normal_w[11] = [f32::NAN, 0.0, 1.0];
    frame
}
