//! Tests of the whole back end.

use super::*;
use crate::{AFFINITY_DIM, TrainFrame};
use glamx::{DPose3, DQuat, DVec3, Quat};
use rand::RngExt;
use sms_core::Intrinsics;

/// A camera looking along +z of the world, a little turned.
fn camera(width: usize, height: usize) -> Camera {
    let rotation = DQuat::from_euler(glamx::EulerRot::XYZ, 0.05, -0.1, 0.03);
    Camera::new(
        Intrinsics {
            width,
            height,
            fx: 0.9 * width as f64,
            fy: 0.92 * width as f64,
            cx: 0.48 * width as f64,
            cy: 0.53 * height as f64,
        },
        DPose3::from_parts(DVec3::new(0.1, -0.05, -1.0), rotation),
    )
}

#[test]
fn one_gaussian_is_seen_where_it_is() {
    let camera = camera(64, 40);
    let p_w = camera.unproject(30.5, 20.5, 1.2);
    let mut trainer = CpuTrainer::new(&TrainConfig::default(), 3, Seed(1));
    trainer.insert(&[Seedling {
        position_w: p_w.as_vec3(),
        rotation_wg: Quat::IDENTITY,
        scale: Vec3::new(0.02, 0.02, 0.002),
        opacity: 0.8,
        color: [0.5, 0.25, 1.0],
        affinity: [0.1; AFFINITY_DIM],
    }]);
    let maps = trainer.render(&camera);
    let i = 20 * 64 + 30;
    assert!((maps.alpha[i] - 0.8).abs() < 1e-3, "{}", maps.alpha[i]);
    assert!((maps.color[i][2] - 0.8).abs() < 1e-3);
    assert!((maps.depth[i] - 1.2).abs() < 1e-4);
    assert!((maps.normal_w[i][2] + 0.8).abs() < 1e-3, "faces the camera: {:?}", maps.normal_w[i]);
    assert_eq!(maps.alpha[0], 0.0);
    let _ = (
        Seed(0).rng().random::<f32>(),
        TrainFrame { camera, color: vec![], depth: vec![], normal_w: vec![], label: vec![] },
    );
}
