//! The interface between the schedule and its back ends: a whole training step instead of single operations.
//!
//! Seeding, schedule, random state and early stopping are above this trait and shared by all back ends. Parameters and
//! Adam moments are below it, on the device.

use crate::harmonics::Harmonics;
use crate::parameters::Parameters;
use crate::{AFFINITY_DIM, GaussianModel, LearningRates, LossWeights};
use glamx::{Quat, Vec3};
use serde::{Deserialize, Serialize};
use sms_core::{Camera, CoreError};

/// One observed view, at training resolution. All buffers are row-major with `camera.intrinsics` size.
#[derive(Debug, Clone)]
pub struct TrainFrame {
    /// The camera.
    pub camera: Camera,
    /// Colour, sRGB values scaled to 0..1.
    pub color: Vec<[f32; 3]>,
    /// Depth in metres, 0 where unknown.
    pub depth: Vec<f32>,
    /// Unit normals in the world facing the camera, zero where unknown.
    pub normal_w: Vec<[f32; 3]>,
    /// Labels; `u16::MAX` for pixels excluded from segmentation.
    pub label: Vec<u16>,
}

/// A Gaussian to be inserted, in natural units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seedling {
    /// Centre in the world, metres.
    pub position_w: Vec3,
    /// Rotation from the Gaussian's axes to the world; the third axis is the disc's normal.
    pub rotation_wg: Quat,
    /// Standard deviations, metres.
    pub scale: Vec3,
    /// Opacity in (0, 1).
    pub opacity: f32,
    /// Colour, 0..1.
    pub color: [f32; 3],
    /// View-dependent part of the colour; zeros for none.
    pub harmonics: Harmonics,
    /// Affinity feature.
    pub affinity: [f32; AFFINITY_DIM],
}

/// The terms of the loss (paper, Section "Scan"): unweighted and averaged as in the paper.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct LossTerms {
    /// Mean absolute colour error.
    pub color_l1: f32,
    /// 1 − SSIM.
    pub dssim: f32,
    /// Isotropic regulariser.
    pub isotropic: f32,
    /// Depth L1, metres, over valid pixels.
    pub depth: f32,
    /// Normal L1 over valid pixels.
    pub normal: f32,
    /// Mean smallest scale, metres.
    pub flat: f32,
    /// Cross-entropy, nats.
    pub segmentation: f32,
    /// The weighted total that was minimized.
    pub total: f32,
}

impl LossTerms {
    /// Adds every term of `terms` times `share`.
    pub fn add(&mut self, terms: &Self, share: f32) {
        self.color_l1 += terms.color_l1 * share;
        self.dssim += terms.dssim * share;
        self.isotropic += terms.isotropic * share;
        self.depth += terms.depth * share;
        self.normal += terms.normal * share;
        self.flat += terms.flat * share;
        self.segmentation += terms.segmentation * share;
        self.total += terms.total * share;
    }

    /// Sets the total to the weighted sum of the other terms.
    #[must_use]
    pub fn with_total(self, w: &LossWeights) -> Self {
        let total = w.color * ((1.0 - w.ssim) * self.color_l1 + w.ssim * self.dssim)
            + w.isotropic * self.isotropic
            + w.depth * self.depth
            + w.normal * self.normal
            + w.flat * self.flat
            + w.segmentation * self.segmentation;
        Self { total, ..self }
    }
}

/// Result of a batch of steps: the terms averaged over the batch.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct StepStats {
    /// Mean loss terms.
    pub loss: LossTerms,
    /// Steps taken.
    pub steps: u32,
}

/// Steps submitted together: first those with reported losses, then the others.
#[derive(Debug, Clone, PartialEq)]
pub struct StepBatch {
    /// Learning rates of all of them.
    pub rates: LearningRates,
    /// Frames of the steps with reported losses, in order.
    pub own: Vec<FrameId>,
    /// Frames of the steps after them.
    pub replayed: Vec<FrameId>,
}

/// Rendered images of one camera, row-major.
#[derive(Debug, Clone, Default)]
pub struct RenderedMaps {
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// Colour.
    pub color: Vec<[f32; 3]>,
    /// Accumulated opacity, 0..1.
    pub alpha: Vec<f32>,
    /// Median depth in metres: that of the splat at which half of the accumulated opacity is reached; 0 where nothing
    /// is visible. The mean depth, which training minimizes, lies between surfaces at silhouettes and behind faint
    /// splats. On two sets of held-out views of noisy billiards scans, the mean absolute error was 2.3 and 2.1 mm (mean
    /// depth: 2.9 and 2.5 mm), and 1.6 and 2.2 mm on objects (mean depth: 4.7 mm).
    pub depth: Vec<f32>,
    /// World normals, not normalised.
    pub normal_w: Vec<[f32; 3]>,
    /// Most likely label.
    pub label: Vec<u16>,
}

impl RenderedMaps {
    /// Resizes all maps; new pixels are zero.
    pub fn resize(&mut self, width: usize, height: usize) {
        let pixels = width * height;
        (self.width, self.height) = (width, height);
        self.color.resize(pixels, [0.0; 3]);
        self.alpha.resize(pixels, 0.0);
        self.depth.resize(pixels, 0.0);
        self.normal_w.resize(pixels, [0.0; 3]);
        self.label.resize(pixels, 0);
    }
}

/// The state needed to continue training exactly: parameters in the optimiser's own units, moments, step counts.
/// All back ends share the same layout.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TrainState {
    /// Bytes of the state (little-endian, versioned by their first word).
    pub bytes: Vec<u8>,
}

/// Errors of a back end.
#[derive(Debug, thiserror::Error)]
pub enum TrainerError {
    /// The state was written by another version or is damaged.
    #[error("the checkpoint does not fit this program: {0}")]
    BadState(String),
    /// The device was lost or ran out of memory ([`Trainer::failure`]).
    #[error("the device failed ({0}); run again to go on from the last checkpoint, on any device")]
    Device(String),
    /// Files or interruption.
    #[error(transparent)]
    Core(#[from] CoreError),
}

impl TrainerError {
    /// A state with a number that is not finite.
    pub fn not_finite() -> Self {
        Self::BadState("it holds a number that is not finite".to_owned())
    }
}

/// Index of a frame given to [`Trainer::add_frame`].
pub type FrameId = usize;

/// A back end: owns parameters and moments, and takes whole training steps.
pub trait Trainer: Send {
    /// Makes a view available to [`Trainer::steps`]; ids count from 0.
    fn add_frame(&mut self, frame: TrainFrame) -> FrameId;
    /// Number of Gaussians.
    fn len(&self) -> usize;
    /// Whether there are none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }
    /// Appends Gaussians with zeroed moments.
    fn insert(&mut self, seedlings: &[Seedling]);
    /// Keeps only Gaussians whose entry is true; order is kept. `mask.len() == self.len()`.
    fn retain(&mut self, mask: &[bool]);
    /// Takes one step per entry, in order.
    fn steps(&mut self, frames: &[FrameId]) -> StepStats;
    /// Calls [`Trainer::set_rates`] and takes all steps of the batches, one batch after the other. Returns the
    /// statistics of the batches' own steps. Also adds the frame made by `next`, if any, and returns its id. A device
    /// may report a batch only when the next one starts, and may take steps while the frame is made and added.
    fn batches(
        &mut self,
        batches: &[StepBatch],
        next: &dyn Fn() -> Option<TrainFrame>,
    ) -> (Vec<StepStats>, Option<FrameId>) {
        let take = |batch: &StepBatch| {
            self.set_rates(&batch.rates);
            let stats = self.steps(&batch.own);
            if !batch.replayed.is_empty() {
                self.steps(&batch.replayed);
            }
            stats
        };
        let stats = batches.iter().map(take).collect();
        (stats, next().map(|frame| self.add_frame(frame)))
    }
    /// Sets the constant colour b behind all Gaussians (0 to 1; initially black): a pixel shows Σ c·α·T + T_final·b, in
    /// training and rendering alike. It is neither learned nor part of the state: callers must set it first.
    fn set_background(&mut self, rgb: [f32; 3]);
    /// Replaces the learning rates from the next step on; initially they are those of [`crate::TrainConfig`]. They
    /// are not part of the state.
    fn set_rates(&mut self, rates: &LearningRates);
    /// Renders a view (no gradients).
    fn render(&mut self, camera: &Camera) -> RenderedMaps;
    /// Returns maps that are no longer needed, to reuse their memory.
    fn recycle(&mut self, maps: RenderedMaps) {
        drop(maps);
    }
    /// Opacities in order.
    fn opacities(&self) -> Vec<f32>;
    /// Centres in order.
    fn positions_w(&self) -> Vec<Vec3>;
    /// Centres and opacities in order, with a single transfer from a device.
    fn places(&self) -> (Vec<Vec3>, Vec<f32>) {
        (self.positions_w(), self.opacities())
    }
    /// The model in natural units with labels filled in.
    fn model(&self) -> GaussianModel;
    /// The whole state, for a checkpoint.
    fn snapshot(&self) -> TrainState;
    /// Continues from a checkpoint (frames are added again by the caller).
    ///
    /// # Errors
    /// [`TrainerError::BadState`].
    fn restore(&mut self, state: &TrainState) -> Result<(), TrainerError>;
    /// Changes the state. The numbers of Gaussians and of classes must stay the same.
    fn edit(&mut self, change: &mut dyn FnMut(&mut Parameters)) -> Result<(), TrainerError> {
        let mut parameters = Parameters::decode(&self.snapshot())?;
        change(&mut parameters);
        self.restore(&parameters.encode())
    }
    /// Returns the failure of the device, if any: it was lost, or ran out of memory. All results of the trainer are
    /// invalid afterwards.
    fn failure(&self) -> Option<String> {
        None
    }
}
