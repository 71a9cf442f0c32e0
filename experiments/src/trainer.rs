//! Back ends of an experiment's scans.

use crate::BenchError;
use sms_core::Seed;
use sms_gaussians::{CpuTrainer, TrainConfig, Trainer};
use std::fmt;
use std::sync::Arc;

type Make = dyn Fn(&TrainConfig, usize, Seed) -> Result<Box<dyn Trainer>, BenchError> + Send + Sync;

/// Makes the trainer of each scan. The default is the CPU's, so that figures of different machines compare.
#[derive(Clone)]
pub struct TrainerMaker {
    device: String,
    make: Arc<Make>,
}

impl TrainerMaker {
    /// Trainers of another back end: `device` is its name in results, and `make` is given settings, number of classes
    /// and seed.
    pub fn new(
        device: impl Into<String>,
        make: impl Fn(&TrainConfig, usize, Seed) -> Result<Box<dyn Trainer>, BenchError> + Send + Sync + 'static,
    ) -> Self {
        Self { device: device.into(), make: Arc::new(make) }
    }

    /// Name of the back end.
    pub fn device(&self) -> &str {
        &self.device
    }

    pub(crate) fn make(
        &self,
        train: &TrainConfig,
        classes: usize,
        seed: Seed,
    ) -> Result<Box<dyn Trainer>, BenchError> {
        (self.make)(train, classes, seed)
    }
}

impl Default for TrainerMaker {
    fn default() -> Self {
        Self::new("cpu", |train, classes, seed| Ok(Box::new(CpuTrainer::new(train, classes, seed))))
    }
}

impl fmt::Debug for TrainerMaker {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("TrainerMaker").field(&self.device).finish()
    }
}
