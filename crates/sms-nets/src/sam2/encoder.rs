//! The image encoder: Hiera (Ryali et al. 2023) with windowed attention, and a feature pyramid (Ravi et al. 2024,
//! "SAM 2"). Maps are channels-last throughout.

use super::config::Sam2Config;
use super::positions::{resize_bicubic, sine_2d};
use crate::kernels::Activation;
use crate::ops::{Linear, TensorObserver, attention, mlp};
use crate::weights::{Loaded, Weights};
use candle_core::{D, Result, Tensor};
use candle_nn::{LayerNorm, Module};

#[derive(Debug)]
struct HieraBlock {
    norm1: LayerNorm,
    norm2: LayerNorm,
    qkv: Linear,
    output: Linear,
    mlp: Vec<Linear>,
    /// Present if the block changes the number of channels.
    projection: Option<Linear>,
    heads: usize,
    /// Side of the windows; 0 for the whole map.
    window: usize,
    /// Whether the block halves the map.
    pools: bool,
}

impl HieraBlock {
    /// `x` (1, h, w, c).
    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let (_, h, w, _) = x.dims4()?;
        let y = self.norm1.forward(x)?;
        let residual = match &self.projection {
            Some(projection) => {
                let projected = projection.forward(&y)?;
                if self.pools { max_pool(&projected)? } else { projected }
            }
            None => x.clone(),
        };
        let (windows, size) =
            if self.window > 0 { (partitioned(&y, self.window)?, self.window) } else { (y, 0) };
        let (n, wh, ww, _) = windows.dims4()?;
        let qkv = self.qkv.forward(&windows)?;
        let c = qkv.dim(D::Minus1)? / 3;
        let part = |i: usize| qkv.narrow(3, i * c, c);
        let (mut q, k, v) = (part(0)?, part(1)?, part(2)?);
        if self.pools {
            q = max_pool(&q.contiguous()?)?;
        }
        let (_, qh, qw, _) = q.dims4()?;
        let flat = |x: Tensor, len: usize| x.reshape((n, len, c));
        let scale = ((c / self.heads) as f64).powf(-0.5);
        let attended =
            attention(&flat(q, qh * qw)?, &flat(k, wh * ww)?, &flat(v, wh * ww)?, self.heads, scale)?;
        let attended = self.output.forward(&attended)?.reshape((n, qh, qw, c))?;
        let (h, w) = if self.pools { (h / 2, w / 2) } else { (h, w) };
        let size = if self.pools { size / 2 } else { size };
        let attended = if size > 0 { joined(&attended, size, h, w)? } else { attended };
        let x = (residual + attended)?;
        &x + mlp(&self.norm2.forward(&x)?, &self.mlp, Activation::Gelu)?
    }
}

/// Splits a map (1, h, w, c) into windows (windows, side, side, c), padded with zeros at the bottom and right.
fn partitioned(x: &Tensor, side: usize) -> Result<Tensor> {
    let (_, h, w, c) = x.dims4()?;
    let (rows, columns) = (h.div_ceil(side), w.div_ceil(side));
    let x = x.pad_with_zeros(1, 0, rows * side - h)?.pad_with_zeros(2, 0, columns * side - w)?;
    x.reshape((rows, side, columns, side, c))?.transpose(1, 2)?.reshape((rows * columns, side, side, c))
}

/// Joins windows to their map (1, h, w, c).
fn joined(windows: &Tensor, side: usize, h: usize, w: usize) -> Result<Tensor> {
    let c = windows.dim(D::Minus1)?;
    let (rows, columns) = (h.div_ceil(side), w.div_ceil(side));
    let x = windows.reshape((rows, columns, side, side, c))?.transpose(1, 2)?;
    x.reshape((1, rows * side, columns * side, c))?.narrow(1, 0, h)?.narrow(2, 0, w)?.contiguous()
}

/// Returns the largest of each 2 × 2 pixels of (n, h, w, c).
fn max_pool(x: &Tensor) -> Result<Tensor> {
    let (n, h, w, c) = x.dims4()?;
    let (h, w) = (h / 2, w / 2);
    let x = x.narrow(1, 0, 2 * h)?.narrow(2, 0, 2 * w)?.contiguous()?.reshape((n, h, 2, w * 2 * c))?;
    let rows = x.narrow(2, 0, 1)?.maximum(&x.narrow(2, 1, 1)?)?.reshape((n, h, w, 2 * c))?;
    rows.narrow(3, 0, c)?.maximum(&rows.narrow(3, c, c)?)
}

/// Repeats each pixel of (1, h, w, c) four times.
fn doubled(x: &Tensor) -> Result<Tensor> {
    let (_, h, w, c) = x.dims4()?;
    x.reshape((h, 1, w, 1, c))?.broadcast_as((h, 2, w, 2, c))?.reshape((1, 2 * h, 2 * w, c))
}

/// Converts a map to channels first, as in the reference.
pub(crate) fn channels_first(x: &Tensor) -> Result<Tensor> {
    x.permute((0, 3, 1, 2))?.contiguous()
}

/// Features of one image, ready for the decoder and the memories.
#[derive(Debug, Clone)]
pub struct ImageFeatures {
    /// Stride 4, after the decoder's projection: (pixels, c / 8).
    pub(crate) fine: Tensor,
    /// Stride 8, after the decoder's projection: (pixels, c / 4).
    pub(crate) middle: Tensor,
    /// Stride 16: (tokens, c).
    pub(crate) coarse: Tensor,
}

#[derive(Debug)]
pub(crate) struct Encoder {
    patch_weight: Tensor,
    patch_bias: Tensor,
    positions: Tensor,
    blocks: Vec<HieraBlock>,
    stage_ends: Vec<usize>,
    /// From the coarsest level to the finest.
    laterals: Vec<Linear>,
    top_down: Vec<usize>,
    to_fine: Linear,
    to_middle: Linear,
    hidden: usize,
}

impl Encoder {
    pub(crate) fn new(config: &Sam2Config, weights: &Weights) -> Loaded<Self> {
        let hiera = &config.vision_config.backbone_config;
        let at = weights.at("vision_encoder.backbone");
        let dims = &hiera.embed_dim_per_stage;
        let stages = dims.len();
        let first = dims[0];
        let side = config.image_size / 4;
        let mut blocks = Vec::new();
        let mut stage_ends = Vec::new();
        for stage in 0..stages {
            for i in 0..hiera.blocks_per_stage[stage] {
                let opens = stage > 0 && i == 0;
                // The first block of a stage still has the windows of the previous stage.
                let window = hiera.window_size_per_stage[if opens { stage - 1 } else { stage }];
                let size = (if opens { dims[stage - 1] } else { dims[stage] }, dims[stage]);
                let global = hiera.global_attention_blocks.contains(&blocks.len());
                let block = at.at("blocks").at(blocks.len());
                let inner = (dims[stage] as f64 * hiera.mlp_ratio) as usize;
                blocks.push(HieraBlock {
                    norm1: block.layer_norm("layer_norm1", size.0, hiera.layer_norm_eps)?,
                    norm2: block.layer_norm("layer_norm2", size.1, hiera.layer_norm_eps)?,
                    qkv: block.linear("attn.qkv", size.0, 3 * size.1)?,
                    output: block.linear("attn.proj", size.1, size.1)?,
                    mlp: block.feed_forward(["mlp.proj_in", "mlp.proj_out"], size.1, inner)?,
                    projection: opens.then(|| block.linear("proj", size.0, size.1)).transpose()?,
                    heads: hiera.num_attention_heads_per_stage[stage].max(1),
                    window: if global { 0 } else { window },
                    pools: opens,
                });
            }
            stage_ends.push(blocks.len() - 1);
        }
        let hidden = config.hidden();
        let neck = weights.at("vision_encoder.neck.convs");
        let laterals = (0..stages).map(|i| neck.pointwise(&i.to_string(), dims[stages - 1 - i], hidden));
        let patch = at.at("patch_embed.projection");
        let background = hiera.window_positional_embedding_background_size;
        let window = hiera.window_size_per_stage[0];
        let coarse = at.tensor("pos_embed", &[1, first, background[0], background[1]])?;
        let tiled = at.tensor("pos_embed_window", &[1, first, window, window])?;
        Ok(Self {
            patch_weight: patch.tensor("weight", &[first, 3, 7, 7])?,
            patch_bias: patch.tensor("bias", &[first])?,
            positions: positions(&coarse, background, &tiled, window, side)?,
            blocks,
            stage_ends,
            laterals: laterals.collect::<Loaded<_>>()?,
            top_down: config.vision_config.fpn_top_down_levels.clone(),
            to_fine: weights.pointwise("mask_decoder.conv_s0", hidden, hidden / 8)?,
            to_middle: weights.pointwise("mask_decoder.conv_s1", hidden, hidden / 4)?,
            hidden,
        })
    }

    /// Returns features of one image (1, 3, side, side).
    pub(crate) fn forward(
        &self,
        pixel_values: &Tensor,
        observer: &mut TensorObserver<'_>,
    ) -> Result<ImageFeatures> {
        let patches =
            pixel_values.conv2d(&self.patch_weight, 3, 4, 1, 1)?.permute((0, 2, 3, 1))?.contiguous()?;
        let patches = patches.broadcast_add(&self.patch_bias)?;
        observer.show("encoder.patch_embed", || Ok(patches.clone()))?;
        let mut x = (patches + &self.positions)?;
        let mut stages = Vec::new();
        for (i, block) in self.blocks.iter().enumerate() {
            x = block.forward(&x)?;
            if self.stage_ends.contains(&i) {
                observer.show(&format!("encoder.stage{}", stages.len()), || Ok(x.clone()))?;
                stages.push(x.clone());
            }
        }
        let lateral = |level: usize| self.laterals[stages.len() - 1 - level].forward(&stages[level]);
        let mut levels: Vec<Tensor> = Vec::new();
        for level in (0..stages.len()).rev() {
            let own = lateral(level)?;
            levels.push(match levels.last() {
                Some(coarser) if self.top_down.contains(&level) => (own + doubled(coarser)?)?,
                _ => own,
            });
        }
        levels.reverse();
        for (i, level) in levels.iter().take(3).enumerate() {
            observer.show(&format!("encoder.fpn{i}"), || channels_first(level))?;
            observer.show(&format!("encoder.fpn_pos{i}"), || {
                sine_2d(level.dim(1)?, self.hidden, level.device())?.t()?.contiguous()
            })?;
        }
        let (fine, middle) = (self.to_fine.forward(&levels[0])?, self.to_middle.forward(&levels[1])?);
        observer.show("decoder.high_res_s0", || channels_first(&fine))?;
        observer.show("decoder.high_res_s1", || channels_first(&middle))?;
        let flat = |x: &Tensor| x.flatten(0, 2);
        Ok(ImageFeatures { fine: flat(&fine)?, middle: flat(&middle)?, coarse: flat(&levels[2])? })
    }
}

/// Returns the coarse embedding enlarged to the map, plus the window embedding repeated over the map: (1, side, side,
/// c).
fn positions(
    coarse: &Tensor,
    from: [usize; 2],
    tiled: &Tensor,
    window: usize,
    side: usize,
) -> Result<Tensor> {
    let channels = coarse.dim(1)?;
    let mut all = resize_bicubic(&coarse.flatten_all()?.to_vec1()?, channels, from, side);
    let tiled: Vec<f32> = tiled.permute((0, 2, 3, 1))?.flatten_all()?.to_vec1()?;
    for (cell, values) in all.chunks_mut(channels).enumerate() {
        let at = (cell / side % window) * window + cell % side % window;
        for (value, tile) in values.iter_mut().zip(&tiled[at * channels..]) {
            *value += tile;
        }
    }
    Tensor::from_vec(all, (1, side, side, channels), coarse.device())
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    #[test]
    fn joining_windows_inverts_splitting() {
        for (h, w, side) in [(8, 8, 4), (7, 5, 3)] {
            let x = Tensor::randn(0f32, 1.0, (1, h, w, 2), &Device::Cpu).unwrap();
            let windows = partitioned(&x, side).unwrap();
            assert_eq!(windows.dims(), [h.div_ceil(side) * w.div_ceil(side), side, side, 2]);
            let back = joined(&windows, side, h, w).unwrap();
            assert_eq!(
                back.flatten_all().unwrap().to_vec1::<f32>().unwrap(),
                x.flatten_all().unwrap().to_vec1::<f32>().unwrap()
            );
        }
    }

    #[test]
    fn pooling_takes_the_largest_of_four_and_doubling_repeats() {
        let x = Tensor::arange(0f32, 16.0, &Device::Cpu).unwrap().reshape((1, 4, 4, 1)).unwrap();
        let pooled = max_pool(&x).unwrap();
        assert_eq!(pooled.flatten_all().unwrap().to_vec1::<f32>().unwrap(), [5.0, 7.0, 13.0, 15.0]);
        let back = max_pool(&doubled(&pooled).unwrap()).unwrap();
        assert_eq!(back.flatten_all().unwrap().to_vec1::<f32>().unwrap(), [5.0, 7.0, 13.0, 15.0]);
    }
}
