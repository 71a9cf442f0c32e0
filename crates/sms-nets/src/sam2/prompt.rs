//! Prompts as tokens: boxes, or nothing.

use super::config::Sam2Config;
use super::positions::fourier;
use crate::weights::{Loaded, Weights};
use candle_core::{Device, Result, Tensor};

#[derive(Debug)]
pub(crate) struct PromptEncoder {
    frequencies: Tensor,
    points: Tensor,
    not_a_point: Tensor,
    /// Embedding of "no mask" at every pixel, (c).
    pub(crate) no_mask: Tensor,
    image_size: f64,
}

impl PromptEncoder {
    /// `shared` are the random Fourier features of the image's positions; released files omit the prompt encoder's
    /// copy of them.
    pub(crate) fn new(config: &Sam2Config, shared: &Tensor, weights: &Weights) -> Loaded<Self> {
        let c = config.hidden();
        let at = weights.at("prompt_encoder");
        // Mask prompts are not used; reading their tensors detects files without them.
        let mask = at.at("mask_embed");
        for (name, shape) in [("conv1", [4, 1, 2, 2]), ("conv2", [16, 4, 2, 2]), ("conv3", [c, 16, 1, 1])] {
            mask.at(name).tensor("weight", &shape)?;
            mask.at(name).tensor("bias", &shape[..1])?;
        }
        mask.layer_norm("layer_norm1", 4, 1e-6)?;
        mask.layer_norm("layer_norm2", 16, 1e-6)?;
        Ok(Self {
            frequencies: at.tensor_or("shared_embedding.positional_embedding", &[2, c / 2], shared)?,
            points: at.tensor("point_embed.weight", &[4, c])?,
            not_a_point: at.tensor("not_a_point_embed.weight", &[1, c])?,
            no_mask: at.tensor("no_mask_embed.weight", &[1, c])?.squeeze(0)?,
            image_size: config.image_size as f64,
        })
    }

    /// Returns the tokens of a box, in model pixels: its two corners and a padding point, (3, c).
    pub(crate) fn of_box(&self, [x0, y0, x1, y1]: [f64; 4], device: &Device) -> Result<Tensor> {
        // Prompts are pixel indices, but the encoding uses pixel centres, half a pixel farther.
        let at = |v: f64| ((v + 0.5) / self.image_size) as f32;
        let corners = Tensor::new(&[[at(x0), at(y0)], [at(x1), at(y1)]], device)?;
        let corners = (fourier(&corners, &self.frequencies)? + self.points.narrow(0, 2, 2)?)?;
        Tensor::cat(&[&corners, &self.not_a_point], 0)
    }

    /// Returns the tokens without a prompt: two padding points, (2, c).
    pub(crate) fn of_nothing(&self) -> Result<Tensor> {
        Tensor::cat(&[&self.not_a_point, &self.not_a_point], 0)
    }
}

/// Returns encodings of the positions of a grid's cells, (side · side, c).
pub(crate) fn grid_positions(side: usize, frequencies: &Tensor) -> Result<Tensor> {
    let at = |i: usize| (i as f32 + 0.5) / side as f32;
    let points: Vec<f32> = (0..side * side).flat_map(|cell| [at(cell % side), at(cell / side)]).collect();
    fourier(&Tensor::from_vec(points, (side * side, 2), frequencies.device())?, frequencies)
}
