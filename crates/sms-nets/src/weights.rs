//! Parameters of a network by name.

use crate::NetsError;
use crate::ops::Linear;
use crate::safetensors::SafetensorsFile;
use candle_core::{Device, Tensor};
use candle_nn::LayerNorm;
use std::path::Path;
use std::sync::Arc;

/// A part of a network, read from its weights.
pub(crate) type Loaded<T> = Result<T, NetsError>;

/// A source of parameters: a safetensors file, or made-up values in benchmarks and tests.
pub trait WeightsSource: std::fmt::Debug + Send + Sync {
    /// Whether there is a parameter of this name.
    fn holds(&self, name: &str) -> bool;

    /// Returns the parameter `name` as 32-bit floats.
    ///
    /// # Errors
    /// [`NetsError::Input`] if it is missing, or has another shape or no float type.
    fn tensor(&self, name: &str, shape: &[usize], device: &Device) -> Result<Tensor, NetsError>;
}

/// Parameters of a network below one prefix of their names.
#[derive(Debug, Clone)]
pub struct Weights {
    source: Arc<dyn WeightsSource>,
    prefix: String,
    device: Device,
}

impl Weights {
    /// Opens the parameters of a safetensors file; each is read on request.
    ///
    /// # Errors
    /// [`NetsError::Input`] if the file is not a safetensors file or is cut off, [`NetsError::Core`] if it cannot
    /// be read.
    pub fn open(path: &Path, device: &Device) -> Loaded<Self> {
        Ok(Self::new(Arc::new(SafetensorsFile::open(path)?), device))
    }

    /// Returns the parameters of a source, on a device.
    pub fn new(source: Arc<dyn WeightsSource>, device: &Device) -> Self {
        Self { source, prefix: String::new(), device: device.clone() }
    }

    /// Returns the device of the parameters.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// The same parameters with the prefix `name.`.
    pub fn at(&self, name: impl std::fmt::Display) -> Self {
        Self { prefix: format!("{}{name}.", self.prefix), ..self.clone() }
    }

    /// Returns the parameter `name` of this shape, as 32-bit floats.
    ///
    /// # Errors
    /// [`NetsError::Input`] if the file lacks the parameter, or the parameter has another shape (as in the weights of
    /// another model).
    pub fn tensor(&self, name: &str, shape: &[usize]) -> Loaded<Tensor> {
        self.source.tensor(&format!("{}{name}", self.prefix), shape, &self.device)
    }

    /// Returns the parameter `name`, or the tied parameter `other` if the file omits it.
    ///
    /// # Errors
    /// As [`Weights::tensor`].
    pub fn tensor_or(&self, name: &str, shape: &[usize], other: &Tensor) -> Loaded<Tensor> {
        let is_given = self.source.holds(&format!("{}{name}", self.prefix));
        if is_given { self.tensor(name, shape) } else { Ok(other.clone()) }
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

    pub(crate) fn layer_norm(&self, name: &str, size: usize, eps: f64) -> Loaded<LayerNorm> {
        let at = self.at(name);
        Ok(LayerNorm::new(at.tensor("weight", &[size])?, at.tensor("bias", &[size])?, eps))
    }
}
