//! `config.json` of an OWLv2 model. Missing fields have the defaults of the library that wrote it.

use serde::Deserialize;

/// Sizes of an OWLv2 model.
#[derive(Debug, Clone, Deserialize)]
#[serde(default)]
pub struct Owlv2Config {
    /// Architecture; `owlv2`.
    pub model_type: String,
    /// The text tower.
    pub text_config: TextConfig,
    /// The image tower.
    pub vision_config: VisionConfig,
    /// Length of the embeddings shared by both towers.
    pub projection_dim: usize,
}

/// Sizes of the text tower.
#[derive(Debug, Clone, Deserialize)]
#[serde(default)]
pub struct TextConfig {
    /// Number of tokens.
    pub vocab_size: usize,
    /// Channels.
    pub hidden_size: usize,
    /// Channels between a block's two fully connected layers.
    pub intermediate_size: usize,
    /// Number of blocks.
    pub num_hidden_layers: usize,
    /// Number of attention heads.
    pub num_attention_heads: usize,
    /// Number of tokens of a query, padding included.
    pub max_position_embeddings: usize,
    /// Added to the variance in layer normalisations.
    pub layer_norm_eps: f64,
}

/// Sizes of the image tower.
#[derive(Debug, Clone, Deserialize)]
#[serde(default)]
pub struct VisionConfig {
    /// Channels.
    pub hidden_size: usize,
    /// Channels between a block's two fully connected layers.
    pub intermediate_size: usize,
    /// Number of blocks.
    pub num_hidden_layers: usize,
    /// Number of attention heads.
    pub num_attention_heads: usize,
    /// Side of the resized square image, in pixels.
    pub image_size: usize,
    /// Side of a patch, in pixels.
    pub patch_size: usize,
    /// Added to the variance in layer normalisations.
    pub layer_norm_eps: f64,
}

impl VisionConfig {
    /// Returns the number of patches along a side of the image.
    pub fn grid(&self) -> usize {
        self.image_size / self.patch_size.max(1)
    }
}

/// Largest plausible size; published models are smaller.
const LARGEST: usize = 1 << 16;

impl Owlv2Config {
    /// Returns the first value that is impossible for any network, or `None`. Sizes that contradict the weights are
    /// detected when the weights are read.
    pub fn fault(&self) -> Option<String> {
        let (text, vision) = (&self.text_config, &self.vision_config);
        for (name, value, least, most) in [
            ("projection_dim", self.projection_dim, 1, LARGEST),
            ("text_config.vocab_size", text.vocab_size, 1, 16 * LARGEST),
            ("text_config.hidden_size", text.hidden_size, 1, LARGEST),
            ("text_config.intermediate_size", text.intermediate_size, 1, LARGEST),
            ("text_config.num_hidden_layers", text.num_hidden_layers, 1, 1024),
            ("text_config.num_attention_heads", text.num_attention_heads, 1, LARGEST),
            // The minimum is start, a word, end.
            ("text_config.max_position_embeddings", text.max_position_embeddings, 3, 1024),
            ("vision_config.hidden_size", vision.hidden_size, 1, LARGEST),
            ("vision_config.intermediate_size", vision.intermediate_size, 1, LARGEST),
            ("vision_config.num_hidden_layers", vision.num_hidden_layers, 1, 1024),
            ("vision_config.num_attention_heads", vision.num_attention_heads, 1, LARGEST),
            ("vision_config.image_size", vision.image_size, 1, 8192),
            ("vision_config.patch_size", vision.patch_size, 1, 8192),
        ] {
            if !(least..=most).contains(&value) {
                return Some(format!("{name} is {value}, not in {least} to {most}"));
            }
        }
        for (tower, hidden, heads, eps) in [
            ("text_config", text.hidden_size, text.num_attention_heads, text.layer_norm_eps),
            ("vision_config", vision.hidden_size, vision.num_attention_heads, vision.layer_norm_eps),
        ] {
            if !hidden.is_multiple_of(heads) {
                return Some(format!(
                    "{tower}.hidden_size is {hidden}, not a multiple of {tower}.num_attention_heads, {heads}"
                ));
            }
            if !(eps > 0.0 && eps <= 1.0) {
                return Some(format!("{tower}.layer_norm_eps is {eps}, not in (0, 1]"));
            }
        }
        if !vision.image_size.is_multiple_of(vision.patch_size) {
            let (image, patch) = (vision.image_size, vision.patch_size);
            return Some(format!(
                "vision_config.image_size is {image}, not a multiple of vision_config.patch_size, {patch}"
            ));
        }
        // The output of the class head has as many channels as the text tower and is compared with queries of the
        // shared length.
        if self.projection_dim != text.hidden_size {
            let (shared, hidden) = (self.projection_dim, text.hidden_size);
            return Some(format!(
                "projection_dim is {shared}, text_config.hidden_size {hidden}: they must be equal"
            ));
        }
        None
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

#[cfg(test)]
mod tests {
    use super::*;

    fn fault(json: &str) -> Option<String> {
        serde_json::from_str::<Owlv2Config>(json).unwrap().fault()
    }

    #[test]
    fn published_models_can_be_built() {
        assert_eq!(Owlv2Config::default().fault(), None);
        // `google/owlv2-large-patch14-ensemble`.
        let large = r#"{"projection_dim": 768, "text_config": {"hidden_size": 768, "intermediate_size": 3072, "num_attention_heads": 12},
            "vision_config": {"hidden_size": 1024, "intermediate_size": 4096, "num_hidden_layers": 24, "num_attention_heads": 16,
            "image_size": 1008, "patch_size": 14}}"#;
        assert_eq!(fault(large), None);
    }

    #[test]
    fn unsupported_configurations_are_named() {
        for (tower, key, value) in [
            ("text_config", "vocab_size", "0"),
            ("text_config", "hidden_size", "0"),
            ("text_config", "intermediate_size", "18446744073709551615"),
            ("text_config", "num_hidden_layers", "0"),
            ("text_config", "num_attention_heads", "0"),
            ("text_config", "max_position_embeddings", "2"),
            ("text_config", "max_position_embeddings", "1000000"),
            ("text_config", "layer_norm_eps", "-1e-5"),
            ("vision_config", "hidden_size", "100000000"),
            ("vision_config", "num_hidden_layers", "1000000000"),
            ("vision_config", "num_attention_heads", "0"),
            ("vision_config", "image_size", "0"),
            ("vision_config", "image_size", "160000"),
            ("vision_config", "patch_size", "0"),
            ("vision_config", "layer_norm_eps", "0"),
        ] {
            let json = format!(r#"{{"{tower}": {{"{key}": {value}}}}}"#);
            let fault = fault(&json).unwrap_or_default();
            assert!(fault.starts_with(&format!("{tower}.{key} is ")), "{json}: {fault}");
        }
        assert!(fault(r#"{"projection_dim": 0}"#).unwrap().starts_with("projection_dim is 0"));
    }

    #[test]
    fn sizes_that_do_not_divide_are_named() {
        for (json, parts) in [
            (r#"{"vision_config": {"patch_size": 14}}"#, ["image_size is 768", "patch_size, 14"]),
            (
                r#"{"vision_config": {"num_attention_heads": 7}}"#,
                ["hidden_size is 768", "num_attention_heads, 7"],
            ),
            (
                r#"{"text_config": {"num_attention_heads": 5}}"#,
                ["text_config.hidden_size is 512", "heads, 5"],
            ),
            (r#"{"projection_dim": 256}"#, ["projection_dim is 256", "text_config.hidden_size 512"]),
        ] {
            let fault = fault(json).unwrap_or_default();
            assert!(parts.iter().all(|part| fault.contains(part)), "{json}: {fault}");
        }
    }
}
