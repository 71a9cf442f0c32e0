//! `config.json` of an OWLv2 model; what it leaves out has the values of the library that wrote it.

use serde::Deserialize;

/// An OWLv2 model's sizes.
#[derive(Debug, Clone, Deserialize)]
#[serde(default)]
pub struct Owlv2Config {
    /// Which architecture; `owlv2`.
    pub model_type: String,
    /// The text tower.
    pub text_config: TextConfig,
    /// The image tower.
    pub vision_config: VisionConfig,
    /// Length of the embeddings that both towers share.
    pub projection_dim: usize,
}

/// The text tower's sizes.
#[derive(Debug, Clone, Deserialize)]
#[serde(default)]
pub struct TextConfig {
    /// Number of tokens.
    pub vocab_size: usize,
    /// Channels.
    pub hidden_size: usize,
    /// Channels between a block's two fully connected layers.
    pub intermediate_size: usize,
    /// Blocks.
    pub num_hidden_layers: usize,
    /// Attention heads.
    pub num_attention_heads: usize,
    /// Tokens of a query, padding included.
    pub max_position_embeddings: usize,
    /// Added to the variance in layer normalisations.
    pub layer_norm_eps: f64,
}

/// The image tower's sizes.
#[derive(Debug, Clone, Deserialize)]
#[serde(default)]
pub struct VisionConfig {
    /// Channels.
    pub hidden_size: usize,
    /// Channels between a block's two fully connected layers.
    pub intermediate_size: usize,
    /// Blocks.
    pub num_hidden_layers: usize,
    /// Attention heads.
    pub num_attention_heads: usize,
    /// Side of the square that the image is resized to, in pixels.
    pub image_size: usize,
    /// Side of a patch, in pixels.
    pub patch_size: usize,
    /// Added to the variance in layer normalisations.
    pub layer_norm_eps: f64,
}

impl VisionConfig {
    /// Patches along a side of the image.
    pub fn grid(&self) -> usize {
        self.image_size / self.patch_size.max(1)
    }
}

impl Owlv2Config {
    /// The sizes of `google/owlv2-base-patch16-ensemble`.
    pub fn base_patch16() -> Self {
        let mut config = Self::default();
        config.vision_config.image_size = 960;
        config
    }
}

impl Default for Owlv2Config {
    fn default() -> Self {
        Self {
            model_type: "owlv2".into(),
            text_config: TextConfig::default(),
            vision_config: VisionConfig::default(),
            projection_dim: 512,
        }
    }
}

impl Default for TextConfig {
    fn default() -> Self {
        Self {
            vocab_size: 49408,
            hidden_size: 512,
            intermediate_size: 2048,
            num_hidden_layers: 12,
            num_attention_heads: 8,
            max_position_embeddings: 16,
            layer_norm_eps: 1e-5,
        }
    }
}

impl Default for VisionConfig {
    fn default() -> Self {
        Self {
            hidden_size: 768,
            intermediate_size: 3072,
            num_hidden_layers: 12,
            num_attention_heads: 12,
            image_size: 768,
            patch_size: 16,
            layer_norm_eps: 1e-5,
        }
    }
}
