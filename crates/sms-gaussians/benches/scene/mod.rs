//! The trainer for the benches.

mod wall;

use sms_core::Seed;
use sms_gaussians::{CpuTrainer, SimdForm, TrainConfig};
use wall::{WALL_CLASSES, fill_wall};

/// A trainer of `count` Gaussians with one frame, after three steps; `None` if this CPU cannot run the form.
pub(crate) fn trainer(
    config: &TrainConfig,
    form: SimdForm,
    size: (usize, usize),
    count: usize,
) -> Option<CpuTrainer> {
    let mut trainer = CpuTrainer::with_form(config, WALL_CLASSES, Seed(3), form)?;
    fill_wall(&mut trainer, size, count);
    Some(trainer)
}
