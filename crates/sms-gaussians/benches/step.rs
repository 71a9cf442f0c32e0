//! Milliseconds of one full training step on the CPU, split by part, in every compiled form that this CPU can run.
//!
//! `cargo bench -p sms-gaussians --bench step [-- THREADS] [portable|avx2|avx512|detected]… [share=SHARE]`. The scene is a
//! wall of discs about as dense as a scan leaves them.

use rand::RngExt;
use sms_core::glamx::{DVec3, Quat, Vec3};
use sms_core::{Camera, Intrinsics, Seed};
use sms_gaussians::{
    AFFINITY_DIM, CpuTrainer, Seedling, SimdForm, StepTimes, TrainConfig, TrainFrame, Trainer,
};

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

/// Steps whose CPU time is measured together.
const GROUP: usize = 10;

/// The shortest step by the clock, the shortest of each part, and the CPU seconds of a step in the best
/// group.
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
    let mut best = (f64::INFINITY, StepTimes::from_parts([f64::INFINITY; StepTimes::PARTS]));
    let (mut least, mut cpu) = (f64::INFINITY, cpu_seconds());
    for step in 0..steps {
        let before = trainer.times();
        let start = std::time::Instant::now();
        trainer.steps(&[0]);
        let seconds = start.elapsed().as_secs_f64();
        best = (best.0.min(seconds), best.1.shorter(&trainer.times().since(&before)));
        // The system counts CPU time in ticks of some milliseconds: whole groups of steps are measured.
        if step % GROUP == GROUP - 1 {
            let now = cpu_seconds();
            least = least.min(cpu.zip(now).map_or(f64::NAN, |(from, to)| (to - from) / GROUP as f64));
            cpu = now;
        }
    }
    (best.0, best.1, least)
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let threads = arguments.iter().find_map(|a| a.parse().ok()).unwrap_or(1);
    let named = |form: &SimdForm| arguments.contains(&format!("{form:?}").to_lowercase());
    let mut forms = SimdForm::available().to_vec();
    if arguments.iter().any(|a| a == "detected") {
        forms.drain(..forms.len() - 1);
    } else if forms.iter().any(named) {
        forms.retain(named);
    }
    let share = arguments.iter().find_map(|a| a.strip_prefix("share=")?.parse().ok());
    let config = TrainConfig { segmentation_share: share.unwrap_or(1.0), ..TrainConfig::default() };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("a thread pool");
    println!(
        "milliseconds of one step, shortest of several, {threads} thread(s); parts are summed over threads"
    );
    let names = StepTimes::NAMES.map(|name| format!("{:>7}", &name[..name.len().min(7)])).join(" ");
    println!("{:>9} {:>6} {:>9} {:>8} {:>8} {:>8}  {names}", "size", "count", "form", "wall", "cpu", "parts");
    for size in [(320, 200), (640, 400)] {
        for count in [10_000, 20_000] {
            for &form in &forms {
                let steps = if form == SimdForm::Portable { 10 } else { 100 };
                let Some(trainer) = CpuTrainer::with_form(&config, CLASSES, Seed(3), form) else {
                    continue;
                };
                let (seconds, times, cpu) = pool.install(|| measure(trainer, size, count, steps));
                let parts = times.parts().map(|s| format!("{:7.2}", s * 1e3)).join(" ");
                let size = format!("{}x{}", size.0, size.1);
                println!(
                    "{size:>9} {count:>6} {:>9} {:>8.2} {:>8.2} {:>8.2}  {parts}",
                    format!("{form:?}").to_lowercase(),
                    seconds * 1e3,
                    cpu * 1e3,
                    times.total() * 1e3,
                );
            }
        }
    }
}
