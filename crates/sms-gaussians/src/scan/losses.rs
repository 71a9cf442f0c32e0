//! The history of the losses, and early stopping.

use super::config::StopConfig;
use crate::LossTerms;
use serde::{Deserialize, Serialize};

/// Mean losses of one batch of steps on one frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LossSample {
    /// Steps taken since the start of the scan, this batch included.
    pub step: u64,
    /// The current frame of the schedule (index in the sequence); `None` in the refinement over all frames.
    pub frame: Option<usize>,
    /// Mean loss terms on that frame (over all frames in the refinement).
    pub loss: LossTerms,
    /// Number of Gaussians.
    pub gaussians: usize,
}

/// Returns whether the losses of a slot's batches have stalled: the mean of the last window is not lower than the mean
/// of the window before by the required share.
pub(crate) fn stalled(batch_losses: &[f32], settings: &StopConfig) -> bool {
    let window = settings.window.max(1);
    if !settings.enabled || batch_losses.len() < 2 * window {
        return false;
    }
    let mean = |values: &[f32]| values.iter().sum::<f32>() / values.len() as f32;
    let (before, last) = batch_losses[batch_losses.len() - 2 * window..].split_at(window);
    mean(before) - mean(last) < settings.min_gain * mean(before)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn falling_losses_go_on_and_level_ones_stop() {
        let settings = StopConfig { enabled: true, window: 2, min_gain: 0.05 };
        assert!(!stalled(&[1.0, 1.0, 1.0], &settings), "too few to tell");
        assert!(stalled(&[1.0, 1.0, 1.0, 1.0], &settings));
        assert!(!stalled(&[1.0, 0.9, 0.8, 0.7], &settings));
        assert!(stalled(&[5.0, 1.0, 0.99, 0.98, 0.97], &settings));
        assert!(!stalled(&[1.0; 8], &StopConfig { enabled: false, ..settings }));
    }
}
