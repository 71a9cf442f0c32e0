//! Rendered views of a finished model, for the report.

use super::ply::seedlings_of;
use crate::parameters::{ClassifierState, Parameters};
use crate::{CpuTrainer, GaussianModel, TrainConfig, TrainState, Trainer};
use sms_core::{ColorImage, DepthImage, Image, LabelMap, Seed};
use sms_frames::Sequence;

/// A model rendered from the camera of one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct ViewRender {
    /// The frame's index in the sequence.
    pub frame_index: usize,
    /// Colour.
    pub color: ColorImage,
    /// Depth in metres, 0 where nothing is visible.
    pub depth: DepthImage,
    /// Most likely label; background where nothing is visible.
    pub label: LabelMap,
    /// Accumulated opacity, 0 to 1.
    pub alpha: Image<f32>,
}

/// Returns the state of a trainer with `model` and fresh moments: for [`Trainer::restore`] of a trainer with
/// `model.classifier.classes` classes (at least one).
pub(crate) fn state_of_model(model: &GaussianModel) -> TrainState {
    let c = &model.classifier;
    let mut parameters = Parameters::new(c.classes.max(1), Seed(0));
    if c.classes > 0 {
        let values = [&c.w1, &c.b1, &c.w2, &c.b2].into_iter().flatten().copied().collect();
        parameters.classifier = ClassifierState::without_moments(c.classes, values);
    }
    parameters.insert(&seedlings_of(model));
    parameters.encode()
}

/// Renders frames of `sequence` from `model` on the CPU. Indices beyond the sequence are left out.
pub fn render_views(model: &GaussianModel, sequence: &Sequence, frames: &[usize]) -> Vec<ViewRender> {
    let mut trainer = CpuTrainer::new(&TrainConfig::default(), model.classifier.classes.max(1), Seed(0));
    // A state made from a model is valid, unless the model has a number that is not finite. Such a model is not
    // rendered.
    if trainer.restore(&state_of_model(model)).is_err() {
        return Vec::new();
    }
    trainer.set_background(model.background);
    let known = frames.iter().filter_map(|&i| sequence.frames.get(i).map(|f| (i, f)));
    known
        .map(|(frame_index, frame)| {
            let maps = trainer.render(&frame.camera);
            let (w, h) = (maps.width, maps.height);
            let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
            let label = maps.label.iter().zip(&maps.alpha).map(|(l, a)| if *a >= 0.5 { *l } else { 0 });
            ViewRender {
                frame_index,
                color: Image::from_vec(w, h, maps.color.iter().map(|c| c.map(byte)).collect()),
                label: Image::from_vec(w, h, label.collect()),
                depth: Image::from_vec(w, h, maps.depth),
                alpha: Image::from_vec(w, h, maps.alpha),
            }
        })
        .collect()
}
