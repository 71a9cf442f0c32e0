//! CPU time of a training step of a fixed scene, comparable between machines' runs and versions.

use crate::process::cpu_seconds;
use glamx::{DVec3, Quat, Vec3};
use rand::RngExt;
use sms_core::metrics::Metrics;
use sms_core::{Camera, Intrinsics, Seed};
use sms_gaussians::{AFFINITY_DIM, CpuTrainer, Seedling, StepTimes, TrainConfig, TrainFrame, Trainer};

/// Gaussians of the fixed scene.
pub const STEP_GAUSSIANS: usize = 20_000;
const CLASSES: usize = 8;

/// CPU milliseconds of one full training step with [`STEP_GAUSSIANS`] Gaussians at `width` × `height`, summed over
/// threads: the median of several short batches. The scene is a bumpy wall of discs that fill the view, about as dense as
/// a scan leaves them, all inside the frustum (the same as in the crate's `benches/step.rs`). `None` where the system
/// does not tell CPU times.
pub fn fixed_step_cpu_ms(train: &TrainConfig, width: usize, height: usize) -> Option<f64> {
    const BATCHES: usize = 7;
    const STEPS: usize = 4;
    let camera = Camera::look_at(
        Intrinsics::from_fov(width, height, 1.1),
        DVec3::new(0.0, -0.7, 0.6),
        DVec3::new(0.0, 0.0, 0.05),
        DVec3::Z,
    );
    let mut trainer = CpuTrainer::new(train, CLASSES, Seed(3));
    trainer.insert(&discs(&camera, STEP_GAUSSIANS, Seed(2)));
    let maps = trainer.render(&camera);
    trainer.retain(&vec![false; STEP_GAUSSIANS]);
    trainer.insert(&discs(&camera, STEP_GAUSSIANS, Seed(1)));
    let label = (0..width * height).map(|i| ((i % width / 40 + i / width / 40) % CLASSES) as u16).collect();
    let frame = trainer.add_frame(TrainFrame {
        camera,
        color: maps.color,
        depth: maps.depth,
        normal_w: maps.normal_w,
        label,
    });
    trainer.steps(&[frame; 3]);
    let mut batches = Vec::new();
    for _ in 0..BATCHES {
        let before = cpu_seconds()?;
        trainer.steps(&[frame; STEPS]);
        batches.push((cpu_seconds()? - before) / STEPS as f64 * 1e3);
    }
    batches.sort_by(f64::total_cmp);
    Some(batches[BATCHES / 2])
}

/// The share of each part in all steps of a scan, under `prefix` (`…scan_step_blend_share`).
pub fn step_shares(prefix: &str, times: &StepTimes) -> Metrics {
    let mut metrics = Metrics::new();
    let total = times.total().max(f64::MIN_POSITIVE);
    for (part, seconds) in [
        ("project", times.project),
        ("bin", times.bin),
        ("blend", times.blend),
        ("ssim", times.ssim),
        ("pixels", times.pixels),
        ("segmentation", times.segmentation),
        ("unblend", times.unblend),
        ("unproject", times.unproject),
        ("adam", times.adam),
    ] {
        metrics.set(format!("{prefix}scan_step_{part}_share"), seconds / total);
    }
    metrics
}

/// Discs facing the camera's side of a bumpy surface, one pixel spacing wide and a little tilted.
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
                affinity: std::array::from_fn::<f32, AFFINITY_DIM, _>(|_| part(-0.5, 0.5) as f32),
            }
        })
        .collect()
}
