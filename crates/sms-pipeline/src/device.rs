//! The device of a scan: the CPU, or a GPU in builds with the feature `gpu`.

#[cfg(feature = "gpu")]
use crate::Event;
use crate::EventSink;
use sms_core::{InputError, StageContext};
use sms_gaussians::{CpuTrainer, TrainConfig, Trainer};

/// Device of a scan; parsed from `auto`, `cpu`, `gpu` or `gpu:N`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Device {
    /// A GPU if one is available and supported by the build, otherwise the CPU.
    #[default]
    Auto,
    /// The CPU.
    Cpu,
    /// A GPU: the best one, or the one with this index in `sms devices`.
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
                Err(_) => Err(format!("{index:?} is not an index; `sms devices` lists them")),
            },
            _ => Err("use auto, cpu, gpu or gpu:N".to_owned()),
        }
    }
}

impl Device {
    /// Refuses a selected GPU that this program or machine does not have, before any work for it.
    ///
    /// # Errors
    /// [`InputError`] with the cure.
    pub(crate) fn refuse_missing(self) -> Result<(), InputError> {
        #[cfg(feature = "gpu")]
        if let Self::Gpu(choice) = self {
            let adapters = sms_gaussians_gpu::adapters();
            return match choice {
                Some(index) if index >= adapters.len() => Err(no_such_gpu(index, adapters.len())),
                None if adapters.iter().all(|a| a.software) => Err(no_gpu()),
                _ => Ok(()),
            };
        }
        match self {
            Self::Gpu(_) if !cfg!(feature = "gpu") => Err(without_gpu()),
            _ => Ok(()),
        }
    }
}

#[cfg(feature = "gpu")]
fn no_such_gpu(index: usize, count: usize) -> InputError {
    InputError::new(
        format!("GPU {index} does not exist; {count} found"),
        "--device",
        "`sms devices` lists them",
    )
}

#[cfg(feature = "gpu")]
fn no_gpu() -> InputError {
    InputError::new(
        "no GPU was found",
        "--device",
        "install the GPU's driver and the Vulkan loader (Debian: libvulkan1), or use --device auto",
    )
}

/// Returns the error for a GPU in a program built without GPU support.
pub fn without_gpu() -> InputError {
    InputError::new(
        "this program was built without GPU support",
        "--device",
        "build it with `--features gpu`, or use --device cpu",
    )
}

/// Returns the trainer of a scan and the value of the metric `scan.device`. If a GPU cannot be used, reports the reason
/// and uses the CPU.
#[cfg(feature = "gpu")]
pub(crate) fn trainer(
    device: Device,
    train: &TrainConfig,
    classes: usize,
    events: &dyn EventSink,
    context: StageContext<'_>,
) -> Result<(Box<dyn Trainer>, String), InputError> {
    use sms_gaussians_gpu::{AdapterChoice, GpuError, checked_trainer};
    let cpu = || Box::new(CpuTrainer::new(train, classes, context.seed));
    let choice = match device {
        Device::Cpu => return Ok((cpu(), "cpu".to_owned())),
        Device::Gpu(Some(index)) => AdapterChoice::Index(index),
        Device::Auto | Device::Gpu(None) => AdapterChoice::Best,
    };
    match checked_trainer(train, classes, context.seed, choice) {
        Ok(trainer) => {
            let name = trainer.adapter().name.clone();
            events.event(&Event::Message(&format!("scanning on {name}")));
            Ok((Box::new(trainer), format!("gpu: {name}")))
        }
        Err(GpuError::NoSuchAdapter { index, count }) => Err(no_such_gpu(index, count)),
        Err(GpuError::NoAdapter(_)) if device == Device::Auto => Ok((cpu(), "cpu".to_owned())),
        Err(error) => {
            events.event(&Event::Alert(&format!("{error}; scanning on the CPU")));
            context.warnings.add(
                "scan",
                "gpu_not_used",
                format!("{error}; the scan ran on the CPU"),
                "`sms devices` lists the GPUs and their faults; --device cpu avoids this warning",
            );
            Ok((cpu(), "cpu".to_owned()))
        }
    }
}

/// Returns the trainer of a scan and the value of the metric `scan.device`.
#[cfg(not(feature = "gpu"))]
pub(crate) fn trainer(
    device: Device,
    train: &TrainConfig,
    classes: usize,
    _: &dyn EventSink,
    context: StageContext<'_>,
) -> Result<(Box<dyn Trainer>, String), InputError> {
    match device {
        Device::Gpu(_) => Err(without_gpu()),
        Device::Auto | Device::Cpu => {
            Ok((Box::new(CpuTrainer::new(train, classes, context.seed)), "cpu".to_owned()))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Device;

    #[test]
    fn a_gpu_that_is_missing_is_refused() {
        assert!(Device::Auto.refuse_missing().is_ok() && Device::Cpu.refuse_missing().is_ok());
        assert_eq!(Device::Gpu(Some(4000)).refuse_missing().unwrap_err().path, "--device");
        #[cfg(feature = "gpu")]
        let has_gpu = sms_gaussians_gpu::adapters().iter().any(|a| !a.software);
        #[cfg(not(feature = "gpu"))]
        let has_gpu = false;
        assert_eq!(Device::Gpu(None).refuse_missing().is_ok(), has_gpu);
    }

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
