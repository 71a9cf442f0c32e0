//! Times training steps of a fixed scene, and each kernel, in milliseconds: `step_times GAUSSIANS WIDTH HEIGHT
//! [--adapter N] [--export DIR]`.
//!
//! The scene is the wall of discs of [`fill_wall`], as in the CPU's benchmark. `--export` also writes it for
//! `benches/peers/gsplat_wall.py`.

#[path = "../../sms-gaussians/benches/scene/wall.rs"]
mod wall;

use sms_core::glamx::{DMat4, DVec3};
use sms_core::{Camera, Intrinsics, Seed};
use sms_gaussians::{GaussianModel, TrainConfig, Trainer, write_ply};
use sms_gaussians_gpu::{AdapterChoice, GpuTrainer};
use std::path::Path;
use std::time::Instant;
use wall::{WALL_CLASSES, fill_wall};

/// Steps of one timed submission.
const STEPS: usize = 50;
/// Number of timed submissions; the median is reported.
const BATCHES: usize = 9;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).filter(|a| a != "--bench").collect();
    let option = |name: &str| {
        let at = arguments.iter().position(|a| a == name)?;
        arguments.get(at + 1).map(String::as_str)
    };
    let number = |i: usize| arguments.get(i).and_then(|a| a.parse::<usize>().ok());
    let (Some(count), Some(width), Some(height)) = (number(0), number(1), number(2)) else {
        return Err("give GAUSSIANS WIDTH HEIGHT [--adapter N] [--export DIR]".into());
    };
    let choice =
        option("--adapter").map(str::parse).transpose()?.map_or(AdapterChoice::Best, AdapterChoice::Index);
    let mut trainer = GpuTrainer::new(&TrainConfig::default(), WALL_CLASSES, Seed(3), choice)?;
    let frame = fill_wall(&mut trainer, (width, height), count);
    if let Some(folder) = option("--export") {
        export(&trainer.model(), (width, height), Path::new(folder))?;
    }
    let mut batches: Vec<f64> = (0..BATCHES)
        .map(|_| {
            let began = Instant::now();
            trainer.steps(&[frame; STEPS]);
            began.elapsed().as_secs_f64() * 1e3 / STEPS as f64
        })
        .collect();
    batches.sort_by(f64::total_cmp);
    let name = &trainer.adapter().name;
    println!(
        "{name}: {count} Gaussians, {width}×{height}: {:.3} ms a step, {} MiB on the device, {:.1} pairs a Gaussian",
        batches[BATCHES / 2],
        trainer.device_bytes() >> 20,
        f64::from(trainer.last_pairs()) / count as f64,
    );
    // Medians kernel by kernel.
    let mut times: Vec<(&str, Vec<f64>)> = Vec::new();
    for _ in 0..BATCHES {
        let Some(step) = trainer.timed_step(frame) else {
            break;
        };
        times.resize_with(step.len(), || ("", Vec::new()));
        for ((name, all), (kernel, ms)) in times.iter_mut().zip(step) {
            *name = kernel;
            all.push(ms);
        }
    }
    let mut sum = 0.0;
    for (name, mut all) in times {
        all.sort_by(f64::total_cmp);
        let median = all[all.len() / 2];
        sum += median;
        println!("  {name:9} {:8.1} µs", 1e3 * median);
    }
    println!("  {:9} {:8.1} µs", "all", 1e3 * sum);
    trainer.failure().map_or(Ok(()), |reason| Err(reason.into()))
}

/// Writes the wall's Gaussians and its camera, which is the one of [`fill_wall`].
fn export(
    model: &GaussianModel,
    (width, height): (usize, usize),
    folder: &Path,
) -> Result<(), Box<dyn std::error::Error>> {
    std::fs::create_dir_all(folder)?;
    write_ply(model, &folder.join("scene.ply"))?;
    let intrinsics = Intrinsics::from_fov(width, height, 1.1);
    let camera =
        Camera::look_at(intrinsics, DVec3::new(0.0, -0.7, 0.6), DVec3::new(0.0, 0.0, 0.05), DVec3::Z);
    let x_cw = camera.x_wc.inverse();
    let matrix = DMat4::from_rotation_translation(x_cw.rotation, x_cw.translation);
    let rows: Vec<String> = (0..4).map(|i| format!("{:?}", matrix.row(i).to_array())).collect();
    let k = camera.intrinsics;
    let text = format!(
        r#"{{"width": {width}, "height": {height}, "x_cw": [{}], "k": [[{}, 0, {}], [0, {}, {}], [0, 0, 1]]}}"#,
        rows.join(", "),
        k.fx,
        k.cx,
        k.fy,
        k.cy
    );
    std::fs::write(folder.join("camera.json"), text)?;
    Ok(())
}
