//! Self-check: compares the kernels with those of the CPU on a small scene before use. Drivers have bugs, and a subtly
//! wrong scan is worse than a slow one.

use crate::compare::{ErrorSpread, first_moments, images};
use crate::gpu::{AdapterChoice, GpuError};
use crate::probe::{CLASSES, camera, fill, still};
use crate::trainer::GpuTrainer;
use sms_core::Seed;
use sms_gaussians::{CpuTrainer, LearningRates, TrainConfig, Trainer};

/// Result of the self-check.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SelfCheck {
    /// Differences of colours, opacities and normals.
    pub image: ErrorSpread,
    /// Differences of gradients, relative to the largest gradient of their group; the worst group.
    pub gradient: ErrorSpread,
    /// Relative difference of the loss after a few steps.
    pub loss: f64,
}

/// Largest 99.9th percentile of the image's differences.
const IMAGE_MOST: f64 = 1e-5;
/// Largest 99.9th percentile of the gradients' differences.
const GRADIENT_MOST: f64 = 1e-3;
/// Largest difference of the losses.
const LOSS_MOST: f64 = 1e-2;

const SIZE: (usize, usize) = (70, 45);
const COUNT: usize = 400;
/// Number of steps before losses are compared.
const STEPS: usize = 10;

impl SelfCheck {
    /// Returns the reason why the device must not be used; `None` if it passed.
    pub fn fault(&self) -> Option<String> {
        if self.image.p999 > IMAGE_MOST {
            return Some(format!("the image: {}", self.image));
        }
        if self.gradient.p999 > GRADIENT_MOST {
            return Some(format!("gradients: {}", self.gradient));
        }
        if self.loss.is_nan() || self.loss > LOSS_MOST {
            return Some(format!("the loss after {STEPS} steps: {:.2} %", 1e2 * self.loss));
        }
        None
    }
}

impl std::fmt::Display for SelfCheck {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "image {}; gradients {}; loss {:.1e}", self.image, self.gradient, self.loss)
    }
}

/// Compares an adapter with the CPU on a small random scene.
///
/// # Errors
/// [`GpuError`] if the adapter cannot be opened, cannot run the kernels, or is lost. Wrong results are not an
/// error: see [`SelfCheck::fault`].
pub fn self_check(choice: AdapterChoice) -> Result<SelfCheck, GpuError> {
    let still = TrainConfig { rates: still(), ..TrainConfig::default() };
    let (mut cpu, mut gpu) =
        (CpuTrainer::new(&still, CLASSES, Seed(2)), GpuTrainer::new(&still, CLASSES, Seed(2), choice)?);
    fill(&mut cpu, SIZE, COUNT);
    fill(&mut gpu, SIZE, COUNT);
    let view = camera(SIZE);
    let image = images(&gpu.render(&view), &cpu.render(&view));
    // After one step from zero moments, Adam's first moment is a tenth of the gradient.
    gpu.steps(&[0]);
    cpu.steps(&[0]);
    let groups = first_moments(&gpu.snapshot(), &cpu.snapshot()).unwrap_or_default();
    let worst = ErrorSpread { p999: f64::INFINITY, max: f64::INFINITY };
    let gradient = groups
        .into_iter()
        .map(|(_, spread)| spread)
        .reduce(|a, b| ErrorSpread { p999: a.p999.max(b.p999), max: a.max.max(b.max) })
        .unwrap_or(worst);
    let rates = LearningRates { harmonics: 2e-3, off_plane: 0.3, ..LearningRates::default() };
    gpu.set_rates(&rates);
    cpu.set_rates(&rates);
    let frames: Vec<usize> = (0..STEPS).map(|i| i % 2).collect();
    gpu.steps(&frames);
    cpu.steps(&frames);
    let (a, b) = (f64::from(gpu.steps(&[0]).loss.total), f64::from(cpu.steps(&[0]).loss.total));
    match gpu.failure() {
        Some(reason) => Err(GpuError::Unsuitable { name: gpu.adapter().name.clone(), reason }),
        None => Ok(SelfCheck { image, gradient, loss: (a / b - 1.0).abs() }),
    }
}

/// [`GpuTrainer::new`] on an adapter that has just passed [`self_check`].
///
/// # Errors
/// [`GpuError`], including [`GpuError::SelfCheck`].
pub fn checked_trainer(
    config: &TrainConfig,
    classes: usize,
    seed: Seed,
    choice: AdapterChoice,
) -> Result<GpuTrainer, GpuError> {
    let trainer = GpuTrainer::new(config, classes, seed, choice)?;
    match self_check(choice)?.fault() {
        Some(difference) => Err(GpuError::SelfCheck { name: trainer.adapter().name.clone(), difference }),
        None => Ok(trainer),
    }
}
