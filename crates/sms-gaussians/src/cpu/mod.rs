//! The CPU back end.

use crate::parameters::{LOGIT_OPACITY, POSITION, Parameters, sigmoid};
use crate::{
    Classifier, FrameId, GaussianModel, RenderedMaps, Seedling, StepStats, TrainConfig, TrainFrame,
    TrainState, Trainer, TrainerError,
};
use glamx::Vec3;
use sms_core::{Camera, Seed};

/// [`Trainer`] on the CPU.
pub struct CpuTrainer {
    config: TrainConfig,
    parameters: Parameters,
    frames: Vec<TrainFrame>,
}

impl CpuTrainer {
    /// A trainer without Gaussians for `classes` classes, the background included; the classifier starts from `seed`.
    pub fn new(config: &TrainConfig, classes: usize, seed: Seed) -> Self {
        Self { config: *config, parameters: Parameters::new(classes, seed), frames: Vec::new() }
    }
}

impl Trainer for CpuTrainer {
    fn add_frame(&mut self, frame: TrainFrame) -> FrameId {
        self.frames.push(frame);
        self.frames.len() - 1
    }

    fn len(&self) -> usize {
        self.parameters.rows.len()
    }

    fn insert(&mut self, seedlings: &[Seedling]) {
        self.parameters.insert(seedlings);
    }

    fn retain(&mut self, mask: &[bool]) {
        self.parameters.retain(mask);
    }

    fn steps(&mut self, _frames: &[FrameId]) -> StepStats {
        let _ = self.config;
        StepStats::default()
    }

    fn render(&mut self, camera: &Camera) -> RenderedMaps {
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        RenderedMaps {
            width,
            height,
            color: vec![[0.0; 3]; width * height],
            alpha: vec![0.0; width * height],
            depth: vec![0.0; width * height],
            normal_w: vec![[0.0; 3]; width * height],
            label: vec![0; width * height],
        }
    }

    fn opacities(&self) -> Vec<f32> {
        self.parameters.rows.iter().map(|r| sigmoid(r.0[LOGIT_OPACITY])).collect()
    }

    fn positions_w(&self) -> Vec<Vec3> {
        self.parameters.rows.iter().map(|r| Vec3::from_slice(&r.0[POSITION..])).collect()
    }

    fn classifier(&self) -> Classifier {
        self.parameters.classifier.classifier()
    }

    fn model(&self) -> GaussianModel {
        self.parameters.model()
    }

    fn snapshot(&self) -> TrainState {
        self.parameters.encode()
    }

    fn restore(&mut self, state: &TrainState) -> Result<(), TrainerError> {
        let parameters = Parameters::decode(state)?;
        if parameters.classifier.classes != self.parameters.classifier.classes {
            return Err(TrainerError::BadState(format!(
                "it has {} classes, the masks have {}",
                parameters.classifier.classes, self.parameters.classifier.classes
            )));
        }
        self.parameters = parameters;
        Ok(())
    }
}
