//! Differentiable 3D Gaussians: model, losses, training schedule, CPU back end, checkpoint and PLY.
//!
//! [`scan`] turns posed RGB-D frames with labels into a [`GaussianModel`] (paper, Section "Scan"): each frame is seeded
//! and optimised in turn while earlier frames are replayed, or all frames are fused into one surface first
//! ([`ScanOrder`]). A back end is a [`Trainer`], which takes whole training
//! steps. This crate contains [`CpuTrainer`]; its tests compare with a reference in double precision (`tests/oracle`).
//! [`write_ply`] and [`read_ply`] store the model as a standard 3D Gaussian Splatting file.
//!
//! ```
//! use sms_core::{BACKGROUND, Camera, Cancel, Image, Intrinsics, Labels, MaskSource};
//! use sms_core::{Seed, StageContext, Warnings};
//! use sms_core::glamx::DPose3;
//! use sms_frames::{Frame, Sequence};
//! use sms_gaussians::{CpuTrainer, Preset, ScanConfig, read_ply, scan};
//! // One grey wall, half a metre away.
//! let camera = Camera::new(Intrinsics::from_fov(32, 20, 0.6), DPose3::identity());
//! let color = Image::filled(32, 20, [128; 3]);
//! let depth = Image::filled(32, 20, 0.5);
//! let frame = Frame::new(camera, color, depth, Image::filled(32, 20, [0.0, 0.0, -1.0]));
//! let sequence =
//!     Sequence { frames: vec![frame], x_world_recording: DPose3::identity(), source: "wall".into() };
//! let labels =
//!     Labels { maps: vec![Image::filled(32, 20, BACKGROUND)], objects: vec![], source: MaskSource::Files };
//! let config = ScanConfig::preset(Preset::Draft);
//! let seed = Seed(1);
//! let mut trainer = CpuTrainer::new(&config.train, labels.class_count(), seed);
//! let dir = tempfile::tempdir()?;
//! let (cancel, warnings) = (Cancel::new(), Warnings::new());
//! let context = StageContext::quiet(&cancel, &warnings).with_seed(seed);
//! let result = scan(&sequence, &labels, &config, dir.path(), &mut trainer, &mut (), context)?;
//! assert!(result.model.positions_w.iter().all(|p| (p.z - 0.5).abs() < 1e-3));
//! assert_eq!(read_ply(&dir.path().join("scene.ply"))?.len(), result.model.len());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#[cfg(test)]
extern crate self as sms_gaussians;

mod config;
mod cpu;
pub mod harmonics;
mod model;
#[cfg(test)]
#[path = "../tests/oracle/mod.rs"]
mod oracle;
#[cfg(test)]
mod oracle_tests;
pub mod parameters;
mod scan;
#[cfg(test)]
mod test_scene;
mod trainer;

pub use config::{DepthTerm, LearningRates, LossWeights, TrainConfig};
pub use cpu::limits;
pub use cpu::{CpuTrainer, SimdForm, StepTimes};
pub(crate) use model::HIDDEN_DIM;
pub use model::{AFFINITY_DIM, Classifier, GaussianModel};
pub use scan::{
    BatchDone, FusedConfig, GROWING_CLASSES, GrowingScan, LossSample, Preset, PruningConfig, ScanConfig,
    ScanError, ScanObserver, ScanOrder, ScanResult, ScanResumed, SeedingConfig, SlotDone, StageSeconds,
    StopConfig, ViewRender, ViewScore, read_ply, render_views, scan, write_ply,
};
pub use trainer::{
    FrameId, LossTerms, RenderedMaps, Seedling, StepBatch, StepStats, TrainFrame, TrainState, Trainer,
    TrainerError,
};
