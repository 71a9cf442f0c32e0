//! Milliseconds of training steps of the fixed scene, and of each kernel: `step_times GAUSSIANS WIDTH HEIGHT [ADAPTER]`.
//!
//! The wall of discs of [`fill_wall`] as the CPU's benchmark takes it, so that figures can be compared.

use sms_core::Seed;
use sms_gaussians::{TrainConfig, Trainer, WALL_CLASSES, fill_wall};
use sms_gaussians_gpu::{Choice, GpuTrainer};
use std::time::Instant;

/// Steps of one timed submission.
const STEPS: usize = 50;
/// Timed submissions, of which the median counts.
const BATCHES: usize = 9;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<usize> = std::env::args().skip(1).map(|a| a.parse()).collect::<Result<_, _>>()?;
    let (&[count, width, height], rest) =
        arguments.split_first_chunk().ok_or("give GAUSSIANS WIDTH HEIGHT [ADAPTER]")?;
    let choice = rest.first().map_or(Choice::Best, |index| Choice::Index(*index));
    let mut trainer = GpuTrainer::new(&TrainConfig::default(), WALL_CLASSES, Seed(3), choice)?;
    let frame = fill_wall(&mut trainer, (width, height), count);
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
