//! A SAM 2.1 model: its parts, and masks in a single image.

use super::config::Sam2Config;
use super::decoder::{Decoded, MaskDecoder, feed_forward};
use super::encoder::{Encoder, ImageFeatures};
use super::memory::{MemoryAttention, MemoryEncoder};
use super::prompt::{PromptEncoder, grid_positions};
use crate::kernels::Activation;
use crate::ops::{Linear, Seams, mlp};
use crate::owlv2::PixelBox;
use crate::{NetsError, Weights, resize_bilinear};
use candle_core::{Device, Result, Tensor};

/// What stands in a mask where the object is not in the picture.
pub(crate) const NO_OBJECT: f32 = -1024.0;

/// An object's mask in one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct ObjectMask {
    /// Logits at the decoder's resolution, `side` rows of `side`; above 0 on the object, −1024 everywhere where it is
    /// judged absent.
    pub logits: Vec<f32>,
    /// Pixels along a side.
    pub side: usize,
    /// Above 0 where the object is in the picture.
    pub object_score: f32,
    /// The share of overlap with the truth that the network expects, in 0..1.
    pub iou: f32,
}

impl ObjectMask {
    /// Whether the object is in the picture.
    pub fn is_present(&self) -> bool {
        self.object_score > 0.0
    }

    /// Logits of each pixel of an image of this size.
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
    /// For memories 1 frame old, 2 frames old, …, and last for the prompted frame: (memories, memory channels).
    pub(crate) memory_times: Tensor,
    pub(crate) places: Tensor,
    no_memory: Tensor,
    device: Device,
}

impl Sam2 {
    /// The model of `config` with these weights.
    ///
    /// # Errors
    /// [`NetsError::Input`] when the weights are another model's.
    pub fn new(config: &Sam2Config, weights: &Weights) -> std::result::Result<Self, NetsError> {
        let (c, memory) = (config.hidden(), config.memory_encoder_output_channels);
        let shared = weights.tensor("shared_image_embedding.positional_embedding", &[2, c / 2])?;
        // Not used where frames are prompted by boxes; asked for so that a file without them is noticed.
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

    /// The model's sizes.
    pub fn config(&self) -> &Sam2Config {
        &self.config
    }

    /// The device that the model is on.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Positions of a memory's tokens, (tokens, memory channels).
    pub fn memory_positions(&self) -> &Tensor {
        &self.memory_encoder.places
    }

    /// The corners of a box on an image of `width` × `height` pixels as the prompt encoder takes them: left, upper,
    /// right and lower edge in the model's pixels.
    pub fn box_prompt(&self, bbox: &PixelBox, (width, height): (usize, usize)) -> [f64; 4] {
        let side = self.config.image_size as f64;
        let (sx, sy) = (side / width as f64, side / height as f64);
        [bbox.x0 * sx, bbox.y0 * sy, bbox.x1 * sx, bbox.y1 * sy]
    }

    /// Features of one image from [`super::pixel_values`]; the costly part, the same for all objects.
    ///
    /// # Errors
    /// When the device fails, or the image has another size than the model takes.
    pub fn encode(&self, pixel_values: &Tensor, seams: &mut Seams<'_>) -> Result<ImageFeatures> {
        let features = self.encoder.forward(pixel_values, seams)?;
        let (side, c) = (self.config.grid(), self.config.hidden());
        let map = |x: &Tensor| x.t()?.reshape((1, c, side, side));
        seams.show("decoder.image_positional_embeddings", || map(&self.places))?;
        seams.show("decoder.dense_prompt", || map(&self.prompts.no_mask.expand((side * side, c))?))?;
        Ok(features)
    }

    /// The mask of what is in `bbox`, a box on an image of `width` × `height` pixels, in that image alone.
    ///
    /// # Errors
    /// When the device fails.
    pub fn segment(
        &self,
        features: &ImageFeatures,
        bbox: &PixelBox,
        (width, height): (usize, usize),
    ) -> Result<ObjectMask> {
        let corners = self.box_prompt(bbox, (width, height));
        let (decoded, _) = self.decode_box(features, corners, &mut Seams::none())?;
        let chosen = decoded.single(&self.config.mask_decoder_config)?;
        self.object_mask(&decoded, chosen.mask)
    }

    /// Decodes a box, in model pixels, without memories; also the features that were decoded.
    pub(crate) fn decode_box(
        &self,
        features: &ImageFeatures,
        corners: [f64; 4],
        seams: &mut Seams<'_>,
    ) -> Result<(Decoded, Tensor)> {
        let conditioned = features.coarse.broadcast_add(&self.no_memory)?;
        let prompt = self.prompts.of_box(corners, &self.device)?;
        seams.show("sparse_prompt", || Ok(prompt.clone()))?;
        let side = self.config.grid();
        seams.show("decoder_image_embedding", || conditioned.t()?.reshape((1, (), side, side)))?;
        let decoded =
            self.decoder.forward(features, &conditioned, &prompt, &self.prompts.no_mask, &self.places)?;
        Ok((decoded, conditioned))
    }

    /// One of the decoded masks, emptied where the object is not in the picture.
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

    /// The pointer to an object, from its mask's token, (1, c).
    pub(crate) fn object_pointer(&self, decoded: &Decoded, token: usize) -> Result<Tensor> {
        if decoded.object_score <= 0.0 {
            return Ok(self.no_pointer.clone());
        }
        mlp(&decoded.tokens.narrow(0, token, 1)?, &self.pointer, Activation::Relu)
    }
}
