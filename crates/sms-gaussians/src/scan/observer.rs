//! Observation of a running scan, for live viewers.

use super::evaluate::ViewScore;
use super::losses::LossSample;
use crate::{GaussianModel, RenderedMaps};
use sms_frames::Frame;

/// Receives the progress of a scan. Observers cannot change the result. Calls come from the scanning thread and
/// should be short.
pub trait ScanObserver {
    /// The scan continues an interrupted one. Called before the first batch.
    fn resumed(&mut self, resumed: &ScanResumed) {
        let _ = resumed;
    }

    /// A recording that was followed is complete: what was seen so far is a map that grew ([`super::GrowingScan`]) in the recording's own
    /// world, and the scan of all frames begins.
    fn completed(&mut self) {}

    /// A batch of steps was taken.
    fn batch(&mut self, batch: &BatchDone) {
        let _ = batch;
    }

    /// A frame, or the refinement over all frames, is done.
    fn slot(&mut self, slot: &SlotDone<'_>) {
        let _ = slot;
    }
}

/// No observer.
impl ScanObserver for () {}

/// The position at which a scan is resumed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ScanResumed {
    /// Index of the frame among those trained on; their number in the refinement.
    pub slot: usize,
    /// Number of frames trained on.
    pub frames: usize,
    /// Steps since the start of the scan.
    pub steps: u64,
}

/// A batch of steps.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BatchDone {
    /// Losses and number of Gaussians.
    pub sample: LossSample,
    /// Index of the current frame among those trained on; their number in the refinement.
    pub slot: usize,
    /// Number of frames trained on.
    pub frames: usize,
    /// Steps taken in this slot.
    pub step: usize,
    /// Most steps of this slot.
    pub steps: usize,
    /// Seconds left of the whole scan; `None` before an estimate is possible.
    pub seconds_left: Option<f64>,
}

/// A finished frame, or the finished refinement.
pub struct SlotDone<'a> {
    /// Index of the frame among those trained on; their number for the refinement.
    pub slot: usize,
    /// Number of frames trained on.
    pub frames: usize,
    /// Steps since the start of the scan.
    pub step: u64,
    /// The frame as observed (for the refinement, the last one).
    pub frame: &'a Frame,
    /// The current rendering of the same view.
    pub rendered: &'a RenderedMaps,
    /// Agreement of frame and rendering.
    pub score: ViewScore,
    /// Builds the current model on demand.
    pub model: &'a dyn Fn() -> GaussianModel,
}
