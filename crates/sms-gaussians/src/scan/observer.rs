//! Watching a scan from outside: what a live viewer needs, without the schedule knowing of any.

use super::evaluate::ViewScore;
use super::losses::LossSample;
use crate::{GaussianModel, RenderedMaps};
use sms_frames::Frame;

/// Is told of a scan while it runs. It sees everything and changes nothing: a scan has the same result whoever
/// watches. Calls come from the scanning thread and should be short.
pub trait ScanObserver {
    /// A batch of steps was taken.
    fn batch(&mut self, batch: &BatchDone) {
        let _ = batch;
    }

    /// A frame, or the refinement over all frames, is done.
    fn slot(&mut self, slot: &SlotDone<'_>) {
        let _ = slot;
    }
}

/// Nobody watches.
impl ScanObserver for () {}

/// A batch of steps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BatchDone {
    /// Losses and number of Gaussians.
    pub sample: LossSample,
    /// Which of the frames trained on the schedule is at, from 0; their number in the refinement.
    pub slot: usize,
    /// Frames trained on.
    pub frames: usize,
    /// Steps taken in this slot.
    pub step: usize,
    /// Most steps of this slot.
    pub steps: usize,
    /// Seconds left of the whole scan; `None` before that can be told.
    pub seconds_left: Option<f64>,
}

/// A frame that is done, or the refinement.
pub struct SlotDone<'a> {
    /// Which of the frames trained on, from 0; their number for the refinement.
    pub slot: usize,
    /// Frames trained on.
    pub frames: usize,
    /// Steps since the start of the scan.
    pub step: u64,
    /// The frame as observed (of the refinement: the last one).
    pub frame: &'a Frame,
    /// The same view as rendered now.
    pub rendered: &'a RenderedMaps,
    /// How well they agree.
    pub score: ViewScore,
    /// The Gaussians as they are now; made only when asked for.
    pub model: &'a dyn Fn() -> GaussianModel,
}
