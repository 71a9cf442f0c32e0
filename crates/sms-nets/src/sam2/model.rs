//! A SAM 2.1 model: its parts, and masks in a single image.

use super::config::Sam2Config;
use super::decoder::{Decoded, MaskDecoder, feed_forward};
use super::encoder::{Encoder, ImageFeatures};
use super::memory::{MemoryAttention, MemoryEncoder};
use super::prompt::{PromptEncoder, grid_positions};
use crate::kernels::{Activation, resize_bilinear};
use crate::ops::{Linear, TensorObserver, mlp};
use crate::owlv2::PixelBox;
use crate::weights::{Loaded, Weights};
use candle_core::{Device, Result, Tensor};

/// Logit of masks of absent objects.
pub(crate) const NO_OBJECT: f32 = -1024.0;

/// An object's mask in one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectMask {
    /// Logits at the decoder's resolution, `side` rows of `side`; above 0 on the object, −1024 everywhere if it is
    /// predicted absent.
    pub logits: Vec<f32>,
    /// Pixels along a side.
    pub side: usize,
    /// Above 0 if the object is in the picture.
    pub object_score: f32,
    /// Predicted intersection over union with the truth, in 0..1.
    pub iou: f32,
}

impl ObjectMask {
    /// Whether the object is in the picture.
    pub fn is_present(&self) -> bool {
        self.object_score > 0.0
    }

    /// Returns the logits of each pixel of an image of this size.
    pub fn resized(&self, width: usize, height: usize) -> Vec<f32> {
        resize_bilinear(&self.logits, (self.side, self.side), (width, height))
    }
}

/// A SAM 2.1 video model.
#[derive(Debug)]
pub struct Sam2 {
    pub(crate) config: Sam2Config,
    pub(crate) encoder: Encoder,
    pub(crate) prompts: PromptEncoder,
    pub(crate) decoder: MaskDecoder,
    pub(crate) memory_attention: MemoryAttention,
    pub(crate) memory_encoder: MemoryEncoder,
    pub(crate) pointer: Vec<Linear>,
    pub(crate) pointer_times: Linear,
    pub(crate) no_pointer: Tensor,
    pub(crate) occluded: Tensor,
    /// Encodings for memories 1 frame old, 2 frames old, …, and last for the prompted frame: (memories, memory
    /// channels).
    pub(crate) memory_times: Tensor,
    pub(crate) places: Tensor,
    no_memory: Tensor,
    device: Device,
}

impl Sam2 {
    /// Builds the model of `config` with these weights.
    ///
    /// # Errors
    /// [`crate::NetsError::Input`] if the weights belong to another model.
    pub fn new(config: &Sam2Config, weights: &Weights) -> Loaded<Self> {
        let (c, memory) = (config.hidden(), config.memory_encoder_output_channels);
        let shared = weights.tensor("shared_image_embedding.positional_embedding", &[2, c / 2])?;
        // Box prompts do not use these tensors; reading them detects files without them.
        weights.tensor("no_memory_positional_encoding", &[1, 1, c])?;
        weights.tensor("mask_downsample.weight", &[1, 1, 4, 4])?;
        weights.tensor("mask_downsample.bias", &[1])?;
        Ok(Self {
            encoder: Encoder::new(config, weights)?,
            prompts: PromptEncoder::new(config, &shared, weights)?,
            decoder: MaskDecoder::new(config, weights)?,
            memory_attention: MemoryAttention::new(config, weights)?,
            memory_encoder: MemoryEncoder::new(config, weights)?,
            pointer: feed_forward(&weights.at("object_pointer_proj"), c, c, c, 3)?,
            pointer_times: weights.linear("temporal_positional_encoding_projection_layer", c, memory)?,
            no_pointer: weights.tensor("no_object_pointer", &[1, c])?,
            occluded: weights.tensor("occlusion_spatial_embedding_parameter", &[1, memory])?,
            memory_times: weights
                .tensor("memory_temporal_positional_encoding", &[config.num_maskmem, 1, 1, memory])?
                .flatten(0, 2)?,
            places: grid_positions(config.grid(), &shared)?,
            no_memory: weights.tensor("no_memory_embedding", &[1, 1, c])?.flatten(0, 1)?,
            device: weights.device().clone(),
            config: config.clone(),
        })
    }

    /// Returns the model's sizes.
    pub fn config(&self) -> &Sam2Config {
        &self.config
    }

    /// Returns the model's device.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Returns the positions of a memory's tokens, (tokens, memory channels).
    pub fn memory_positions(&self) -> &Tensor {
        &self.memory_encoder.places
    }

    /// Returns the corners of a box on an image of `width` × `height` pixels in the prompt encoder's form: left,
    /// upper, right and lower edge in the model's pixels.
    pub fn box_prompt(&self, bbox: &PixelBox, (width, height): (usize, usize)) -> [f64; 4] {
        let side = self.config.image_size as f64;
        let (sx, sy) = (side / width as f64, side / height as f64);
        [bbox.x0 * sx, bbox.y0 * sy, bbox.x1 * sx, bbox.y1 * sy]
    }

    /// Returns features of one image from [`super::pixel_values`]. This is the costly part, and it is shared by all
    /// objects.
    ///
    /// # Errors
    /// If the device fails, or the image has the wrong size.
    pub fn encode(&self, pixel_values: &Tensor, observer: &mut TensorObserver<'_>) -> Result<ImageFeatures> {
        let features = self.encoder.forward(pixel_values, observer)?;
        let (side, c) = (self.config.grid(), self.config.hidden());
        let map = |x: &Tensor| x.t()?.reshape((1, c, side, side));
        observer.show("decoder.image_positional_embeddings", || map(&self.places))?;
        observer.show("decoder.dense_prompt", || map(&self.prompts.no_mask.expand((side * side, c))?))?;
        Ok(features)
    }

    /// Returns the mask of the object in `bbox`, a box on an image of `width` × `height` pixels, without memories.
    ///
    /// # Errors
    /// If the device fails.
    pub fn segment(
        &self,
        features: &ImageFeatures,
        bbox: &PixelBox,
        (width, height): (usize, usize),
    ) -> Result<ObjectMask> {
        let corners = self.box_prompt(bbox, (width, height));
        let decoded = self.decode_box(features, corners, &mut TensorObserver::none())?;
        let mask = decoded.single(&self.config.mask_decoder_config)?;
        self.object_mask(&decoded, mask)
    }

    /// Decodes a box, in model pixels, without memories.
    pub(crate) fn decode_box(
        &self,
        features: &ImageFeatures,
        corners: [f64; 4],
        observer: &mut TensorObserver<'_>,
    ) -> Result<Decoded> {
        let conditioned = features.coarse.broadcast_add(&self.no_memory)?;
        let side = self.config.grid();
        observer.show("decoder_image_embedding", || conditioned.t()?.reshape((1, (), side, side)))?;
        self.decode(features, &conditioned, self.prompts.of_box(corners, &self.device)?, observer)
    }

    /// Decodes a prompt (tokens, c) on the features of stride 16, conditioned on memories or their absence.
    pub(crate) fn decode(
        &self,
        features: &ImageFeatures,
        conditioned: &Tensor,
        prompt: Tensor,
        observer: &mut TensorObserver<'_>,
    ) -> Result<Decoded> {
        observer.show("sparse_prompt", || Ok(prompt.clone()))?;
        self.decoder.forward(features, conditioned, &prompt, &self.prompts.no_mask, &self.places)
    }

    /// Returns one of the decoded masks, emptied if the object is not in the picture.
    pub(crate) fn object_mask(&self, decoded: &Decoded, mask: usize) -> Result<ObjectMask> {
        let mut logits = decoded.masks.get(mask)?.to_vec1::<f32>()?;
        if decoded.object_score <= 0.0 {
            logits.fill(NO_OBJECT);
        }
        Ok(ObjectMask {
            logits,
            side: self.config.mask_side(),
            object_score: decoded.object_score,
            iou: decoded.iou[mask],
        })
    }

    /// Returns the pointer to an object, from its mask's token, (1, c).
    pub(crate) fn object_pointer(&self, decoded: &Decoded, token: usize) -> Result<Tensor> {
        if decoded.object_score <= 0.0 {
            return Ok(self.no_pointer.clone());
        }
        mlp(&decoded.tokens.narrow(0, token, 1)?, &self.pointer, Activation::Relu)
    }
}
