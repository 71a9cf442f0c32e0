//! Tracking through a video. Each object has its own bank of memories.

use super::encoder::ImageFeatures;
use super::model::{ObjectMask, Sam2};
use super::positions::sine_1d;
use crate::kernels::resize_bilinear;
use crate::ops::TensorObserver;
use crate::owlv2::PixelBox;
use candle_core::{Result, Tensor};
use std::collections::BTreeMap;

/// Memory of one frame for an object.
#[derive(Debug)]
struct Memory {
    /// (tokens, memory channels); absent once it is too old for attention.
    features: Option<Tensor>,
    /// (1, c).
    pointer: Tensor,
}

/// An object's memories by frame; frame 0 is the prompted one.
type Bank = BTreeMap<usize, Memory>;

/// Tracks objects through a video, frame by frame.
#[derive(Debug)]
pub struct Tracker<'a> {
    model: &'a Sam2,
    banks: Vec<Bank>,
    /// Box of each object, in model pixels.
    boxes: Vec<[f64; 4]>,
    /// Index of the next frame.
    frame: usize,
    frames: usize,
}

impl<'a> Tracker<'a> {
    /// Starts tracking the objects in `boxes` on the first of `frames` frames of `size` (width, height) pixels.
    ///
    /// The number of frames affects the result, because ages of pointers are relative to the largest possible age.
    pub fn new(model: &'a Sam2, boxes: &[PixelBox], size: (usize, usize), frames: usize) -> Self {
        let boxes: Vec<_> = boxes.iter().map(|b| model.box_prompt(b, size)).collect();
        let banks = boxes.iter().map(|_| Bank::default()).collect();
        Self { model, banks, boxes, frame: 0, frames }
    }

    /// Returns the objects' masks in the next frame.
    ///
    /// # Errors
    /// If the device fails.
    pub fn next(
        &mut self,
        features: &ImageFeatures,
        observer: &mut TensorObserver<'_>,
    ) -> Result<Vec<ObjectMask>> {
        let outer = std::mem::take(&mut observer.prefix);
        let frame = self.frame;
        let mut masks = Vec::with_capacity(self.banks.len());
        let mut inputs = Vec::new();
        for object in 0..self.banks.len() {
            observer.prefix = format!("{outer}frame{frame}.obj{object}.");
            let (mask, input) = self.step(object, features, observer)?;
            masks.push(mask);
            inputs.push(input);
        }
        observer.prefix = format!("{outer}frame{frame}.");
        let device = self.model.device();
        observer.show("pred_masks", || {
            Tensor::new(masks.iter().flat_map(|m| m.logits.clone()).collect::<Vec<_>>(), device)
        })?;
        observer.show("object_score_logits", || {
            Tensor::new(masks.iter().map(|m| m.object_score).collect::<Vec<_>>(), device)
        })?;
        observer.show("memory_encoder_masks", || Tensor::cat(&inputs, 0))?;
        observer.prefix = outer;
        self.frame += 1;
        Ok(masks)
    }

    /// Processes one object in the current frame; returns its mask and the memory encoder's input.
    fn step(
        &mut self,
        object: usize,
        features: &ImageFeatures,
        observer: &mut TensorObserver<'_>,
    ) -> Result<(ObjectMask, Tensor)> {
        let model = self.model;
        let is_prompted = self.frame == 0;
        // On the prompted frame, the pointer always comes from the single mask.
        let (decoded, mask, token) = if is_prompted {
            let decoded = model.decode_box(features, self.boxes[object], observer)?;
            let mask = decoded.single(&model.config.mask_decoder_config)?;
            (decoded, mask, 0)
        } else {
            let conditioned = self.conditioned(object, features, observer)?;
            let decoded = model.decode(features, &conditioned, model.prompts.of_nothing()?, observer)?;
            let mask = decoded.best_of_three();
            (decoded, mask, mask)
        };
        let shown = if is_prompted { (mask, 1) } else { (1, decoded.iou.len() - 1) };
        let shown_tokens = if is_prompted { (0, 1) } else { shown };
        observer.show("decoder_masks", || decoded.masks.narrow(0, shown.0, shown.1))?;
        observer
            .show("decoder_iou", || Tensor::new(&decoded.iou[shown.0..shown.0 + shown.1], model.device()))?;
        observer.show("decoder_tokens", || decoded.tokens.narrow(0, shown_tokens.0, shown_tokens.1))?;
        observer.show("object_score_logits", || Tensor::new(&[decoded.object_score], model.device()))?;
        let pointer = model.object_pointer(&decoded, token)?;
        observer.show("object_pointer", || Ok(pointer.clone()))?;
        let result = model.object_mask(&decoded, mask)?;
        let (features, input) = self.memorize(features, &result, is_prompted, observer)?;
        observer.show("memory_features", || Ok(features.clone()))?;
        self.keep(object, Memory { features: Some(features), pointer });
        Ok((result, input))
    }

    /// Returns the memory of the current frame, and the mask in the memory encoder's form.
    fn memorize(
        &self,
        features: &ImageFeatures,
        mask: &ObjectMask,
        is_prompted: bool,
        observer: &mut TensorObserver<'_>,
    ) -> Result<(Tensor, Tensor)> {
        let config = &self.model.config;
        let size = config.image_size;
        let mut logits = resize_bilinear(&mask.logits, (mask.side, mask.side), (size, size));
        observer.show("high_res_mask", || Tensor::new(logits.as_slice(), self.model.device()))?;
        let (scale, bias) = (config.sigmoid_scale_for_mem_enc, config.sigmoid_bias_for_mem_enc);
        for logit in &mut logits {
            // The mask of a prompted frame is binary.
            let share = if is_prompted { f32::from(*logit > 0.0) } else { 1.0 / (1.0 + (-*logit).exp()) };
            *logit = share * scale + bias;
        }
        let input = Tensor::from_vec(logits, (1, 1, size, size), self.model.device())?;
        let memory = self.model.memory_encoder.forward(&features.coarse, &input)?;
        let memory = if mask.is_present() { memory } else { memory.broadcast_add(&self.model.occluded)? };
        Ok((memory, input))
    }

    /// Stores a memory of the current frame and drops memories that are too old for attention.
    fn keep(&mut self, object: usize, memory: Memory) {
        let config = &self.model.config;
        let (frame, bank) = (self.frame, &mut self.banks[object]);
        bank.insert(frame, memory);
        bank.retain(|&at, _| at == 0 || frame - at < config.max_object_pointers_in_encoder.max(1));
        for (&at, memory) in bank {
            if at != 0 && frame - at + 1 >= config.num_maskmem {
                memory.features = None;
            }
        }
    }

    /// Returns the current frame's features, conditioned on an object's memories.
    fn conditioned(
        &self,
        object: usize,
        features: &ImageFeatures,
        observer: &mut TensorObserver<'_>,
    ) -> Result<Tensor> {
        let (model, bank) = (self.model, &self.banks[object]);
        let config = &model.config;
        let frame = self.frame;
        let last = config.num_maskmem - 1;
        let mut tokens = Vec::new();
        let mut positions = Vec::new();
        let mut add = |memory: Option<&Memory>, time: usize| -> Result<()> {
            if let Some(features) = memory.and_then(|m| m.features.as_ref()) {
                tokens.push(features.clone());
                positions.push(model.memory_encoder.places.broadcast_add(&model.memory_times.get(time)?)?);
            }
            Ok(())
        };
        // The prompted frame comes first, with the last of the times, then the others from the oldest to the newest.
        add(bank.get(&0), last)?;
        let tracked = |age: usize| bank.get(&frame.checked_sub(age).filter(|&at| at != 0)?);
        for age in (1..=last).rev() {
            add(tracked(age), age - 1)?;
        }
        let most = config.max_object_pointers_in_encoder.min(self.frames);
        let mut pointers: Vec<(usize, &Tensor)> = Vec::new();
        pointers.extend(bank.get(&0).map(|m| (frame, &m.pointer)));
        pointers.extend((1..most).filter_map(|age| Some((age, &tracked(age)?.pointer))));
        // A pointer has the channels of several memory tokens, so it is split.
        let channels = config.memory_encoder_output_channels;
        let split = config.hidden() / channels;
        let ages: Vec<f32> = pointers.iter().map(|&(age, _)| age as f32 / (most.max(2) - 1) as f32).collect();
        let times = model.pointer_times.forward(&sine_1d(&ages, config.hidden(), model.device())?)?;
        let pointer_tokens = pointers.len() * split;
        let all: Vec<&Tensor> = pointers.iter().map(|&(_, p)| p).collect();
        tokens.push(Tensor::cat(&all, 0)?.reshape((pointer_tokens, channels))?);
        positions.push(
            times
                .unsqueeze(1)?
                .broadcast_as((pointers.len(), split, channels))?
                .reshape((pointer_tokens, channels))?,
        );
        let (memory, places) = (Tensor::cat(&tokens, 0)?, Tensor::cat(&positions, 0)?);
        observer.show("memory_tokens", || Ok(memory.clone()))?;
        observer.show("memory_tokens_position", || Ok(places.clone()))?;
        observer.show("num_pointer_tokens", || Tensor::new(&[pointer_tokens as u32], model.device()))?;
        let conditioned =
            model.memory_attention.forward(&features.coarse, &memory, &places, pointer_tokens)?;
        observer.show("memory_attention", || Ok(conditioned.clone()))?;
        Ok(conditioned)
    }
}
