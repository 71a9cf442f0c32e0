//! Differentiable 3D Gaussians: model, losses, training schedule, CPU back end, checkpoint and PLY.

mod config;
mod cpu;
mod model;
pub mod oracle;
pub mod parameters;
mod scan;
#[cfg(test)]
mod test_scene;
mod trainer;

pub use config::{DepthTerm, LearningRates, LossWeights, TrainConfig};
pub use cpu::limits;
pub use cpu::{CpuTrainer, StepTimes};
pub use model::{AFFINITY_DIM, Classifier, GaussianModel, HIDDEN_DIM};
pub use scan::{
    LossSample, Preset, PruningConfig, ScanConfig, ScanError, ScanResult, SeedingConfig, StopConfig,
    ViewRender, ViewScore, classifier_path, read_ply, render_views, render_views_with, scan, seedlings_of,
    state_of_model, write_ply,
};
pub use trainer::{
    FrameId, LossTerms, RenderedMaps, Seedling, StepStats, TrainFrame, TrainState, Trainer, TrainerError,
};
