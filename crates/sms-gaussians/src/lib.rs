//! Differentiable 3D Gaussians: model, losses, training schedule, CPU back end, checkpoint and PLY.

mod model;
mod trainer;

pub use model::{AFFINITY_DIM, Classifier, GaussianModel, HIDDEN_DIM};
pub use trainer::{FrameId, LossTerms, RenderedMaps, Seedling, StepStats, TrainFrame, TrainState, Trainer, TrainerError};
