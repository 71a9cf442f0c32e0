//! CPU time of a training step on a fixed scene, to compare runs and versions.

use crate::cpu_time::cpu_seconds;
use crate::wall::{WALL_CLASSES, fill_wall};
use sms_core::Seed;
use sms_core::metrics::Metrics;
use sms_gaussians::{CpuTrainer, StepTimes, TrainConfig, Trainer};

/// Gaussians of the fixed scene.
pub const STEP_GAUSSIANS: usize = 20_000;

/// Returns the CPU milliseconds of one full training step with [`STEP_GAUSSIANS`] Gaussians at `width` × `height`, summed over
/// threads: the median of several short batches. The scene is that of `fill_wall`. `None` if the system
/// does not report CPU times.
pub fn fixed_step_cpu_ms(train: &TrainConfig, width: usize, height: usize) -> Option<f64> {
    const BATCHES: usize = 7;
    const STEPS: usize = 4;
    let mut trainer = CpuTrainer::new(train, WALL_CLASSES, Seed(3));
    let frame = fill_wall(&mut trainer, (width, height), STEP_GAUSSIANS);
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
    for (part, seconds) in StepTimes::NAMES.into_iter().zip(times.parts()) {
        metrics.set(format!("{prefix}scan_step_{part}_share"), seconds / total);
    }
    metrics
}
