//! The two towers and the heads of OWLv2 (Minderer et al. 2023, "Scaling Open-Vocabulary Object Detection").

use super::{Owlv2Config, Tokens};
use crate::attention::Attention;
use crate::kernels::Activation;
use crate::ops::{Linear, TensorObserver, mlp, normalized};
use crate::weights::{Loaded, Weights};
use candle_core::{D, Device, Result, Tensor};
use candle_nn::{LayerNorm, Module};

/// A block of either tower.
#[derive(Debug)]
struct TowerBlock {
    attention: Attention,
    norm1: LayerNorm,
    norm2: LayerNorm,
    mlp: Vec<Linear>,
}

impl TowerBlock {
    fn new(at: &Weights, size: usize, inner: usize, heads: usize, eps: f64) -> Loaded<Self> {
        Ok(Self {
            attention: Attention::new(&at.at("self_attn"), [size; 3], heads, "out_proj")?,
            norm1: at.layer_norm("layer_norm1", size, eps)?,
            norm2: at.layer_norm("layer_norm2", size, eps)?,
            mlp: at.feed_forward(["mlp.fc1", "mlp.fc2"], size, inner)?,
        })
    }

    /// `x` (b, n, c); `mask` (b, n, n) is added to the scores.
    fn forward(&self, x: &Tensor, mask: Option<&Tensor>) -> Result<Tensor> {
        let y = self.norm1.forward(x)?;
        let (q, k, v) = self.attention.projected(&y, &y, &y)?;
        let x = (x + self.attention.attend(&q, &k, &v, mask)?)?;
        &x + mlp(&self.norm2.forward(&x)?, &self.mlp, Activation::QuickGelu)?
    }
}

/// Output of the heads for each patch.
#[derive(Debug, Clone)]
pub struct Owlv2Heads {
    /// Score of each query, (1, patches, queries).
    pub logits: Tensor,
    /// Centre and size of the box in 0..1 of the padded square, (1, patches, 4).
    pub boxes: Tensor,
    /// Whether the patch belongs to an object, (1, patches).
    pub objectness: Tensor,
    /// Class embeddings, (1, patches, c).
    pub class_embeds: Tensor,
}

/// An OWLv2 model.
#[derive(Debug)]
pub struct Owlv2 {
    config: Owlv2Config,
    token_embedding: Tensor,
    text_positions: Tensor,
    text_blocks: Vec<TowerBlock>,
    text_norm: LayerNorm,
    text_projection: Linear,
    class_token: Tensor,
    patch_weight: Tensor,
    image_positions: Tensor,
    pre_norm: LayerNorm,
    image_blocks: Vec<TowerBlock>,
    post_norm: LayerNorm,
    image_projection: Linear,
    merge_norm: LayerNorm,
    class_dense: Linear,
    logit_shift: Linear,
    logit_scale: Linear,
    box_head: Vec<Linear>,
    objectness_head: Vec<Linear>,
    box_bias: Tensor,
}

impl Owlv2 {
    /// Builds the model of `config` with these weights.
    ///
    /// # Errors
    /// [`crate::NetsError::Input`] if the weights belong to another model.
    pub fn new(config: &Owlv2Config, weights: &Weights) -> Loaded<Self> {
        let (t, v) = (&config.text_config, &config.vision_config);
        let owl = weights.at("owlv2");
        let (text, vision) = (owl.at("text_model"), owl.at("vision_model"));
        let grid = v.grid();
        let text_blocks = (0..t.num_hidden_layers).map(|i| {
            let at = text.at("encoder.layers").at(i);
            TowerBlock::new(&at, t.hidden_size, t.intermediate_size, t.num_attention_heads, t.layer_norm_eps)
        });
        let image_blocks = (0..v.num_hidden_layers).map(|i| {
            let at = vision.at("encoder.layers").at(i);
            TowerBlock::new(&at, v.hidden_size, v.intermediate_size, v.num_attention_heads, v.layer_norm_eps)
        });
        let head = |name: &str, outputs: usize| {
            let at = weights.at(name);
            Loaded::Ok(vec![
                at.linear("dense0", v.hidden_size, v.hidden_size)?,
                at.linear("dense1", v.hidden_size, v.hidden_size)?,
                at.linear("dense2", v.hidden_size, outputs)?,
            ])
        };
        // Detection does not use the contrastive temperature; reading it detects files without it.
        owl.tensor("logit_scale", &[])?;
        let patch = [v.hidden_size, 3, v.patch_size, v.patch_size];
        Ok(Self {
            token_embedding: text
                .tensor("embeddings.token_embedding.weight", &[t.vocab_size, t.hidden_size])?,
            text_positions: text.tensor(
                "embeddings.position_embedding.weight",
                &[t.max_position_embeddings, t.hidden_size],
            )?,
            text_blocks: text_blocks.collect::<Loaded<_>>()?,
            text_norm: text.layer_norm("final_layer_norm", t.hidden_size, t.layer_norm_eps)?,
            text_projection: owl.linear_no_bias("text_projection", t.hidden_size, config.projection_dim)?,
            class_token: vision.tensor("embeddings.class_embedding", &[v.hidden_size])?,
            patch_weight: vision
                .tensor("embeddings.patch_embedding.weight", &patch)?
                .reshape((v.hidden_size, 3 * v.patch_size * v.patch_size))?,
            image_positions: vision
                .tensor("embeddings.position_embedding.weight", &[grid * grid + 1, v.hidden_size])?,
            pre_norm: vision.layer_norm("pre_layernorm", v.hidden_size, v.layer_norm_eps)?,
            image_blocks: image_blocks.collect::<Loaded<_>>()?,
            post_norm: vision.layer_norm("post_layernorm", v.hidden_size, v.layer_norm_eps)?,
            image_projection: owl.linear_no_bias(
                "visual_projection",
                v.hidden_size,
                config.projection_dim,
            )?,
            merge_norm: weights.layer_norm("layer_norm", v.hidden_size, v.layer_norm_eps)?,
            class_dense: weights.linear("class_head.dense0", v.hidden_size, t.hidden_size)?,
            logit_shift: weights.linear("class_head.logit_shift", v.hidden_size, 1)?,
            logit_scale: weights.linear("class_head.logit_scale", v.hidden_size, 1)?,
            box_head: head("box_head", 4)?,
            objectness_head: head("objectness_head", 1)?,
            box_bias: box_bias(grid, weights.device())?,
            config: config.clone(),
        })
    }

    /// Returns the model's sizes.
    pub fn config(&self) -> &Owlv2Config {
        &self.config
    }

    /// Returns embeddings of queries, (queries, c), of unit length.
    ///
    /// # Errors
    /// If the device fails, or tokens are outside the model's vocabulary.
    pub fn text(&self, queries: &[Tokens], observer: &mut TensorObserver<'_>) -> Result<Tensor> {
        let device = self.token_embedding.device();
        let (count, length) = (queries.len(), self.config.text_config.max_position_embeddings);
        let ids: Vec<u32> = queries.iter().flat_map(|q| q.ids.iter().copied()).collect();
        let ids = Tensor::from_vec(ids, count * length, device)?;
        let embedded = self.token_embedding.index_select(&ids, 0)?.reshape((count, length, ()))?;
        let mut x = embedded.broadcast_add(&self.text_positions)?;
        observer.show("text.embeddings", || Ok(x.clone()))?;
        // A token attends to itself and the tokens before it, except padding.
        let mut mask = Vec::with_capacity(count * length * length);
        for query in queries {
            for i in 0..length {
                mask.extend((0..length).map(|j| if j > i || j >= query.used { f32::MIN } else { 0.0 }));
            }
        }
        let mask = Tensor::from_vec(mask, (count, length, length), device)?;
        for (i, block) in self.text_blocks.iter().enumerate() {
            x = block.forward(&x, Some(&mask))?;
            observer.show(&format!("text.layer{i}"), || Ok(x.clone()))?;
        }
        let x = self.text_norm.forward(&x)?;
        observer.show("text.last_hidden_state", || Ok(x.clone()))?;
        // CLIP pools at the largest token id: the end of the text.
        let pooled = queries.iter().enumerate().map(|(i, query)| {
            let end = (0..length).rev().max_by_key(|&j| query.ids[j]).unwrap_or(0);
            x.get(i)?.get(end)
        });
        let pooled = Tensor::stack(&pooled.collect::<Result<Vec<_>>>()?, 0)?;
        observer.show("text.pooled", || Ok(pooled.clone()))?;
        let embeds = normalized(&self.text_projection.forward(&pooled)?, 0.0)?;
        observer.show("text.embeds_normalized", || Ok(embeds.clone()))?;
        Ok(embeds)
    }

    /// Returns features of an image's patches, (1, patches, c), from [`super::pixel_values`].
    ///
    /// # Errors
    /// If the device fails, or the image has the wrong size.
    pub fn image(&self, pixel_values: &Tensor, observer: &mut TensorObserver<'_>) -> Result<Tensor> {
        let v = &self.config.vision_config;
        let (grid, patch) = (v.grid(), v.patch_size);
        // A convolution with a stride equal to its kernel is one product with the patches.
        let patches = pixel_values
            .reshape((3, grid, patch, grid, patch))?
            .permute((1, 3, 0, 2, 4))?
            .reshape((grid * grid, 3 * patch * patch))?;
        let patches = patches.matmul(&self.patch_weight.t()?)?;
        let x = Tensor::cat(&[&self.class_token.unsqueeze(0)?, &patches], 0)?;
        let x = (x + &self.image_positions)?.unsqueeze(0)?;
        observer.show("vision.embeddings", || Ok(x.clone()))?;
        let mut x = self.pre_norm.forward(&x)?;
        observer.show("vision.pre_layernorm", || Ok(x.clone()))?;
        for (i, block) in self.image_blocks.iter().enumerate() {
            x = block.forward(&x, None)?;
            observer.show(&format!("vision.layer{i}"), || Ok(x.clone()))?;
        }
        observer.show("vision.last_hidden_state", || Ok(x.clone()))?;
        let x = self.post_norm.forward(&x)?;
        let class = x.narrow(1, 0, 1)?;
        let embeds = self.image_projection.forward(&class.squeeze(1)?)?;
        observer.show("vision.image_embeds_normalized", || normalized(&embeds, 0.0))?;
        let patches = x.narrow(1, 1, grid * grid)?.broadcast_mul(&class)?;
        let features = self.merge_norm.forward(&patches)?;
        observer.show("vision.feature_map", || features.reshape((1, grid, grid, ())))?;
        Ok(features)
    }

    /// Returns the heads' output for patches of [`Owlv2::image`] and queries of [`Owlv2::text`].
    ///
    /// # Errors
    /// If the device fails.
    pub fn heads(&self, features: &Tensor, queries: &Tensor) -> Result<Owlv2Heads> {
        let dense = self.class_dense.forward(features)?;
        let class_embeds = normalized(&dense, 1e-6)?;
        let queries = normalized(queries, 1e-6)?;
        let fit = class_embeds.squeeze(0)?.matmul(&queries.t()?)?.unsqueeze(0)?;
        let scale = (self.logit_scale.forward(features)?.elu(1.0)? + 1.0)?;
        let logits = fit.broadcast_add(&self.logit_shift.forward(features)?)?.broadcast_mul(&scale)?;
        let boxes = mlp(features, &self.box_head, Activation::Gelu)?.broadcast_add(&self.box_bias)?;
        let objectness = mlp(features, &self.objectness_head, Activation::Gelu)?.squeeze(D::Minus1)?;
        Ok(Owlv2Heads { logits, boxes: candle_nn::ops::sigmoid(&boxes)?, objectness, class_embeds })
    }

    /// Returns the offset of the box head's output, the place and size of each patch, (patches, 4).
    pub fn box_bias(&self) -> &Tensor {
        &self.box_bias
    }
}

fn box_bias(grid: usize, device: &Device) -> Result<Tensor> {
    // The inverse of the sigmoid, kept finite at 0 and 1.
    let logit = |p: f32| (p + 1e-4).ln() - (-p + 1e-4).ln_1p();
    let side = logit(1.0 / grid as f32);
    let place = |i: usize| logit(((i + 1) as f32 / grid as f32).clamp(0.0, 1.0));
    let bias = (0..grid * grid).flat_map(|i| [place(i % grid), place(i / grid), side, side]).collect();
    Tensor::from_vec(bias, (grid * grid, 4), device)
}
