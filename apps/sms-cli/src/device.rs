//! What computes a scan: the CPU, or a GPU in a build with the feature `gpu`.

use crate::context::Context;
use sms_core::{InputError, Seed, Warnings};
use sms_gaussians::{CpuTrainer, TrainConfig, Trainer};

/// `--device`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) enum Device {
    /// A GPU where there is one and the build knows of GPUs, else the CPU.
    #[default]
    Auto,
    /// The CPU.
    Cpu,
    /// A GPU: the best one, or that of this index in `sms devices`.
    Gpu(Option<usize>),
}

impl std::str::FromStr for Device {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once(':') {
            None if text == "auto" => Ok(Self::Auto),
            None if text == "cpu" => Ok(Self::Cpu),
            None if text == "gpu" => Ok(Self::Gpu(None)),
            Some(("gpu", index)) => match index.parse() {
                Ok(index) => Ok(Self::Gpu(Some(index))),
                Err(_) => Err(format!("{index:?} is no index; `sms devices` lists them")),
            },
            _ => Err("give auto, cpu, gpu or gpu:N".to_owned()),
        }
    }
}

/// A GPU was asked for that this program cannot use.
#[cfg(not(feature = "gpu"))]
pub(crate) fn without_gpu() -> InputError {
    InputError::new(
        "this program was built without GPUs",
        "--device",
        "build it with `--features gpu`, or give --device cpu",
    )
}

/// The trainer of a scan and what `scan.device` says of it. A GPU that cannot be used is told, loudly where it was asked
/// for, and the CPU takes its place.
#[cfg(feature = "gpu")]
pub(crate) fn trainer(
    context: &Context,
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
            context.say(format!("scanning on {name}"));
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
            if !context.json {
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
    _: &Context,
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

#[cfg(test)]
mod tests {
    use super::Device;

    #[test]
    fn devices_are_named_as_the_help_says() {
        for (text, device) in [
            ("auto", Device::Auto),
            ("cpu", Device::Cpu),
            ("gpu", Device::Gpu(None)),
            ("gpu:3", Device::Gpu(Some(3))),
        ] {
            assert_eq!(text.parse(), Ok(device));
        }
        for text in ["", "gpu:", "gpu:-1", "cpu:0", "cuda", "gpu:a"] {
            assert!(text.parse::<Device>().is_err(), "{text}");
        }
    }
}
