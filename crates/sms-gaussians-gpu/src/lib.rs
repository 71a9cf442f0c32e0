//! GPU back end of the scan: whole training steps in WGSL through `wgpu`.

mod check;
mod compare;
mod gpu;
mod kernels;
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
pub use compare::Spread;
pub use gpu::{AdapterSummary, Choice, GpuError, adapters};
pub use kernels::KernelForm;
pub use trainer::{GpuTrainer, MAX_CLASSES};

#[cfg(test)]
mod tests;
