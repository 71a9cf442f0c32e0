//! GPU back end of the scan: whole training steps in WGSL through `wgpu`.
//!
//! [`GpuTrainer`] implements [`sms_gaussians::Trainer`] with the state, settings and semantics of the CPU trainer. The
//! two differ only in time and rounding, and each can continue a checkpoint of the other. Parameters and moments live
//! on the device; up to 64 steps are submitted at once, and only their losses are read back. The kernels are in
//! `shaders/`, in the order of a step: `project`, `visit` (twice), `place`, `sort`, `forward`, `ssim`, `loss`,
//! `segment`, `backward`, `reduce`, `update`, `finish`. Their cost, and rejected variants, are in
//! `experiments/studies/gpu.md`.
//!
//! [`checked_trainer`] first compares the adapter with the CPU on a small scene ([`self_check`]).
//!
//! ```no_run
//! use sms_core::Seed;
//! use sms_gaussians::TrainConfig;
//! use sms_gaussians_gpu::{AdapterChoice, adapters, checked_trainer};
//!
//! for adapter in adapters() {
//!     println!("{}: {} ({})", adapter.index, adapter.name, adapter.driver);
//! }
//! let trainer = checked_trainer(&TrainConfig::default(), 3, Seed(1), AdapterChoice::Best)?;
//! println!("training on {}", trainer.adapter().name);
//! # Ok::<(), sms_gaussians_gpu::GpuError>(())
//! ```

mod check;
mod compare;
mod gpu;
mod kernels;
mod maps;
mod probe;
mod rows;
mod steps;
mod store;
mod target;
mod trainer;
mod uniforms;
mod unroll;
mod work;

pub use check::{SelfCheck, checked_trainer, self_check};
pub use compare::ErrorSpread;
pub use gpu::{AdapterChoice, AdapterSummary, GpuError, adapters};
pub use trainer::{GpuTrainer, MAX_CLASSES};

#[cfg(test)]
#[path = "../../sms-gaussians/tests/oracle/mod.rs"]
mod oracle;
#[cfg(test)]
mod tests;
