//! A fixed scene for timing training steps: a wall of discs about as dense as in a scan, and a view of another such
//! wall. Timings of other crates include this file by its path.

use rand::RngExt;
use sms_core::glamx::{DVec3, Quat, Vec3};
use sms_core::{Camera, Intrinsics, Seed};
use sms_gaussians::{AFFINITY_DIM, FrameId, Seedling, TrainFrame, Trainer};

/// Number of classes of the wall's labels.
pub(crate) const WALL_CLASSES: usize = 8;

/// Fills an empty trainer with a wall of `count` discs and a frame of `width` × `height` pixels of another wall,
/// and takes three steps to grow the buffers. Returns the frame.
pub(crate) fn fill_wall(trainer: &mut dyn Trainer, (width, height): (usize, usize), count: usize) -> FrameId {
    let camera = Camera::look_at(
        Intrinsics::from_fov(width, height, 1.1),
        DVec3::new(0.0, -0.7, 0.6),
        DVec3::new(0.0, 0.0, 0.05),
        DVec3::Z,
    );
    trainer.insert(&discs(&camera, count, Seed(2)));
    let maps = trainer.render(&camera);
    trainer.retain(&vec![false; count]);
    trainer.insert(&discs(&camera, count, Seed(1)));
    let label =
        (0..width * height).map(|i| ((i % width / 40 + i / width / 40) % WALL_CLASSES) as u16).collect();
    let frame = trainer.add_frame(TrainFrame {
        camera,
        color: maps.color,
        depth: maps.depth,
        normal_w: maps.normal_w,
        label,
    });
    trainer.steps(&[frame; 3]);
    frame
}

/// Discs on a bumpy surface that faces the camera, one pixel spacing wide and slightly tilted.
fn discs(camera: &Camera, count: usize, seed: Seed) -> Vec<Seedling> {
    let mut rng = seed.rng();
    let k = &camera.intrinsics;
    let spacing = ((k.width * k.height) as f64 / count as f64).sqrt();
    (0..count)
        .map(|_| {
            let mut part = |low: f64, high: f64| rng.random_range(low..high);
            let (u, v) = (part(0.0, k.width as f64), part(0.0, k.height as f64));
            let z = 0.8 + 0.1 * (u / 40.0).sin() * (v / 30.0).cos() + part(-0.003, 0.003);
            let sigma = 0.8 * spacing * z / k.fx;
            let tilt = Quat::from_xyzw(part(-0.2, 0.2) as f32, part(-0.2, 0.2) as f32, 0.0, 1.0).normalize();
            Seedling {
                position_w: camera.unproject(u, v, z).as_vec3(),
                rotation_wg: camera.x_wc.rotation.as_quat() * tilt,
                scale: Vec3::new(
                    (sigma * part(0.7, 1.4)) as f32,
                    (sigma * part(0.7, 1.4)) as f32,
                    0.15 * sigma as f32,
                ),
                opacity: part(0.3, 0.95) as f32,
                color: [part(0.0, 1.0) as f32, part(0.0, 1.0) as f32, part(0.0, 1.0) as f32],
                harmonics: sms_gaussians::harmonics::CONSTANT,
                affinity: std::array::from_fn::<f32, AFFINITY_DIM, _>(|_| part(-0.5, 0.5) as f32),
            }
        })
        .collect()
}
