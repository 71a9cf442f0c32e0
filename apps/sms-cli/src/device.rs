//! What computes a scan: the CPU, or a GPU in a build with the feature `gpu`.

#[cfg(not(feature = "gpu"))]
use sms_cli::front::without_gpu;
use sms_cli::front::{Console, Device};
#[cfg(feature = "gpu")]
use sms_core::InputError;
use sms_core::{Seed, Warnings};
use sms_gaussians::{CpuTrainer, TrainConfig, Trainer};

/// The trainer of a scan and what `scan.device` says of it. A GPU that cannot be used is told, loudly where it was asked
/// for, and the CPU takes its place.
#[cfg(feature = "gpu")]
pub(crate) fn trainer(
    console: &Console,
    device: Device,
    train: &TrainConfig,
    classes: usize,
    seed: Seed,
    warnings: &Warnings,
) -> anyhow::Result<(Box<dyn Trainer>, String)> {
    use sms_gaussians_gpu::{Choice, GpuError, checked_trainer};
    let cpu = || Box::new(CpuTrainer::new(train, classes, seed));
    let choice = match device {
        Device::Cpu => return Ok((cpu(), "cpu".to_owned())),
        Device::Gpu(Some(index)) => Choice::Index(index),
        Device::Auto | Device::Gpu(None) => Choice::Best,
    };
    match checked_trainer(train, classes, seed, choice) {
        Ok(trainer) => {
            let name = trainer.adapter().name.clone();
            console.say(format!("scanning on {name}"));
            Ok((Box::new(trainer), format!("gpu: {name}")))
        }
        Err(GpuError::NoSuchAdapter { index, count }) => Err(InputError::new(
            format!("there is no GPU {index}: there are {count}"),
            "--device",
            "`sms devices` lists them",
        )
        .into()),
        Err(GpuError::NoAdapter(_)) if device == Device::Auto => Ok((cpu(), "cpu".to_owned())),
        Err(error) => {
            if !console.json {
                eprintln!("warning: {error}: scanning on the CPU instead");
            }
            warnings.add(
                "scan",
                "gpu_not_used",
                format!("{error}; the CPU scanned instead"),
                "`sms devices` tells more; --device cpu asks for no GPU",
            );
            Ok((cpu(), "cpu".to_owned()))
        }
    }
}

/// The trainer of a scan and what `scan.device` says of it.
#[cfg(not(feature = "gpu"))]
pub(crate) fn trainer(
    _: &Console,
    device: Device,
    train: &TrainConfig,
    classes: usize,
    seed: Seed,
    _: &Warnings,
) -> anyhow::Result<(Box<dyn Trainer>, String)> {
    match device {
        Device::Gpu(_) => Err(without_gpu().into()),
        Device::Auto | Device::Cpu => Ok((Box::new(CpuTrainer::new(train, classes, seed)), "cpu".to_owned())),
    }
}
