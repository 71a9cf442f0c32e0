//! `sms-experiments scan --device gpu`: the same scenes and figures on a GPU, with the times of its kernels.

use sms_cli::front::Console;
use sms_core::Warnings;
#[cfg(feature = "gpu")]
use sms_core::{Seed, StageContext};
use sms_experiments::{BenchOptions, BenchScene, TrainerMaker};
#[cfg(feature = "gpu")]
use sms_gaussians::TrainConfig;
use sms_pipeline::Device;
use std::path::Path;

/// Scans a scene on a GPU and measures it; never on the CPU instead.
#[cfg(feature = "gpu")]
pub(crate) fn run(
    console: &Console,
    scene: &BenchScene,
    options: &BenchOptions,
    index: Option<usize>,
    dir: &Path,
    warnings: &Warnings,
) -> anyhow::Result<()> {
    use sms_core::metrics::Metrics;
    use sms_experiments::{Prepared, run_scene_with};
    use sms_gaussians_gpu::GpuTrainer;
    let make = |train: &TrainConfig, classes, seed| checked(train, classes, seed, index);
    let figures = |prefix: &str, trainer: &mut GpuTrainer, prepared: &Prepared| {
        let mut metrics = Metrics::new();
        metrics.set(format!("{prefix}device"), trainer.adapter().name.clone());
        metrics.set(format!("{prefix}device_bytes"), trainer.device_bytes());
        metrics.set(format!("{prefix}pairs"), trainer.last_pairs());
        if let Some(ms) = step_ms(trainer, &[0; 50], 7) {
            metrics.set(format!("{prefix}step_ms"), ms);
        }
        let views: Vec<usize> = (0..prepared.trained(options.scan.holdout).len()).collect();
        if let Some(ms) = step_ms(trainer, &views, 3) {
            metrics.set(format!("{prefix}step_views_ms"), ms);
        }
        for (kernel, ms) in trainer.timed_step(0).unwrap_or_default() {
            metrics.set(format!("{prefix}step_{kernel}_ms"), ms);
        }
        metrics
    };
    run_scene_with(
        scene,
        options,
        dir,
        make,
        figures,
        StageContext::new(console.context.progress.as_ref(), &console.context.cancel, warnings),
    )?;
    Ok(())
}

/// A GPU's trainer, never the CPU's instead.
#[cfg(feature = "gpu")]
fn checked(
    train: &TrainConfig,
    classes: usize,
    seed: Seed,
    index: Option<usize>,
) -> Result<sms_gaussians_gpu::GpuTrainer, sms_experiments::BenchError> {
    use sms_gaussians_gpu::{AdapterChoice, checked_trainer};
    let choice = index.map_or(AdapterChoice::Best, AdapterChoice::Index);
    checked_trainer(train, classes, seed, choice).map_err(|error| {
        let cure = "`sms devices` lists the devices";
        sms_core::InputError::new(error.to_string(), "--device", cure).into()
    })
}

/// Back end of kept scans: `auto` is the CPU, so that figures stay comparable.
#[cfg(feature = "gpu")]
pub(crate) fn trainer_maker(device: Device) -> anyhow::Result<TrainerMaker> {
    Ok(match device {
        Device::Auto | Device::Cpu => TrainerMaker::default(),
        Device::Gpu(index) => TrainerMaker::new("gpu", move |train, classes, seed| {
            Ok(Box::new(checked(train, classes, seed, index)?))
        }),
    })
}

/// A program without GPUs says so.
#[cfg(not(feature = "gpu"))]
pub(crate) fn trainer_maker(device: Device) -> anyhow::Result<TrainerMaker> {
    match device {
        Device::Auto | Device::Cpu => Ok(TrainerMaker::default()),
        Device::Gpu(_) => Err(sms_pipeline::without_gpu().into()),
    }
}

/// Wall-clock milliseconds of a step on the scene's finished Gaussians: the median of several batches of steps on these
/// frames. The scan's own steps are fewer to a submission, and the schedule works between them.
#[cfg(feature = "gpu")]
fn step_ms(trainer: &mut sms_gaussians_gpu::GpuTrainer, frames: &[usize], batches: usize) -> Option<f64> {
    use sms_gaussians::Trainer;
    let mut all = Vec::new();
    for _ in 0..batches {
        let began = std::time::Instant::now();
        trainer.steps(frames);
        all.push(began.elapsed().as_secs_f64() * 1e3 / frames.len().max(1) as f64);
    }
    all.sort_by(f64::total_cmp);
    trainer.failure().is_none().then(|| all[batches / 2])
}

/// A program without GPUs says so.
#[cfg(not(feature = "gpu"))]
pub(crate) fn run(
    _: &Console,
    _: &BenchScene,
    _: &BenchOptions,
    _: Option<usize>,
    _: &Path,
    _: &Warnings,
) -> anyhow::Result<()> {
    Err(sms_pipeline::without_gpu().into())
}
