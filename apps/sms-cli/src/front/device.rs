//! The argument `--device`.

use sms_core::InputError;

/// `--device`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Device {
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

/// The refusal of a GPU by a program that was built without GPUs.
pub fn without_gpu() -> InputError {
    InputError::new(
        "this program was built without GPUs",
        "--device",
        "build it with `--features gpu`, or give --device cpu",
    )
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
