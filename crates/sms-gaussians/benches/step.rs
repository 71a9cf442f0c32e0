//! Milliseconds of one full training step on the CPU, split by part, in both compiled forms.
//!
//! `cargo bench -p sms-gaussians [-- THREADS] [detected]`; with `detected` the portable form is left out. The scene is a wall of discs about as dense as a scan leaves them.

use rand::RngExt;
use sms_core::glamx::{DVec3, Quat, Vec3};
use sms_core::{Camera, Intrinsics, Seed};
use sms_gaussians::{AFFINITY_DIM, CpuTrainer, Seedling, StepTimes, TrainConfig, TrainFrame, Trainer};

const CLASSES: usize = 8;

fn camera(width: usize, height: usize) -> Camera {
    Camera::look_at(
        Intrinsics::from_fov(width, height, 1.1),
        DVec3::new(0.0, -0.7, 0.6),
        DVec3::new(0.0, 0.0, 0.05),
        DVec3::Z,
    )
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

/// CPU seconds of all threads of this process so far, where the system tells (Linux); less disturbed by other work
/// than the clock on the wall.
fn cpu_seconds() -> Option<f64> {
    let mut nanoseconds = 0.0;
    for task in std::fs::read_dir("/proc/self/task").ok()? {
        let text = std::fs::read_to_string(task.ok()?.path().join("schedstat")).ok()?;
        nanoseconds += text.split_whitespace().next()?.parse::<f64>().ok()?;
    }
    Some(nanoseconds * 1e-9)
}

/// The shortest step by the clock with its parts, and the mean CPU seconds of a step.
fn measure(
    mut trainer: CpuTrainer,
    (width, height): (usize, usize),
    count: usize,
    steps: usize,
) -> (f64, StepTimes, f64) {
    let camera = camera(width, height);
    trainer.insert(&discs(&camera, count, Seed(2)));
    let maps = trainer.render(&camera);
    trainer.retain(&vec![false; count]);
    trainer.insert(&discs(&camera, count, Seed(1)));
    let label = (0..width * height).map(|i| ((i % width / 40 + i / width / 40) % CLASSES) as u16).collect();
    trainer.add_frame(TrainFrame {
        camera,
        color: maps.color,
        depth: maps.depth,
        normal_w: maps.normal_w,
        label,
    });
    trainer.steps(&[0; 3]);
    // The best of several short runs: other work on the machine only ever adds time.
    let mut best = (f64::INFINITY, StepTimes::default());
    let cpu = cpu_seconds();
    for _ in 0..steps {
        let before = trainer.times();
        let start = std::time::Instant::now();
        trainer.steps(&[0]);
        let seconds = start.elapsed().as_secs_f64();
        if seconds < best.0 {
            best = (seconds, trainer.times().since(&before));
        }
    }
    let cpu = cpu.zip(cpu_seconds()).map_or(f64::NAN, |(from, to)| (to - from) / steps as f64);
    (best.0, best.1, cpu)
}

fn main() {
    let threads = std::env::args().skip(1).find_map(|a| a.parse().ok()).unwrap_or(1);
    let detected = std::env::args().any(|a| a == "detected");
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
    println!("milliseconds of one step, best of several, {threads} thread(s); parts are summed over threads");
    let parts = "project     bin   blend    ssim  pixels segment unblend unproj.    adam";
    println!("{:>9} {:>6} {:>9} {:>8} {:>8}  {parts}", "size", "count", "form", "wall", "cpu");
    let config = TrainConfig::default();
    for size in [(320, 200), (640, 400)] {
        for count in [10_000, 20_000] {
            let mut steps = [0.0; 2];
            for (form, name) in ["portable", "detected"].into_iter().enumerate().skip(usize::from(detected)) {
                let (seconds, t, cpu) = pool.install(|| {
                    let new = if form == 0 { CpuTrainer::portable } else { CpuTrainer::new };
                    measure(new(&config, CLASSES, Seed(3)), size, count, if form == 0 { 6 } else { 20 })
                });
                steps[form] = seconds;
                let parts = [
                    t.project,
                    t.bin,
                    t.blend,
                    t.ssim,
                    t.pixels,
                    t.segmentation,
                    t.unblend,
                    t.unproject,
                    t.adam,
                ];
                let parts: Vec<String> = parts.iter().map(|s| format!("{:7.2}", s * 1e3)).collect();
                let size = format!("{}x{}", size.0, size.1);
                println!(
                    "{size:>9} {count:>6} {name:>9} {:>8.2} {:>8.2}  {}",
                    seconds * 1e3,
                    cpu * 1e3,
                    parts.join(" ")
                );
            }
            if !detected {
                println!("{:>26} {:>8.2}", "ratio", steps[0] / steps[1]);
            }
        }
    }
}
