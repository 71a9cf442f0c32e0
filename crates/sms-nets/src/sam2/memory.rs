//! Memories of frames and their masks, and the attention of later frames to them.

use super::config::Sam2Config;
use super::positions::{Rotary, sine_2d};
use crate::attention::Attention;
use crate::kernels::Activation;
use crate::ops::{Linear, activated, depthwise, mlp};
use crate::weights::{Loaded, Weights};
use candle_core::{D, Result, Tensor};
use candle_nn::{LayerNorm, Module};

/// Attention with rotary positions: `q` (n, c); `k`, `v` (m, keys), of which the last `unturned` have no position on the
/// grid.
fn turned_attention(
    layer: &Attention,
    q: &Tensor,
    k: &Tensor,
    v: &Tensor,
    unturned: usize,
    rotary: &Rotary,
) -> Result<Tensor> {
    let (q, k, v) = layer.projected(q, k, v)?;
    let size = q.dim(D::Minus1)? / layer.heads;
    let turned = |x: &Tensor, unturned: usize| {
        let heads = (0..layer.heads).map(|i| rotary.turn(&x.narrow(1, i * size, size)?, unturned));
        Tensor::cat(&heads.collect::<Result<Vec<_>>>()?, 1)?.unsqueeze(0)
    };
    layer.attend(&turned(&q, 0)?, &turned(&k, unturned)?, &v.unsqueeze(0)?, None)?.squeeze(0)
}

#[derive(Debug)]
struct AttentionBlock {
    own: Attention,
    memory: Attention,
    mlp: Vec<Linear>,
    norms: [LayerNorm; 3],
}

/// Conditions a frame's features on an object's memories.
#[derive(Debug)]
pub(crate) struct MemoryAttention {
    blocks: Vec<AttentionBlock>,
    norm: LayerNorm,
    rotary: Rotary,
    /// Positions of the features, (tokens, c).
    places: Tensor,
}

impl MemoryAttention {
    pub(crate) fn new(config: &Sam2Config, weights: &Weights) -> Loaded<Self> {
        let (c, memory) = (config.hidden(), config.memory_encoder_output_channels);
        let (heads, inner) =
            (config.memory_attention_num_attention_heads, config.memory_attention_feed_forward_hidden_size);
        let at = weights.at("memory_attention");
        let blocks = (0..config.memory_attention_num_layers).map(|i| {
            let at = at.at("layers").at(i);
            let norm = |i: usize| at.layer_norm(&format!("layer_norm{i}"), c, 1e-5);
            Loaded::Ok(AttentionBlock {
                own: Attention::new(&at.at("self_attn"), [c; 3], heads, "o_proj")?,
                memory: Attention::new(&at.at("cross_attn_image"), [c, memory, c], heads, "o_proj")?,
                mlp: at.feed_forward(["linear1", "linear2"], c, inner)?,
                norms: [norm(1)?, norm(2)?, norm(3)?],
            })
        });
        Ok(Self {
            blocks: blocks.collect::<Loaded<_>>()?,
            norm: at.layer_norm("layer_norm", c, 1e-5)?,
            rotary: Rotary::new(config.grid(), c / heads.max(1), config.rope_theta(), weights.device())?,
            places: sine_2d(config.grid(), c, weights.device())?,
        })
    }

    /// `features` (tokens, c); `memory` and its positions (m, memory channels), of which the last `pointers` are object
    /// pointers.
    pub(crate) fn forward(
        &self,
        features: &Tensor,
        memory: &Tensor,
        positions: &Tensor,
        pointers: usize,
    ) -> Result<Tensor> {
        let mut x = (features + (&self.places * 0.1)?)?;
        let keys = (memory + positions)?;
        for block in &self.blocks {
            let y = block.norms[0].forward(&x)?;
            x = (&x + turned_attention(&block.own, &y, &y, &y, 0, &self.rotary)?)?;
            let y = block.norms[1].forward(&x)?;
            x = (&x + turned_attention(&block.memory, &y, &keys, memory, pointers, &self.rotary)?)?;
            x = (&x + mlp(&block.norms[2].forward(&x)?, &block.mlp, Activation::Relu)?)?;
        }
        self.norm.forward(&x)
    }
}

/// A convolution that halves a mask, with its normalization and activation.
#[derive(Debug)]
struct Halving {
    weight: Tensor,
    bias: Tensor,
    norm: LayerNorm,
}

/// A block that fuses mask and features (ConvNeXt's).
#[derive(Debug)]
struct Fuser {
    taps: Tensor,
    bias: Tensor,
    norm: LayerNorm,
    mlp: Vec<Linear>,
    scale: Tensor,
    kernel: usize,
}

#[derive(Debug)]
pub(crate) struct MemoryEncoder {
    halvings: Vec<Halving>,
    mask_projection: Linear,
    feature_projection: Linear,
    fusers: Vec<Fuser>,
    projection: Linear,
    /// Positions of a memory's tokens, (tokens, memory channels).
    pub(crate) places: Tensor,
}

impl MemoryEncoder {
    pub(crate) fn new(config: &Sam2Config, weights: &Weights) -> Loaded<Self> {
        let (c, outputs) = (config.hidden(), config.memory_encoder_output_channels);
        let at = weights.at("memory_encoder");
        let mut halvings = Vec::new();
        let mut channels = 1;
        // From the image's size to stride 16.
        for i in 0..4 {
            let layer = at.at("mask_downsampler.layers").at(i);
            halvings.push(Halving {
                weight: layer.tensor("conv.weight", &[4 * channels, channels, 3, 3])?,
                bias: layer.tensor("conv.bias", &[4 * channels])?,
                norm: layer.layer_norm("layer_norm", 4 * channels, 1e-6)?,
            });
            channels *= 4;
        }
        let (kernel, inner) = (config.memory_fuser_kernel_size, config.memory_fuser_intermediate_dim);
        let fusers = (0..config.memory_fuser_num_layers).map(|i| {
            let layer = at.at("memory_fuser.layers").at(i);
            let weight = layer.tensor("depthwise_conv.weight", &[c, 1, kernel, kernel])?;
            Loaded::Ok(Fuser {
                taps: weight.reshape((c, kernel * kernel))?.t()?.contiguous()?,
                bias: layer.tensor("depthwise_conv.bias", &[c])?,
                norm: layer.layer_norm("layer_norm", c, 1e-6)?,
                mlp: layer.feed_forward(["pointwise_conv1", "pointwise_conv2"], c, inner)?,
                scale: layer.tensor("scale", &[c])?,
                kernel,
            })
        });
        Ok(Self {
            halvings,
            mask_projection: at.pointwise("mask_downsampler.final_conv", channels, c)?,
            feature_projection: at.pointwise("feature_projection", c, c)?,
            fusers: fusers.collect::<Loaded<_>>()?,
            projection: at.pointwise("projection", c, outputs)?,
            places: sine_2d(config.grid(), outputs, weights.device())?,
        })
    }

    /// Returns the memory (tokens, memory channels) of features (tokens, c) and the network's mask input (1, 1,
    /// side, side).
    pub(crate) fn forward(&self, features: &Tensor, mask: &Tensor) -> Result<Tensor> {
        let mut x = mask.clone();
        for halving in &self.halvings {
            let y = x.conv2d(&halving.weight, 1, 2, 1, 1)?.permute((0, 2, 3, 1))?.contiguous()?;
            let y = activated(halving.norm.forward(&y.broadcast_add(&halving.bias)?)?, Activation::Gelu)?;
            x = y.permute((0, 3, 1, 2))?.contiguous()?;
        }
        let mask = self.mask_projection.forward(&x.permute((0, 2, 3, 1))?.contiguous()?)?;
        let features = self.feature_projection.forward(features)?.reshape(mask.shape())?;
        let mut x = (features + mask)?;
        for fuser in &self.fusers {
            let y = depthwise(&x, &fuser.taps, &fuser.bias, fuser.kernel)?;
            let y = mlp(&fuser.norm.forward(&y)?, &fuser.mlp, Activation::Gelu)?;
            x = (x + y.broadcast_mul(&fuser.scale)?)?;
        }
        self.projection.forward(&x)?.flatten(0, 2)
    }
}
