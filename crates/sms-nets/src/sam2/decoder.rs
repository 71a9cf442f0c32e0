//! The mask decoder: a two-way transformer between prompt tokens and image features, and the heads on it.

use super::config::{DecoderConfig, Sam2Config};
use super::encoder::ImageFeatures;
use crate::attention::Attention;
use crate::kernels::Activation;
use crate::ops::{Linear, activated, mlp};
use crate::weights::{Loaded, Weights};
use candle_core::{Result, Tensor};
use candle_nn::{LayerNorm, Module};

/// A block of the two-way transformer.
#[derive(Debug)]
struct TwoWay {
    tokens: Attention,
    tokens_to_image: Attention,
    image_to_tokens: Attention,
    mlp: Vec<Linear>,
    norms: [LayerNorm; 4],
}

impl TwoWay {
    fn new(at: &Weights, size: usize, config: &DecoderConfig) -> Loaded<Self> {
        let (inner, heads) = (size / config.attention_downsample_rate.max(1), config.num_attention_heads);
        let attention =
            |name: &str, inner: usize| Attention::new(&at.at(name), [size, size, inner], heads, "o_proj");
        let norm = |i: usize| at.layer_norm(&format!("layer_norm{i}"), size, 1e-5);
        Ok(Self {
            tokens: attention("self_attn", size)?,
            tokens_to_image: attention("cross_attn_token_to_image", inner)?,
            image_to_tokens: attention("cross_attn_image_to_token", inner)?,
            mlp: feed_forward(&at.at("mlp"), size, config.mlp_dim, size, config.num_hidden_layers)?,
            norms: [norm(1)?, norm(2)?, norm(3)?, norm(4)?],
        })
    }

    /// Returns new tokens and image features; in the `first` block the tokens are still the prompt itself.
    fn forward(
        &self,
        tokens: &Tensor,
        image: &Tensor,
        prompt: &Tensor,
        places: &Tensor,
        first: bool,
    ) -> Result<(Tensor, Tensor)> {
        let x = if first {
            self.tokens.forward(tokens, tokens, tokens)?
        } else {
            let placed = (tokens + prompt)?;
            (tokens + self.tokens.forward(&placed, &placed, tokens)?)?
        };
        let x = self.norms[0].forward(&x)?;
        let placed_image = (image + places)?;
        let x = (&x + self.tokens_to_image.forward(&(&x + prompt)?, &placed_image, image)?)?;
        let x = self.norms[1].forward(&x)?;
        let x = self.norms[2].forward(&(&x + mlp(&x, &self.mlp, Activation::Relu)?)?)?;
        let image = (image + self.image_to_tokens.forward(&placed_image, &(&x + prompt)?, &x)?)?;
        Ok((x, self.norms[3].forward(&image)?))
    }
}

/// Fully connected layers: `depth` of them, with the library's names.
pub(crate) fn feed_forward(
    at: &Weights,
    inputs: usize,
    inner: usize,
    outputs: usize,
    depth: usize,
) -> Loaded<Vec<Linear>> {
    let mut layers = vec![at.linear("proj_in", inputs, inner)?];
    for i in 0..depth.saturating_sub(2) {
        layers.push(at.at("layers").linear(&i.to_string(), inner, inner)?);
    }
    layers.push(at.linear("proj_out", inner, outputs)?);
    Ok(layers)
}

/// A transposed convolution of kernel and stride 2: each pixel becomes four, independent of its neighbours.
#[derive(Debug)]
struct Upscale {
    /// (inputs, 4 · outputs), the four pixels row by row.
    weight: Tensor,
    bias: Tensor,
    outputs: usize,
}

impl Upscale {
    fn new(at: &Weights, inputs: usize, outputs: usize) -> Loaded<Self> {
        let weight = at.tensor("weight", &[inputs, outputs, 2, 2])?;
        Ok(Self {
            weight: weight.permute((0, 2, 3, 1))?.reshape((inputs, 4 * outputs))?,
            bias: at.tensor("bias", &[outputs])?,
            outputs,
        })
    }

    /// Maps pixels (side · side, inputs) to (2 side · 2 side, outputs).
    fn forward(&self, x: &Tensor, side: usize) -> Result<Tensor> {
        let four = x.matmul(&self.weight)?.reshape((side, side, 2, 2 * self.outputs))?;
        let rows = four.transpose(1, 2)?.reshape((4 * side * side, self.outputs))?;
        rows.broadcast_add(&self.bias)
    }
}

/// Output of the decoder for one prompt.
#[derive(Debug, Clone)]
pub(crate) struct Decoded {
    /// Logits of the single mask and of the three for an ambiguous prompt, (4, side · side).
    pub(crate) masks: Tensor,
    /// Predicted quality of each mask, in 0..1.
    pub(crate) iou: Vec<f32>,
    /// The masks' tokens, (4, c).
    pub(crate) tokens: Tensor,
    /// Above 0 if the object is in the picture.
    pub(crate) object_score: f32,
}

#[derive(Debug)]
pub(crate) struct MaskDecoder {
    /// Object, quality and mask tokens, (2 + masks, c).
    own_tokens: Tensor,
    blocks: Vec<TwoWay>,
    last: Attention,
    last_norm: LayerNorm,
    upscale1: Upscale,
    upscale2: Upscale,
    upscale_norm: LayerNorm,
    hyper: Vec<Vec<Linear>>,
    iou_head: Vec<Linear>,
    object_head: Vec<Linear>,
}

impl MaskDecoder {
    pub(crate) fn new(config: &Sam2Config, weights: &Weights) -> Loaded<Self> {
        let (c, at) = (config.hidden(), weights.at("mask_decoder"));
        let decoder = &config.mask_decoder_config;
        let masks = decoder.num_multimask_outputs + 1;
        let object = at.tensor("obj_score_token.weight", &[1, c])?;
        let iou = at.tensor("iou_token.weight", &[1, c])?;
        let mask_tokens = at.tensor("mask_tokens.weight", &[masks, c])?;
        let transformer = at.at("transformer");
        let blocks =
            (0..decoder.num_hidden_layers).map(|i| TwoWay::new(&transformer.at("layers").at(i), c, decoder));
        let hyper =
            (0..masks).map(|i| feed_forward(&at.at("output_hypernetworks_mlps").at(i), c, c, c / 8, 3));
        let inner = c / decoder.attention_downsample_rate.max(1);
        let last = transformer.at("final_attn_token_to_image");
        let (depth, hidden) = (decoder.iou_head_depth, decoder.iou_head_hidden_dim);
        Ok(Self {
            own_tokens: Tensor::cat(&[object, iou, mask_tokens], 0)?,
            blocks: blocks.collect::<Loaded<_>>()?,
            last: Attention::new(&last, [c, c, inner], decoder.num_attention_heads, "o_proj")?,
            last_norm: transformer.layer_norm("layer_norm_final_attn", c, 1e-5)?,
            upscale1: Upscale::new(&at.at("upscale_conv1"), c, c / 4)?,
            upscale2: Upscale::new(&at.at("upscale_conv2"), c / 4, c / 8)?,
            upscale_norm: at.layer_norm("upscale_layer_norm", c / 4, 1e-6)?,
            hyper: hyper.collect::<Loaded<_>>()?,
            iou_head: feed_forward(&at.at("iou_prediction_head"), c, hidden, masks, depth)?,
            object_head: feed_forward(&at.at("pred_obj_score_head"), c, c, 1, 3)?,
        })
    }

    /// Decodes masks for one prompt (tokens, c) on image features (side · side, c), conditioned on memories or their
    /// absence. `no_mask` (c) replaces the missing mask prompt; `places` are the encodings of the positions.
    pub(crate) fn forward(
        &self,
        features: &ImageFeatures,
        conditioned: &Tensor,
        prompt: &Tensor,
        no_mask: &Tensor,
        places: &Tensor,
    ) -> Result<Decoded> {
        let side = (conditioned.dim(0)? as f64).sqrt().round() as usize;
        let prompt = Tensor::cat(&[&self.own_tokens, prompt], 0)?.unsqueeze(0)?;
        let mut image = conditioned.broadcast_add(no_mask)?.unsqueeze(0)?;
        let places = places.unsqueeze(0)?;
        let mut tokens = prompt.clone();
        for (i, block) in self.blocks.iter().enumerate() {
            (tokens, image) = block.forward(&tokens, &image, &prompt, &places, i == 0)?;
        }
        let attended = self.last.forward(&(&tokens + &prompt)?, &(&image + &places)?, &image)?;
        let tokens = self.last_norm.forward(&(&tokens + attended)?)?.squeeze(0)?;

        let fine = (self.upscale1.forward(&image.squeeze(0)?, side)? + &features.middle)?;
        let fine = activated(self.upscale_norm.forward(&fine)?, Activation::Gelu)?;
        let fine = activated((self.upscale2.forward(&fine, 2 * side)? + &features.fine)?, Activation::Gelu)?;
        let mask_tokens = tokens.narrow(0, 2, self.hyper.len())?;
        let hyper = self
            .hyper
            .iter()
            .enumerate()
            .map(|(i, layers)| mlp(&mask_tokens.narrow(0, i, 1)?, layers, Activation::Relu));
        let hyper = Tensor::cat(&hyper.collect::<Result<Vec<_>>>()?, 0)?;
        let iou = candle_nn::ops::sigmoid(&mlp(&tokens.narrow(0, 1, 1)?, &self.iou_head, Activation::Relu)?)?;
        let object_score = mlp(&tokens.narrow(0, 0, 1)?, &self.object_head, Activation::Relu)?;
        Ok(Decoded {
            masks: hyper.matmul(&fine.t()?)?,
            iou: iou.squeeze(0)?.to_vec1()?,
            tokens: mask_tokens,
            object_score: object_score.flatten_all()?.to_vec1::<f32>()?[0],
        })
    }
}

impl Decoded {
    /// Selects a row of [`Decoded::masks`] on a prompted frame: the single mask if it is stable, else the best of the
    /// others.
    pub(crate) fn single(&self, config: &DecoderConfig) -> Result<usize> {
        let logits = self.masks.get(0)?.to_vec1::<f32>()?;
        let delta = config.dynamic_multimask_stability_delta;
        let above = |limit: f32| logits.iter().filter(|&&l| l > limit).count();
        let (inner, outer) = (above(delta), above(-delta));
        let stability = if outer > 0 { inner as f64 / outer as f64 } else { 1.0 };
        let is_stable = stability >= config.dynamic_multimask_stability_thresh;
        Ok(if is_stable { 0 } else { self.best_of_three() })
    }

    /// Returns the row of the best mask other than the single one (the first of equals).
    pub(crate) fn best_of_three(&self) -> usize {
        (1..self.iou.len()).fold(1, |best, i| if self.iou[i] > self.iou[best] { i } else { best })
    }
}
