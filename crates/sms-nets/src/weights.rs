//! Parameters of a network by name: from a safetensors file, or synthetic for benchmarks and tests.

use crate::NetsError;
use crate::ops::Linear;
use crate::safetensors::SafetensorsFile;
use candle_core::{Device, Tensor};
use candle_nn::LayerNorm;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex};

/// A part of a network, read from its weights.
pub(crate) type Loaded<T> = Result<T, NetsError>;

/// Names and shapes of the requested parameters.
pub type Shapes = BTreeMap<String, Vec<usize>>;

/// Parameters of a network below one prefix of their names.
#[derive(Debug, Clone)]
pub struct Weights {
    source: WeightsSource,
    prefix: String,
    device: Device,
    requested: Arc<Mutex<Shapes>>,
}

#[derive(Debug, Clone)]
enum WeightsSource {
    File(Arc<SafetensorsFile>),
    Zeros,
    Random(u64),
}

impl Weights {
    /// Opens the parameters of a safetensors file; each is read on request.
    ///
    /// # Errors
    /// [`NetsError::Input`] if the file is not a safetensors file or is cut off, [`NetsError::Core`] if it cannot
    /// be read.
    pub fn open(path: &Path, device: &Device) -> Loaded<Self> {
        Ok(Self::from(WeightsSource::File(Arc::new(SafetensorsFile::open(path)?)), device))
    }

    /// Returns zeros for every name, to record the parameters that a network requests.
    pub fn zeros() -> Self {
        Self::from(WeightsSource::Zeros, &Device::Cpu)
    }

    /// Returns pseudo-random values for every name, with a variance of one over the number of inputs, so that
    /// activations stay in the normal range: for benchmarks. The same seed gives the same values.
    pub fn random(seed: u64, device: &Device) -> Self {
        Self::from(WeightsSource::Random(seed), device)
    }

    fn from(source: WeightsSource, device: &Device) -> Self {
        Self { source, prefix: String::new(), device: device.clone(), requested: Arc::default() }
    }

    /// Returns the device of the parameters.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// The same parameters with the prefix `name.`.
    pub fn at(&self, name: impl std::fmt::Display) -> Self {
        Self { prefix: format!("{}{name}.", self.prefix), ..self.clone() }
    }

    /// Returns the parameters requested so far, through this or any other prefix.
    pub fn requested(&self) -> Shapes {
        self.requested.lock().map(|requested| requested.clone()).unwrap_or_default()
    }

    /// Returns the parameter `name` of this shape, as 32-bit floats.
    ///
    /// # Errors
    /// [`NetsError::Input`] if the file lacks the parameter, or the parameter has another shape (as in the weights of
    /// another model).
    pub fn tensor(&self, name: &str, shape: &[usize]) -> Loaded<Tensor> {
        let name = format!("{}{name}", self.prefix);
        if let Ok(mut requested) = self.requested.lock() {
            requested.insert(name.clone(), shape.to_vec());
        }
        match &self.source {
            WeightsSource::File(file) => file.tensor(&name, shape, &self.device),
            WeightsSource::Zeros => Ok(Tensor::zeros(shape, candle_core::DType::F32, &self.device)?),
            WeightsSource::Random(seed) => {
                let values = random_values(&name, shape, *seed);
                Ok(Tensor::from_vec(values, shape, &self.device)?)
            }
        }
    }

    /// Returns the parameter `name`, or the tied parameter `other` if the file omits it.
    ///
    /// # Errors
    /// As [`Weights::tensor`].
    pub fn tensor_or(&self, name: &str, shape: &[usize], other: &Tensor) -> Loaded<Tensor> {
        let full = format!("{}{name}", self.prefix);
        match &self.source {
            WeightsSource::File(file) if !file.holds(&full) => Ok(other.clone()),
            _ => self.tensor(name, shape),
        }
    }

    /// A fully connected layer with a bias.
    pub(crate) fn linear(&self, name: &str, inputs: usize, outputs: usize) -> Loaded<Linear> {
        let at = self.at(name);
        Ok(Linear::new(at.tensor("weight", &[outputs, inputs])?, Some(at.tensor("bias", &[outputs])?)))
    }

    /// A fully connected layer without a bias.
    pub(crate) fn linear_no_bias(&self, name: &str, inputs: usize, outputs: usize) -> Loaded<Linear> {
        Ok(Linear::new(self.at(name).tensor("weight", &[outputs, inputs])?, None))
    }

    /// A 1 × 1 convolution, as an equivalent fully connected layer over channels.
    pub(crate) fn pointwise(&self, name: &str, inputs: usize, outputs: usize) -> Loaded<Linear> {
        let at = self.at(name);
        let weight = at.tensor("weight", &[outputs, inputs, 1, 1])?.reshape((outputs, inputs))?;
        Ok(Linear::new(weight, Some(at.tensor("bias", &[outputs])?)))
    }

    /// Two fully connected layers with biases: `size` channels to `inner` and back.
    pub(crate) fn feed_forward(&self, names: [&str; 2], size: usize, inner: usize) -> Loaded<Vec<Linear>> {
        Ok(vec![self.linear(names[0], size, inner)?, self.linear(names[1], inner, size)?])
    }

    /// A layer normalisation.
    pub(crate) fn layer_norm(&self, name: &str, size: usize, eps: f64) -> Loaded<LayerNorm> {
        let at = self.at(name);
        Ok(LayerNorm::new(at.tensor("weight", &[size])?, at.tensor("bias", &[size])?, eps))
    }
}

/// Returns uniform values of variance one over the number of inputs, from the SplitMix64 sequence seeded by the
/// name.
fn random_values(name: &str, shape: &[usize], seed: u64) -> Vec<f32> {
    let start = name.bytes().fold(seed ^ 0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    let inputs: usize = shape.iter().skip(1).product();
    let scale = (3.0 / inputs.max(1) as f32).sqrt();
    let count: usize = shape.iter().product();
    let is_gain = name.contains("norm") && name.ends_with("weight");
    (1..=count as u64)
        .map(|i| {
            let mut z = start.wrapping_add(i.wrapping_mul(0x9e37_79b9_7f4a_7c15));
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            let uniform = ((z ^ (z >> 31)) >> 40) as f32 / (1u64 << 23) as f32 - 1.0;
            if is_gain {
                1.0 + 0.1 * uniform
            } else if shape.len() > 1 {
                scale * uniform
            } else {
                0.1 * uniform
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn random_weights_depend_on_name_and_seed_and_have_unit_gain() {
        let of = |name, seed| random_values(name, &[64, 256], seed);
        let a = of("a.weight", 1);
        assert_eq!(a, of("a.weight", 1));
        assert_ne!(a, of("b.weight", 1));
        assert_ne!(a, of("a.weight", 2));
        let variance = a.iter().map(|v| v * v).sum::<f32>() / a.len() as f32;
        assert!((variance * 256.0 - 1.0).abs() < 0.05, "{variance}");
    }

    #[test]
    fn prefixes_join_and_requests_are_kept() {
        let weights = Weights::zeros();
        weights.at("a").at(3).linear("fc", 2, 5).unwrap();
        let expected: Shapes =
            [("a.3.fc.weight".into(), vec![5, 2]), ("a.3.fc.bias".into(), vec![5])].into_iter().collect();
        assert_eq!(weights.requested(), expected);
    }
}
