//! `config.json` of a SAM 2.1 video model. Missing fields have the defaults of the library that wrote the file, which
//! are those of `sam2.1-hiera-tiny`.

use serde::Deserialize;

/// Sizes and rules of a SAM 2.1 model.
#[derive(Debug, Clone, Deserialize)]
#[serde(default)]
pub struct Sam2Config {
    /// Architecture; `sam2_video`.
    pub model_type: String,
    /// The image encoder.
    pub vision_config: EncoderConfig,
    /// The mask decoder.
    pub mask_decoder_config: DecoderConfig,
    /// Side of the resized square image, in pixels.
    pub image_size: usize,
    /// Number of frames with a memory per object, including the prompted one.
    pub num_maskmem: usize,
    /// Greatest number of object pointers per object.
    pub max_object_pointers_in_encoder: usize,
    /// Number of blocks of the memory attention.
    pub memory_attention_num_layers: usize,
    /// Attention heads of the memory attention.
    pub memory_attention_num_attention_heads: usize,
    /// Channels between the two fully connected layers of the memory attention.
    pub memory_attention_feed_forward_hidden_size: usize,
    /// Base of the rotary position encoding.
    pub memory_attention_rope_theta: f32,
    /// The base, as stored by newer versions of the library.
    pub rope_parameters: Option<RopeParameters>,
    /// Channels of a memory.
    pub memory_encoder_output_channels: usize,
    /// Number of blocks that fuse a mask with the image's features.
    pub memory_fuser_num_layers: usize,
    /// Channels between the two fully connected layers of a fusing block.
    pub memory_fuser_intermediate_dim: usize,
    /// Kernel of the depthwise convolution in a fusing block.
    pub memory_fuser_kernel_size: usize,
    /// The memory encoder takes masks as `scale · σ(logit) + bias`.
    pub sigmoid_scale_for_mem_enc: f32,
    /// See `sigmoid_scale_for_mem_enc`.
    pub sigmoid_bias_for_mem_enc: f32,
}

/// The rotary encoding, as stored by newer versions of the library.
#[derive(Debug, Clone, Deserialize)]
pub struct RopeParameters {
    /// The base.
    pub rope_theta: f32,
}

/// The image encoder: Hiera and a feature pyramid.
#[derive(Debug, Clone, Deserialize)]
#[serde(default)]
pub struct EncoderConfig {
    /// Hiera.
    pub backbone_config: HieraConfig,
    /// Channels of the pyramid and of everything after it.
    pub fpn_hidden_size: usize,
    /// Levels to which the next coarser one is added.
    pub fpn_top_down_levels: Vec<usize>,
}

/// Hiera (Ryali et al. 2023) as used in SAM 2.
#[derive(Debug, Clone, Deserialize)]
#[serde(default)]
pub struct HieraConfig {
    /// Number of blocks of each stage.
    pub blocks_per_stage: Vec<usize>,
    /// Channels of each stage.
    pub embed_dim_per_stage: Vec<usize>,
    /// Attention heads of each stage.
    pub num_attention_heads_per_stage: Vec<usize>,
    /// Side of the attention windows of each stage, in tokens.
    pub window_size_per_stage: Vec<usize>,
    /// Indices of the blocks that attend to the whole image.
    pub global_attention_blocks: Vec<usize>,
    /// Size of the stored coarse position embedding.
    pub window_positional_embedding_background_size: [usize; 2],
    /// Channels between the two fully connected layers, in multiples of the block's.
    pub mlp_ratio: f64,
    /// Added to the variance in layer normalisations.
    pub layer_norm_eps: f64,
}

/// The mask decoder.
#[derive(Debug, Clone, Deserialize)]
#[serde(default)]
pub struct DecoderConfig {
    /// Number of blocks of the two-way transformer, and of fully connected layers in each.
    pub num_hidden_layers: usize,
    /// Attention heads.
    pub num_attention_heads: usize,
    /// Channels between the fully connected layers.
    pub mlp_dim: usize,
    /// Reduction of the channels in cross attention.
    pub attention_downsample_rate: usize,
    /// Number of masks besides the single one.
    pub num_multimask_outputs: usize,
    /// Number of fully connected layers of the quality head.
    pub iou_head_depth: usize,
    /// Channels of the quality head.
    pub iou_head_hidden_dim: usize,
    /// Logits on both sides of 0 between which the stability of a mask is measured.
    pub dynamic_multimask_stability_delta: f32,
    /// Share of the mask below which it counts as unstable.
    pub dynamic_multimask_stability_thresh: f64,
}

/// Largest plausible size; published models are smaller.
const LARGEST: usize = 1 << 16;

impl Sam2Config {
    /// Returns the number of channels of the features.
    pub fn hidden(&self) -> usize {
        self.vision_config.fpn_hidden_size
    }

    /// Returns the number of tokens along a side of the coarsest features used, of stride 16.
    pub fn grid(&self) -> usize {
        self.image_size / 16
    }

    /// Returns the pixels along a side of the low-resolution masks, of stride 4.
    pub fn mask_side(&self) -> usize {
        self.image_size / 4
    }

    /// Returns the base of the rotary position encoding.
    pub fn rope_theta(&self) -> f32 {
        self.rope_parameters.as_ref().map_or(self.memory_attention_rope_theta, |r| r.rope_theta)
    }

    /// Returns the first value that is impossible for any network, or `None`. Sizes that contradict the weights are
    /// detected when the weights are read.
    pub fn fault(&self) -> Option<String> {
        let hiera = &self.vision_config.backbone_config;
        let stages = hiera.embed_dim_per_stage.len();
        if stages != 4 {
            return Some(format!("embed_dim_per_stage has {stages} stages instead of 4"));
        }
        for (name, list) in [
            ("blocks_per_stage", &hiera.blocks_per_stage),
            ("embed_dim_per_stage", &hiera.embed_dim_per_stage),
            ("num_attention_heads_per_stage", &hiera.num_attention_heads_per_stage),
            ("window_size_per_stage", &hiera.window_size_per_stage),
        ] {
            if list.len() != stages || list.iter().any(|v| !(1..=LARGEST).contains(v)) {
                return Some(format!("{name} is {list:?}: {stages} positive numbers are needed"));
            }
        }
        let [rows, columns] = hiera.window_positional_embedding_background_size;
        let decoder = &self.mask_decoder_config;
        for (name, value) in [
            ("window_positional_embedding_background_size", rows.min(columns)),
            ("image_size", self.image_size),
            ("num_maskmem", self.num_maskmem),
            ("fpn_hidden_size", self.hidden()),
            ("memory_encoder_output_channels", self.memory_encoder_output_channels),
            ("memory_attention_num_attention_heads", self.memory_attention_num_attention_heads),
            ("mask_decoder_config.num_attention_heads", decoder.num_attention_heads),
            ("mask_decoder_config.num_multimask_outputs", decoder.num_multimask_outputs),
            ("mask_decoder_config.iou_head_depth", decoder.iou_head_depth),
        ] {
            if !(1..=LARGEST).contains(&value) {
                return Some(format!("{name} is {value}"));
            }
        }
        if !self.image_size.is_multiple_of(32) || self.image_size > 8192 {
            return Some(format!(
                "image_size is {}: a multiple of 32, at most 8192, is needed",
                self.image_size
            ));
        }
        let uneven = |c: usize, heads: usize| !c.is_multiple_of(heads);
        let mut widths = hiera.embed_dim_per_stage.iter().zip(&hiera.num_attention_heads_per_stage);
        if let Some((c, heads)) = widths.find(|(c, heads)| uneven(**c, **heads)) {
            return Some(format!("{c} channels are not divisible by {heads} attention heads"));
        }
        if uneven(self.hidden(), self.memory_encoder_output_channels) {
            let (c, memory) = (self.hidden(), self.memory_encoder_output_channels);
            return Some(format!(
                "fpn_hidden_size is {c}, not a multiple of memory_encoder_output_channels, {memory}"
            ));
        }
        None
    }
}

impl Default for Sam2Config {
    fn default() -> Self {
        Self {
            model_type: "sam2_video".into(),
            vision_config: EncoderConfig::default(),
            mask_decoder_config: DecoderConfig::default(),
            image_size: 1024,
            num_maskmem: 7,
            max_object_pointers_in_encoder: 16,
            memory_attention_num_layers: 4,
            memory_attention_num_attention_heads: 1,
            memory_attention_feed_forward_hidden_size: 2048,
            memory_attention_rope_theta: 10_000.0,
            rope_parameters: None,
            memory_encoder_output_channels: 64,
            memory_fuser_num_layers: 2,
            memory_fuser_intermediate_dim: 1024,
            memory_fuser_kernel_size: 7,
            sigmoid_scale_for_mem_enc: 20.0,
            sigmoid_bias_for_mem_enc: -10.0,
        }
    }
}

impl Default for EncoderConfig {
    fn default() -> Self {
        Self {
            backbone_config: HieraConfig::default(),
            fpn_hidden_size: 256,
            fpn_top_down_levels: vec![2, 3],
        }
    }
}

impl Default for HieraConfig {
    fn default() -> Self {
        Self {
            blocks_per_stage: vec![1, 2, 7, 2],
            embed_dim_per_stage: vec![96, 192, 384, 768],
            num_attention_heads_per_stage: vec![1, 2, 4, 8],
            window_size_per_stage: vec![8, 4, 14, 7],
            global_attention_blocks: vec![5, 7, 9],
            window_positional_embedding_background_size: [7, 7],
            mlp_ratio: 4.0,
            layer_norm_eps: 1e-6,
        }
    }
}

impl Default for DecoderConfig {
    fn default() -> Self {
        Self {
            num_hidden_layers: 2,
            num_attention_heads: 8,
            mlp_dim: 2048,
            attention_downsample_rate: 2,
            num_multimask_outputs: 3,
            iou_head_depth: 3,
            iou_head_hidden_dim: 256,
            dynamic_multimask_stability_delta: 0.05,
            dynamic_multimask_stability_thresh: 0.98,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unsupported_configurations_are_named() {
        assert_eq!(Sam2Config::default().fault(), None);
        let faulty = |json: &str, part: &str| {
            let config: Sam2Config = serde_json::from_str(json).unwrap();
            let fault = config.fault().unwrap_or_default();
            assert!(fault.contains(part), "{json}: {fault}");
        };
        faulty(r#"{"num_maskmem": 0}"#, "num_maskmem is 0");
        faulty(r#"{"image_size": 100}"#, "image_size");
        faulty(r#"{"image_size": 0}"#, "image_size");
        faulty(r#"{"memory_encoder_output_channels": 60}"#, "memory_encoder_output_channels");
        for (key, value) in [
            ("blocks_per_stage", "[1, 2]"),
            ("blocks_per_stage", "[0, 2, 7, 2]"),
            ("embed_dim_per_stage", "[96]"),
            ("embed_dim_per_stage", "[]"),
            ("window_size_per_stage", "[8, 4, 0, 7]"),
            ("num_attention_heads_per_stage", "[1, 2, 4]"),
        ] {
            faulty(&format!(r#"{{"vision_config": {{"backbone_config": {{"{key}": {value}}}}}}}"#), key);
        }
        let heads =
            r#"{"vision_config": {"backbone_config": {"num_attention_heads_per_stage": [5, 2, 4, 8]}}}"#;
        faulty(heads, "96 channels are not divisible by 5");
    }
}
