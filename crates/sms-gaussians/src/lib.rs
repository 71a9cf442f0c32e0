//! Differentiable 3D Gaussians: model, losses, training schedule, CPU back end, checkpoint and PLY.

mod config;
mod cpu;
mod model;
pub mod parameters;
mod trainer;

pub use config::{DepthTerm, LearningRates, LossWeights, TrainConfig};
pub use cpu::{CpuTrainer, StepTimes};
pub use model::{AFFINITY_DIM, Classifier, GaussianModel, HIDDEN_DIM};
pub use trainer::{
    FrameId, LossTerms, RenderedMaps, Seedling, StepStats, TrainFrame, TrainState, Trainer, TrainerError,
};
